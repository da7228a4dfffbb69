//! Evaluation of a workspace of rendered images against their ground truth.

use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::geometry::{Rigid3, Sim3};
use tiepoint_pipeline::eval::{Alignment, Cloud, TrueObservation};
use tiepoint_pipeline::evaluation::{
    PoseEvaluation, RegisteredCloud, SurfaceEvaluation, Truth, TruthFormat, evaluate_poses,
    evaluate_surface, register_cloud,
};
use tiepoint_pipeline::sfm::rig::{RelativePose, Trajectory, relative_pose_statistics};
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Reconstruction};
use tiepoint_pipeline::workspace::{LocatedModel, RigFile};
use tiepoint_report::CameraError;
use tiepoint_synth::Drive;

/// Points farther than this from every camera centre are not compared with the laser scan.
pub(crate) const MAX_CLOUD_RANGE_M: f64 = 30.0;

/// The errors of a model. Lengths are in metres.
pub(crate) struct DriveEvaluation {
    pub(crate) poses: PoseEvaluation,
    /// The largest model, with the capture times of its images.
    pub(crate) model: Reconstruction,
    /// Extrinsics and clocks of its rig.
    pub(crate) rig: Option<RigFile>,
    pub(crate) camera_errors: Vec<CameraError>,
    pub(crate) baseline: Option<FrameBaselines>,
    pub(crate) surface: Option<SurfaceEvaluation>,
    /// Distances to the scan after Sim(3) alignment of the cameras and rigid ICP.
    pub(crate) cloud: Option<RegisteredCloud>,
    /// Distances to the scan of the same tracks, triangulated with the true cameras.
    pub(crate) exact_cloud: Option<RegisteredCloud>,
}

/// Compares a workspace with its drive. `truth` is the folder of the true model, `scan` the laser
/// scan in metres; `is_compared` selects the points of the cloud (in the world frame)
/// that are compared with it.
///
/// # Errors
///
/// The models cannot be read, or too few images have a pose to align them.
pub(crate) fn evaluate_drive(
    workspace: &Path,
    drive: &Drive,
    truth: &Path,
    scan: Option<&Cloud>,
    is_compared: impl Fn(&Vector3<f64>) -> bool,
) -> Result<DriveEvaluation, Error> {
    let truth = Truth { format: TruthFormat::Colmap, path: truth.to_owned() };
    let located = LocatedModel::open(workspace)?;
    let rig = located.rig.clone();
    let poses = evaluate_poses(&located, &truth, None)?;
    let model = with_stamps(located.reconstruction, drive);
    let world_from_model = poses.truth_from_model;
    let surface = evaluate_surface(&model, &world_from_model, |image, pixel| {
        true_observation(drive, image, pixel)
    });
    let camera_errors = camera_errors(&model, drive, &world_from_model);
    let is_near = |centre: &dyn Fn(&CameraError) -> Vector3<f64>, point: &Vector3<f64>| {
        camera_errors.iter().any(|error| (centre(error) - point).norm() < MAX_CLOUD_RANGE_M)
            && is_compared(point)
    };
    let points = model.tracks().map(|(_, track)| world_from_model * track.xyz);
    let points: Vec<Vector3<f64>> =
        points.filter(|point| is_near(&|error| error.estimated_centre, point)).collect();
    let register = |points: &[Vector3<f64>], alignment| {
        register_cloud(points, scan?, &Sim3::identity(), alignment)
    };
    let cloud = register(&points, Alignment::Rigid);
    let exact = surface.iter().flat_map(|surface| &surface.exact_points).copied();
    let exact: Vec<Vector3<f64>> =
        exact.filter(|point| is_near(&|error| error.true_centre, point)).collect();
    let exact_cloud = register(&exact, Alignment::None);
    let baseline = frame_baselines(&model, drive, poses.scale);
    Ok(DriveEvaluation { poses, model, rig, camera_errors, baseline, surface, cloud, exact_cloud })
}

/// Distances of the first two cameras at the instants of the second one's images, in metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameBaselines {
    pub(crate) mean_m: f64,
    pub(crate) max_m: f64,
    /// Root mean square deviation of the second camera's centre from its mean, in the frame of the
    /// first camera.
    pub(crate) deviation_m: f64,
}

/// The poses of the first camera are interpolated at the true instants of the second one, so that
/// models with and without clocks are measured alike, and cameras that are not triggered together
/// have a baseline, too.
fn frame_baselines(model: &Reconstruction, drive: &Drive, scale: f64) -> Option<FrameBaselines> {
    let poses_of = |wanted: usize| {
        let of_image = |(_, image, pose): (ImageId, &Image, &Rigid3)| {
            let (camera, exposure) = drive.find(&image.name)?;
            (camera == wanted).then_some((exposure.time_s, *pose))
        };
        let mut poses: Vec<(f64, Rigid3)> = model.registered().filter_map(of_image).collect();
        poses.sort_by(|one, other| one.0.total_cmp(&other.0));
        poses
    };
    let (first, second) = (Trajectory::new(poses_of(0)), poses_of(1));
    let relative =
        |(time_s, pose): &(f64, Rigid3)| Some(RelativePose::between(&first.at(*time_s)?, pose));
    let relative: Vec<RelativePose> = second.iter().filter_map(relative).collect();
    let statistics = relative_pose_statistics(&relative)?;
    let largest = relative.iter().map(|pose| pose.translation.norm()).fold(0.0, f64::max);
    Some(FrameBaselines {
        mean_m: scale * statistics.mean_baseline,
        max_m: scale * largest,
        deviation_m: scale * statistics.rms_translation,
    })
}

/// The largest model of a workspace, with the time stamps of its images on their cameras' clocks,
/// and its rig.
///
/// # Errors
///
/// The model cannot be read.
pub(crate) fn read_drive_model(
    workspace: &Path,
    drive: &Drive,
) -> Result<(Reconstruction, Option<RigFile>), Error> {
    let located = LocatedModel::open(workspace)?;
    Ok((with_stamps(located.reconstruction, drive), located.rig))
}

/// A model with the time stamps of its images on their cameras' clocks.
fn with_stamps(mut model: Reconstruction, drive: &Drive) -> Reconstruction {
    let times: Vec<(ImageId, f64)> = model
        .images()
        .filter_map(|(id, image)| Some((id, drive.find(&image.name)?.1.stamp_s)))
        .collect();
    times.into_iter().for_each(|(id, stamp_s)| model.set_time(id, Some(stamp_s)));
    model
}

/// Estimated and true centre of each registered image, in the order of the images.
pub(crate) fn camera_errors(
    model: &Reconstruction,
    drive: &Drive,
    world_from_model: &Sim3,
) -> Vec<CameraError> {
    let error = |image: &Image| {
        let (camera, exposure) = drive.find(&image.name)?;
        Some(CameraError {
            camera,
            estimated_centre: *world_from_model * image.cam_from_world()?.origin_in_a(),
            true_centre: drive.cam_from_world(camera, exposure.time_s).origin_in_a(),
        })
    };
    model.registered().filter_map(|(_, image, _)| error(image)).collect()
}

/// The true camera centre and surface point of a pixel, with the true lens, shutter and clock.
fn true_observation(drive: &Drive, image: &Image, pixel: &Vector2<f64>) -> TrueObservation {
    let (camera, exposure) = drive.find(&image.name).expect("the images are those of the drive");
    let camera_in_world =
        drive.row_pose(camera, exposure.time_s, pixel.y).world_from_cam.translation;
    let surface =
        drive.surface_at(camera, exposure.time_s, pixel).filter(|surface| !surface.is_moving);
    TrueObservation {
        camera_in_world,
        surface_in_world: surface.map(|surface| surface.point_in_world),
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_synth::{DriveOptions, Effects, FeatureOptions, FeatureScene};

    use super::*;

    /// Cameras that are triggered up to half an interval apart, with the true poses: the error is
    /// that of the interpolation (2.5 mm at 2.5 Hz with turns and stops, README of tiepoint-rig).
    #[test]
    fn cameras_that_are_not_triggered_together_have_their_baseline() {
        let mut effects = Effects::default();
        effects.clocks.offset_s = 0.2;
        effects.clocks.phase = 1.0;
        effects.clocks.late_start_s = 0.5;
        let options = DriveOptions { effects, rate_hz: 5.0, ..DriveOptions::default() };
        let mut drive = Drive::new(&options).unwrap();
        drive.keep_first(25);
        let features = FeatureOptions { observations: 2_000, ..FeatureOptions::default() };
        let model = FeatureScene::new(&drive, &features).unwrap().truth().clone();
        let true_m = (drive.cam_from_world(0, 5.0).origin_in_a()
            - drive.cam_from_world(1, 5.0).origin_in_a())
        .norm();
        let found = frame_baselines(&model, &drive, 2.0).unwrap();
        assert!((found.mean_m - 2.0 * true_m).abs() < 0.003, "{found:?}, {true_m}");
        assert!(found.max_m - 2.0 * true_m < 0.005, "{found:?}, {true_m}");
        assert!(found.deviation_m < 0.005, "{found:?}");
    }
}
