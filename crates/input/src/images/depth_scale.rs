//! Depth maps as PNG of 16 bits a pixel, as nerfstudio and trainers of Gaussian splats read them: a
//! depth is the value times one scale, and 0 means that there is none.

use std::path::Path;

use tiepoint_io::Result;

use super::pixels::write_png;

/// Depth of one unit of a pixel, in the unit of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthScale(f32);

impl DepthScale {
    /// The finest scale for depths up to `farthest`; farther ones get the largest value.
    pub fn up_to(farthest: f32) -> Self {
        Self(farthest / f32::from(u16::MAX))
    }

    /// The scale as JSON, with the name that it has in nerfstudio.
    pub fn json(&self) -> String {
        format!("{{\n  \"depth_unit_scale_factor\": {:e}\n}}\n", self.0)
    }

    /// Writes depths, by rows. The smallest depth is one unit.
    ///
    /// # Errors
    ///
    /// If there are not `width * height` depths, and if the file cannot be written.
    pub fn write(&self, path: &Path, width: u32, height: u32, depths: &[f32]) -> Result<()> {
        let value = |depth: &f32| match *depth > 0.0 {
            true => (depth / self.0).round().clamp(1.0, f32::from(u16::MAX)) as u16,
            false => 0,
        };
        let bytes: Vec<u8> = depths.iter().flat_map(|depth| value(depth).to_ne_bytes()).collect();
        write_png(path, &bytes, width, height, image::ExtendedColorType::L16)
    }
}
