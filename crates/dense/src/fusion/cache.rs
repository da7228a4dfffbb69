//! Images in memory, and which of their pixels are in the cloud already.

use std::collections::BTreeMap;

use super::image::FusionImage;

/// Images in memory, bounded in number; the least recently used one goes first.
pub(super) struct Cache {
    capacity: usize,
    clock: u64,
    images: BTreeMap<usize, (u64, FusionImage)>,
    /// Pixels that are in the cloud, one bit each, of images that a later one may need.
    covered: BTreeMap<usize, Vec<u64>>,
}

impl Cache {
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity, clock: 0, images: BTreeMap::new(), covered: BTreeMap::new() }
    }

    /// Loads an image and as many of its neighbours, in order, as there is room for.
    pub(super) fn require<E>(
        &mut self,
        index: usize,
        others: &[usize],
        load: &mut impl FnMut(usize) -> Result<FusionImage, E>,
    ) -> Result<(), E> {
        self.clock += 1;
        let wanted: Vec<usize> =
            std::iter::once(index).chain(others.iter().copied()).take(self.capacity).collect();
        for image in &wanted {
            if let Some((used, _)) = self.images.get_mut(image) {
                *used = self.clock;
            }
        }
        for image in wanted {
            if self.images.contains_key(&image) {
                continue;
            }
            while self.images.len() >= self.capacity {
                let oldest = self.images.iter().min_by_key(|(image, (used, _))| (*used, **image));
                let Some(oldest) = oldest.map(|(image, _)| *image) else { break };
                self.images.remove(&oldest);
            }
            let mut loaded = load(image)?;
            if let Some(covered) = self.covered.get(&image) {
                loaded.covered.clone_from(covered);
            }
            self.images.insert(image, (self.clock, loaded));
        }
        Ok(())
    }

    /// An image that [`Cache::require`] loaded.
    pub(super) fn get(&self, index: usize) -> &FusionImage {
        &self.images[&index].1
    }

    /// An image, if the last [`Cache::require`] asked for it.
    pub(super) fn find(&self, index: usize) -> Option<&FusionImage> {
        self.images.get(&index).filter(|(used, _)| *used == self.clock).map(|(_, image)| image)
    }

    /// Notes the pixels of an image that are in the cloud.
    pub(super) fn set_covered(&mut self, index: usize, is_covered: Vec<bool>) {
        let word = |bits: &[bool]| {
            bits.iter().enumerate().fold(0, |word, (bit, is_set)| word | u64::from(*is_set) << bit)
        };
        let covered: Vec<u64> = is_covered.chunks(64).map(word).collect();
        if let Some((_, image)) = self.images.get_mut(&index) {
            image.covered.clone_from(&covered);
        }
        self.covered.insert(index, covered);
    }

    /// Forgets the images that no visit after `index` needs.
    pub(super) fn forget_unused(&mut self, index: usize, last_use: &[usize]) {
        self.images.retain(|image, _| last_use[*image] > index);
        self.covered.retain(|image, _| last_use[*image] > index);
    }
}
