//! Descriptors of one image, packed once for the brute-force kernel.
//!
//! Sixteen descriptors make a panel. Within it the bytes are transposed in groups of four, so that one vector load gives
//! the same four bytes of sixteen (or eight) descriptors: what a `u8 × i8` dot-product instruction wants. Matching one
//! image against eighty neighbours in a video packs it once, and grows its forest once if it is searched that way.

use tiepoint_features::{Descriptor, Features};

use crate::forest::{Forest, ForestOptions};

/// Descriptors in a panel.
pub(crate) const PANEL: usize = 16;
/// Panels in the widest tile of the kernel; lists of panels are filled up to a multiple of it.
pub(crate) const TILE: usize = 4;
/// Groups of four bytes in a descriptor.
pub(crate) const GROUPS: usize = 32;

/// Sixteen descriptors, `[group][descriptor]`, each group of four bytes as a little-endian word.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub(crate) struct Panel(pub(crate) [[u32; PANEL]; GROUPS]);

/// The descriptors of one image, ready to be matched against those of many others.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    pub(crate) len: usize,
    pub(crate) panels: Vec<Panel>,
    /// `|x|²` of every descriptor.
    pub(crate) squares: Vec<i32>,
    /// Sum of the entries of every descriptor.
    pub(crate) sums: Vec<i32>,
    /// The features of largest scale, for preemptive matching; in descending order of scale.
    pub(crate) leading: Option<Box<Prepared>>,
    /// Randomized kd-trees, where wanted.
    pub(crate) forest: Option<Forest>,
}

impl Prepared {
    /// Packs descriptors. Their indices stay what they are in the slice.
    pub fn new(descriptors: &[Descriptor]) -> Self {
        let count = descriptors.len().div_ceil(PANEL).next_multiple_of(TILE);
        let mut panels = vec![Panel([[0; PANEL]; GROUPS]); count];
        for (panel, chunk) in panels.iter_mut().zip(descriptors.chunks(PANEL)) {
            for (lane, descriptor) in chunk.iter().enumerate() {
                for (group, bytes) in descriptor.as_chunks::<4>().0.iter().enumerate() {
                    panel.0[group][lane] = u32::from_le_bytes(*bytes);
                }
            }
        }
        Prepared {
            len: descriptors.len(),
            panels,
            squares: descriptors
                .iter()
                .map(|d| d.iter().map(|&x| i32::from(x) * i32::from(x)).sum())
                .collect(),
            sums: descriptors.iter().map(|d| d.iter().map(|&x| i32::from(x)).sum()).collect(),
            leading: None,
            forest: None,
        }
    }

    /// Packs the descriptors of `features`, and those of the `leading` largest keypoints once more, so that pairs can be
    /// tried on them first ([`crate::Preempt`], which says what 1024 of them lose).
    pub fn from_features(features: &Features, leading: usize) -> Self {
        let mut order: Vec<usize> = (0..features.descriptors.len().min(features.keypoints.len())).collect();
        order.sort_by(|&i, &j| {
            features.keypoints[j].scale.total_cmp(&features.keypoints[i].scale).then(i.cmp(&j))
        });
        let largest: Vec<Descriptor> = order.iter().take(leading).map(|&i| features.descriptors[i]).collect();
        Prepared { leading: Some(Box::new(Prepared::new(&largest))), ..Prepared::new(&features.descriptors) }
    }

    /// Grows randomized kd-trees for [`crate::Method::Forest`].
    pub fn grow_forest(&mut self, options: &ForestOptions) {
        let descriptors: Vec<Descriptor> = (0..self.len)
            .map(|index| {
                let mut descriptor = [0; 128];
                for (group, bytes) in descriptor.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                    *bytes = self.word(index, group).to_le_bytes();
                }
                descriptor
            })
            .collect();
        self.forest = Some(Forest::new(&descriptors, options));
    }

    /// How many descriptors there are.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Group `group` of descriptor `index`, four bytes as a little-endian word.
    #[inline]
    pub(crate) fn word(&self, index: usize, group: usize) -> u32 {
        self.panels[index / PANEL].0[group][index % PANEL]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_hold_every_byte() {
        // 37 descriptors: two full panels, a part of one, and one to fill up.
        let descriptors: Vec<Descriptor> =
            (0..37u32).map(|i| std::array::from_fn(|k| (i * 131 + k as u32 * 7) as u8)).collect();
        let mut prepared = Prepared::new(&descriptors);
        assert_eq!((prepared.len(), prepared.panels.len()), (37, 4));
        for (i, descriptor) in descriptors.iter().enumerate() {
            let bytes: Vec<u8> = (0..GROUPS).flat_map(|g| prepared.word(i, g).to_le_bytes()).collect();
            assert_eq!(bytes, descriptor);
            assert_eq!(prepared.sums[i], descriptor.iter().map(|&x| i32::from(x)).sum::<i32>());
        }
        prepared.grow_forest(&ForestOptions::default());
        let found = prepared.forest.unwrap().nearest(&descriptors, crate::Checks::Total(1000));
        assert!(
            found.iter().enumerate().all(|(i, nearest)| (nearest.index, nearest.distance) == (i as u32, 0))
        );
    }
}
