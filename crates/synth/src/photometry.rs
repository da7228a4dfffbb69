//! The photometric pipeline of the camera: exposure, noise, tone curve, quantisation to 8 bits,
//! JPEG.

use std::io::Cursor;

use image::{ImageEncoder, ImageFormat, RgbImage, codecs::jpeg::JpegEncoder};
use rayon::prelude::*;
use tiepoint_geometry::Rng;

use crate::render::Radiance;

/// Entries of the look-up table of the tone curve.
const TONE_STEPS: usize = 1 << 14;
/// Exponent of the tone curve: the gamma of common displays.
const GAMMA: f64 = 2.2;

/// Parameters of the photometric pipeline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Development {
    /// Gain: factor on the linear radiance.
    pub gain: f64,
    /// Standard deviation of the noise at white, relative to white. It is proportional to the
    /// square root of the radiance (shot noise); a tenth of it remains in the dark. 0 for none.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Development {
    fn default() -> Self {
        Self { gain: 1.0, noise: 0.0, seed: 0 }
    }
}

/// Converts linear radiance to an 8-bit image. Each row has its own random stream.
pub fn develop(radiance: &Radiance, development: &Development) -> RgbImage {
    let tone: Vec<u8> = (0..TONE_STEPS)
        .map(|k| (255.0 * ((k as f64 + 0.5) / TONE_STEPS as f64).powf(1.0 / GAMMA)).round() as u8)
        .collect();
    let (gain, noise) = (development.gain as f32, development.noise as f32);
    let mut bytes = vec![0u8; 3 * radiance.width * radiance.height];
    let rows =
        bytes.par_chunks_mut(3 * radiance.width).zip(radiance.pixels.par_chunks(radiance.width));
    rows.enumerate().for_each(|(y, (bytes, pixels))| {
        let mut rng = Rng::stream(development.seed, &[y as u64]);
        for (bytes, light) in bytes.chunks_exact_mut(3).zip(pixels) {
            let mut random = if noise > 0.0 { [rng.next_u64(), rng.next_u64()] } else { [0; 2] };
            for (byte, light) in bytes.iter_mut().zip(light) {
                let mut value = gain * light;
                if noise > 0.0 {
                    value +=
                        noise * (0.01 + value.max(0.0)).sqrt() * approximate_normal(&mut random);
                }
                let step = (value * TONE_STEPS as f32) as usize;
                *byte = tone[step.min(TONE_STEPS - 1)];
            }
        }
    });
    RgbImage::from_raw(radiance.width as u32, radiance.height as u32, bytes)
        .expect("three bytes a pixel were allocated")
}

/// An approximately normal number with mean 0 and variance 1: the sum of four uniform numbers of
/// ten bits each, taken from the rest of 128 random bits (Irwin 1927, Hall 1927). Its short tails
/// suffice for sensor noise.
fn approximate_normal(bits: &mut [u64; 2]) -> f32 {
    let mut sum = 0;
    for word in bits.iter_mut() {
        sum += (*word & 0x3FF) + (*word >> 10 & 0x3FF);
        *word >>= 20;
    }
    // The variance of a uniform number on 0..=1023 is (1024² − 1)/12.
    (sum as f32 - 4.0 * 511.5) / (4.0f32 * (1024.0 * 1024.0 - 1.0) / 12.0).sqrt()
}

/// The image after JPEG compression with a quality of 1 to 100.
pub(crate) fn jpeg_round_trip(image: &RgbImage, quality: u8) -> Option<RgbImage> {
    let decoded =
        image::load_from_memory_with_format(&jpeg_bytes(image, quality, &[])?, ImageFormat::Jpeg);
    decoded.ok().map(|image| image.to_rgb8())
}

/// The bytes of a JPEG file of the image with EXIF data, which may be empty.
pub(crate) fn jpeg_bytes(image: &RgbImage, quality: u8, exif: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    encoder.set_exif_metadata(exif.to_vec()).ok()?;
    encoder.encode_image(image).ok()?;
    Some(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(level: f32) -> Radiance {
        Radiance { width: 200, height: 100, pixels: vec![[level; 3]; 20_000] }
    }

    fn mean_and_deviation(image: &RgbImage) -> (f64, f64) {
        let linear: Vec<f64> =
            image.as_raw().iter().map(|&b| (f64::from(b) / 255.0).powf(GAMMA)).collect();
        let mean = linear.iter().sum::<f64>() / linear.len() as f64;
        let variance = linear.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / linear.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn gain_and_noise_have_the_requested_size() {
        // 60,000 samples: the standard deviation is known to 0.3 %, and quantisation to 8 bits adds
        // less than 3 %.
        let development = Development { gain: 1.5, noise: 0.03, seed: 1 };
        let (mean, deviation) = mean_and_deviation(&develop(&flat(0.2), &development));
        let expected = 0.03 * (0.01 + 0.3f64).sqrt();
        assert!((mean - 0.3).abs() < 0.002, "{mean}");
        assert!((deviation / expected - 1.0).abs() < 0.04, "{deviation} {expected}");
        let (mean, deviation) = mean_and_deviation(&develop(&flat(0.2), &Development::default()));
        assert!((mean - 0.2).abs() < 0.002 && deviation < 1e-9, "{mean} {deviation}");
    }

    #[test]
    fn noise_depends_on_the_seed() {
        let with = |seed: u64| develop(&flat(0.2), &Development { gain: 1.0, noise: 0.02, seed });
        assert_eq!(with(1), with(1));
        assert_ne!(with(1), with(2));
    }

    #[test]
    fn jpeg_error_is_small() {
        let mut light = flat(0.2);
        for (k, pixel) in light.pixels.iter_mut().enumerate() {
            *pixel = [0.1 + 0.3 * (k % 200) as f32 / 200.0; 3];
        }
        let image = develop(&light, &Development::default());
        let back = jpeg_round_trip(&image, 90).unwrap();
        let worst = image.as_raw().iter().zip(back.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() <= 12, "{worst:?}");
    }
}
