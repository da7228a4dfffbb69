//! Exact nearest and second nearest neighbours by brute force, in both directions.
//!
//! The squared distance is `|a|² + |b|² − 2 a·b`, so the computation is a matrix product of bytes.
//! It is divided into tiles whose products stay in registers. Each product updates the two largest
//! values of its row and of its column: one product serves both directions, and the N × N matrix is
//! not stored.
//!
//! - `kernel` is the loop over tiles, generic over the trait `KeyLanes`.
//! - `screen` is the loop over tiles of compressed descriptors, which only finds the pairs that may
//!   be near each other, generic over the trait `ScoreLanes`.
//! - `lanes` has the traits and their portable implementation.
//! - `x86` has the implementations for AVX-512 VNNI, AVX-VNNI and AVX2.
//! - `isa` selects the implementation at run time. All give the same result, because the arithmetic
//!   is exact in integers.

mod isa;
mod kernel;
mod lanes;
mod screen;
#[cfg(target_arch = "x86_64")]
mod x86;

use crate::matches::Nearest;
use crate::prepared::Prepared;

pub use isa::Isa;
pub(crate) use isa::Kind;

/// The nearest neighbours between the descriptors of two images, in both directions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NearestBothWays {
    /// For every descriptor of the first image, its neighbours in the second.
    pub of_a: Vec<Nearest>,
    /// For every descriptor of the second image, its neighbours in the first.
    pub of_b: Vec<Nearest>,
}

/// The exact two nearest neighbours of every descriptor, in both directions, by brute force on the
/// fastest instruction set of the CPU.
pub fn nearest(a: &Prepared, b: &Prepared) -> NearestBothWays {
    nearest_on(Isa::best(), a, b)
}

/// As [`nearest`] on a given instruction set, for tests and measurements.
pub fn nearest_on(isa: Isa, a: &Prepared, b: &Prepared) -> NearestBothWays {
    let [of_a, of_b] = isa.compare_all(a, &b.pack());
    NearestBothWays { of_a, of_b }
}

#[cfg(test)]
mod tests {
    use tiepoint_features::SiftDescriptor;

    use super::{Isa, nearest_on};
    use crate::distance::squared_distance;
    use crate::prepared::Prepared;
    use crate::random::stream;

    /// Small enough for Miri and sanitizers: two tiles with padding and an incomplete block of
    /// rows.
    #[test]
    fn few_descriptors_match_the_definition() {
        let mut random = stream(3, 0);
        let mut some = |count: usize| -> Vec<SiftDescriptor> {
            (0..count).map(|_| std::array::from_fn(|_| random.below(256) as u8)).collect()
        };
        let (a, b) = (some(13), some(67));
        for isa in Isa::supported() {
            let found = nearest_on(isa, &Prepared::new(&a), &Prepared::new(&b));
            for (from, to, found) in [(&a, &b, &found.of_a), (&b, &a, &found.of_b)] {
                for (descriptor, nearest) in from.iter().zip(found) {
                    let mut distances: Vec<u32> =
                        to.iter().map(|other| squared_distance(descriptor, other)).collect();
                    assert_eq!(distances[nearest.index as usize], nearest.distance, "{isa}");
                    distances.sort_unstable();
                    assert_eq!(distances[..2], [nearest.distance, nearest.second], "{isa}");
                }
            }
        }
    }
}
