//! Intrinsics in bundle adjustment: constant parameters and priors.

use tiepoint_ba::factors::Prior;
use tiepoint_geometry::CameraModelKind;
use tiepoint_geometry::nalgebra::SVector;
use tiepoint_scene::{Camera, CameraId, IntrinsicsPrior};

use crate::options::{AdjustOptions, RefineIntrinsics};

/// Standard deviation of the ratio of two focal lengths. A value ten times as large suffices for a
/// million keypoints.
const FOCAL_RATIO_SIGMA: f64 = 1e-6;

/// Returns the indices of the constant parameters. Parameters that act like a rotation of the
/// camera are constant unless asked for: a systematic error of a hundredth of a pixel would rotate
/// the camera by a tenth of a degree.
pub(crate) fn fixed_columns(kind: CameraModelKind, refine: RefineIntrinsics) -> Vec<usize> {
    (0..kind.num_params())
        .filter(|index| {
            if kind.metadata_indices().contains(index) {
                true
            } else if kind.focal_indices().contains(index) {
                !refine.focal
            } else if kind.principal_point_indices().contains(index) {
                !refine.principal_point
            } else {
                let is_prism = kind.rotation_degenerate_indices().contains(index);
                !refine.distortion || is_prism && !refine.prism
            }
        })
        .collect()
}

/// Prior on the intrinsics: that of the calibration, or else principal point and distortion near
/// the image centre and 0 and the options' prior on the first focal length. The ratio of the focal
/// lengths is constant unless it is refined. Standard deviations are divided by the noise of the
/// keypoints.
pub(crate) fn intrinsics_prior<const N: usize>(
    params: &SVector<f64, N>,
    id: CameraId,
    camera: &Camera,
    calibration: Option<&IntrinsicsPrior>,
    refine: RefineIntrinsics,
    options: &AdjustOptions,
) -> Result<Prior<SVector<f64, N>, N>, tiepoint_ba::Error> {
    let kind = camera.intrinsics.kind();
    let (mean, sigmas) = match calibration {
        Some(IntrinsicsPrior { mean, sigmas }) => (
            SVector::from_iterator(mean.params().iter().copied()),
            std::array::from_fn(|index| sigmas[index]),
        ),
        None => uncalibrated(params, id, camera, options),
    };
    let mut prior = Prior::new(mean, &sigmas.map(|sigma| sigma / options.noise))?;
    if let (&[x, y], false) = (kind.focal_indices(), refine.aspect) {
        let (ratio, weight) =
            (params[y] / params[x], options.noise / (FOCAL_RATIO_SIGMA * params[y]));
        prior.mean[y] = ratio * prior.mean[x];
        prior.sqrt_information[(y, x)] = -ratio * weight;
        prior.sqrt_information[(y, y)] = weight;
    }
    Ok(prior)
}

/// Mean and standard deviations for a camera without a calibration.
fn uncalibrated<const N: usize>(
    params: &SVector<f64, N>,
    id: CameraId,
    camera: &Camera,
    options: &AdjustOptions,
) -> (SVector<f64, N>, [f64; N]) {
    let kind = camera.intrinsics.kind();
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let focal = options.focal_priors.iter().find(|prior| prior.camera == id);
    let (mut mean, mut sigmas) = (*params, [options.distortion_sigma; N]);
    for &index in kind.metadata_indices() {
        sigmas[index] = f64::INFINITY;
    }
    for index in (0..N).filter(|index| !kind.metadata_indices().contains(index)) {
        if kind.focal_indices().contains(&index) {
            mean[index] = focal.map_or(params[index], |prior| prior.mean_px);
            sigmas[index] = focal.map_or(f64::INFINITY, |prior| prior.sigma_px);
        } else if let Some(axis) = kind.principal_point_indices().iter().position(|&p| p == index) {
            mean[index] = [width / 2.0, height / 2.0][axis];
            sigmas[index] = options.principal_point_sigma * width.max(height);
        } else {
            let initial = kind.initial_distortion().iter().find(|(found, _)| *found == index);
            mean[index] = initial.map_or(0.0, |&(_, value)| value);
        }
    }
    (mean, sigmas)
}
