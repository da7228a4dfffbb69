//! Rays of observations, and points from them.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::triangulate::{ViewRay, nearest_to_rays};
use tiepoint_scene::{Observation, Reconstruction};

/// The ray of an observation; `None` if its image is not registered or its pixel has no ray.
pub fn view_ray<'a>(model: &'a Reconstruction, observation: &Observation) -> Option<ViewRay<'a>> {
    let image = model.image(observation.image);
    let pixel = image.keypoints[observation.keypoint as usize].pixel;
    ViewRay::new(image.cam_from_world()?, &model.camera(image.camera).intrinsics, pixel)
}

/// Triangulates a point from all observations with the current poses; `None` if the rays do not
/// determine it.
pub fn triangulate_observations(
    model: &Reconstruction,
    observations: &[Observation],
) -> Option<Vector3<f64>> {
    let rays: Vec<ViewRay> = observations.iter().filter_map(|o| view_ray(model, o)).collect();
    nearest_to_rays(rays.iter())
}
