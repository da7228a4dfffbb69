use std::ops::ControlFlow;

use rayon::prelude::*;
use tiepoint_ba::{IterationRecord, Key, Options, Solver, Summary};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{PointId, Reconstruction};

use super::options::{AdjustOptions, Scope};
use super::problem::build;
use super::rigid_frames::RigidFrames;
use super::term::Term;
use crate::Error;
use crate::tracks::seen_at;

/// Adjusts a model with further terms; the model is changed to where the optimiser ended, whatever
/// the reason.
///
/// Images in the model's frames stay rigidly connected: what moves are their rigs' poses, and where
/// the cameras are on the rigs. Points that took no part are moved to where the adjusted poses see
/// them.
///
/// # Errors
///
/// [`Error::NothingToAdjust`] where fewer than two images with a pose see a point, and where the
/// optimiser refuses the problem.
pub fn adjust(
    model: &mut Reconstruction,
    scope: &Scope,
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
    watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
) -> Result<Summary, Error> {
    let mut frames = (!model.frames.is_empty()).then(|| RigidFrames::new(model));
    let frames_term = frames.as_mut().map(|frames| frames as &mut dyn Term);
    let mut terms: Vec<&mut dyn Term> =
        terms.iter_mut().map(|term| &mut **term as &mut dyn Term).collect();
    terms.extend(frames_term);
    let mut variables = build(model, scope, options, &mut terms)?;
    let solver_options = Options {
        max_iterations: options.max_iterations,
        function_tolerance: options.function_tolerance,
        ..Options::default()
    };
    let problem = variables.problem_mut();
    let summary = Solver::new(problem, &solver_options)?.solve(problem, watch)?;
    // They come back with the poses that their rigs have now.
    model.frames.clear();
    variables.write_back(model);
    terms.iter_mut().for_each(|term| term.read(variables.problem()));
    if let Some(frames) = frames {
        frames.write_back(model);
    }
    retriangulate_others(model, scope, &variables.points);
    Ok(summary)
}

/// Watches an adjustment that nothing stops.
pub(crate) fn keep_going(_: &IterationRecord) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Moves each point that took no part to where the poses see it now; those that did come in order.
fn retriangulate_others(
    model: &mut Reconstruction,
    scope: &Scope,
    adjusted: &[(PointId, Key<Vector3<f64>>)],
) {
    let took_no_part =
        |point: &PointId| adjusted.binary_search_by_key(point, |(other, _)| *other).is_err();
    let others: Vec<PointId> = scope.points(model).into_iter().filter(took_no_part).collect();
    let place = |point: &PointId| seen_at(model, &model.track(*point)?.observations);
    let places: Vec<_> = others.par_iter().map(place).collect();
    for (point, place) in others.into_iter().zip(places) {
        if let (Some(xyz), Some(track)) = (place, model.track_mut(point)) {
            track.xyz = xyz;
        }
    }
}
