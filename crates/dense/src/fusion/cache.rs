//! Images in memory, and the marks of their pixels.

use std::collections::BTreeMap;

use super::image::{FusionImage, mark};

/// Images in memory, bounded in number; the least recently used one goes first.
pub(super) struct Cache {
    capacity: usize,
    clock: u64,
    images: BTreeMap<usize, (u64, FusionImage)>,
    /// The marks of images that are needed later.
    marks: BTreeMap<usize, Vec<u64>>,
}

impl Cache {
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity, clock: 0, images: BTreeMap::new(), marks: BTreeMap::new() }
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
            if let Some(marks) = self.marks.get(&image) {
                loaded.marks.clone_from(marks);
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

    /// Replaces the marks of an image.
    pub(super) fn set_marks(&mut self, index: usize, marks: Vec<u64>) {
        if let Some((_, image)) = self.images.get_mut(&index) {
            image.marks.clone_from(&marks);
        }
        self.marks.insert(index, marks);
    }

    /// Marks a pixel of an image in memory.
    pub(super) fn mark(&mut self, index: usize, pixel: usize) {
        if let Some((_, image)) = self.images.get_mut(&index) {
            let words = image.depths.len().div_ceil(64);
            image.marks.resize(words, 0);
            mark(&mut image.marks, pixel);
            mark(self.marks.entry(index).or_insert_with(|| vec![0; words]), pixel);
        }
    }

    /// Forgets the images that no visit after `index` needs.
    pub(super) fn forget_unused(&mut self, index: usize, last_use: &[usize]) {
        self.images.retain(|image, _| last_use[*image] > index);
        self.marks.retain(|image, _| last_use[*image] > index);
    }
}
