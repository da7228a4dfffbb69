//! Whether the images of a camera agree on its focal length.
//!
//! A photo that was cropped or zoomed has another focal length than the others. In a model with one
//! for all, its pose and the points compensate for a part. With the points constant, the pose of
//! each image is estimated again together with a scale about the principal point: 1 if the image
//! agrees. The points were fitted with the shared focal length, so that the scale shows a part of
//! the contradiction only: a tenth for a quarter of the images, less for few.

use rayon::prelude::*;
use tiepoint_adjust::keypoint_sigma_px;
use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector2, Vector3};
use tiepoint_geometry::numeric::{MEDIAN_NORM_OF_TWO, median};
use tiepoint_geometry::{Intrinsics, Loss, Rigid3};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

/// Pose and logarithm of the scale.
const NUM_PARAMETERS: usize = 7;
/// Fewest observations of an image.
const MIN_OBSERVATIONS: usize = 30;
/// Most observations of an image that are used.
const MAX_OBSERVATIONS: usize = 1000;
const MAX_ITERATIONS: usize = 20;
/// Smallest change of a parameter, in units of its standard deviation, for a further iteration.
const MIN_STEP_SIGMAS: f64 = 1e-3;
/// Scale of the Cauchy loss in standard deviations: 95 % efficiency on Gaussian noise (Holland and
/// Welsch 1977).
const CAUCHY_SIGMAS: f64 = 2.385;

/// The scale of an image relative to its camera's focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageScale {
    /// The image.
    pub image: ImageId,
    /// Its camera.
    pub camera: CameraId,
    /// Focal length of the image over that of the camera, with the points constant.
    pub scale: f64,
    /// Standard deviation of the scale.
    pub sd: f64,
}

/// The scales of all registered images with enough observations, for cameras with a focal length.
pub fn image_scales(model: &Reconstruction) -> Vec<ImageScale> {
    let mut observed: Vec<Vec<(u32, Vector3<f64>)>> = vec![Vec::new(); model.num_images()];
    for (_, track) in model.tracks() {
        for o in &track.observations {
            observed[o.image.index()].push((o.keypoint, track.xyz));
        }
    }
    let images: Vec<(ImageId, Rigid3)> =
        model.registered().map(|(id, _, pose)| (id, *pose)).collect();
    let scale = |&(id, pose): &(ImageId, Rigid3)| {
        let observed = &observed[id.index()];
        let image = model.image(id);
        let intrinsics = model.camera(image.camera).intrinsics;
        if observed.len() < MIN_OBSERVATIONS || intrinsics.kind().focal_indices().is_empty() {
            return None;
        }
        let step = observed.len().div_ceil(MAX_OBSERVATIONS);
        let observations = observed.iter().step_by(step).map(|&(keypoint, xyz)| {
            let keypoint = &image.keypoints[keypoint as usize];
            let sigma = keypoint_sigma_px(keypoint.scale_px);
            Observation { xyz, pixel: keypoint.pixel, sigma }
        });
        let (scale, sd) = fit(&intrinsics, pose, &observations.collect::<Vec<_>>())?;
        Some(ImageScale { image: id, camera: image.camera, scale, sd })
    };
    images.par_iter().filter_map(scale).collect()
}

struct Observation {
    xyz: Vector3<f64>,
    pixel: Vector2<f64>,
    /// Relative standard deviation.
    sigma: f64,
}

/// The scale that fits best together with the pose, and its standard deviation: iteratively
/// reweighted Gauss-Newton.
fn fit(
    intrinsics: &Intrinsics,
    mut pose: Rigid3,
    observations: &[Observation],
) -> Option<(f64, f64)> {
    type Hessian = SMatrix<f64, NUM_PARAMETERS, NUM_PARAMETERS>;
    let centre = intrinsics.principal_point();
    let mut log_scale: f64 = 0.0;
    let residual = |pose: &Rigid3, log_scale: f64, o: &Observation| {
        let projected = intrinsics.project(&(*pose * o.xyz))?;
        Some((centre + (projected - centre) * log_scale.exp() - o.pixel) / o.sigma)
    };
    let mut sd = f64::INFINITY;
    for _ in 0..MAX_ITERATIONS {
        let mut errors: Vec<f64> = observations
            .iter()
            .filter_map(|o| Some(residual(&pose, log_scale, o)?.norm()))
            .collect();
        let noise = (median(&mut errors)? / MEDIAN_NORM_OF_TWO).max(f64::MIN_POSITIVE);
        let loss = Loss::Cauchy(CAUCHY_SIGMAS * noise);
        let (mut hessian, mut gradient) = (Hessian::zeros(), SVector::zeros());
        for o in observations {
            let Some(r) = residual(&pose, log_scale, o) else { continue };
            let Some(jacobian) = jacobian(intrinsics, &pose, log_scale, o) else { continue };
            let [_, weight, _] = loss.evaluate(r.norm_squared());
            hessian += jacobian.transpose() * jacobian * weight;
            gradient += jacobian.transpose() * r * weight;
        }
        let inverse = hessian.cholesky()?.inverse();
        let step: SVector<f64, NUM_PARAMETERS> = -(inverse * gradient);
        pose = moved(&pose, &step);
        log_scale += step[6];
        sd = noise * inverse[(6, 6)].sqrt();
        let is_small = |k: usize| step[k].abs() < MIN_STEP_SIGMAS * noise * inverse[(k, k)].sqrt();
        if (0..NUM_PARAMETERS).all(is_small) {
            break;
        }
    }
    let scale = log_scale.exp();
    (scale.is_finite() && sd.is_finite()).then_some((scale, scale * sd))
}

/// The pose after a rotation vector and a translation in the camera frame.
fn moved(pose: &Rigid3, step: &SVector<f64, NUM_PARAMETERS>) -> Rigid3 {
    let rotation = Vector3::new(step[0], step[1], step[2]);
    let translation = Vector3::new(step[3], step[4], step[5]);
    Rigid3::new(
        tiepoint_geometry::nalgebra::UnitQuaternion::from_scaled_axis(rotation),
        translation,
    ) * *pose
}

/// The derivative of the residual by pose and scale; by the point in the camera frame it is that of
/// a central difference.
fn jacobian(
    intrinsics: &Intrinsics,
    pose: &Rigid3,
    log_scale: f64,
    o: &Observation,
) -> Option<SMatrix<f64, 2, NUM_PARAMETERS>> {
    let point = *pose * o.xyz;
    let scale = log_scale.exp();
    // The truncation error is 1e-10 of the derivative, the rounding error of the same order.
    let h = 1e-5 * point.norm();
    let mut jacobian = SMatrix::<f64, 2, NUM_PARAMETERS>::zeros();
    for axis in 0..3 {
        let mut offset = Vector3::zeros();
        offset[axis] = h;
        let (plus, minus) =
            (intrinsics.project(&(point + offset))?, intrinsics.project(&(point - offset))?);
        let by_point = (plus - minus) * (scale / (2.0 * h * o.sigma));
        jacobian.column_mut(3 + axis).copy_from(&by_point);
    }
    for axis in 0..3 {
        let mut turned = Vector3::zeros();
        turned[axis] = 1.0;
        let turned: Vector3<f64> = turned.cross(&point);
        let by_rotation = jacobian.fixed_columns::<3>(3) * turned;
        jacobian.column_mut(axis).copy_from(&by_rotation);
    }
    let by_scale = (intrinsics.project(&point)? - intrinsics.principal_point()) * (scale / o.sigma);
    jacobian.column_mut(6).copy_from(&by_scale);
    Some(jacobian)
}
