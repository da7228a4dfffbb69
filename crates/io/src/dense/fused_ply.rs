//! `fused.ply` of COLMAP: points with normals and colours, binary little-endian. The property
//! `confidence`, which COLMAP's has not, comes last, if the depth maps have confidences.

use std::path::Path;

use crate::Result;
use crate::counted_file::CountedFile;
use crate::ply::header;

/// Writes points one after the other.
#[derive(Debug)]
pub struct FusedPly {
    file: CountedFile,
    has_confidence: bool,
}

impl FusedPly {
    /// Begins a new file; the path must not exist.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn create(path: &Path, has_confidence: bool) -> Result<Self> {
        Ok(Self { file: CountedFile::create(path)?, has_confidence })
    }

    /// Writes a point: position, unit normal, red, green and blue, and the probability that it is
    /// right, which a file without confidences leaves out.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn push(
        &mut self,
        xyz: [f32; 3],
        normal: [f32; 3],
        color: [u8; 3],
        confidence: f32,
    ) -> Result<()> {
        let mut record = [0; 31];
        let numbers = xyz.into_iter().chain(normal).map(f32::to_le_bytes);
        for (bytes, number) in record.as_chunks_mut::<4>().0.iter_mut().zip(numbers) {
            *bytes = number;
        }
        record[24..27].copy_from_slice(&color);
        record[27..].copy_from_slice(&confidence.to_le_bytes());
        self.file.push(if self.has_confidence { &record } else { &record[..27] })
    }

    /// Writes the header, and waits until the file is on the disk. Returns the number of points.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn finish(self) -> Result<u64> {
        let count = self.file.count;
        let after: &[&str] = if self.has_confidence { &["confidence"] } else { &[] };
        let header = header(&[], count, "float", &["x", "y", "z", "nx", "ny", "nz"], after);
        self.file.finish(header.as_bytes())?;
        Ok(count)
    }
}
