//! A model against a world that can be asked what lies behind a pixel, and against a laser scan.

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_eval::geometry::Sim3;
use tiepoint_eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_eval::{
    Statistics, SurfaceError, TrueObservation, surface_errors, triangulate_true_observations,
};
use tiepoint_sfm::scene::{Image, PointId, Reconstruction, Track};

use crate::ErrorStatistics;

/// Surfaces farther than this from every camera that saw them count as far, in units of the truth
/// (metres): a keypoint off by 0.3 px moves a point 30 m away by decimetres, and far points would
/// drown the mean.
const NEAR: f64 = 30.0;

/// How far the points of a model are from the true surface at their pixels, cameras aligned. In
/// units of the truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SurfaceEvaluation {
    /// Points of the model.
    pub points: usize,
    /// Those that show the sky or something that moves; they are not in the statistics.
    pub not_on_a_surface: usize,
    /// All others.
    pub distance: ErrorStatistics,
    /// Those seen from at most 30 m (units of the truth).
    pub near: Option<ErrorStatistics>,
    /// The distances that points would have if the cameras were exactly known: what is left is the
    /// keypoints' and the matches'.
    pub floor: Option<ErrorStatistics>,
    /// The same of those seen from at most 30 m.
    pub near_floor: Option<ErrorStatistics>,
    /// The points that exactly known cameras would have given.
    #[serde(skip)]
    pub exact_points: Vec<Vector3<f64>>,
    /// Each measured point's error.
    #[serde(skip)]
    pub errors: Vec<(PointId, SurfaceError)>,
}

/// Compares each point of a model with what truly lies behind the pixels that saw it.
/// `truth_from_model` comes from the cameras ([`crate::PoseEvaluation::truth_from_model`]);
/// `true_observation` says what an image sees at a pixel, and is asked in parallel. `None` where no point
/// is on a surface.
pub fn evaluate_surface(
    model: &Reconstruction,
    truth_from_model: &Sim3,
    true_observation: impl Fn(&Image, &Vector2<f64>) -> TrueObservation + Sync,
) -> Option<SurfaceEvaluation> {
    let tracks: Vec<(PointId, &Track)> = model.tracks().collect();
    let sightings_of = |(_, track): &(PointId, &Track)| -> Vec<TrueObservation> {
        let observations = track.observations.iter();
        let asked = observations.map(|observation| {
            let image = model.image(observation.image);
            true_observation(image, &image.keypoints[observation.keypoint as usize].pixel)
        });
        asked.collect()
    };
    let true_observations: Vec<Vec<TrueObservation>> =
        tracks.par_iter().map(sightings_of).collect();
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
