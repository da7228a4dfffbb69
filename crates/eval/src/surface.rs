//! The distance of reconstructed points to the true surface at the pixels that saw them.
//!
//! A point stands for what its keypoints show. Where the truth is a world that can be asked (a
//! rendered one), the true camera says which surface point lies behind each of these pixels, and
//! the distance to *that* point is the error. Unlike the distance to the nearest point of a cloud
//! it sees errors along a façade, and needs no closest-point alignment, which hides drift: align by
//! the cameras ([`crate::compare_poses`]), and by nothing else.
//!
//! The observations of a point do not agree quite: keypoints are off by a fraction of a pixel,
//! which at an edge is the difference between a lamp post and the house behind it, and on a road
//! seen at a grazing angle is metres. So a point's error is the median over its observations (the
//! lower one of an even number). Observations of the sky and of what moves have no surface point to
//! be compared with; a point most of whose observations are such is in the model by mistake, and is
//! counted, not measured.

use tiepoint_geometry::nalgebra::{Matrix3, Vector3};

/// What an observation of a reconstructed point truly saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueObservation {
    /// The true camera's centre, when it exposed the pixel.
    pub camera_in_world: Vector3<f64>,
    /// The true surface point behind the pixel; `None` for the sky, and for what moves.
    pub surface_in_world: Option<Vector3<f64>>,
}

impl TrueObservation {
    fn range(&self) -> Option<f64> {
        self.surface_in_world.map(|surface| (surface - self.camera_in_world).norm())
    }
}

/// How far a point is from the surface that it stands for; in units of the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceError {
    /// Median distance of the point to the surface points behind its pixels.
    pub distance: f64,
    /// Distance of the nearest true camera to the surface point that it saw.
    pub range: f64,
}

/// The error of each point, given in the world of the truth, from what its observations saw; `None`
/// where more than half of them saw no surface that stands still.
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

/// Smallest part of the rays' mean extent across them that must lie in the worst direction: below
/// it they are parallel.
const MIN_CONDITION: f64 = 1e-9;

/// Where each point would be if the cameras were exactly known: the point nearest to the true rays
/// of its pixels (weighted by one over the squared range, so that angles count). Its
/// [`surface_errors`] are the floor that keypoints and matches leave. `None` where fewer than two
/// rays are left, or these are parallel.
pub fn triangulate_true_observations(
    true_observations: &[Vec<TrueObservation>],
) -> Vec<Option<Vector3<f64>>> {
    true_observations.iter().map(|true_observations| intersect(true_observations)).collect()
}

fn intersect(true_observations: &[TrueObservation]) -> Option<Vector3<f64>> {
    let (mut normal, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for true_observation in true_observations {
        let Some(surface) = true_observation.surface_in_world else { continue };
        let ray = surface - true_observation.camera_in_world;
        let (direction, range) = (ray.normalize(), ray.norm());
        // The square of the distance across the ray, as an angle.
        let across = (Matrix3::identity() - direction * direction.transpose()) / (range * range);
        normal += across;
        right += across * true_observation.camera_in_world;
        count += 1;
    }
    let eigenvalues = normal.symmetric_eigenvalues();
    if count < 2 || eigenvalues.min() < MIN_CONDITION * eigenvalues.max() {
        return None;
    }
    Some(normal.cholesky()?.solve(&right))
}
