//! Descriptors of one image, made ready once for all images that it is matched with.
//!
//! The brute-force kernel wants sixteen descriptors to a panel. Within it the bytes are transposed in groups of four, so that one
//! vector load gives the same four bytes of sixteen (or eight) descriptors: what a `u8 × i8` dot-product instruction wants. What
//! is kept packed that way is the short form of the descriptors by which most pairs are ruled out (`screen`); whole descriptors
//! are kept as they come and packed when they are needed, which takes a hundredth of the time of comparing them.

use tiepoint_features::{Descriptor, Features};

use crate::forest::{Forest, ForestOptions};
use crate::screen::Screen;

/// Descriptors in a panel.
pub(crate) const PANEL: usize = 16;
/// Panels in the widest tile of the kernel; lists of panels are filled up to a multiple of it.
pub(crate) const TILE: usize = 4;
/// Groups of four bytes in a descriptor.
pub(crate) const GROUPS: usize = 32;

/// Vectors of `G` groups of four bytes, which are compared with each other.
pub(crate) trait Vectors<const G: usize> {
    /// How many.
    fn len(&self) -> usize;
    /// Group `group` of vector `index`, four bytes as a little-endian word.
    fn word(&self, index: usize, group: usize) -> u32;
    /// `|x|²` of vector `index`.
    fn square(&self, index: usize) -> i32;
}

/// Sixteen vectors, `[group][vector]`, each group of four bytes as a little-endian word.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub(crate) struct Panel<const G: usize>(pub(crate) [[u32; PANEL]; G]);

/// Vectors packed as the columns of the kernel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Packed<const G: usize> {
    pub(crate) len: usize,
    pub(crate) panels: Vec<Panel<G>>,
    /// `|x|²` of every vector.
    pub(crate) squares: Vec<i32>,
    /// Sum of the entries of every vector.
    pub(crate) sums: Vec<i32>,
}

impl<const G: usize> Packed<G> {
    /// Packs `len` vectors, whose groups of four bytes `vector` gives.
    pub(crate) fn new(len: usize, mut vector: impl FnMut(usize) -> [[u8; 4]; G]) -> Self {
        let count = len.div_ceil(PANEL).next_multiple_of(TILE);
        let mut panels = vec![Panel([[0; PANEL]; G]); count];
        let (mut squares, mut sums) = (Vec::with_capacity(len), Vec::with_capacity(len));
        for index in 0..len {
            let vector = vector(index);
            let panel = &mut panels[index / PANEL];
            for (words, bytes) in panel.0.iter_mut().zip(&vector) {
                words[index % PANEL] = u32::from_le_bytes(*bytes);
            }
            squares.push(square(vector.as_flattened()));
            sums.push(vector.as_flattened().iter().map(|&x| i32::from(x)).sum());
        }
        Packed { len, panels, squares, sums }
    }
}

impl<const G: usize> Vectors<G> for Packed<G> {
    fn len(&self) -> usize {
        self.len
    }
    #[inline]
    fn word(&self, index: usize, group: usize) -> u32 {
        self.panels[index / PANEL].0[group][index % PANEL]
    }
    fn square(&self, index: usize) -> i32 {
        self.squares[index]
    }
}

fn square(bytes: &[u8]) -> i32 {
    bytes.iter().map(|&x| i32::from(x) * i32::from(x)).sum()
}

/// The descriptors of one image, ready to be matched against those of many others.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    pub(crate) descriptors: Vec<Descriptor>,
    /// Their short form.
    pub(crate) screen: Screen,
    /// The features of largest scale, for preemptive matching; in descending order of scale.
    pub(crate) leading: Option<Box<Prepared>>,
    /// Randomized kd-trees, where wanted.
    pub(crate) forest: Option<Forest>,
}

impl Prepared {
    /// Packs descriptors. Their indices stay what they are in the slice.
    pub fn new(descriptors: &[Descriptor]) -> Self {
        Prepared {
            descriptors: descriptors.to_vec(),
            screen: Screen::new(descriptors),
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
        self.forest = Some(Forest::new(&self.descriptors, options));
    }

    /// How many descriptors there are.
    pub fn len(&self) -> usize {
        self.descriptors.len()
    }

    /// Whether there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.descriptors.is_empty()
    }

    /// Some of the descriptors, packed whole.
    pub(crate) fn pack(&self, indices: &[u32]) -> Packed<GROUPS> {
        Packed::new(indices.len(), |i| groups(&self.descriptors[indices[i] as usize]))
    }

    /// All descriptors, packed whole.
    pub(crate) fn pack_all(&self) -> Packed<GROUPS> {
        Packed::new(self.len(), |i| groups(&self.descriptors[i]))
    }
}

fn groups(descriptor: &Descriptor) -> [[u8; 4]; GROUPS] {
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
    fn square(&self, index: usize) -> i32 {
        square(&self.descriptors[index])
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
        let packed = prepared.pack_all();
        assert_eq!((prepared.len(), packed.panels.len()), (37, 4));
        for (i, descriptor) in descriptors.iter().enumerate() {
            let bytes = |vectors: &dyn Vectors<GROUPS>| -> Vec<u8> {
                (0..GROUPS).flat_map(|g| vectors.word(i, g).to_le_bytes()).collect()
            };
            assert_eq!(bytes(&packed), descriptor);
            assert_eq!(bytes(&prepared), descriptor);
            assert_eq!(packed.square(i), prepared.square(i));
            assert_eq!(packed.sums[i], descriptor.iter().map(|&x| i32::from(x)).sum::<i32>());
        }
        let some = prepared.pack(&[36, 5]);
        assert_eq!(
            (some.len, some.word(0, 7), some.word(1, 31)),
            (2, packed.word(36, 7), packed.word(5, 31))
        );
        prepared.grow_forest(&ForestOptions::default());
        let found = prepared.forest.unwrap().nearest(&descriptors, crate::Checks::Total(1000));
        assert!(
            found.iter().enumerate().all(|(i, nearest)| (nearest.index, nearest.distance) == (i as u32, 0))
        );
    }
}
