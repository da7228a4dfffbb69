//! Rolling shutters of a model on disk: the motion of its images, and the keypoints before their
//! correction.
//!
//! Mapping with a rolling shutter stores the readout times in `report.json`. The motion of an image
//! is a function of the poses and times of its camera, so that it is computed here anew.

use std::collections::BTreeMap;
use std::path::Path;

use tiepoint_io::database::Database;
use tiepoint_io::gsplat;
use tiepoint_io::nerfstudio::Motion;
use tiepoint_sfm::geometry::nalgebra::Vector2;
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_sfm::{RollingShutter, RowPoses, row_poses};

use crate::workspace::keypoints::keypoint;
use crate::workspace::model_location::{ModelLocation, read_times};
use crate::{Error, Report};

/// The readout times of a model in a folder of a workspace; none if it was mapped without a rolling
/// shutter, or is in no workspace. Sets the times of the images, so that
/// [`row_poses`](tiepoint_sfm::row_poses) has all it needs.
///
/// # Errors
///
/// The report or the times cannot be read.
pub fn rolling_shutters(
    folder: &Path,
    model: &mut Reconstruction,
) -> Result<Vec<RollingShutter>, Error> {
    let location = ModelLocation::of(folder);
    let (report, index) = location.report();
    if !report.is_file() {
        return Ok(Vec::new());
    }
    let report = Report::read(&report)?;
    let reported = report.models.get(index).map_or(&[][..], |model| &model.cameras);
    let shutter = |(camera, of_model): (_, &tiepoint_sfm::scene::Camera)| {
        let reported = reported.iter().find(|reported| {
            model.original_ids.camera(camera) == u64::from(reported.id)
                && (reported.width, reported.height) == (of_model.width, of_model.height)
        })?;
        let readout_s = reported.readout_s?;
        Some(RollingShutter { camera, readout_s, readout_sd_s: reported.readout_sd_s })
    };
    let shutters: Vec<RollingShutter> = model.cameras().filter_map(shutter).collect();
    if !shutters.is_empty() {
        read_times(model, &location.timestamps())?;
    }
    Ok(shutters)
}

/// The motion of the images of a model with rolling shutters. Sets the times of the images.
///
/// # Errors
///
/// The report or the times cannot be read, or no image has a motion: the model was mapped without
/// a rolling shutter, or is in no workspace.
pub(crate) fn motions(
    folder: &Path,
    model: &mut Reconstruction,
) -> Result<BTreeMap<ImageId, RowPoses>, Error> {
    let shutters = rolling_shutters(folder, model)?;
    let motions = row_poses(model, &shutters);
    if motions.is_empty() {
        return Err(Error::NoShutter { path: folder.to_owned() });
    }
    Ok(motions)
}

/// The motions in the form of the exported files.
pub(crate) fn for_nerfstudio(motions: &BTreeMap<ImageId, RowPoses>) -> BTreeMap<ImageId, Motion> {
    motions.iter().map(|(id, rows)| (*id, motion(rows))).collect()
}

/// The poses of the first and the last row.
pub(crate) fn for_gsplat(
    model: &Reconstruction,
    motions: &BTreeMap<ImageId, RowPoses>,
) -> BTreeMap<ImageId, gsplat::RowPoses> {
    let of_image = |(id, rows): (&ImageId, &RowPoses)| {
        let middle = model.image(*id).cam_from_world()?;
        // The centres of the rows.
        let [first, last] =
            [0.5, rows.height_px - 0.5].map(|y_px| rows.cam_from_world(middle, y_px));
        Some((*id, gsplat::RowPoses { first, last, motion: motion(rows) }))
    };
    motions.iter().filter_map(of_image).collect()
}

fn motion(rows: &RowPoses) -> Motion {
    Motion {
        velocity_in_world: rows.velocity_in_world,
        angular_velocity_rad_s: rows.angular_velocity_rad_s,
        readout_s: rows.readout_s,
    }
}

/// Moves the keypoints of the registered images back to where they were detected.
///
/// # Errors
///
/// The database of the workspace cannot be read, or has other images or keypoints.
pub(crate) fn restore_detected_keypoints(
    folder: &Path,
    model: &mut Reconstruction,
) -> Result<(), Error> {
    let path = ModelLocation::of(folder).database();
    let database = Database::open_read_only(&path)?;
    let images = database.read_images()?.into_iter().enumerate();
    let in_database: BTreeMap<String, ImageId> =
        images.map(|(index, image)| (image.name, ImageId::from_index(index))).collect();
    let registered: Vec<ImageId> = model.registered().map(|(id, ..)| id).collect();
    for id in registered {
        let image = model.image(id);
        let missing =
            || Error::NoDetectedKeypoints { path: path.clone(), image: image.name.clone() };
        let keypoints =
            database.read_keypoints(*in_database.get(&image.name).ok_or_else(missing)?)?;
        if keypoints.len() != image.keypoints.len() {
            return Err(missing());
        }
        let pixels: Vec<Vector2<f64>> = keypoints.iter().map(|k| keypoint(k).pixel).collect();
        model.move_keypoints(id, &pixels);
    }
    Ok(())
}
