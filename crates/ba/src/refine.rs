//! Eliminated variables on their own, with the kept ones held: Gauss-Newton steps that cost little, for nothing but small
//! blocks have to be solved, and that take out of the way what is not linear in these variables (Jeong, Nister, Steedly,
//! Szeliski, Kweon 2012, "Pushing the envelope of modern methods for bundle adjustment", section 5.2: embedded point iterations).
//! Each variable keeps a step only if it lowers the cost of its own factors, so that nothing gets worse.
#![allow(clippy::needless_range_loop)] // one index runs through several arrays

use crate::eliminate::Sums;
use crate::eliminate::damping;
use crate::problem::Problem;
use crate::run::Rows;
use crate::schur::{SchurSystem, survives};
use crate::structure::{Cell, Chunk, NO_OWN, Structure};
use crate::variable::{FIXED, Values};

/// λ of these steps: against singular blocks, not for caution.
const LAMBDA: f64 = 1e-6;

pub(crate) struct Refine {
    chunks: Vec<Part>,
    /// For each store, where the steps are, or [`FIXED`]; empty for stores without an eliminated variable.
    step_at: Vec<Vec<u32>>,
    /// Steps of the eliminated variables.
    steps: Vec<f64>,
    /// The values that steps start from, of stores with an eliminated variable.
    base: Values,
}

/// What one chunk works on.
#[derive(Default)]
struct Part {
    rows: Vec<f64>,
    costs: Vec<f64>,
    /// Cells whose step is to be undone.
    worse: Vec<u32>,
}

impl Refine {
    pub(crate) fn new(problem: &Problem, structure: &Structure, refinements: usize) -> Self {
        if refinements == 0 {
            let (chunks, step_at, steps, base) = Default::default();
            return Self { chunks, step_at, steps, base };
        }
        let mut step_at: Vec<Vec<u32>> = structure.step_at.clone();
        for at in step_at.iter_mut().flatten() {
            // Behind those of the kept ones.
            *at =
                if *at == FIXED { FIXED } else { at.checked_sub(structure.kept_len as u32).unwrap_or(FIXED) };
        }
        for at in &mut step_at {
            if at.iter().all(|&at| at == FIXED) {
                at.clear();
            }
        }
        let part = |chunk: &Chunk| {
            let longest =
                chunk.batches.iter().map(|batch| batch_len(problem, chunk, batch.stretches.clone()));
            Part {
                rows: vec![0.0; longest.max().unwrap_or(0)],
                costs: vec![0.0; chunk.factors.len()],
                worse: Vec::new(),
            }
        };
        Self {
            chunks: structure.chunks.iter().map(part).collect(),
            steps: vec![0.0; structure.step_len - structure.kept_len],
            base: problem.values.clone(),
            step_at,
        }
    }

    /// One step of each eliminated variable from `trial`, where the factors have these costs. `sums` knows which of them
    /// count.
    pub(crate) fn round(
        &mut self,
        problem: &Problem,
        trial: &mut Values,
        structure: &Structure,
        sums: &[Sums],
        costs: &mut [Vec<f64>],
    ) {
        let mut tasks = Vec::with_capacity(self.chunks.len());
        let mut rest = &mut self.steps[..];
        for (part, chunk) in self.chunks.iter_mut().zip(&structure.chunks) {
            let (steps, others) = rest.split_at_mut(chunk.steps.len());
            tasks.push((part, steps));
            rest = others;
        }
        let from: &Values = trial;
        SchurSystem::for_chunks(&structure.chunks, &mut tasks, |chunk, (part, steps)| {
            part.step(problem, from, chunk, steps)
        });
        for ((trial, base), at) in trial.stores.iter_mut().zip(&mut self.base.stores).zip(&self.step_at) {
            if !at.is_empty() {
                std::mem::swap(trial, base);
                trial.plus_all(&**base, &self.steps, at);
            }
        }
        let to: &Values = trial;
        let mut tasks: Vec<_> = self.chunks.iter_mut().zip(sums).zip(costs).collect();
        SchurSystem::for_chunks(&structure.chunks, &mut tasks, |chunk, ((part, sums), costs)| {
            part.judge(problem, to, chunk, &sums.costs, costs);
        });
        for (part, chunk) in self.chunks.iter().zip(&structure.chunks) {
            for &cell in &part.worse {
                let Cell { store, slot, .. } = chunk.cells[cell as usize];
                let (trial, base) = (&mut trial.stores[store as usize], &self.base.stores[store as usize]);
                trial.copy_one(&**base, slot as usize);
            }
        }
    }
}

/// How many numbers the rows of a batch have.
fn batch_len(problem: &Problem, chunk: &Chunk, stretches: std::ops::Range<usize>) -> usize {
    let own = chunk.stretches[stretches].iter().filter(|stretch| stretch.own != NO_OWN);
    own.map(|stretch| {
        let run = &problem.runs[stretch.run as usize];
        (stretch.end - stretch.start) * run.rows() * (run.dofs()[stretch.own as usize] + 1)
    })
    .sum()
}

impl Part {
    /// The steps of a chunk's variables.
    fn step(&mut self, problem: &Problem, from: &Values, chunk: &Chunk, steps: &mut [f64]) {
        let mut factor = 0;
        for batch in &chunk.batches {
            let mut at = 0;
            for stretch in &chunk.stretches[batch.stretches.clone()] {
                if stretch.own == NO_OWN {
                    continue;
                }
                let run = &problem.runs[stretch.run as usize];
                let range = stretch.start..stretch.end;
                let len = range.len() * run.rows() * (run.dofs()[stretch.own as usize] + 1);
                let rows = Rows { rows: &mut self.rows[at..at + len], costs: &mut self.costs[range.clone()] };
                run.linearize_own(stretch.own, from, &chunk.factors[range], rows);
                at += len;
            }
            let mut rows = &mut self.rows[..at];
            for cell in &chunk.cells[batch.cells.clone()] {
                let to = &mut steps[cell.step - chunk.steps.start..];
                let count = match cell.dof {
                    0 => 0,
                    1 => step::<1>(chunk, cell, factor, rows, to),
                    2 => step::<2>(chunk, cell, factor, rows, to),
                    3 => step::<3>(chunk, cell, factor, rows, to),
                    4 => step::<4>(chunk, cell, factor, rows, to),
                    5 => step::<5>(chunk, cell, factor, rows, to),
                    _ => step::<6>(chunk, cell, factor, rows, to),
                };
                rows = &mut rows[count..];
                factor = cell.end as usize;
            }
        }
    }

    /// Takes over the costs of what has become better, and lists the cells that have not.
    fn judge(&mut self, problem: &Problem, to: &Values, chunk: &Chunk, counted: &[f64], costs: &mut [f64]) {
        self.worse.clear();
        for stretch in chunk.stretches.iter().filter(|stretch| stretch.own != NO_OWN) {
            let range = stretch.start..stretch.end;
            let run = &problem.runs[stretch.run as usize];
            run.costs(to, &chunk.factors[range.clone()], &mut self.costs[range]);
        }
        let mut start = 0;
        for (index, cell) in chunk.cells.iter().enumerate() {
            let range = start..cell.end as usize;
            start = range.end;
            if cell.dof == 0 {
                continue;
            }
            let (mut old, mut new) = (0.0, 0.0);
            let mut alive = true;
            for i in range.clone() {
                alive &= survives(counted[i], self.costs[i]);
                if !counted[i].is_nan() {
                    old += costs[i];
                    new += self.costs[i];
                }
            }
            if alive && new < old {
                costs[range.clone()].copy_from_slice(&self.costs[range]);
            } else {
                self.worse.push(index as u32);
            }
        }
    }
}

/// The Gauss-Newton step of one variable. Gives the length of its factors' rows.
fn step<const P: usize>(chunk: &Chunk, cell: &Cell, first: usize, rows: &mut [f64], to: &mut [f64]) -> usize {
    let (mut v, mut g, mut at) = ([[0.0; P]; P], [0.0; P], 0);
    for &shape in &chunk.shape_of[first..cell.end as usize] {
        let shape = &chunk.shapes[shape as usize];
        let rows = &mut rows[at..][..shape.rows * (P + 1)];
        at += rows.len();
        for held in
            shape.held.iter().filter_map(|column| column.checked_sub(shape.eliminated)).filter(|&i| i < P)
        {
            rows.chunks_exact_mut(P + 1).for_each(|row| row[held] = 0.0);
        }
        for row in rows.chunks_exact(P + 1) {
            for i in 0..P {
                for j in 0..=i {
                    v[i][j] += row[i] * row[j];
                }
                g[i] += row[i] * row[P];
            }
        }
    }
    for i in 0..P {
        v[i][i] += damping(v[i][i], LAMBDA);
    }
    let mut inverse = [0.0; P];
    crate::eliminate::cholesky(&mut v, &mut inverse);
    for i in 0..P {
        for j in 0..i {
            g[i] -= v[i][j] * g[j];
        }
        g[i] *= inverse[i];
    }
    for i in (0..P).rev() {
        for j in i + 1..P {
            g[i] -= v[j][i] * g[j];
        }
        g[i] *= inverse[i];
        to[i] = -g[i];
    }
    at
}
