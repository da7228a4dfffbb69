//! Images and masks of one camera, resampled to another one at the same place.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::Camera;

use crate::Error;

/// Undistortion from one camera to another one at the same place.
#[derive(Clone, Copy, Debug)]
pub struct Undistortion {
    from: Camera,
    to: Camera,
    /// Samples of a pixel along each axis: enough that no source pixel is skipped where the image
    /// becomes smaller.
    samples: u32,
}

impl Undistortion {
    /// Undistortion of the images of `from` to `to`, usually that of
    /// [`undistort_camera`](crate::undistort::undistort_camera).
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let ratio = from.intrinsics.mean_focal_px() / to.intrinsics.mean_focal_px();
        // A pixel of any camera has less than 256 source pixels along an axis, as scales are
        // bounded; the bound keeps a foreign camera from running for hours.
        let samples = (ratio - 1e-6).ceil().clamp(1.0, 256.0) as u32;
        Self { from: *from, to: *to, samples }
    }

    /// The camera of the images.
    pub fn from(&self) -> &Camera {
        &self.from
    }

    /// The camera of the undistorted images.
    pub fn to(&self) -> &Camera {
        &self.to
    }

    /// The place of a pixel of `from` in `to`; `None` if `to` does not image its ray.
    pub fn pixel(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.to.intrinsics.project(&self.from.intrinsics.unproject(pixel)?)
    }

    /// Resamples an image of `C` interleaved bytes a pixel, bilinearly, and as the mean of several
    /// samples where the image becomes smaller. Pixels without a source are 0.
    ///
    /// # Errors
    /// [`Error::Size`] if the image does not have the size of the camera.
    pub fn image<const C: usize>(&self, pixels: &[u8]) -> Result<Vec<u8>, Error> {
        self.check(pixels, C)?;
        if self.from.intrinsics == self.to.intrinsics && self.size_is_kept() {
            return Ok(pixels.to_vec());
        }
        let mut out = vec![0; self.to.width as usize * self.to.height as usize * C];
        let row_bytes = (self.to.width as usize * C).max(1);
        out.par_chunks_mut(row_bytes).enumerate().for_each(|(row, out)| {
            for (column, out) in out.chunks_exact_mut(C).enumerate() {
                let (mut sum, mut count) = ([0.0; C], 0.0);
                self.for_each_source(column, row, |source| {
                    if let Some(color) = source.and_then(|s| self.bilinear::<C>(pixels, &s)) {
                        (0..C).for_each(|channel| sum[channel] += color[channel]);
                        count += 1.0;
                    }
                });
                if count > 0.0 {
                    (0..C).for_each(|channel| out[channel] = (sum[channel] / count).round() as u8);
                }
            }
        });
        Ok(out)
    }

    /// Resamples a mask of one byte a pixel, 0 where the image is not to be used. A pixel is 255
    /// if all its samples have a source that is not 0, and else 0. `None` for `mask` gives the
    /// mask of the pixels with a source.
    ///
    /// # Errors
    /// [`Error::Size`] if the mask does not have the size of the camera.
    pub fn mask(&self, mask: Option<&[u8]>) -> Result<Vec<u8>, Error> {
        mask.map_or(Ok(()), |mask| self.check(mask, 1))?;
        let width = self.from.width as usize;
        let is_used = |source: Option<Vector2<f64>>| {
            let Some(source) = source.filter(|source| self.from.contains(source)) else {
                return false;
            };
            let x = (source.x as usize).min(width.saturating_sub(1));
            let y = (source.y as usize).min((self.from.height as usize).saturating_sub(1));
            mask.is_none_or(|mask| mask[y * width + x] != 0)
        };
        let mut out = vec![0; self.to.width as usize * self.to.height as usize];
        let row_bytes = (self.to.width as usize).max(1);
        out.par_chunks_mut(row_bytes).enumerate().for_each(|(row, out)| {
            for (column, out) in out.iter_mut().enumerate() {
                let mut all = true;
                self.for_each_source(column, row, |source| all &= is_used(source));
                *out = if all { u8::MAX } else { 0 };
            }
        });
        Ok(out)
    }

    fn size_is_kept(&self) -> bool {
        (self.from.width, self.from.height) == (self.to.width, self.to.height)
    }

    fn check(&self, pixels: &[u8], channels: usize) -> Result<(), Error> {
        let Camera { width, height, .. } = self.from;
        let expected = width as usize * height as usize * channels;
        if pixels.len() == expected {
            Ok(())
        } else {
            Err(Error::Size { width, height, found: pixels.len() })
        }
    }

    /// The places in `from` of the samples of a pixel of `to`.
    fn for_each_source(
        &self,
        column: usize,
        row: usize,
        mut visit: impl FnMut(Option<Vector2<f64>>),
    ) {
        let step = 1.0 / f64::from(self.samples);
        for v in 0..self.samples {
            for u in 0..self.samples {
                let pixel = Vector2::new(
                    column as f64 + step * (f64::from(u) + 0.5),
                    row as f64 + step * (f64::from(v) + 0.5),
                );
                let ray = self.to.intrinsics.unproject(&pixel);
                visit(ray.and_then(|ray| self.from.intrinsics.project(&ray)));
            }
        }
    }

    /// The colour at a place, bilinear between pixel centres; within half a pixel of the border,
    /// the colour of the border. `None` outside of the image.
    fn bilinear<const C: usize>(&self, pixels: &[u8], place: &Vector2<f64>) -> Option<[f64; C]> {
        if !self.from.contains(place) {
            return None;
        }
        let (width, height) = (self.from.width as usize, self.from.height as usize);
        let x = (place.x - 0.5).clamp(0.0, width as f64 - 1.0);
        let y = (place.y - 0.5).clamp(0.0, height as f64 - 1.0);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        let (u, v) = (x - x0 as f64, y - y0 as f64);
        Some(std::array::from_fn(|channel| {
            let at = |x: usize, y: usize| f64::from(pixels[(y * width + x) * C + channel]);
            let top = (1.0 - u) * at(x0, y0) + u * at(x1, y0);
            let bottom = (1.0 - u) * at(x0, y1) + u * at(x1, y1);
            (1.0 - v) * top + v * bottom
        }))
    }
}
