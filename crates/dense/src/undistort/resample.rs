//! Images and masks of one camera, resampled to another one at the same place.

use rayon::prelude::*;
use tiepoint_geometry::CameraModelKind;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::Camera;
use tiepoint_simd::Isa;

use super::mix::{WEIGHT_BITS, mix, mix_rgb};
use super::rgb_row::{self, OFFSET, Rgb};
use super::source_map::{CELL, FRACTION_BITS, RowWalk, SourceMap};
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

    /// Whether each pixel stays as it is: both cameras are without distortion, and equal.
    pub fn is_identity(&self) -> bool {
        let is_pinhole = |camera: &Camera| {
            let kind = camera.intrinsics.kind();
            matches!(kind, CameraModelKind::SimplePinhole | CameraModelKind::Pinhole)
        };
        let matrix = |camera: &Camera| camera.intrinsics.calibration_matrix();
        let size = |camera: &Camera| (camera.width, camera.height);
        let (from, to) = (&self.from, &self.to);
        is_pinhole(from) && is_pinhole(to) && matrix(from) == matrix(to) && size(from) == size(to)
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
        self.image_by::<C>(pixels, Isa::best())
    }

    fn image_by<const C: usize>(&self, pixels: &[u8], isa: Isa) -> Result<Vec<u8>, Error> {
        self.check(pixels, C)?;
        if self.is_identity() {
            return Ok(pixels.to_vec());
        }
        let mut out = vec![0; self.to.width as usize * self.to.height as usize * C];
        let row_bytes = (self.to.width as usize * C).max(1);
        let map = (self.samples == 1)
            .then(|| SourceMap::new(self.to.width, self.to.height, |place| self.source(place)));
        out.par_chunks_mut(CELL * row_bytes).enumerate().for_each(|(band, out)| {
            for cell in 0..(self.to.width as usize).div_ceil(CELL) {
                let mut walk = map.as_ref().and_then(|map| map.walk(cell, band));
                for (row, out) in out.chunks_exact_mut(row_bytes).enumerate() {
                    let end = ((cell + 1) * CELL * C).min(row_bytes);
                    let (out, _) = out[cell * CELL * C..end].as_chunks_mut::<C>();
                    let done = walk
                        .as_mut()
                        .map_or(0, |walk| self.interior_of_row(pixels, walk.next_row(), isa, out));
                    if done != u32::MAX {
                        let (column, row) = (cell * CELL, band * CELL + row);
                        for (k, out) in out.iter_mut().enumerate() {
                            if done >> k & 1 == 0 {
                                *out = self.pixel_mean(pixels, column + k, row);
                            }
                        }
                    }
                }
            }
        });
        Ok(out)
    }

    /// The mean of the samples of a pixel.
    #[cold]
    fn pixel_mean<const C: usize>(&self, pixels: &[u8], column: usize, row: usize) -> [u8; C] {
        let (mut sum, mut count) = ([0.0; C], 0.0);
        self.for_each_source(column, row, |source| {
            if let Some(color) = source.and_then(|s| self.bilinear::<C>(pixels, &s)) {
                (0..C).for_each(|channel| sum[channel] += color[channel]);
                count += 1.0;
            }
        });
        if count > 0.0 { sum.map(|sum: f64| (sum / count).round() as u8) } else { [0; C] }
    }

    /// Sets the pixels of a row in a cell that have a colour by [`Self::interior`]. Returns a bit
    /// for each; those beyond the row are set, too.
    #[inline(never)]
    fn interior_of_row<const C: usize>(
        &self,
        pixels: &[u8],
        walk: RowWalk,
        isa: Isa,
        out: &mut [[u8; C]],
    ) -> u32 {
        let Camera { width, height, .. } = self.from;
        let mut done = u32::MAX;
        if C == 3
            && let Ok(out) =
                <&mut [[u8; 3]; CELL]>::try_from(out.as_flattened_mut().as_chunks_mut().0)
            && rgb_row::mix(isa, Rgb { pixels, width, height }, &walk, out)
        {
            return done;
        }
        for (k, (place, out)) in walk.places().iter().zip(out).enumerate() {
            match self.interior(pixels, *place) {
                Some(color) => *out = color,
                None => done &= !(1 << k),
            }
        }
        done
    }

    /// [`Self::bilinear`] at a place of a walk between four pixels of the image, with weights of
    /// 12 bits; `None` elsewhere, and for pixels at the end of the data.
    #[inline]
    fn interior<const C: usize>(&self, pixels: &[u8], place: [i64; 2]) -> Option<[u8; C]> {
        const ONE: u32 = 1 << WEIGHT_BITS;
        let [x, y] = place.map(|value| (value - OFFSET) >> (FRACTION_BITS - WEIGHT_BITS));
        // Negative places become large ones.
        let [x0, y0] = [x, y].map(|value| (value >> WEIGHT_BITS) as u64);
        let (width, height) = (u64::from(self.from.width), u64::from(self.from.height));
        if x0.saturating_add(1) >= width || y0.saturating_add(1) >= height {
            return None;
        }
        let [u, v] = [x, y].map(|value| value as u32 & (ONE - 1));
        let both = (u * v + ONE / 2) >> WEIGHT_BITS;
        let weights = [[ONE + both - u - v, u - both], [v - both, both]];
        let weights = weights.map(|row| row.map(|weight| weight as u16));
        let start = (y0 * width + x0) as usize * C;
        let row_bytes = width as usize * C;
        if C == 3 {
            let top = *pixels.get(start..)?.first_chunk()?;
            let bottom = *pixels.get(start + row_bytes..)?.first_chunk()?;
            let color = mix_rgb([top, bottom], weights);
            return Some(std::array::from_fn(|channel| color[channel]));
        }
        let top = pixels.get(start..start + 2 * C)?;
        let bottom = pixels.get(start + row_bytes..start + row_bytes + 2 * C)?;
        Some(std::array::from_fn(|channel| {
            mix([top, bottom].map(|row| [row[channel], row[C + channel]]), weights)
        }))
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

    fn check(&self, pixels: &[u8], channels: usize) -> Result<(), Error> {
        let Camera { width, height, .. } = self.from;
        let expected = width as usize * height as usize * channels;
        if pixels.len() == expected {
            Ok(())
        } else {
            Err(Error::Size { width, height, found: pixels.len() })
        }
    }

    /// The place in `from` of a place in `to`; `None` if `from` does not image its ray.
    pub(crate) fn source(&self, place: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.from.intrinsics.project(&self.to.intrinsics.unproject(place)?)
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
                visit(self.source(&pixel));
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

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{Intrinsics, Rng};

    use super::*;

    #[test]
    fn rows_at_once_are_as_pixel_by_pixel() {
        let mut rng = Rng::stream(7, &[]);
        let (mut quick, mut total) = (0, 0);
        // Narrow images end inside of a cell and of the data; strong lenses leave the image.
        for (k, (width, height)) in
            [(97, 61), (200, 150), (64, 33), (18, 17), (3, 90), (90, 2), (400, 300)]
                .into_iter()
                .enumerate()
        {
            let size = f64::from(width.max(height));
            let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
            for distortion in [[-0.2, 0.03, 0.001, -0.002], [0.15, 0.0, 0.01, 0.01], [0.0; 4]] {
                let mut params = vec![0.8 * size, 0.81 * size, cx + 0.3, cy - 0.2];
                params.extend(distortion);
                let from = Intrinsics::new(CameraModelKind::Opencv, &params).unwrap();
                let focal_px = size * [0.8, 0.5, 1.3][k % 3];
                let to = Intrinsics::new(
                    CameraModelKind::Pinhole,
                    &[focal_px, focal_px, cx - 2.0, cy + 1.5],
                )
                .unwrap();
                let camera = |intrinsics, width, height| Camera {
                    intrinsics,
                    width,
                    height,
                    has_focal_prior: true,
                };
                let map = Undistortion {
                    from: camera(from, width, height),
                    to: camera(to, width + 40, height + 20),
                    samples: 1,
                };
                let pixels: Vec<u8> =
                    (0..width * height * 3).map(|_| rng.next_u64() as u8).collect();
                let images: Vec<Vec<u8>> = Isa::available()
                    .into_iter()
                    .map(|isa| map.image_by::<3>(&pixels, isa).unwrap())
                    .collect();
                for image in &images {
                    assert!(image == images.last().unwrap(), "{width} × {height}");
                }
                quick += images[0].iter().filter(|value| **value != 0).count();
                total += images[0].len();
            }
        }
        assert!(quick * 3 > total, "most pixels have a source: {quick} of {total}");
    }
}
