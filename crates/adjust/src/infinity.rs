//! Points at infinity, whose depth the rays do not determine.

use tiepoint_geometry::nalgebra::Matrix3;
use tiepoint_scene::{PointId, Reconstruction, Track};

/// Minimum ratio of depth information to direction information. Below it the undamped normal
/// equations are singular.
const MIN_DEPTH_INFORMATION: f64 = 1e-8;

/// Returns a copy of the model in which points at infinity are held out. Such points constrain only
/// rotations, which the other points constrain as well.
pub fn without_points_at_infinity(model: &Reconstruction) -> Reconstruction {
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
        // NaN counts as infinity.
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
