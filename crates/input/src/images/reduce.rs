//! Images of a fraction of the size.

use super::{Luma, Rgb};

impl Rgb {
    /// The image at 1/`factor` of its size, rounded down; a pixel is the mean of the area that it
    /// covers. `factor` is at least 1.
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        let (width, height) = (reduced_size(self.width, factor), reduced_size(self.height, factor));
        let data = reduced::<3>(&self.data, [self.width, self.height], [width, height]);
        Self { width, height, data }
    }

    /// The image with its aspect ratio, at most `max_side` columns and rows and about `max_pixels`
    /// pixels, which are means of areas; the same image if it is as small.
    #[must_use]
    pub fn fitted(&self, max_side: u32, max_pixels: u64) -> Self {
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let by_side = f64::from(max_side) / width.max(height);
        let scale = by_side.min((max_pixels as f64 / (width * height)).sqrt());
        if scale >= 1.0 {
            return self.clone();
        }
        let [width, height] = [width, height].map(|side| ((side * scale) as u32).max(1));
        let data = reduced::<3>(&self.data, [self.width, self.height], [width, height]);
        Self { width, height, data }
    }
}

impl Luma {
    /// [`Rgb::reduced`] of a grey image.
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        let (width, height) = (reduced_size(self.width, factor), reduced_size(self.height, factor));
        let data = reduced::<1>(&self.data, [self.width, self.height], [width, height]);
        Self { width, height, data }
    }
}

/// Rounds down, as nerfstudio expects of `images_2` by default (`downscale_rounding_mode`). gsplat
/// and 3DGS take the size of the files.
fn reduced_size(size: u32, factor: u32) -> u32 {
    // Not above `size`, unless that is 0.
    (size / factor.max(1)).max(1)
}

/// The pixels that an output pixel covers along an axis, with their shares of it.
fn shares(from: u32, to: u32) -> Vec<(usize, Vec<f32>)> {
    let scale = f64::from(from) / f64::from(to);
    let of_pixel = |pixel: u32| {
        let (begin, end) = (f64::from(pixel) * scale, f64::from(pixel + 1) * scale);
        let first = begin as usize;
        // Rounding must not add a pixel with a share of 1e-16.
        let last = ((end - 1e-9).ceil() as usize).clamp(first + 1, from as usize);
        let share = |k: usize| ((end.min(k as f64 + 1.0) - begin.max(k as f64)) / scale) as f32;
        (first, (first..last).map(share).collect())
    };
    (0..to).map(of_pixel).collect()
}

fn reduced<const C: usize>(data: &[u8], from: [u32; 2], to: [u32; 2]) -> Vec<u8> {
    if from == to || from.contains(&0) {
        return data.to_vec();
    }
    let columns = shares(from[0], to[0]);
    let row_bytes = from[0] as usize * C;
    let mut out = Vec::with_capacity(to[0] as usize * to[1] as usize * C);
    let mut sums = vec![0.0f32; row_bytes];
    for (first, weights) in shares(from[1], to[1]) {
        sums.fill(0.0);
        for (k, weight) in weights.iter().enumerate() {
            let row = &data[(first + k) * row_bytes..][..row_bytes];
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * f32::from(*value));
        }
        for (first, weights) in &columns {
            for channel in 0..C {
                let values = sums[first * C + channel..].iter().step_by(C);
                let mean: f32 = weights.iter().zip(values).map(|(w, value)| w * value).sum();
                out.push(mean.round() as u8);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_means_of_areas() {
        let image = Luma { width: 4, height: 2, data: vec![0, 10, 20, 30, 40, 50, 60, 70] };
        let half = Luma { width: 2, height: 1, data: vec![25, 45] };
        assert_eq!(image.reduced(2), half);
        assert_eq!(image.reduced(1), image);
        // Five columns become two of 5/2 columns each.
        let odd = Luma { width: 5, height: 1, data: vec![0, 50, 100, 150, 200] };
        let mean = |shares: [f64; 3]| (shares.iter().sum::<f64>() * 2.0 / 5.0).round() as u8;
        let expected = vec![mean([0.0, 50.0, 0.5 * 100.0]), mean([0.5 * 100.0, 150.0, 200.0])];
        assert_eq!(odd.reduced(2), Luma { width: 2, height: 1, data: expected });
        let rgb = Rgb { width: 2, height: 1, data: vec![0, 100, 200, 10, 100, 100] };
        let pixel = Rgb { width: 1, height: 1, data: vec![5, 100, 150] };
        assert_eq!(rgb.reduced(4), pixel);
        assert_eq!((rgb.fitted(1, 9), rgb.fitted(9, 1)), (pixel.clone(), pixel));
        assert_eq!(rgb.fitted(2, 2), rgb);
        let flat = Luma { width: 37, height: 23, data: vec![255; 37 * 23] };
        assert!(flat.reduced(8).data.iter().all(|value| *value == 255));
    }
}
