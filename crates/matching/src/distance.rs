//! The distance of descriptors.

use tiepoint_features::SiftDescriptor;

/// Squared Euclidean distance, exact.
pub(crate) fn squared_distance(a: &SiftDescriptor, b: &SiftDescriptor) -> u32 {
    a.iter().zip(b).map(|(&x, &y)| u32::from(x.abs_diff(y)).pow(2)).sum()
}
