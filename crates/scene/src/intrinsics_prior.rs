//! What a calibration says of the intrinsics of a camera.

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModel, Intrinsics, with_camera_model};

/// The intrinsics that a calibration gives, and how well it knows them.
#[derive(Clone, Debug, PartialEq)]
pub struct IntrinsicsPrior {
    /// The calibrated values.
    pub mean: Intrinsics,
    /// Standard deviations of the parameters, in their order and units. Infinite for parameters
    /// without influence on pixels.
    pub sigmas: Vec<f64>,
}

impl IntrinsicsPrior {
    /// A prior whose standard deviations say how far an error of each parameter moves pixels: the
    /// projections of the rays of the image's corners and middles of sides, by `sigma_px` at most.
    /// A ray's pixel in an image of `width` x `height` pixels is that of `mean`; where a fisheye
    /// has no ray at the border, it is the outermost on the way to the image centre.
    pub fn new(mean: Intrinsics, width: u32, height: u32, sigma_px: f64) -> Self {
        let size = Vector2::new(f64::from(width), f64::from(height));
        let places = [-0.5, 0.0, 0.5];
        let border = places.iter().flat_map(|x| places.iter().map(|y| Vector2::new(*x, *y)));
        let mut influence = vec![0.0_f64; mean.params().len()];
        for from_centre in border.filter(|offset| *offset != Vector2::zeros()) {
            for (largest, moved) in influence.iter_mut().zip(moves(&mean, size, from_centre)) {
                *largest = largest.max(moved);
            }
        }
        for index in mean.kind().metadata_indices() {
            influence[*index] = 0.0;
        }
        let sigmas = influence.into_iter().map(|influence| sigma_px / influence).collect();
        Self { mean, sigmas }
    }

    /// By how many standard deviations intrinsics of the same camera model differ from the mean,
    /// for each parameter.
    pub fn deviations(&self, intrinsics: &Intrinsics) -> Vec<f64> {
        let params = intrinsics.params().iter().zip(self.mean.params());
        params.zip(&self.sigmas).map(|((found, mean), sigma)| (found - mean) / sigma).collect()
    }
}

/// Steps from the border to the image centre.
const NUM_STEPS: usize = 20;

/// How far a unit of each parameter moves the pixel of a ray: the outermost ray between the image
/// centre and a point, given relative to the image's size. Empty if there is none.
fn moves(intrinsics: &Intrinsics, size: Vector2<f64>, from_centre: Vector2<f64>) -> Vec<f64> {
    with_camera_model!(intrinsics, M, params => {
        let at = |step: usize| {
            let scale = 1.0 - step as f64 / NUM_STEPS as f64;
            let pixel = 0.5 * size + scale * from_centre.component_mul(&size);
            M::project_with_jacobian(params, &M::unproject(params, &pixel)?)
        };
        let projection = (0..NUM_STEPS).find_map(at);
        let norm = |column: &[f64]| column[0].hypot(column[1]);
        projection.map_or(Vec::new(), |projection| {
            projection.d_params.as_slice().chunks_exact(2).map(norm).collect()
        })
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use tiepoint_geometry::CameraModelKind;

    use super::*;

    const SIZE: [u32; 2] = [640, 480];

    /// Steps of difference quotients in standard deviations, small against the curvature of the
    /// models, and the relative error of the quotients.
    const STEP: f64 = 1e-6;
    const TOLERANCE: f64 = 1e-2;

    proptest! {
        /// One standard deviation of a parameter moves some pixel of the border by the given
        /// distance, and none by more.
        #[test]
        fn a_deviation_moves_the_border_by_sigma_px(
            kind in proptest::sample::select(CameraModelKind::ALL),
            focal_px in 450.0..900.0_f64,
            sigma_px in 0.1..3.0_f64,
        ) {
            let mean = Intrinsics::centred(kind, focal_px, SIZE[0], SIZE[1]);
            let prior = IntrinsicsPrior::new(mean, SIZE[0], SIZE[1], sigma_px);
            for (index, sigma) in prior.sigmas.iter().enumerate() {
                if sigma.is_infinite() {
                    // beta of EUCM has no influence where alpha is 0.
                    let is_without = kind == CameraModelKind::Eucm && index == 5;
                    prop_assert!(is_without || kind.metadata_indices().contains(&index));
                    continue;
                }
                let mut other = mean;
                other.params_mut()[index] += STEP * sigma;
                let mut largest = 0.0_f64;
                for (x, y) in [(0.0, 0.0), (320.0, 0.0), (640.0, 0.0), (0.0, 240.0)] {
                    let pixel = Vector2::new(x, y);
                    let Some(ray) = mean.unproject(&pixel) else { continue };
                    let moved = other.project(&ray).unwrap() - mean.project(&ray).unwrap();
                    largest = largest.max(moved.norm() / STEP);
                }
                // Some models have no rays in the corners.
                let error = (largest / sigma_px - 1.0).abs();
                prop_assert!(error < TOLERANCE, "{kind:?} {index}: {largest}, not {sigma_px}");
            }
        }
    }

    #[test]
    fn deviations_are_signed_and_in_the_order_of_the_parameters() {
        let mean =
            Intrinsics::new(CameraModelKind::Pinhole, &[500.0, 510.0, 320.0, 240.0]).unwrap();
        let prior = IntrinsicsPrior { mean, sigmas: vec![2.0, 5.0, 1.0, 4.0] };
        let found = Intrinsics::new(CameraModelKind::Pinhole, &[503.0, 510.0, 319.0, 248.0]);
        assert_eq!(prior.deviations(&found.unwrap()), [1.5, 0.0, -1.0, 2.0]);
    }

    /// A fisheye of 180 degrees whose circle ends within the image.
    #[test]
    fn a_border_without_rays() {
        let kind = CameraModelKind::OpencvFisheye;
        let mean = Intrinsics::centred(kind, 100.0, SIZE[0], SIZE[1]);
        let prior = IntrinsicsPrior::new(mean, SIZE[0], SIZE[1], 1.0);
        assert!(prior.sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0), "{prior:?}");
    }
}
