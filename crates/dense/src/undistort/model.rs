//! Models with PINHOLE cameras.

use tiepoint_scene::{Image, Observation, OriginalIds, Reconstruction, Track};

use super::{UndistortOptions, Undistortion, undistort_camera};
use crate::Error;

/// The model with undistorted cameras and keypoints, and with registered images only. A keypoint
/// whose ray the pinhole does not image stays at its place and loses its observation; a point
/// without two observations is left out. Rigs and frames are kept, and so are the ids of the files.
///
/// # Errors
/// [`Error::Option`] if an option is out of its range.
pub fn undistort_model(
    model: &Reconstruction,
    options: &UndistortOptions,
) -> Result<Reconstruction, Error> {
    let mut new = Reconstruction::default();
    let mut undistortions = Vec::new();
    for (_, camera) in model.cameras() {
        let to = undistort_camera(camera, options)?;
        undistortions.push(Undistortion::new(camera, &to));
        new.add_camera(to);
    }
    let ids = &model.original_ids;
    let cameras = model.cameras().map(|(id, _)| ids.camera(id)).collect();
    let (mut image_ids, mut point_ids) = (Vec::new(), Vec::new());
    // By image of `model`: its new id, and whether each keypoint has a place.
    let mut images = vec![None; model.num_images()];
    for (old, image, pose) in model.registered() {
        let undistortion = &undistortions[image.camera.index()];
        let mut keypoints = image.keypoints.to_vec();
        let mut has_place = vec![true; keypoints.len()];
        for (keypoint, has_place) in keypoints.iter_mut().zip(&mut has_place) {
            match undistortion.pixel(&keypoint.pixel) {
                Some(pixel) => keypoint.pixel = pixel,
                None => *has_place = false,
            }
        }
        let id = new.add_image(Image::new(image.name.clone(), image.camera, keypoints));
        new.set_time(id, image.time_s);
        new.register(id, *pose);
        image_ids.push(ids.image(old));
        images[old.index()] = Some((id, has_place));
    }
    new.rigs.clone_from(&model.rigs);
    new.frames.clone_from(&model.frames);
    for frame in &mut new.frames {
        let renumbered =
            frame.images.iter().filter_map(|old| Some(images[old.index()].as_ref()?.0));
        frame.images = renumbered.collect();
    }
    new.frames.retain(|frame| !frame.images.is_empty());
    for (point, track) in model.tracks() {
        let kept = track.observations.iter().filter_map(|observation| {
            let (image, has_place) = images[observation.image.index()].as_ref()?;
            has_place[observation.keypoint as usize]
                .then_some(Observation { image: *image, keypoint: observation.keypoint })
        });
        let observations: Vec<Observation> = kept.collect();
        if observations.len() >= 2 {
            new.add_track(Track { observations, ..track.clone() });
            point_ids.push(ids.point(point));
        }
    }
    new.original_ids = OriginalIds::new(cameras, image_ids, point_ids);
    Ok(new)
}
