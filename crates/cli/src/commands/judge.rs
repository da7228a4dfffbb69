//! A workspace against the rendered world that its images show.

use std::path::Path;

use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::{Alignment, Sighting};
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Reconstruction};
use tiepoint_pipeline::{
    CloudEvaluation, Error, PoseEvaluation, RigEvaluation, SurfaceEvaluation, Truth, TruthFormat,
    Whereabouts, evaluate_cloud, evaluate_poses, evaluate_rig, evaluate_surface, model_folder,
};
use tiepoint_synth::Drive;

/// Points of a cloud farther than this from the vehicle's way are no more compared than a scanner
/// would see them.
const MAX_CLOUD_RANGE_M: f64 = 30.0;

/// What there is to say about a model whose world is known. Lengths are in metres.
pub(crate) struct Judged {
    pub(crate) poses: PoseEvaluation,
    /// With the times of its images.
    pub(crate) model: Reconstruction,
    pub(crate) whereabouts: Vec<Whereabouts>,
    pub(crate) baseline: Option<RigEvaluation>,
    pub(crate) surface: Option<SurfaceEvaluation>,
    /// Cameras aligned, then the cloud by a rigid motion.
    pub(crate) cloud: Option<CloudEvaluation>,
    /// The cloud of the same tracks, had the cameras been exactly known.
    pub(crate) exact_cloud: Option<CloudEvaluation>,
}

/// Compares a workspace with its drive; `truth` is the true model, `scan` what of the street its
/// points may lie on, and `is_compared` which of them are looked at.
pub(crate) fn judge(
    workspace: &Path,
    drive: &Drive,
    truth: &Path,
    scan: &[Vector3<f64>],
    is_compared: impl Fn(&Vector3<f64>) -> bool,
) -> Result<Judged, Error> {
    let truth = Truth { format: TruthFormat::Colmap, path: truth.to_owned() };
    let poses = evaluate_poses(workspace, &truth, None)?;
    let model = read_drive_model(workspace, drive)?;
    let world_from_model = poses.truth_from_model;
    let surface =
        evaluate_surface(&model, &world_from_model, |image, pixel| sighting(drive, image, pixel));
    let whereabouts = whereabouts(&model, drive, &world_from_model);
    let near = |centre: &dyn Fn(&Whereabouts) -> Vector3<f64>, point: &Vector3<f64>| {
        whereabouts.iter().any(|place| (centre(place) - point).norm() < MAX_CLOUD_RANGE_M)
            && is_compared(point)
    };
    let found = model.tracks().map(|(_, track)| world_from_model * track.xyz);
    let found: Vec<Vector3<f64>> =
        found.filter(|point| near(&|place| place.found, point)).collect();
    let cloud = evaluate_cloud(&found, scan, &Sim3::identity(), Alignment::Rigid);
    let exact = surface.iter().flat_map(|surface| &surface.exact_points).copied();
    let exact: Vec<Vector3<f64>> =
        exact.filter(|point| near(&|place| place.truth, point)).collect();
    let exact_cloud = evaluate_cloud(&exact, scan, &Sim3::identity(), Alignment::None);
    let baseline = evaluate_rig(&model, poses.scale).into_iter().next();
    Ok(Judged { poses, model, whereabouts, baseline, surface, cloud, exact_cloud })
}

/// The largest model of a workspace, its images with the times on their cameras' clocks.
pub(crate) fn read_drive_model(workspace: &Path, drive: &Drive) -> Result<Reconstruction, Error> {
    let mut model = read_model(&model_folder(workspace)?)?;
    let times: Vec<(ImageId, f64)> = model
        .images()
        .filter_map(|(id, image)| Some((id, drive.find(&image.name)?.1.stamp_s)))
        .collect();
    times.into_iter().for_each(|(id, stamp_s)| model.set_time(id, Some(stamp_s)));
    Ok(model)
}

/// Where each camera centre was found, and where it truly was, in the order of the images.
pub(crate) fn whereabouts(
    model: &Reconstruction,
    drive: &Drive,
    world_from_model: &Sim3,
) -> Vec<Whereabouts> {
    let place = |image: &Image| {
        let (camera, exposure) = drive.find(&image.name)?;
        let found = *world_from_model * image.cam_from_world()?.origin_in_a();
        Some(Whereabouts {
            camera,
            found,
            truth: drive.cam_from_world(camera, exposure.time_s).origin_in_a(),
        })
    };
    model.registered().filter_map(|(_, image, _)| place(image)).collect()
}

/// What an image of a drive truly sees at a pixel, through the true lens, shutter and clock.
fn sighting(drive: &Drive, image: &Image, pixel: &Vector2<f64>) -> Sighting {
    let (camera, exposure) = drive.find(&image.name).expect("the images are those of the drive");
    let camera_in_world =
        drive.row_pose(camera, exposure.time_s, pixel.y).world_from_cam.translation;
    let surface =
        drive.surface_at(camera, exposure.time_s, pixel).filter(|surface| !surface.is_moving);
    Sighting { camera_in_world, surface_in_world: surface.map(|surface| surface.point_in_world) }
}
