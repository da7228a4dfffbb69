//! Precomputed data of the descriptors of an image for matching with several images.
//!
//! Compressed descriptors (`compressed`), which exclude most candidates, are stored packed for the
//! brute-force kernel (`packed`). Full descriptors are packed when they are needed, which takes a
//! hundredth of the time of comparing them.

use tiepoint_features::{Keypoint, SiftDescriptor};

use crate::compressed::CompressedDescriptors;
use crate::forest::{Forest, ForestOptions};
use crate::packed::{Packed, Vectors};

/// Number of groups of four bytes in a descriptor.
const GROUPS: usize = 32;

/// The SIFT descriptors of an image with precomputed data for matching.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    pub(crate) descriptors: Vec<SiftDescriptor>,
    /// Compressed descriptors.
    pub(crate) compressed: CompressedDescriptors,
    /// The features of the largest scales, in descending order, for preemptive matching.
    pub(crate) leading: Option<Box<Prepared>>,
    /// Randomized kd-trees, if grown.
    pub(crate) forest: Option<Forest>,
}

impl Prepared {
    /// Prepares descriptors. Indices of matches are indices of `descriptors`.
    pub fn new(descriptors: &[SiftDescriptor]) -> Self {
        Prepared {
            descriptors: descriptors.to_vec(),
            compressed: CompressedDescriptors::new(descriptors),
            leading: None,
            forest: None,
        }
    }

    /// Prepares descriptors, and those with the indices `leading` for preemptive matching
    /// ([`crate::PreemptiveMatching`]).
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn with_leading(descriptors: &[SiftDescriptor], leading: &[usize]) -> Self {
        let leading: Vec<SiftDescriptor> = leading.iter().map(|&i| descriptors[i]).collect();
        Prepared { leading: Some(Box::new(Prepared::new(&leading))), ..Prepared::new(descriptors) }
    }

    /// Builds the kd-forest for [`crate::Method::Forest`].
    pub fn grow_forest(&mut self, options: &ForestOptions) {
        self.forest = Some(Forest::new(&self.descriptors, options));
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.descriptors.len()
    }

    /// Whether there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.descriptors.is_empty()
    }

    /// All full descriptors, packed.
    pub(crate) fn pack(&self) -> Packed<GROUPS> {
        Packed::new(self.len(), 0, |i| groups(&self.descriptors[i]))
    }
}

/// The indices of the `count` largest keypoints, in descending order of their scales.
pub(crate) fn largest(keypoints: &[Keypoint], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..keypoints.len()).collect();
    order.sort_by(|&i, &j| keypoints[j].scale.total_cmp(&keypoints[i].scale).then(i.cmp(&j)));
    order.truncate(count);
    order
}

/// The descriptor in groups of four bytes.
fn groups(descriptor: &SiftDescriptor) -> [[u8; 4]; GROUPS] {
    let mut groups = [[0; 4]; GROUPS];
    groups.as_flattened_mut().copy_from_slice(descriptor);
    groups
}

impl Vectors<GROUPS> for Prepared {
    fn len(&self) -> usize {
        self.descriptors.len()
    }
    #[inline]
    fn word(&self, index: usize, group: usize) -> u32 {
        u32::from_le_bytes(self.descriptors[index].as_chunks::<4>().0[group])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_preserves_every_byte() {
        // 37 descriptors: two full panels, one partial panel and one padding panel.
        let descriptors: Vec<SiftDescriptor> =
            (0..37u32).map(|i| std::array::from_fn(|k| (i * 131 + k as u32 * 7) as u8)).collect();
        let mut prepared = Prepared::new(&descriptors);
        let packed = prepared.pack();
        assert_eq!((prepared.len(), packed.panels.len()), (37, 4));
        for (i, descriptor) in descriptors.iter().enumerate() {
            let bytes = |vectors: &dyn Vectors<GROUPS>| -> Vec<u8> {
                (0..GROUPS).flat_map(|g| vectors.word(i, g).to_le_bytes()).collect()
            };
            assert_eq!(bytes(&packed), descriptor);
            assert_eq!(bytes(&prepared), descriptor);
            let term = |&x: &u8| i32::from(x).pow(2) - 256 * i32::from(x);
            assert_eq!(packed.terms[i], descriptor.iter().map(term).sum::<i32>());
        }
        prepared.grow_forest(&ForestOptions::default());
        let found =
            prepared.forest.unwrap().nearest(&descriptors, crate::forest::Checks::Total(1000));
        assert!(
            found
                .iter()
                .enumerate()
                .all(|(i, nearest)| (nearest.index, nearest.distance) == (i as u32, 0))
        );
    }
}
