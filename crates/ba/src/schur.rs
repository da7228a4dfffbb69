//! The system with the declared variables eliminated: chunks of cells in parallel, then the reduced system.

use std::time::Instant;

use rayon::prelude::*;

use crate::eliminate::Sums;
use crate::error::Error;
use crate::options::LinearSolver;
use crate::problem::Problem;
use crate::reduced::{Columns, Conjugate, Dense, Factorisation, Reduced, Sparse};
use crate::refine::Refine;
use crate::structure::{Chunk, Elimination, Structure};
use crate::summary::Times;
use crate::system::{Linearised, System};
use crate::variable::Values;

/// Up to so many columns a dense factorisation wins over a sparse one, whatever the fill.
const DENSE_COLUMNS: usize = 600;
/// Above, if the reduced system is at least so full, and memory for it is no question.
const DENSE_FILL: f64 = 0.3;
const MAX_DENSE_COLUMNS: usize = 10_000;
/// How often the step of an eliminated variable is halved before it is given up, when it would end a factor's existence.
const HALVINGS: i32 = 6;

pub(crate) struct SchurSystem {
    pub(crate) structure: Structure,
    pub(crate) sums: Vec<Sums>,
    /// Tiles and stashes of all chunks.
    pub(crate) memory: Vec<f64>,
    pub(crate) reduced: Reduced,
    name: &'static str,
    /// Steps of all variables: kept ones by block, then eliminated ones by cell.
    step: Vec<f64>,
    block_at: Vec<usize>,
    trial_costs: Vec<Vec<f64>>,
    refine: Refine,
    refinements: usize,
}

impl SchurSystem {
    pub(crate) fn new(problem: &Problem, solver: LinearSolver, refinements: usize) -> Result<Self, Error> {
        let structure = Structure::new(problem, Elimination::Do)?;
        let dense = match solver {
            LinearSolver::Dense => true,
            LinearSolver::Sparse | LinearSolver::Iterative => false,
            _ => prefers_dense(&structure),
        };
        let (name, factorisation): (_, Box<dyn Factorisation>) = if dense || structure.columns == 0 {
            ("dense Cholesky", Box::new(Dense::new(&structure)))
        } else {
            let columns = Columns::new(&structure)?;
            let direct = if solver == LinearSolver::Iterative { Err(columns) } else { Sparse::new(columns) };
            match direct {
                Ok(sparse) => ("sparse Cholesky", Box::new(sparse)),
                Err(columns) => ("conjugate gradients", Box::new(Conjugate::new(columns))),
            }
        };
        let reduced = Reduced::new(&structure, factorisation);
        Ok(Self {
            memory: vec![0.0; structure.memory_len],
            sums: structure.chunks.iter().map(Sums::new).collect(),
            refine: Refine::new(problem, &structure, refinements),
            refinements,
            trial_costs: structure.chunks.iter().map(|chunk| vec![0.0; chunk.factors.len()]).collect(),
            step: vec![0.0; structure.step_len],
            block_at: structure.blocks.iter().map(|block| block.at).collect(),
            reduced,
            structure,
            name,
        })
    }

    /// Runs `work` on every chunk, in parallel if there are several.
    pub(crate) fn for_chunks<T: Send>(
        chunks: &[Chunk],
        items: &mut [T],
        work: impl Fn(&Chunk, &mut T) + Sync,
    ) {
        if chunks.len() > 1 {
            chunks.par_iter().zip(items).with_max_len(1).for_each(|(chunk, item)| work(chunk, item));
        } else {
            chunks.iter().zip(items).for_each(|(chunk, item)| work(chunk, item));
        }
    }

    /// The cost of the factors that exist where the system was linearised.
    fn total(&self, costs: &[Vec<f64>]) -> f64 {
        let mut total = 0.0;
        for (sums, costs) in self.sums.iter().zip(costs) {
            let mut chunk = 0.0;
            for (before, after) in sums.costs.iter().zip(costs) {
                chunk += if before.is_nan() { 0.0 } else { *after };
            }
            total += chunk;
        }
        total
    }

    /// Halves the step of one cell's variable until all its factors exist that existed before, and gives their cost.
    fn shorten(
        &self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        chunk: &Chunk,
        cell: usize,
        costs: (&[f64], &mut [f64]),
    ) -> bool {
        let factors = chunk.factors_of(cell);
        let cell = &chunk.cells[cell];
        let step = &self.step[cell.step..][..cell.dof as usize];
        let (store, slot) = (cell.store as usize, cell.slot as usize);
        for halving in 1..=HALVINGS {
            let scale = if halving == HALVINGS { 0.0 } else { 0.5f64.powi(halving) };
            let shorter: Vec<f64> = step.iter().map(|step| step * scale).collect();
            trial.stores[store].plus_one(&*values.stores[store], slot, &shorter);
            for i in factors.clone() {
                let run = chunk.run_of(i);
                let at = chunk.factors[i];
                problem.runs[run].costs(trial, &[at], &mut costs.1[i..=i]);
            }
            if factors.clone().all(|i| survives(costs.0[i], costs.1[i])) {
                return true;
            }
        }
        false
    }
}

/// The refinement of a step ends when a round lowers the cost by less than this part of it.
const WORTH_REFINING: f64 = 1e-2;

/// Whether a factor that had the one cost still exists with the other.
pub(crate) fn survives(before: f64, after: f64) -> bool {
    before.is_nan() || after.is_finite()
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

impl System for SchurSystem {
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
        let begin = Instant::now();
        let structure = &self.structure;
        let mut tasks = Vec::with_capacity(structure.chunks.len());
        let mut rest = &mut self.memory[..];
        for (sums, chunk) in self.sums.iter_mut().zip(&structure.chunks) {
            let (memory, others) = rest.split_at_mut(chunk.memory.len());
            tasks.push((sums, memory));
            rest = others;
        }
        Self::for_chunks(&structure.chunks, &mut tasks, |chunk, (sums, memory)| {
            sums.linearize(memory, problem, values, chunk, lambda);
        });
        let middle = Instant::now();
        self.reduced.gather(structure, &self.sums, &self.memory, lambda);
        times.linearize += middle - begin;
        times.gather += middle.elapsed();
        let mut linearised = Linearised { cost: 0.0, missing: 0, gradient_max: 0.0 };
        let mut finite = true;
        for sums in &self.sums {
            for &cost in &sums.costs {
                if cost.is_nan() {
                    linearised.missing += 1;
                } else {
                    linearised.cost += cost;
                }
            }
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

    fn step(&mut self, values: &Values, trial: &mut Values, lambda: f64, times: &mut Times) -> Option<f64> {
        let begin = Instant::now();
        let structure = &self.structure;
        let (kept, eliminated) = self.step.split_at_mut(structure.kept_len);
        let solved = self.reduced.solve(structure, kept);
        times.solve += begin.elapsed();
        solved.ok()?;
        let begin = Instant::now();
        let mut tasks = Vec::with_capacity(structure.chunks.len());
        let mut rest = eliminated;
        for chunk in &structure.chunks {
            let (steps, others) = rest.split_at_mut(chunk.steps.len());
            tasks.push((steps, [0.0; 2]));
            rest = others;
        }
        Self::for_chunks(&structure.chunks, &mut tasks, |chunk, (steps, promise)| {
            *promise = Sums::back_substitute(&self.memory, chunk, kept, &self.block_at, lambda, steps);
        });
        // The model's decrease −gᵀδ − ½ δᵀHδ, with (H + λD) δ = −g, is ½ (λ δᵀDδ − gᵀδ).
        let [mut g_step, mut damped] = [0.0; 2];
        for (_, promise) in &tasks {
            g_step += promise[0];
            damped += promise[1];
        }
        for ((step, gradient), diagonal) in
            kept.iter().zip(&self.reduced.gradient).zip(&self.reduced.diagonal)
        {
            g_step += gradient * step;
            damped += lambda * diagonal * step * step;
        }
        for ((trial, values), at) in trial.stores.iter_mut().zip(&values.stores).zip(&structure.step_at) {
            trial.plus_all(&**values, &self.step, at);
        }
        times.back_substitute += begin.elapsed();
        let promise = 0.5 * (damped - g_step);
        promise.is_finite().then_some(promise)
    }

    fn trial_cost(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        times: &mut Times,
    ) -> Option<f64> {
        let begin = Instant::now();
        let structure = &self.structure;
        let mut trial_costs = std::mem::take(&mut self.trial_costs);
        let shared: &Values = trial;
        Self::for_chunks(&structure.chunks, &mut trial_costs, |chunk, costs| {
            for stretch in &chunk.stretches {
                let range = stretch.start..stretch.end;
                let run = &problem.runs[stretch.run as usize];
                run.costs(shared, &chunk.factors[range.clone()], &mut costs[range]);
            }
        });
        let mut alive = true;
        for ((chunk, sums), costs) in structure.chunks.iter().zip(&self.sums).zip(&mut trial_costs) {
            if sums.costs.iter().zip(costs.iter()).all(|(&before, &after)| survives(before, after)) {
                continue;
            }
            for cell in 0..chunk.cells.len() {
                if chunk.factors_of(cell).all(|i| survives(sums.costs[i], costs[i])) {
                    continue;
                }
                let pair = (&sums.costs[..], &mut costs[..]);
                alive &= chunk.cells[cell].dof > 0 && self.shorten(problem, values, trial, chunk, cell, pair);
            }
        }
        let mut cost = self.total(&trial_costs);
        times.evaluate += begin.elapsed();
        let begin = Instant::now();
        for _ in 0..self.refinements {
            if !alive || !cost.is_finite() {
                break;
            }
            self.refine.round(problem, trial, &self.structure, &self.sums, &mut trial_costs);
            let before = std::mem::replace(&mut cost, self.total(&trial_costs));
            if before - cost < WORTH_REFINING * cost {
                break;
            }
        }
        self.trial_costs = trial_costs;
        times.refine += begin.elapsed();
        (alive && cost.is_finite()).then_some(cost)
    }
}
