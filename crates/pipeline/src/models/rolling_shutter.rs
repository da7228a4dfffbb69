//! Rolling shutters of a finished model: the motion of its images, and the keypoints before their
//! correction.
//!
//! The motion of an image is a function of the poses, the times and the readout time of its camera,
//! so that it is computed here anew.

use std::collections::BTreeMap;

use tiepoint_io::database::Database;
use tiepoint_io::gsplat;
use tiepoint_io::nerfstudio::Motion;
use tiepoint_sfm::convert::keypoint;
use tiepoint_sfm::geometry::RowPoses;
use tiepoint_sfm::geometry::nalgebra::Vector2;
use tiepoint_sfm::rolling_shutter::row_poses;
use tiepoint_sfm::scene::{ImageId, Reconstruction};

use crate::Error;
use crate::workspace::located_model::LocatedModel;

/// The motion of the images of a model with rolling shutters.
///
/// # Errors
///
/// No image has a motion: the model was mapped without a rolling shutter.
pub(crate) fn motions(located: &LocatedModel) -> Result<BTreeMap<ImageId, RowPoses>, Error> {
    let motions = row_poses(&located.reconstruction, &located.shutters);
    if motions.is_empty() {
        return Err(Error::NoShutter { path: located.folder().to_owned() });
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

/// The model with the keypoints of its registered images where they were detected.
///
/// # Errors
///
/// The database of the workspace cannot be read, or has other images or keypoints.
pub(crate) fn detected_keypoints(located: &LocatedModel) -> Result<Reconstruction, Error> {
    let path = located.database();
    let mut model = located.reconstruction.clone();
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
    Ok(model)
}
