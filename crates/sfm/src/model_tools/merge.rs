//! Merge: the images and points of a second model in the frame of a first one.

use std::collections::BTreeMap;

use tiepoint_adjust::triangulate_observations;
use tiepoint_scene::{
    Camera, CameraId, Image, ImageId, Observation, PointId, Reconstruction, Track,
};

use super::align::{ModelAlignment, align_models, common_images, have_same_keypoints};
use crate::Error;
use crate::tracks::{FilterOptions, filter_points};

/// The effect of a merge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergeOutcome {
    /// How the models fit together. Without a similarity nothing was merged.
    pub alignment: ModelAlignment,
    /// Number of images that only the second model had.
    pub new_images: usize,
    /// Number of points that were added.
    pub new_points: usize,
    /// Number of points of the first model that got observations of the second one.
    pub merged_points: usize,
}

/// Adds the images and points of `other` to `model`, in the frame of `model`, if they fit together.
///
/// Images of one name are one image, and keep the pose of `model`. Their cameras are one camera;
/// other cameras of `other` are added. A point of `other` is merged into a point of `model` if its
/// keypoints observe that one and no other; otherwise its keypoints without a point make a new one
/// (the rules of COLMAP's `MergeReconstructions`). Merged points are triangulated again, and
/// observations with errors above `max_error_px` are removed from all points that changed. Images
/// of frames of `other` have poses of their own afterwards.
///
/// # Errors
///
/// Those of the optimiser.
pub fn merge_model(
    model: &mut Reconstruction,
    other: &Reconstruction,
    max_error_px: f64,
) -> Result<MergeOutcome, Error> {
    let alignment = align_models(other, model, max_error_px)?;
    Ok(merge_aligned(model, other, alignment, max_error_px))
}

/// Merges `other` into `model` by the similarity of an alignment, as [`merge_model`].
pub(crate) fn merge_aligned(
    model: &mut Reconstruction,
    other: &Reconstruction,
    alignment: ModelAlignment,
    max_error_px: f64,
) -> MergeOutcome {
    let mut outcome = MergeOutcome { alignment, new_images: 0, new_points: 0, merged_points: 0 };
    let Some(model_from_other) = alignment.reference_from_model else { return outcome };
    let mut other = other.clone();
    other.transform(&model_from_other);

    let (images, new_images) = add_images(model, &other);
    outcome.new_images = new_images;
    let mut changed: Vec<PointId> = Vec::new();
    for (_, track) in other.tracks() {
        let observations = track.observations.iter().filter_map(|o| {
            Some(Observation { image: *images.get(&o.image)?, keypoint: o.keypoint })
        });
        let (mut free, mut points) = (Vec::new(), Vec::new());
        for observation in observations {
            match model.image(observation.image).point_of(observation.keypoint) {
                Some(point) => points.push(point),
                None => free.push(observation),
            }
        }
        points.sort_unstable();
        points.dedup();
        match points[..] {
            [point] if !free.is_empty() => {
                free.into_iter().for_each(|o| model.add_observation(point, o));
                changed.push(point);
                outcome.merged_points += 1;
            }
            [_] => {}
            _ if free.len() >= 2 => {
                let new = Track { observations: free, ..track.clone() };
                changed.push(model.add_track(new));
                outcome.new_points += 1;
            }
            _ => {}
        }
    }
    changed.sort_unstable();
    changed.dedup();
    for &point in &changed {
        let Some(track) = model.track(point) else { continue };
        let xyz = triangulate_observations(model, &track.observations);
        if let (Some(xyz), Some(track)) = (xyz, model.track_mut(point)) {
            track.xyz = xyz;
        }
    }
    let options = FilterOptions { max_error_px, ..FilterOptions::default() };
    filter_points(model, &changed, &options);
    outcome
}

/// Adds the images that only `other` has. Returns the image in `model` of each image of `other`
/// whose keypoints are the same, and the number of added images.
fn add_images(
    model: &mut Reconstruction,
    other: &Reconstruction,
) -> (BTreeMap<ImageId, ImageId>, usize) {
    let common = common_images(other, model);
    let mut cameras: BTreeMap<CameraId, CameraId> =
        common.iter().map(|&(a, b)| (other.image(a).camera, model.image(b).camera)).collect();
    let known: BTreeMap<String, ImageId> =
        model.images().map(|(id, image)| (image.name.clone(), id)).collect();
    let mut images: BTreeMap<ImageId, ImageId> =
        common.into_iter().filter(|ids| have_same_keypoints(other, model, *ids)).collect();
    let mut num_new = 0;
    for (id, image, pose) in other.registered() {
        match known.get(&image.name) {
            Some(there) if model.image(*there).cam_from_world().is_some() => continue,
            Some(there) if have_same_keypoints(other, model, (id, *there)) => {
                model.register(*there, *pose);
                images.insert(id, *there);
            }
            Some(_) => continue,
            None => {
                let camera = *cameras.entry(image.camera).or_insert_with(|| {
                    let camera: Camera = *other.camera(image.camera);
                    let added = model.add_camera(camera);
                    let id = other.original_ids.camera(image.camera);
                    model.original_ids.set_last_camera(added, id);
                    added
                });
                let mut new = Image::new(image.name.clone(), camera, image.keypoints.to_vec());
                new.time_s = image.time_s;
                let new = model.add_image(new);
                model.original_ids.set_last_image(new, other.original_ids.image(id));
                model.register(new, *pose);
                images.insert(id, new);
            }
        }
        num_new += 1;
    }
    (images, num_new)
}
