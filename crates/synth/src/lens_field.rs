//! The lens field: the smooth static displacement of pixels that a calibrated lens leaves.
//!
//! Rectified images of KITTI have one of 0.1 to 0.2 px (Krešo & Šegvić 2015), and so has every
//! action camera. Here it is a sum of cosines,
//!
//! d(x, y) = Σ c_ij cos(iπ x/width) cos(jπ y/height),  0 ≤ i, j ≤ 4,
//!
//! whose correlation falls to zero over about a quarter of the image. The modes are orthogonal on
//! the image to constant and linear displacements: focal length and principal point of the lens
//! without its field are also those that fit the field best.

use std::f64::consts::PI;

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{Camera, CameraId, Image, ImageId, Reconstruction};

/// Highest number of half waves along a side of the image.
const ORDER: usize = 4;
/// Fixed-point iteration of the inverse: the step at which it ends, in pixels, and the most
/// iterations.
const TOLERANCE_PX: f64 = 1e-12;
const ITERATIONS: usize = 30;

/// A smooth displacement of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct LensField {
    /// Width and height of the image, in pixels.
    size: Vector2<f64>,
    /// Half waves along x and y, and the displacement, in pixels, where both cosines are 1.
    modes: Vec<([usize; 2], Vector2<f64>)>,
}

impl LensField {
    /// A random field of an image size in pixels: the displacement has a root mean square of
    /// `rms_px` over the image.
    pub fn sample(rms_px: f64, width: u32, height: u32, rng: &mut Rng) -> Self {
        let all = (0..=ORDER).flat_map(|i| (0..=ORDER).map(move |j| [i, j]));
        // Odd cosines of one coordinate alone are correlated with that coordinate.
        let is_affine = |[i, j]: [usize; 2]| (j == 0 && i % 2 == 1) || (i == 0 && j % 2 == 1);
        let mut modes: Vec<_> = all
            .filter(|&waves| waves != [0, 0] && !is_affine(waves))
            .map(|waves| {
                // The mean square of a cosine is 1/2, so that every mode has the same.
                let weight = if waves.contains(&0) { 0.5f64.sqrt() } else { 1.0 };
                (waves, Vector2::from_fn(|_, _| weight * rng.normal()))
            })
            .collect();
        let mean_square: f64 = modes
            .iter()
            .map(|(waves, c)| c.norm_squared() * if waves.contains(&0) { 0.5 } else { 0.25 })
            .sum();
        modes.iter_mut().for_each(|(_, c)| *c *= rms_px / mean_square.sqrt());
        Self { size: Vector2::new(f64::from(width), f64::from(height)), modes }
    }

    /// Displaces the keypoints of a model by a random field for each camera, with a root mean
    /// square of `rms_px` over the image.
    pub fn displace_keypoints(model: &mut Reconstruction, rms_px: f64, seed: u64) {
        let sample = |(id, camera): (CameraId, &Camera)| {
            let mut rng = Rng::stream(seed, &[34, id.index() as u64]);
            Self::sample(rms_px, camera.width, camera.height, &mut rng)
        };
        let fields: Vec<Self> = model.cameras().map(sample).collect();
        let displaced = |(id, image): (ImageId, &Image)| {
            let field = &fields[image.camera.index()];
            let pixels = image.keypoints.iter().map(|keypoint| keypoint.pixel);
            (id, pixels.map(|pixel| pixel + field.at(&pixel)).collect())
        };
        let displaced: Vec<(ImageId, Vec<Vector2<f64>>)> = model.images().map(displaced).collect();
        for (id, pixels) in displaced {
            model.move_keypoints(id, &pixels);
        }
    }

    /// Half waves along x and y of each mode, and its displacement c_ij in pixels.
    pub fn modes(&self) -> &[([usize; 2], Vector2<f64>)] {
        &self.modes
    }

    /// The displacement at a pixel of the lens without a field, in pixels.
    pub fn at(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let [along_x, along_y]: [[f64; ORDER + 1]; 2] = [0, 1].map(|axis| {
            let phase = PI * pixel[axis] / self.size[axis];
            std::array::from_fn(|waves| (waves as f64 * phase).cos())
        });
        self.modes.iter().map(|&([i, j], c)| c * (along_x[i] * along_y[j])).sum()
    }

    /// The pixel that the field displaces to `pixel`; `None` if the field is not invertible there.
    pub fn undo(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let mut without = *pixel;
        for _ in 0..ITERATIONS {
            let next = pixel - self.at(&without);
            let step_px = (next - without).norm();
            without = next;
            if step_px < TOLERANCE_PX * (1.0 + pixel.norm()) {
                return Some(without);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    const SIZE: (u32, u32) = (640, 480);
    const RMS_PX: f64 = 0.15;

    fn field(seed: u64) -> LensField {
        LensField::sample(RMS_PX, SIZE.0, SIZE.1, &mut Rng::stream(seed, &[]))
    }

    /// Centres of cells of 8 × 8 pixels, where the midpoint rule is exact for these cosines.
    fn cells() -> impl Iterator<Item = Vector2<f64>> {
        (0..60)
            .flat_map(|y| (0..80).map(move |x| Vector2::new(x as f64 + 0.5, y as f64 + 0.5)))
            .map(|cell| cell * 8.0)
    }

    #[test]
    fn a_field_has_its_amplitude_and_leaves_focal_length_and_principal_point() {
        // Sums of 4,800 cosines in double precision.
        const CLOSE: f64 = 1e-12;
        for seed in 0..5 {
            let field = field(seed);
            assert_eq!(field, self::field(seed));
            assert_ne!(field, self::field(seed + 1));
            let (mut square, mut moments) = (0.0, [Vector2::zeros(); 3]);
            for cell in cells() {
                let d = field.at(&cell);
                square += d.norm_squared();
                let centred = [1.0, cell.x / 320.0 - 1.0, cell.y / 240.0 - 1.0];
                moments.iter_mut().zip(centred).for_each(|(moment, x)| *moment += d * x);
            }
            let count = cells().count() as f64;
            assert!(((square / count).sqrt() - RMS_PX).abs() < CLOSE);
            assert!(moments.iter().all(|moment| moment.norm() / count < CLOSE), "{moments:?}");
        }
    }

    #[test]
    fn correlation_falls_to_zero_over_about_a_quarter_of_the_image() {
        let correlation = |shift_px: f64| {
            let (mut product, mut square) = (0.0, 0.0);
            for seed in 0..20 {
                let field = field(seed);
                let shift = Vector2::new(shift_px, 0.0);
                for cell in cells().filter(|cell| cell.x + shift_px < f64::from(SIZE.0)) {
                    product += field.at(&cell).dot(&field.at(&(cell + shift)));
                    square += field.at(&cell).norm_squared();
                }
            }
            product / square
        };
        // Of white noise both would be 0, of a ramp both 1.
        assert!(correlation(40.0) > 0.8, "{}", correlation(40.0));
        assert!(correlation(200.0) < 0.2, "{}", correlation(200.0));
    }

    proptest! {
        #[test]
        fn undo_inverts_the_field(seed in 0u64..100, x in -50.0..700.0, y in -50.0..550.0) {
            let (field, pixel) = (field(seed), Vector2::new(x, y));
            let back = field.undo(&(pixel + field.at(&pixel))).expect("a field of 0.15 px");
            // The error is the last step times the slope of the field, far below one.
            prop_assert!((back - pixel).norm() < 1e-9, "{pixel} became {back}");
        }
    }

    #[test]
    fn a_field_that_folds_the_image_is_not_inverted() {
        let field = LensField::sample(100.0, 64, 48, &mut Rng::stream(1, &[]));
        assert!(cells().any(|pixel| field.undo(&pixel).is_none()));
    }
}
