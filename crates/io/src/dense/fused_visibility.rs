//! `fused.ply.vis` of COLMAP: the images that see each point of `fused.ply`. The number of points
//! as u64, then for each point the number of images and their indices as u32. An index is the
//! place of the image in the model, in order of the ids.

use std::path::Path;

use crate::Result;
use crate::counted_file::CountedFile;

/// Writes the images of points one after the other.
#[derive(Debug)]
pub struct FusedVisibility(CountedFile);

impl FusedVisibility {
    /// Begins a new file; the path must not exist.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        CountedFile::create(path).map(Self)
    }

    /// Writes the images of the next point.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn push(&mut self, images: &[u32]) -> Result<()> {
        let numbers = std::iter::once(images.len() as u32).chain(images.iter().copied());
        let record: Vec<u8> = numbers.flat_map(u32::to_le_bytes).collect();
        self.0.push(&record)
    }

    /// Writes the number of points, and waits until the file is on the disk.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn finish(self) -> Result<()> {
        let count = self.0.count;
        self.0.finish(&count.to_le_bytes())
    }
}
