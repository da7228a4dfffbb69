//! The system with the declared variables eliminated: chunks of cells in parallel, then the reduced
//! system.

use std::ops::Range;
use std::time::Instant;

use crate::eliminate::Sums;
use crate::error::Error;
use crate::memory::Memory;
use crate::options::LinearSolver;
use crate::problem::Problem;
use crate::reduced::{Columns, Conjugate, Dense, Eliminated, Factorisation, Reduced, Sparse};
use crate::refine::Refine;
use crate::retraction::Step;
use crate::run::survives;
use crate::structure::{Chunk, Elimination, FACTORS_PER_CHUNK, Structure, for_chunks};
use crate::summary::Times;
use crate::system::{Attempt, Linearised, System};
use crate::variable::Values;

/// Up to so many columns a dense factorisation wins over a sparse one, whatever the fill.
const DENSE_COLUMNS: usize = 600;
/// Above, if the reduced system is at least so full, and memory for it is no question.
const DENSE_FILL: f64 = 0.3;
const MAX_DENSE_COLUMNS: usize = 10_000;
/// How often the step of an eliminated variable is halved before it is given up, when it would end
/// a factor's existence.
const HALVINGS: i32 = 6;

pub(crate) struct SchurSystem {
    pub(crate) structure: Structure,
    pub(crate) sums: Vec<Sums>,
    /// Tiles and stashes of all chunks.
    pub(crate) memory: Memory,
    pub(crate) reduced: Reduced,
    name: &'static str,
    /// Steps of all variables: kept ones by block, then eliminated ones by cell.
    step: Vec<f64>,
    block_at: Vec<usize>,
    refine: Refine,
}

impl SchurSystem {
    pub(crate) fn new(
        problem: &Problem,
        solver: LinearSolver,
        refinements: usize,
    ) -> Result<Self, Error> {
        let shared = problem.num_factors() > FACTORS_PER_CHUNK;
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
                // What a product has to read decides.
                Err(columns) if columns.num_numbers() > structure.num_coupled() => {
                    return Self::implicit(problem, refinements);
                }
                Err(columns) => ("conjugate gradients", Box::new(Conjugate::new(columns, false))),
            }
        };
        Ok(Self::of(problem, structure, refinements, name, factorisation))
    }

    /// One that never puts the reduced system together.
    fn implicit(problem: &Problem, refinements: usize) -> Result<Self, Error> {
        let structure = Structure::new(problem, Elimination::Implicit)?;
        let factorisation = Box::new(Conjugate::new(Columns::new(&structure)?, true));
        Ok(Self::of(problem, structure, refinements, "implicit conjugate gradients", factorisation))
    }

    fn of(
        problem: &Problem,
        structure: Structure,
        refinements: usize,
        name: &'static str,
        factorisation: Box<dyn Factorisation>,
    ) -> Self {
        let sums = || structure.chunks.iter().map(Sums::new).collect();
        let refine = || Refine::new(problem, &structure, refinements);
        let (sums, refine) =
            if structure.chunks.len() > 1 { rayon::join(sums, refine) } else { (sums(), refine()) };
        let reduced = Reduced::new(&structure, factorisation);
        Self {
            memory: Memory::new(structure.memory_len),
            sums,
            refine,
            step: vec![0.0; structure.step_len],
            block_at: structure.blocks.iter().map(|block| block.at).collect(),
            reduced,
            structure,
            name,
        }
    }

    /// Runs all of `work` on the thread pool if there is something to share out. Called from
    /// outside, each parallel stretch would put the calling thread to sleep and wake it: some ten
    /// times a step, 50 µs each.
    fn on_pool<R: Send>(shared: bool, work: impl FnOnce() -> R + Send) -> R {
        if shared { rayon::scope(|_| work()) } else { work() }
    }

    /// Shortens the steps of a chunk's variables that end the existence of factors, and lets go of
    /// those that live no longer even so. Gives how many those are; `None` where a factor of kept
    /// variables alone is ended, or one is not finite.
    fn rescue(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        chunk: usize,
    ) -> Option<usize> {
        let Self { structure, sums, refine, step, .. } = self;
        let counted = &sums[chunk].costs;
        let mut lost = 0;
        for cell in 0..structure.chunks[chunk].cells.len() {
            let factors = structure.chunks[chunk].factors_of(cell);
            let costs = &mut refine.chunks[chunk].costs;
            if factors.clone().all(|i| survives(counted[i], costs[i])) {
                continue;
            }
            let this = &structure.chunks[chunk];
            if this.cells[cell].dof == 0 {
                return None;
            }
            let step = Step { values, numbers: step, at: &structure.step_at };
            if !shorten(problem, &step, trial, this, cell, (counted, costs)) {
                lost += let_go(this.factors_of(cell), counted, costs)?;
            }
            refine.leave_out(chunk, cell, structure);
        }
        refine.chunks[chunk].sum(counted);
        Some(lost)
    }
}

/// Halves the step of one cell's variable until all its factors exist that existed before, and
/// gives their cost.
fn shorten(
    problem: &Problem,
    step: &Step<'_>,
    trial: &mut Values,
    chunk: &Chunk,
    cell: usize,
    costs: (&[f64], &mut [f64]),
) -> bool {
    let factors = chunk.factors_of(cell);
    let cell = &chunk.cells[cell];
    let tangent = &step.numbers[cell.step..][..cell.dof as usize];
    let variable = (cell.store as usize, cell.slot as usize);
    for halving in 1..=HALVINGS {
        let scale = if halving == HALVINGS { 0.0 } else { 0.5f64.powi(halving) };
        let shorter: Vec<f64> = tangent.iter().map(|step| step * scale).collect();
        step.take_one(problem.retraction.as_deref(), variable, &shorter, trial);
        for i in factors.clone() {
            let run = chunk.run_of(i);
            let at = chunk.factors.numbers[i];
            problem.runs[run].costs(trial, &[at], &mut costs.1[i..=i]);
        }
        if factors.clone().all(|i| survives(costs.0[i], costs.1[i])) {
            return true;
        }
    }
    false
}

/// Gives factors that something else than their variable ends, as a camera that moves past a point,
/// the cost that they had: they gain a step nothing and do not hold up all others. Gives how many;
/// `None` if one is there but not finite.
fn let_go(factors: Range<usize>, before: &[f64], after: &mut [f64]) -> Option<usize> {
    let mut lost = 0;
    for i in factors {
        if !survives(before[i], after[i]) {
            if !after[i].is_nan() {
                return None;
            }
            after[i] = before[i];
            lost += 1;
        }
    }
    Some(lost)
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
            let promise = self.step(lambda, times)?;
            let begin = Instant::now();
            let Self { structure, step, .. } = self;
            let step = Step { values, numbers: step, at: &structure.step_at };
            step.take(problem.retraction.as_deref(), trial);
            times.back_substitute += begin.elapsed();
            let (cost, lost) =
                self.trial_cost(problem, values, trial, times).unwrap_or((f64::INFINITY, 0));
            Some(Attempt { promise, cost, lost })
        })
    }
}

impl SchurSystem {
    /// Whether there is work for several threads.
    fn shared(&self) -> bool {
        self.structure.chunks.len() > 1
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
        let mut tasks = Vec::with_capacity(structure.chunks.len());
        let mut rest = &mut self.memory[..];
        for (sums, chunk) in self.sums.iter_mut().zip(&structure.chunks) {
            let (memory, others) = rest.split_at_mut(chunk.memory.len());
            tasks.push((sums, memory));
            rest = others;
        }
        for_chunks(&structure.chunks, &mut tasks, |chunk, (sums, memory)| {
            sums.linearize(memory, problem, values, chunk, lambda);
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

    /// Solves for the step. Gives by how much the linear model says the cost will fall.
    fn step(&mut self, lambda: f64, times: &mut Times) -> Option<f64> {
        let begin = Instant::now();
        let structure = &self.structure;
        let (kept, eliminated) = self.step.split_at_mut(structure.kept_len);
        let rest = Eliminated { structure, memory: &self.memory };
        let solved = self.reduced.solve(rest, kept);
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
        let (memory, block_at) = (&self.memory, &self.block_at);
        for_chunks(&structure.chunks, &mut tasks, |chunk, (steps, promise)| {
            *promise = Sums::back_substitute(memory, chunk, kept, block_at, lambda, steps);
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
        times.back_substitute += begin.elapsed();
        let promise = 0.5 * (damped - g_step);
        promise.is_finite().then_some(promise)
    }

    /// The cost at `trial`, refined, and how many factors were let go for it; `None` where a factor
    /// that existed does not, or is not finite.
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
        let mut lost = Some(0);
        for chunk in 0..self.structure.chunks.len() {
            if !self.refine.chunks[chunk].alive {
                let more = self.rescue(problem, values, trial, chunk);
                lost = lost.zip(more).map(|(lost, more)| lost + more);
            }
        }
        times.evaluate += begin.elapsed();
        let lost = lost?;
        let begin = Instant::now();
        let Self { structure, sums, refine, .. } = self;
        if refine.cost().is_finite() {
            refine.improve(problem, trial, structure, sums);
        }
        times.refine += begin.elapsed();
        let cost = refine.cost();
        cost.is_finite().then_some((cost, lost))
    }
}
