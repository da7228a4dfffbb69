//! Distances of points to the true surface at their pixels, in a rendered scene.

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_eval::geometry::Sim3;
use tiepoint_eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_eval::{
    Statistics, SurfaceError, TrueObservation, surface_errors, triangulate_true_observations,
};
use tiepoint_sfm::scene::{Image, PointId, Reconstruction, Track};

use crate::evaluation::poses::ErrorStatistics;

/// Maximum range of near points, in units of the ground truth (metres): a keypoint error of 0.3 px
/// moves a point at 30 m by decimetres, so that far points would dominate the mean.
const NEAR: f64 = 30.0;

/// Distances of the points of a model to the true surface at their pixels, after alignment of the
/// cameras, in units of the ground truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SurfaceEvaluation {
    /// Number of points of the model.
    pub points: usize,
    /// Number of points on the sky or on moving objects, which the statistics leave out.
    pub not_on_a_surface: usize,
    /// Distances of all other points.
    pub distance: ErrorStatistics,
    /// Distances of points seen from at most 30 m (units of the ground truth).
    pub near: Option<ErrorStatistics>,
    /// Error floor: distances of the same tracks triangulated with the true cameras. It is due to
    /// keypoints and matches.
    pub floor: Option<ErrorStatistics>,
    /// Error floor of points seen from at most 30 m.
    pub near_floor: Option<ErrorStatistics>,
    /// The tracks triangulated with the true cameras.
    #[serde(skip)]
    pub exact_points: Vec<Vector3<f64>>,
    /// The error of each point on a surface.
    #[serde(skip)]
    pub errors: Vec<(PointId, SurfaceError)>,
}

/// Compares each point of a model with the true surface points at its observations.
/// `truth_from_model` is the alignment of the cameras
/// ([`crate::evaluation::PoseEvaluation::truth_from_model`]); `true_observation` returns the true
/// camera centre and surface point of a pixel of an image, and is called in parallel. `None` if no
/// point is on a surface.
pub fn evaluate_surface(
    model: &Reconstruction,
    truth_from_model: &Sim3,
    true_observation: impl Fn(&Image, &Vector2<f64>) -> TrueObservation + Sync,
) -> Option<SurfaceEvaluation> {
    let tracks: Vec<(PointId, &Track)> = model.tracks().collect();
    let of_track = |(_, track): &(PointId, &Track)| -> Vec<TrueObservation> {
        let observations = track.observations.iter();
        let asked = observations.map(|observation| {
            let image = model.image(observation.image);
            true_observation(image, &image.keypoints[observation.keypoint as usize].pixel)
        });
        asked.collect()
    };
    let true_observations: Vec<Vec<TrueObservation>> = tracks.par_iter().map(of_track).collect();
    let points: Vec<Vector3<f64>> =
        tracks.iter().map(|(_, track)| *truth_from_model * track.xyz).collect();
    let all = surface_errors(&points, &true_observations);
    let errors: Vec<(PointId, SurfaceError)> =
        tracks.iter().zip(all).filter_map(|((id, _), error)| Some((*id, error?))).collect();
    let (known, of_known): (Vec<_>, Vec<_>) = triangulate_true_observations(&true_observations)
        .into_iter()
        .zip(true_observations)
        .filter_map(|(point, true_observations)| Some((point?, true_observations)))
        .unzip();
    let floor: Vec<SurfaceError> =
        surface_errors(&known, &of_known).into_iter().flatten().collect();
    let found: Vec<SurfaceError> = errors.iter().map(|(_, error)| *error).collect();
    Some(SurfaceEvaluation {
        points: tracks.len(),
        not_on_a_surface: tracks.len() - errors.len(),
        distance: statistics(&found, f64::INFINITY)?,
        near: statistics(&found, NEAR),
        floor: statistics(&floor, f64::INFINITY),
        near_floor: statistics(&floor, NEAR),
        exact_points: known,
        errors,
    })
}

fn statistics(errors: &[SurfaceError], max_range: f64) -> Option<ErrorStatistics> {
    let within = errors.iter().filter(|error| error.range <= max_range);
    let distances: Vec<f64> = within.map(|error| error.distance).collect();
    Statistics::of(&distances).map(ErrorStatistics::from)
}
