//! Distances of reconstructed points to the true surface points at their observations.
//!
//! In a rendered scene the true surface point behind each pixel is known. The error of a point is
//! its distance to the surface points behind the pixels that observe it. Unlike the distance to the
//! nearest point of a scan, this includes errors along a façade, and needs no ICP, which hides
//! drift. The model is aligned by its cameras only ([`crate::compare_poses`]).
//!
//! The surface points of a track differ: a keypoint error of a fraction of a pixel is the distance
//! between a lamp post and the house behind it at an edge, and metres on a road at a grazing angle.
//! So the error of a point is the median over its observations (the lower one of an even number).
//! Observations of the sky and of moving objects have no surface point. A point with mostly such
//! observations is counted but not measured.

use tiepoint_geometry::nalgebra::{Matrix3, Vector3};

/// The true geometry of an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueObservation {
    /// True camera centre at the exposure of the pixel.
    pub camera_in_world: Vector3<f64>,
    /// True surface point behind the pixel; `None` for the sky and for moving objects.
    pub surface_in_world: Option<Vector3<f64>>,
}

impl TrueObservation {
    fn range(&self) -> Option<f64> {
        self.surface_in_world.map(|surface| (surface - self.camera_in_world).norm())
    }
}

/// Distance of a point to the true surface, in units of the ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceError {
    /// Median distance to the surface points behind its observations.
    pub distance: f64,
    /// Smallest distance of a true camera to the surface point that it observes.
    pub range: f64,
}

/// The error of each point (in the frame of the ground truth) from its true observations; `None` if
/// more than half of them have no surface point.
pub fn surface_errors(
    points_in_world: &[Vector3<f64>],
    true_observations: &[Vec<TrueObservation>],
) -> Vec<Option<SurfaceError>> {
    let error = |(point, true_observations): (&Vector3<f64>, &Vec<TrueObservation>)| {
        let surfaces = true_observations
            .iter()
            .filter_map(|true_observation| true_observation.surface_in_world);
        let mut distances: Vec<f64> = surfaces.map(|surface| (surface - point).norm()).collect();
        if distances.is_empty() || 2 * distances.len() < true_observations.len() {
            return None;
        }
        distances.sort_by(f64::total_cmp);
        let range =
            true_observations.iter().filter_map(TrueObservation::range).min_by(f64::total_cmp)?;
        Some(SurfaceError { distance: distances[(distances.len() - 1) / 2], range })
    };
    points_in_world.iter().zip(true_observations).map(error).collect()
}

/// Minimum ratio of the smallest to the largest eigenvalue of the normal matrix; below it the rays
/// are parallel.
const MIN_CONDITION: f64 = 1e-9;

/// Triangulates each track from the true cameras: the point nearest to the true rays of its pixels,
/// weighted by the inverse squared range, so that angles are minimised. The [`surface_errors`] of
/// these points are an error floor that is due to keypoints and matches. `None` for fewer than two
/// rays, or parallel ones.
pub fn triangulate_true_observations(
    true_observations: &[Vec<TrueObservation>],
) -> Vec<Option<Vector3<f64>>> {
    true_observations.iter().map(|true_observations| intersect(true_observations)).collect()
}

/// Least-squares intersection of the true rays of a track.
fn intersect(true_observations: &[TrueObservation]) -> Option<Vector3<f64>> {
    let (mut normal, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for true_observation in true_observations {
        let Some(surface) = true_observation.surface_in_world else { continue };
        let ray = surface - true_observation.camera_in_world;
        let (direction, range) = (ray.normalize(), ray.norm());
        // Projection across the ray over the squared range: squared angles.
        let projection =
            (Matrix3::identity() - direction * direction.transpose()) / (range * range);
        normal += projection;
        right += projection * true_observation.camera_in_world;
        count += 1;
    }
    let eigenvalues = normal.symmetric_eigenvalues();
    if count < 2 || eigenvalues.min() < MIN_CONDITION * eigenvalues.max() {
        return None;
    }
    Some(normal.cholesky()?.solve(&right))
}
