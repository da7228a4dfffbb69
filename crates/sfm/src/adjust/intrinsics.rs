//! The intrinsics of a camera in an adjustment: which parameters stay, and what is known of them
//! beforehand.

use tiepoint_ba::factors::Prior;
use tiepoint_geometry::CameraModelKind;
use tiepoint_geometry::nalgebra::SVector;
use tiepoint_scene::{Camera, CameraId};

use super::options::{AdjustOptions, RefineIntrinsics};

/// Standard deviation of the ratio of two focal lengths. Ten times as much is enough for a million
/// keypoints.
const FOCAL_RATIO_SIGMA: f64 = 1e-6;

/// Indices of the parameters that stay. What a turn of the camera does as well is one of them: a
/// hundredth of a pixel of systematic error would turn the camera by a tenth of a degree.
pub(super) fn fixed_columns(kind: CameraModelKind, refine: RefineIntrinsics) -> Vec<usize> {
    (0..kind.num_params())
        .filter(|index| {
            if kind.focal_indices().contains(index) {
                !refine.focal
            } else if kind.principal_point_indices().contains(index) {
                !refine.principal_point
            } else {
                !refine.distortion || kind.rotation_degenerate_indices().contains(index)
            }
        })
        .collect()
}

/// What is known of a camera before looking: the principal point is near the middle, distortion is
/// small, the focal lengths keep their ratio, and what the options say of the first one. In units
/// of the keypoints' noise, as residuals are.
pub(super) fn intrinsics_prior<const N: usize>(
    params: &SVector<f64, N>,
    id: CameraId,
    camera: &Camera,
    options: &AdjustOptions,
) -> Result<Prior<SVector<f64, N>, N>, tiepoint_ba::Error> {
    let kind = camera.intrinsics.kind();
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let focal = options.focal_priors.iter().find(|prior| prior.camera == id);
    let (mut mean, mut sigmas) = (*params, [options.distortion_sigma; N]);
    for index in 0..N {
        if kind.focal_indices().contains(&index) {
            mean[index] = focal.map_or(params[index], |prior| prior.mean_px);
            sigmas[index] = focal.map_or(f64::INFINITY, |prior| prior.sigma_px);
        } else if let Some(axis) = kind.principal_point_indices().iter().position(|&p| p == index) {
            mean[index] = [width / 2.0, height / 2.0][axis];
            sigmas[index] = options.principal_point_sigma * width.max(height);
        } else {
            mean[index] = 0.0;
        }
    }
    let mut prior = Prior::new(mean, &sigmas.map(|sigma| sigma / options.noise))?;
    if let &[x, y] = kind.focal_indices() {
        let (ratio, weight) =
            (params[y] / params[x], options.noise / (FOCAL_RATIO_SIGMA * params[y]));
        prior.mean[y] = ratio * prior.mean[x];
        prior.sqrt_information[(y, x)] = -ratio * weight;
        prior.sqrt_information[(y, y)] = weight;
    }
    Ok(prior)
}
