use std::ops::ControlFlow;

use rayon::prelude::*;
use tiepoint_ba::{IterationRecord, Key, Options, Solver, Summary};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{PointId, Reconstruction};

use crate::Error;
use crate::options::{AdjustOptions, Scope};
use crate::portrait_landscape::copy_to_unused;
use crate::problem::build_problem;
use crate::rigid_frames::RigidFrames;
use crate::term::Term;
use crate::triangulation::triangulate_observations;

/// Runs bundle adjustment with additional terms. The model receives the final state for every
/// termination reason.
///
/// Images of the model's frames stay rigidly connected: the poses of the frames and of the sensors
/// on their rigs are variables. Points that take no part are triangulated again from the adjusted
/// poses.
///
/// # Errors
///
/// [`Error::NothingToAdjust`] if fewer than two registered images observe a point; other errors if
/// the optimiser rejects the problem.
pub fn adjust(
    model: &mut Reconstruction,
    scope: &Scope,
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
    watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
) -> Result<Summary, Error> {
    options.validate()?;
    let mut frames = (!model.frames.is_empty()).then(|| RigidFrames::new(model, options));
    // The frames come first, so that the terms find the poses of their images.
    let frames_term = frames.as_mut().map(|frames| frames as &mut dyn Term);
    let given = terms.iter_mut().map(|term| &mut **term as &mut dyn Term);
    let mut terms: Vec<&mut dyn Term> = frames_term.into_iter().chain(given).collect();
    let mut variables = build_problem(model, scope, options, &mut terms)?;
    let solver_options = Options {
        max_iterations: options.max_iterations,
        function_tolerance: options.function_tolerance,
        ..Options::default()
    };
    let problem = variables.problem_mut();
    let summary = Solver::new(problem, &solver_options)?.solve_with(problem, watch)?;
    // `RigidFrames::write_back` restores the frames with their new poses.
    model.frames.clear();
    variables.write_back(model);
    terms.iter_mut().for_each(|term| term.read(variables.problem()));
    if let Some(frames) = frames {
        frames.write_back(model);
    }
    copy_to_unused(model);
    retriangulate_others(model, scope, &variables.points);
    Ok(summary)
}

/// Callback that never stops an adjustment.
pub fn keep_going(_: &IterationRecord) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Triangulates each point that took no part from the adjusted poses. `adjusted` is sorted.
fn retriangulate_others(
    model: &mut Reconstruction,
    scope: &Scope,
    adjusted: &[(PointId, Key<Vector3<f64>>)],
) {
    let is_not_adjusted =
        |point: &PointId| adjusted.binary_search_by_key(point, |(other, _)| *other).is_err();
    let others: Vec<PointId> = scope.points(model).into_iter().filter(is_not_adjusted).collect();
    let triangulated =
        |point: &PointId| triangulate_observations(model, &model.track(*point)?.observations);
    let positions: Vec<_> = others.par_iter().map(triangulated).collect();
    for (point, triangulated) in others.into_iter().zip(positions) {
        if let (Some(xyz), Some(track)) = (triangulated, model.track_mut(point)) {
            track.xyz = xyz;
        }
    }
}
