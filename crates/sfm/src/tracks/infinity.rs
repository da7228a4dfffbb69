//! Points whose depth their rays do not tell.

use tiepoint_geometry::nalgebra::Matrix3;
use tiepoint_scene::{PointId, Reconstruction, Track};

/// A point whose depth its rays tell this much worse than its direction (as a ratio of information)
/// is at infinity: the undamped system is singular for it.
const MIN_DEPTH_INFORMATION: f64 = 1e-8;

/// With such points set aside; they move nothing but rotations, which all others move too.
pub(crate) fn without_points_at_infinity(model: &Reconstruction) -> Reconstruction {
    let is_far = |track: &Track| {
        let mut information = Matrix3::zeros();
        for pose in track.observations.iter().filter_map(|o| model.image(o.image).cam_from_world())
        {
            let ray = track.xyz - pose.origin_in_a();
            let direction = ray.normalize();
            information +=
                (Matrix3::identity() - direction * direction.transpose()) / ray.norm_squared();
        }
        let eigenvalues = information.symmetric_eigenvalues();
        // Not a number is nowhere.
        let is_near = eigenvalues.min() > MIN_DEPTH_INFORMATION * eigenvalues.max();
        !is_near
    };
    let far: Vec<PointId> =
        model.tracks().filter(|(_, track)| is_far(track)).map(|(point, _)| point).collect();
    let mut near = model.clone();
    for point in far {
        if let Some(track) = near.track_mut(point) {
            track.is_held_out = true;
        }
    }
    near
}
