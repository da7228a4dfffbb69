//! Absolute pose of a rig of calibrated cameras from 2D-3D correspondences of all of them.

use std::ops::Range;

use nalgebra::{SVector, Vector2, Vector3};

use super::absolute_pose::d_pose;
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::{CameraModel, Intrinsics, Loss, Manifold, Rigid3, solvers};

/// A camera of a rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigCamera {
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose on the rig.
    pub cam_from_rig: Rigid3,
}

/// A pixel of a camera of a rig, and the point that it is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigObservation {
    /// Index of the camera among those of the rig.
    pub camera: usize,
    /// Pixel.
    pub pixel: Vector2<f64>,
    /// Point in the world frame.
    pub point_in_world: Vector3<f64>,
}

/// Estimates `rig_from_world` of a rig whose `cameras` make `observations`. An observation whose
/// camera does not exist is an outlier.
///
/// Minimal models come from [`solvers::gp3p`]; refinement minimises the reprojection error over all
/// cameras. `options.max_error` is a reprojection error in pixels. Points behind their camera are
/// outliers. The scale of the model is that of the rig.
pub fn generalized_absolute_pose(
    cameras: &[RigCamera],
    observations: &[RigObservation],
    options: &RansacOptions,
) -> Option<Report<Rigid3>> {
    ransac(&GeneralizedAbsolutePose::new(cameras, observations), options)
}

/// The RANSAC problem of the absolute pose of a rig.
struct GeneralizedAbsolutePose<'a> {
    cameras: &'a [RigCamera],
    observations: &'a [RigObservation],
    /// Centre of the camera and unit ray of each pixel in the frame of the rig; a zero ray for a
    /// pixel without one.
    rays_in_rig: Vec<(Vector3<f64>, Vector3<f64>)>,
}

impl<'a> GeneralizedAbsolutePose<'a> {
    fn new(cameras: &'a [RigCamera], observations: &'a [RigObservation]) -> Self {
        let ray = |observation: &RigObservation| {
            let RigCamera { intrinsics, cam_from_rig } = cameras.get(observation.camera)?;
            let ray_in_cam = intrinsics.unproject(&observation.pixel)?;
            Some((cam_from_rig.origin_in_a(), cam_from_rig.rotation.inverse() * ray_in_cam))
        };
        let rays_in_rig = observations.iter().map(|o| ray(o).unwrap_or_default()).collect();
        Self { cameras, observations, rays_in_rig }
    }
}

impl Estimator for GeneralizedAbsolutePose<'_> {
    type Model = Rigid3;
    const SAMPLE_SIZE: usize = 3;

    fn num_data(&self) -> usize {
        self.observations.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Rigid3>) {
        let origins = std::array::from_fn(|i| self.rays_in_rig[sample[i]].0);
        let rays = std::array::from_fn(|i| self.rays_in_rig[sample[i]].1);
        let points = std::array::from_fn(|i| self.observations[sample[i]].point_in_world);
        models.extend(solvers::gp3p(&origins, &rays, &points));
    }

    fn squared_residuals(&self, model: &Rigid3, range: Range<usize>, squared: &mut [f64]) {
        // The observations of a camera are usually consecutive.
        let mut last: Option<(usize, Rigid3)> = None;
        for (squared, observation) in squared.iter_mut().zip(&self.observations[range]) {
            *squared = f64::INFINITY;
            let RigObservation { camera, pixel, point_in_world } = observation;
            let Some(RigCamera { intrinsics, cam_from_rig }) = self.cameras.get(*camera) else {
                continue;
            };
            let cam_from_world = match last {
                Some((same, pose)) if same == *camera => pose,
                _ => *cam_from_rig * *model,
            };
            last = Some((*camera, cam_from_world));
            let point_in_cam = cam_from_world * *point_in_world;
            if let Some(error) = intrinsics.squared_error_px2(&point_in_cam, pixel) {
                *squared = error;
            }
        }
    }

    fn refine(&self, model: &Rigid3, data: &[usize], loss: Loss) -> Option<Rigid3> {
        let problem =
            Reprojection { cameras: self.cameras, observations: self.observations, inliers: data };
        Some(minimize(&problem, model, loss, MAX_LM_ITERATIONS))
    }
}

/// Minimises the reprojection error of all cameras over the pose of the rig.
struct Reprojection<'a> {
    cameras: &'a [RigCamera],
    observations: &'a [RigObservation],
    inliers: &'a [usize],
}

impl Problem<6> for Reprojection<'_> {
    type Value = Rigid3;

    fn plus(&self, value: &Rigid3, delta: &SVector<f64, 6>) -> Rigid3 {
        value.plus(delta)
    }

    fn linearize(&self, value: &Rigid3, normal: &mut NormalEquations<6>) {
        for &i in self.inliers {
            let RigObservation { camera, pixel, point_in_world } = &self.observations[i];
            let Some(RigCamera { intrinsics, cam_from_rig }) = self.cameras.get(*camera) else {
                continue;
            };
            let point_in_rig = *value * *point_in_world;
            let point_in_cam = *cam_from_rig * point_in_rig;
            with_camera_model!(intrinsics, M, params => {
                match M::project_with_jacobian(params, &point_in_cam) {
                    Some(projection) => {
                        let d_point_in_rig =
                            projection.d_point * cam_from_rig.rotation.to_rotation_matrix();
                        normal.add(
                            &M::displacement(params, &projection.pixel, pixel),
                            &d_pose(&d_point_in_rig, &point_in_rig),
                        );
                    }
                    None => normal.reject(),
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CameraModelKind, Rng};

    const NUM_POINTS: usize = 120;
    /// Every third correspondence is wrong.
    const OUTLIER_STEP: usize = 3;
    const SEED: u64 = 7;
    /// Noise of the pixels. Of 80 of them the mean has an error of 1e-4 radians, and a rotation
    /// that a translation nearly compensates one ten times that; three standard deviations.
    const NOISE_PX: f64 = 0.5;
    const MAX_ERROR_RAD: f64 = 3e-3;

    fn uniform(rng: &mut Rng) -> Vector3<f64> {
        let [x, y, z] = [0; 3].map(|_| 2.0 * rng.uniform() - 1.0);
        Vector3::new(x, y, z)
    }

    /// The error of the estimated pose of cameras at these places of a rig, in radians and metres.
    fn error(centres_in_rig: &[Vector3<f64>]) -> [f64; 2] {
        let mut rng = Rng::stream(SEED, &[]);
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
        let cameras: Vec<RigCamera> = centres_in_rig
            .iter()
            .enumerate()
            .map(|(index, centre)| {
                // Each looks 90 degrees to the right of the one before it.
                let turn = Vector3::new(0.0, -std::f64::consts::FRAC_PI_2 * index as f64, 0.0);
                let rotation = Rigid3::from_axis_angle(turn, Vector3::zeros()).rotation;
                let cam_from_rig = Rigid3 { rotation, translation: -(rotation * centre) };
                RigCamera { intrinsics, cam_from_rig }
            })
            .collect();
        let rig_from_world = Rigid3::from_axis_angle(uniform(&mut rng), 5.0 * uniform(&mut rng));
        let observations: Vec<RigObservation> = (0..NUM_POINTS)
            .map(|index| {
                let camera = index * cameras.len() / NUM_POINTS;
                let offset = uniform(&mut rng);
                let in_cam = Vector3::new(3.0 * offset.x, 2.0 * offset.y, 8.0 + 3.0 * offset.z);
                let noise = NOISE_PX * Vector2::new(rng.normal(), rng.normal());
                let pixel = intrinsics.project(&in_cam).unwrap() + noise;
                let cam_from_world = cameras[camera].cam_from_rig * rig_from_world;
                let mut point_in_world = cam_from_world.inverse() * in_cam;
                if index % OUTLIER_STEP == 0 {
                    point_in_world += 5.0 * uniform(&mut rng);
                }
                RigObservation { camera, pixel, point_in_world }
            })
            .collect();
        let report =
            generalized_absolute_pose(&cameras, &observations, &RansacOptions::default()).unwrap();
        assert!(report.num_inliers >= NUM_POINTS - NUM_POINTS.div_ceil(OUTLIER_STEP));
        [
            report.model.rotation.angle_to(&rig_from_world.rotation),
            (report.model.origin_in_a() - rig_from_world.origin_in_a()).norm(),
        ]
    }

    #[test]
    fn cameras_that_look_apart_and_cameras_of_one_centre_have_a_pose() {
        let apart = [Vector3::zeros(), Vector3::new(0.5, 0.0, -0.2), Vector3::new(0.0, 0.3, -1.0)];
        let of_one_centre = [Vector3::new(0.3, -0.2, 0.1); 3];
        for centres in [&apart[..], &of_one_centre, &apart[..2], &apart[1..2]] {
            let [rotation_rad, centre_m] = error(centres);
            assert!(rotation_rad < MAX_ERROR_RAD, "{centres:?}: {rotation_rad} rad");
            // Points are at 8 metres.
            assert!(centre_m < 8.0 * MAX_ERROR_RAD, "{centres:?}: {centre_m} m");
        }
    }

    #[test]
    fn an_observation_of_no_camera_is_an_outlier() {
        let camera = RigCamera {
            intrinsics: Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480),
            cam_from_rig: Rigid3::identity(),
        };
        let observation = |camera: usize, x: f64| RigObservation {
            camera,
            pixel: Vector2::new(320.0 + 50.0 * x, 240.0 + 50.0 * x * x),
            point_in_world: Vector3::new(x, x * x, 10.0),
        };
        let observations: Vec<RigObservation> =
            (0..9).map(|i| observation(usize::from(i == 4), f64::from(i) - 4.0)).collect();
        let report =
            generalized_absolute_pose(&[camera], &observations, &RansacOptions::default()).unwrap();
        assert!(!report.inliers[4]);
        assert_eq!(report.num_inliers, 8);
        assert!(report.model.translation.norm() < 1e-6);
    }
}
