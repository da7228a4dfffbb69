//! Filters: observations with large reprojection errors, points with small triangulation angles,
//! and images with few points.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_geometry::OptionError;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_scene::{Image, ImageId, Observation, PointId, Reconstruction};

/// Thresholds of the filter.
#[derive(Clone, Copy, Debug)]
pub struct FilterOptions {
    /// Maximum reprojection error, in pixels.
    pub max_error_px: f64,
    /// Minimum of the largest triangulation angle of a point, in radians.
    pub min_angle_rad: f64,
}

impl FilterOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        OptionError::check_positive("filter.max_error_px", self.max_error_px)?;
        OptionError::check_angle("filter.min_angle_rad", self.min_angle_rad)
    }
}

impl Default for FilterOptions {
    fn default() -> Self {
        Self { max_error_px: 4.0, min_angle_rad: 1.5_f64.to_radians() }
    }
}

/// Filters the given points. Returns the number of removed observations.
pub fn filter_points(
    model: &mut Reconstruction,
    points: &[PointId],
    options: &FilterOptions,
) -> usize {
    let mut num_removed = 0;
    for &point in points {
        let Some(track) = model.track(point) else { continue };
        let (xyz, count) = (track.xyz, track.observations.len());
        let bad: Vec<Observation> = track
            .observations
            .iter()
            .copied()
            .filter(|o| {
                model.observation_error_px(o, &xyz).is_none_or(|error| error > options.max_error_px)
            })
            .collect();
        if bad.len() + 2 > count {
            model.delete_track(point);
            num_removed += count;
            continue;
        }
        num_removed += bad.len();
        bad.into_iter().for_each(|o| model.remove_observation(o));
        if let Some(track) = model.track(point)
            && !has_angle(model, &track.observations, &xyz, options.min_angle_rad)
        {
            num_removed += track.observations.len();
            model.delete_track(point);
        }
    }
    num_removed
}

/// Minimum distance of a point from a camera, relative to the median distance of the points that
/// the camera observes. Matches between images of a stationary camera can triangulate at the camera
/// centre. Such points would dominate the two poses.
const MIN_RELATIVE_DISTANCE: f64 = 1e-3;

/// Filters all points, including those that lie at a camera centre. Returns the number of removed
/// observations.
pub fn filter_all_points(model: &mut Reconstruction, options: &FilterOptions) -> usize {
    let mut at_centre: BTreeSet<PointId> = BTreeSet::new();
    for (_, image, pose) in model.registered() {
        let centre = pose.origin_in_a();
        let seen: Vec<(f64, PointId)> = image
            .points()
            .iter()
            .flatten()
            .filter_map(|&point| Some(((model.track(point)?.xyz - centre).norm(), point)))
            .collect();
        let mut distances: Vec<f64> = seen.iter().map(|(distance, _)| *distance).collect();
        let least = MIN_RELATIVE_DISTANCE * median(&mut distances).unwrap_or(0.0);
        at_centre
            .extend(seen.iter().filter(|(distance, _)| *distance < least).map(|(_, point)| *point));
    }
    let num_removed: usize = at_centre
        .iter()
        .filter_map(|point| model.track(*point))
        .map(|track| track.observations.len())
        .sum();
    at_centre.into_iter().for_each(|point| model.delete_track(point));
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    num_removed + filter_points(model, &points, options)
}

/// Whether two cameras observe the point with a triangulation angle of at least `min_angle_rad`.
fn has_angle(
    model: &Reconstruction,
    observations: &[Observation],
    xyz: &Vector3<f64>,
    min_angle_rad: f64,
) -> bool {
    let max_cosine = min_angle_rad.cos();
    let directions: Vec<Vector3<f64>> = observations
        .iter()
        .filter_map(|o| model.image(o.image).cam_from_world())
        .map(|pose| (pose.origin_in_a() - xyz).normalize())
        .collect();
    directions
        .iter()
        .enumerate()
        .any(|(n, a)| directions[..n].iter().any(|b| a.dot(b) <= max_cosine))
}

/// Deregisters images that observe fewer than `min_points` points, and frames whose images do so
/// together, without the images that `is_kept` names. Returns the images.
pub(crate) fn filter_images(
    model: &mut Reconstruction,
    min_points: usize,
    is_kept: &dyn Fn(ImageId) -> bool,
) -> Vec<ImageId> {
    let mut num_points_of_frame: BTreeMap<ImageId, usize> = BTreeMap::new();
    for frame in &model.frames {
        let num_points = frame.images.iter().map(|image| model.image(*image).num_points()).sum();
        num_points_of_frame.extend(frame.images.iter().map(|image| (*image, num_points)));
    }
    let num_points = |id: ImageId, image: &Image| {
        num_points_of_frame.get(&id).copied().unwrap_or_else(|| image.num_points())
    };
    let removed: Vec<ImageId> = model
        .registered()
        .filter(|(id, image, _)| num_points(*id, image) < min_points && !is_kept(*id))
        .map(|(id, ..)| id)
        .collect();
    removed.iter().for_each(|&image| model.deregister(image));
    removed
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::Vector2;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Keypoint, Track};

    use super::*;

    /// Two images of a nearly stationary camera, and a third at a distance. Each point projects
    /// exactly to its keypoints.
    #[test]
    fn points_at_a_camera_centre_are_removed_and_near_ones_stay() {
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 1000, 1000);
        let places = [0.0, 1e-6, 1.0]
            .map(|x| Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-x, 0.0, 0.0)));
        // In metres: distant points, one near the cameras, and one at the centre of the first two.
        let points: Vec<Vector3<f64>> =
            (0..5).map(|k| Vector3::new(0.3 * f64::from(k), 0.2, 10.0)).collect();
        let (near, at_lens) = (Vector3::new(0.4, 0.1, 0.6), Vector3::new(5e-7, 2e-7, 1e-6));
        let mut model = Reconstruction::default();
        let camera = model.add_camera(Camera {
            intrinsics,
            width: 1000,
            height: 1000,
            has_focal_prior: true,
        });
        let all: Vec<Vector3<f64>> = points.iter().copied().chain([near, at_lens]).collect();
        let images = places.map(|pose| {
            let keypoint = |xyz: &Vector3<f64>| Keypoint {
                pixel: intrinsics.project(&(pose * *xyz)).unwrap_or_else(|| Vector2::new(0.0, 0.0)),
                scale_px: 2.0,
            };
            let name = format!("{}.png", model.images().count());
            let id = model.add_image(Image::new(name, camera, all.iter().map(keypoint).collect()));
            model.register(id, pose);
            id
        });
        for (index, xyz) in all.iter().enumerate() {
            let seen_by = if index + 1 == all.len() { &images[..2] } else { &images[..] };
            let observations =
                seen_by.iter().map(|&image| Observation { image, keypoint: index as u32 });
            model.add_track(Track::new(*xyz, observations.collect()));
        }
        let num_removed = filter_all_points(&mut model, &FilterOptions::default());
        assert_eq!((num_removed, model.num_tracks()), (2, all.len() - 1));
        assert!(model.tracks().all(|(_, track)| track.xyz != at_lens));
    }
}
