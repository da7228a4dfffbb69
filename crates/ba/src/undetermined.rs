//! Which variable the factors do not determine, if the linear system cannot be solved.
//!
//! H = JᵀJ is singular. With λD added, where D is its diagonal, it can be factorised. A landmark
//! that its factors do not determine, even if all else is known, shows in its own block V. Else the
//! reduced system S is singular: D^½ (S + λD)⁻¹ D^½ has the eigenvalue 1/λ for the directions of
//! its null space, and smaller ones for all others, so that a few steps of inverse iteration lead
//! into the null space. The variable that has the largest share of that vector, in units of its
//! conditional standard deviations, is undetermined.

use nalgebra::DMatrix;

use crate::eliminate::LandmarkStash;
use crate::linear_system::LinearSystem;
use crate::problem::Problem;
use crate::reduced::EliminatedSystem;
use crate::schur::SchurSystem;
use crate::structure::{LandmarkBlock, Location, NONE, Task};
use crate::summary::Times;
use crate::variable::AnyKey;

/// λ: far above the rounding of H (1e-16 and some digits), and far below what determines the least
/// determined direction of problems that can be solved. If that does not make a system that can be
/// factorised, the next one.
const LAMBDAS: [f64; 3] = [1e-12, 1e-9, 1e-6];
/// The variance of an undetermined direction of a landmark, in units of its conditional variance
/// and of 1/λ: a vector of the null space has a component of a third at least. A tenth of it.
const MIN_SHARE: f64 = 1.0 / 30.0;
/// Steps of inverse iteration. Each one damps what the factors determine by λ over its eigenvalue.
const ITERATIONS: usize = 3;
/// A step from each number of the start to the next, modulo 1: the golden ratio, so that they have
/// no pattern, and no null space is orthogonal to them.
const GOLDEN: f64 = 0.618_033_988_75;

/// The variable that a problem whose system cannot be factorised does not determine. `None` if it
/// cannot be factorised with λ either.
pub(crate) fn undetermined_variable(problem: &Problem, system: &mut SchurSystem) -> Option<AnyKey> {
    LAMBDAS.into_iter().find_map(|lambda| {
        system.linearize(problem, &problem.values, lambda, &mut Times::default());
        undetermined_landmark(problem, system, lambda)
            .or_else(|| undetermined_kept(problem, system))
    })
}

/// The first landmark whose own factors leave a direction open.
fn undetermined_landmark(problem: &Problem, system: &SchurSystem, lambda: f64) -> Option<AnyKey> {
    let tasks = system.structure.tasks.iter();
    let mut all = tasks.flat_map(|task| task.landmarks.iter().map(move |it| (task, it)));
    let (_, landmark) = all.find(|(task, landmark)| is_open(system, task, landmark, lambda))?;
    Some(problem.values.key(landmark.store as usize, landmark.slot as usize))
}

fn is_open(system: &SchurSystem, task: &Task, landmark: &LandmarkBlock, lambda: f64) -> bool {
    let p = landmark.dof as usize;
    if p == 0 {
        return false;
    }
    let stash = LandmarkStash::of(&system.memory, landmark, task);
    let factor = DMatrix::from_fn(p, p, |i, j| if j <= i { stash.factor(i, j) } else { 0.0 });
    let Some(inverse) = factor.solve_lower_triangular(&DMatrix::identity(p, p)) else {
        return true;
    };
    (0..p)
        .any(|k| inverse.column(k).norm_squared() * stash.diagonal(k, lambda) > MIN_SHARE / lambda)
}

/// The kept variable with the largest share of a vector of the null space.
fn undetermined_kept(problem: &Problem, system: &mut SchurSystem) -> Option<AnyKey> {
    let structure = &system.structure;
    let eliminated = EliminatedSystem { structure, memory: &system.memory };
    system.reduced.factorise(eliminated).ok()?;
    // A direction that no factor depends on has a one on the diagonal of S.
    let mut scales = vec![1.0; structure.columns];
    for block in &structure.blocks {
        for (column, i) in block.free_columns().enumerate() {
            let diagonal = system.reduced.diagonal[block.padded_start + i];
            if diagonal > 0.0 {
                scales[block.first_column + column] = diagonal.sqrt();
            }
        }
    }
    let mut vector: Vec<f64> =
        (0..scales.len()).map(|k| 0.5 + (GOLDEN * k as f64).fract()).collect();
    let scale = |vector: &mut [f64]| {
        vector.iter_mut().zip(&scales).for_each(|(value, scale)| *value *= scale);
    };
    for _ in 0..ITERATIONS {
        scale(&mut vector);
        system.reduced.solve_columns(eliminated, &mut vector);
        scale(&mut vector);
        let norm = vector.iter().map(|value| value * value).sum::<f64>().sqrt();
        vector.iter_mut().for_each(|value| *value /= norm);
    }
    let share = |(store, slot, location): (usize, usize, &Location)| {
        let block = structure.blocks.get(location.block as usize)?;
        let first = location.offset as usize;
        let directions = first..first + problem.values.stores[store].dof();
        let columns = block.free_columns().enumerate().filter(|(_, i)| directions.contains(i));
        let share: f64 =
            columns.map(|(column, _)| vector[block.first_column + column].powi(2)).sum();
        share.is_finite().then_some((share, store, slot))
    };
    let variables = structure.locations.iter().enumerate().flat_map(|(store, slots)| {
        slots.iter().enumerate().map(move |(slot, location)| (store, slot, location))
    });
    let kept = variables.filter(|(.., location)| location.block != NONE);
    let (_, store, slot) = kept.filter_map(share).max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(problem.values.key(store, slot))
}
