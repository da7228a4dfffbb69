//! Linear system with the landmarks eliminated: tasks in parallel, then the reduced system.

use std::ops::Range;
use std::time::Instant;

use crate::eliminate::Sums;
use crate::error::Error;
use crate::factor_group::stays_valid;
use crate::landmark_refinement::LandmarkRefinement;
use crate::linear_system::{Attempt, LinearSystem, Linearised};
use crate::memory::Memory;
use crate::options::LinearSolver;
use crate::problem::Problem;
use crate::reduced::{
    Columns, ConjugateGradients, Dense, EliminatedSystem, Factorisation, Reduced, Sparse,
};
use crate::retraction::Step;
use crate::structure::{Elimination, FACTORS_PER_TASK, Structure, Task, for_each_task};
use crate::summary::Times;
use crate::variable::Values;

/// Up to this many columns, dense factorisation is faster than sparse, whatever the fill.
const DENSE_COLUMNS: usize = 600;
/// Above [`DENSE_COLUMNS`], dense factorisation is used if at least this fraction of the reduced
/// system is filled and it has at most [`MAX_DENSE_COLUMNS`].
const DENSE_FILL: f64 = 0.3;
const MAX_DENSE_COLUMNS: usize = 10_000;
/// How often the step of a landmark is halved if it invalidates a factor. The last time it is set
/// to zero.
const MAX_HALVINGS: i32 = 6;

pub(crate) struct SchurSystem {
    pub(crate) structure: Structure,
    pub(crate) sums: Vec<Sums>,
    /// Tiles and stashes of all tasks.
    pub(crate) memory: Memory,
    pub(crate) reduced: Reduced,
    name: &'static str,
    /// Steps of all variables: kept ones by block, then landmarks by task.
    step: Vec<f64>,
    block_at: Vec<usize>,
    refine: LandmarkRefinement,
}

impl SchurSystem {
    pub(crate) fn new(
        problem: &Problem,
        solver: LinearSolver,
        refinements: usize,
    ) -> Result<Self, Error> {
        let shared = problem.num_factors() > FACTORS_PER_TASK;
        Self::on_pool(shared, || Self::new_here(problem, solver, refinements))
    }

    fn new_here(
        problem: &Problem,
        solver: LinearSolver,
        refinements: usize,
    ) -> Result<Self, Error> {
        if solver == LinearSolver::Implicit {
            return Self::implicit(problem, refinements);
        }
        let structure = Structure::new(problem, Elimination::Do)?;
        let dense = match solver {
            LinearSolver::Dense => true,
            LinearSolver::Sparse | LinearSolver::Iterative => false,
            _ => prefers_dense(&structure),
        };
        let (name, factorisation): (_, Box<dyn Factorisation>) = if dense || structure.columns == 0
        {
            ("dense Cholesky", Box::new(Dense::new(&structure)))
        } else {
            let Ok(columns) = Columns::new(&structure) else {
                return Self::implicit(problem, refinements);
            };
            let direct =
                if solver == LinearSolver::Iterative { Err(columns) } else { Sparse::new(columns) };
            match direct {
                Ok(sparse) => ("sparse Cholesky", Box::new(sparse)),
                // The smaller one is faster, because products are limited by memory traffic.
                Err(columns) if columns.num_numbers() > structure.num_coupled() => {
                    return Self::implicit(problem, refinements);
                }
                Err(columns) => {
                    ("conjugate gradients", Box::new(ConjugateGradients::new(columns, false)))
                }
            }
        };
        Ok(Self::of(problem, structure, refinements, name, factorisation))
    }

    /// A system that never forms the reduced system.
    fn implicit(problem: &Problem, refinements: usize) -> Result<Self, Error> {
        let structure = Structure::new(problem, Elimination::Implicit)?;
        let factorisation = Box::new(ConjugateGradients::new(Columns::new(&structure)?, true));
        Ok(Self::of(problem, structure, refinements, "implicit conjugate gradients", factorisation))
    }

    fn of(
        problem: &Problem,
        structure: Structure,
        refinements: usize,
        name: &'static str,
        factorisation: Box<dyn Factorisation>,
    ) -> Self {
        let sums = || structure.tasks.iter().map(Sums::new).collect();
        let refine = || LandmarkRefinement::new(problem, &structure, refinements);
        let (sums, refine) =
            if structure.tasks.len() > 1 { rayon::join(sums, refine) } else { (sums(), refine()) };
        let reduced = Reduced::new(&structure, factorisation);
        Self {
            memory: Memory::new(structure.memory_len),
            sums,
            refine,
            step: vec![0.0; structure.step_len],
            block_at: structure.blocks.iter().map(|block| block.padded_start).collect(),
            reduced,
            structure,
            name,
        }
    }

    /// Runs all of `work` on the thread pool if `shared`. Otherwise each parallel loop would put
    /// the calling thread to sleep and wake it: about ten times a step, 50 µs each.
    fn on_pool<R: Send>(shared: bool, work: impl FnOnce() -> R + Send) -> R {
        if shared { rayon::scope(|_| work()) } else { work() }
    }

    /// Shortens the steps of a task's landmarks that invalidate factors, and drops factors that are
    /// invalid even at zero step. Returns the number of dropped factors; `None` if a factor without
    /// a landmark becomes invalid, or a factor is not finite.
    fn backtrack(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        task: usize,
    ) -> Option<usize> {
        let Self { structure, sums, refine, step, .. } = self;
        let costs_before = &sums[task].costs;
        let mut dropped = 0;
        for landmark in 0..structure.tasks[task].landmarks.len() {
            let factors = structure.tasks[task].factors_of(landmark);
            let costs = &mut refine.tasks[task].costs;
            if factors.clone().all(|i| stays_valid(costs_before[i], costs[i])) {
                continue;
            }
            let this = &structure.tasks[task];
            if this.landmarks[landmark].dof == 0 {
                return None;
            }
            let step = Step { values, tangents: step, offsets: &structure.step_offsets };
            if !halve_step(problem, &step, trial, this, landmark, (costs_before, costs)) {
                dropped += drop_invalid_residuals(this.factors_of(landmark), costs_before, costs)?;
            }
            refine.exclude(task, landmark, structure);
        }
        refine.tasks[task].sum(costs_before);
        Some(dropped)
    }
}

/// Halves the step of one landmark until all factors that were valid before are valid, and writes
/// their costs. Returns whether that succeeded.
fn halve_step(
    problem: &Problem,
    step: &Step<'_>,
    trial: &mut Values,
    task: &Task,
    landmark: usize,
    costs: (&[f64], &mut [f64]),
) -> bool {
    let factors = task.factors_of(landmark);
    let landmark = &task.landmarks[landmark];
    let tangent = &step.tangents[landmark.step..][..landmark.dof as usize];
    let variable = (landmark.store as usize, landmark.slot as usize);
    for halving in 1..=MAX_HALVINGS {
        let scale = if halving == MAX_HALVINGS { 0.0 } else { 0.5f64.powi(halving) };
        let shorter: Vec<f64> = tangent.iter().map(|step| step * scale).collect();
        step.take_one(problem.retraction.as_deref(), variable, &shorter, trial);
        for i in factors.clone() {
            let group = task.group_of(i);
            let at = task.factors.indices[i];
            problem.factor_groups[group].costs(trial, &[at], &mut costs.1[i..=i]);
        }
        if factors.clone().all(|i| stays_valid(costs.0[i], costs.1[i])) {
            return true;
        }
    }
    false
}

/// Factors that are invalidated by another variable than their landmark, such as a camera that
/// moves past a point, keep the cost that they had. They contribute no decrease and do not block
/// the step. Returns their number; `None` if a factor is valid but not finite.
fn drop_invalid_residuals(
    factors: Range<usize>,
    before: &[f64],
    after: &mut [f64],
) -> Option<usize> {
    let mut dropped = 0;
    for i in factors {
        if !stays_valid(before[i], after[i]) {
            if !after[i].is_nan() {
                return None;
            }
            after[i] = before[i];
            dropped += 1;
        }
    }
    Some(dropped)
}

fn prefers_dense(structure: &Structure) -> bool {
    let columns = structure.columns;
    if columns <= DENSE_COLUMNS {
        return true;
    }
    let filled: usize = (structure.tile_pairs().iter())
        .map(|&(a, b)| {
            let (a, b) = (&structure.blocks[a as usize], &structure.blocks[b as usize]);
            a.num_free() * b.num_free()
        })
        .sum();
    columns <= MAX_DENSE_COLUMNS && 2.0 * filled as f64 > DENSE_FILL * (columns * columns) as f64
}

impl LinearSystem for SchurSystem {
    fn name(&self) -> &'static str {
        self.name
    }

    fn columns(&self) -> (usize, usize) {
        (self.structure.columns, self.structure.step_len - self.structure.kept_len)
    }

    fn linearize(
        &mut self,
        problem: &Problem,
        values: &Values,
        lambda: f64,
        times: &mut Times,
    ) -> Linearised {
        Self::on_pool(self.shared(), || self.linearize_here(problem, values, lambda, times))
    }

    fn attempt(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        lambda: f64,
        times: &mut Times,
    ) -> Option<Attempt> {
        Self::on_pool(self.shared(), || {
            let predicted_reduction = self.solve_step(lambda, times)?;
            let begin = Instant::now();
            let Self { structure, step, .. } = self;
            let step = Step { values, tangents: step, offsets: &structure.step_offsets };
            step.take(problem.retraction.as_deref(), trial);
            times.back_substitute += begin.elapsed();
            let (cost, dropped) =
                self.trial_cost(problem, values, trial, times).unwrap_or((f64::INFINITY, 0));
            Some(Attempt { predicted_reduction, cost, dropped })
        })
    }
}

impl SchurSystem {
    /// Whether there is work for several threads.
    fn shared(&self) -> bool {
        self.structure.tasks.len() > 1
    }

    fn linearize_here(
        &mut self,
        problem: &Problem,
        values: &Values,
        lambda: f64,
        times: &mut Times,
    ) -> Linearised {
        let begin = Instant::now();
        let structure = &self.structure;
        let mut work_items = Vec::with_capacity(structure.tasks.len());
        let mut rest = &mut self.memory[..];
        for (sums, task) in self.sums.iter_mut().zip(&structure.tasks) {
            let (memory, others) = rest.split_at_mut(task.memory.len());
            work_items.push((sums, memory));
            rest = others;
        }
        for_each_task(&structure.tasks, &mut work_items, |task, (sums, memory)| {
            sums.linearize(memory, problem, values, task, lambda);
        });
        let middle = Instant::now();
        self.reduced.gather(structure, &self.sums, &self.memory, lambda);
        times.linearize += middle - begin;
        times.gather += middle.elapsed();
        let mut linearised = Linearised { cost: 0.0, missing: 0, gradient_max: 0.0 };
        let mut finite = true;
        for sums in &self.sums {
            linearised.missing += sums.missing;
            linearised.cost += sums.cost;
            finite &= sums.gradient_max.is_finite();
            linearised.gradient_max = linearised.gradient_max.max(sums.gradient_max);
        }
        for (gradient, diagonal) in self.reduced.gradient.iter().zip(&self.reduced.diagonal) {
            finite &= gradient.is_finite() && diagonal.is_finite();
            linearised.gradient_max = linearised.gradient_max.max(gradient.abs());
        }
        if !finite {
            linearised.gradient_max = f64::INFINITY;
        }
        linearised
    }

    /// Solves for the step. Returns the predicted reduction of the cost (model cost change).
    fn solve_step(&mut self, lambda: f64, times: &mut Times) -> Option<f64> {
        let begin = Instant::now();
        let structure = &self.structure;
        let (kept, eliminated) = self.step.split_at_mut(structure.kept_len);
        let eliminated_system = EliminatedSystem { structure, memory: &self.memory };
        let solved = self.reduced.solve(eliminated_system, kept);
        times.solve += begin.elapsed();
        solved.ok()?;
        let begin = Instant::now();
        let mut work_items = Vec::with_capacity(structure.tasks.len());
        let mut rest = eliminated;
        for task in &structure.tasks {
            let (steps, others) = rest.split_at_mut(task.steps.len());
            work_items.push((steps, [0.0; 2]));
            rest = others;
        }
        let (memory, block_at) = (&self.memory, &self.block_at);
        for_each_task(&structure.tasks, &mut work_items, |task, (steps, predicted_reduction)| {
            *predicted_reduction =
                Sums::back_substitute(memory, task, kept, block_at, lambda, steps);
        });
        // The predicted reduction −gᵀδ − ½ δᵀHδ equals ½ (λ δᵀDδ − gᵀδ), because (H + λD) δ = −g.
        let [mut g_step, mut damped] = [0.0; 2];
        for (_, predicted_reduction) in &work_items {
            g_step += predicted_reduction[0];
            damped += predicted_reduction[1];
        }
        for ((step, gradient), diagonal) in
            kept.iter().zip(&self.reduced.gradient).zip(&self.reduced.diagonal)
        {
            g_step += gradient * step;
            damped += lambda * diagonal * step * step;
        }
        times.back_substitute += begin.elapsed();
        let predicted_reduction = 0.5 * (damped - g_step);
        predicted_reduction.is_finite().then_some(predicted_reduction)
    }

    /// The cost at `trial` after refinement of the landmarks, and the number of dropped factors.
    /// `None` if a factor becomes invalid and cannot be dropped, or is not finite.
    fn trial_cost(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        times: &mut Times,
    ) -> Option<(f64, usize)> {
        let begin = Instant::now();
        let Self { structure, sums, refine, .. } = self;
        refine.evaluate(problem, trial, structure, sums);
        let mut dropped = Some(0);
        for task in 0..self.structure.tasks.len() {
            if !self.refine.tasks[task].all_valid {
                let more = self.backtrack(problem, values, trial, task);
                dropped = dropped.zip(more).map(|(dropped, more)| dropped + more);
            }
        }
        times.evaluate += begin.elapsed();
        let dropped = dropped?;
        let begin = Instant::now();
        let Self { structure, sums, refine, .. } = self;
        if refine.cost().is_finite() {
            refine.refine_landmarks(problem, trial, structure, sums);
        }
        times.refine += begin.elapsed();
        let cost = refine.cost();
        cost.is_finite().then_some((cost, dropped))
    }
}
