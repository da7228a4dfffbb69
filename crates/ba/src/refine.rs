//! What a step costs, and eliminated variables on their own, with the kept ones held: Gauss-Newton
//! steps that cost little, for nothing but small blocks have to be solved, and that take out of the
//! way what is not linear in these variables (Jeong, Nister, Steedly, Szeliski, Kweon 2012,
//! "Pushing the envelope of modern methods for bundle adjustment", section 5.2: embedded point
//! iterations). Each variable keeps a step only if it lowers the cost of its own factors, so that
//! nothing gets worse; and takes another only if that has paid.
#![allow(clippy::needless_range_loop)] // one index runs through several arrays

use std::ops::Range;

use crate::damping::marquardt;
use crate::eliminate::Sums;
use crate::problem::Problem;
use crate::run::{Rows, survives};
use crate::structure::{Batch, Cell, Chunk, NO_OWN, Structure, for_chunks};
use crate::variable::{FIXED, Values};

/// λ of these steps: against singular blocks, not for caution.
const LAMBDA: f64 = 1e-6;
/// A variable goes on as long as a step lowers its cost by more than this part of the mean over all
/// such variables.
const WORTH_REFINING: f64 = 1e-2;

/// Where a step leads, and from there.
pub(crate) struct Refine {
    rounds: usize,
    pub(crate) chunks: Vec<Part>,
    /// For each store, where the steps are, or [`FIXED`]; empty for stores without an eliminated
    /// variable.
    step_at: Vec<Vec<u32>>,
    /// Steps of the eliminated variables.
    steps: Vec<f64>,
    /// The values that steps start from, of stores with an eliminated variable.
    base: Values,
}

/// What one chunk works on.
#[derive(Default)]
pub(crate) struct Part {
    /// Of each factor, [`NO_COST`](crate::run::NO_COST) where it does not exist.
    pub(crate) costs: Vec<f64>,
    /// Their sum over the factors that count.
    pub(crate) cost: f64,
    /// Whether all factors exist that should.
    pub(crate) alive: bool,
    rows: Vec<f64>,
    /// Of the factors of a batch.
    next_costs: Vec<f64>,
    /// Whether a cell's variable takes part in the next round.
    active: Vec<bool>,
    /// Cells whose step is to be undone.
    worse: Vec<u32>,
}

impl Refine {
    pub(crate) fn new(problem: &Problem, structure: &Structure, rounds: usize) -> Self {
        let part = |chunk: &Chunk| Part {
            costs: vec![0.0; chunk.factors.numbers.len()],
            ..Part::default()
        };
        let mut this = Self {
            rounds,
            chunks: structure.chunks.iter().map(part).collect(),
            step_at: Vec::new(),
            steps: Vec::new(),
            base: Values::default(),
        };
        if rounds > 0 {
            this.make_room(problem, structure);
        }
        this
    }

    /// For the rounds.
    fn make_room(&mut self, problem: &Problem, structure: &Structure) {
        self.step_at = structure.step_at.clone();
        for at in self.step_at.iter_mut().flatten() {
            // Behind those of the kept ones.
            *at = if *at == FIXED {
                FIXED
            } else {
                at.checked_sub(structure.kept_len as u32).unwrap_or(FIXED)
            };
        }
        for at in &mut self.step_at {
            if at.iter().all(|&at| at == FIXED) {
                at.clear();
            }
        }
        for (part, chunk) in self.chunks.iter_mut().zip(&structure.chunks) {
            let longest = chunk
                .batches
                .iter()
                .map(|batch| batch_len(problem, chunk, batch.stretches.clone()));
            part.rows = vec![0.0; longest.max().unwrap_or(0)];
            let factors = |batch: &Batch| {
                let stretches = &chunk.stretches[batch.stretches.clone()];
                stretches.iter().map(|stretch| stretch.end - stretch.start).sum()
            };
            part.next_costs = vec![0.0; chunk.batches.iter().map(factors).max().unwrap_or(0)];
            part.active = vec![false; chunk.cells.len()];
        }
        self.steps = vec![0.0; structure.step_len - structure.kept_len];
        self.base = problem.values.clone();
    }

    /// The cost at `trial`. Of the factors of eliminated variables, the derivatives come along, and
    /// with them the steps of the first round. `sums` knows which factors count.
    pub(crate) fn evaluate(
        &mut self,
        problem: &Problem,
        trial: &Values,
        structure: &Structure,
        sums: &[Sums],
    ) {
        let refine = self.rounds > 0;
        let mut tasks = Self::tasks(&mut self.chunks, &mut self.steps, structure, sums);
        for_chunks(&structure.chunks, &mut tasks, |chunk, (part, steps, sums)| {
            if refine {
                part.active
                    .iter_mut()
                    .zip(&chunk.cells)
                    .for_each(|(active, cell)| *active = cell.dof > 0);
                part.step(problem, trial, chunk, steps, true);
            }
            for stretch in chunk.stretches.iter().filter(|stretch| !refine || stretch.own == NO_OWN)
            {
                let range = stretch.start..stretch.end;
                let run = &problem.runs[stretch.run as usize];
                run.costs(trial, &chunk.factors.numbers[range.start..], &mut part.costs[range]);
            }
            part.sum(&sums.costs);
        });
    }

    /// The cost of all.
    pub(crate) fn cost(&self) -> f64 {
        self.chunks.iter().fold(0.0, |sum, part| sum + part.cost)
    }

    /// Takes the steps of the eliminated variables from `trial`, as long as they pay.
    /// [`Refine::evaluate`] has been there.
    pub(crate) fn improve(
        &mut self,
        problem: &Problem,
        trial: &mut Values,
        structure: &Structure,
        sums: &[Sums],
    ) {
        let cells = structure
            .chunks
            .iter()
            .flat_map(|chunk| &chunk.cells)
            .filter(|cell| cell.dof > 0)
            .count();
        for round in 0..self.rounds {
            if round > 0 {
                let mut tasks = Self::tasks(&mut self.chunks, &mut self.steps, structure, sums);
                let from: &Values = trial;
                for_chunks(&structure.chunks, &mut tasks, |chunk, (part, steps, _)| {
                    part.step(problem, from, chunk, steps, false);
                });
            }
            let worth = WORTH_REFINING * self.cost() / cells.max(1) as f64;
            for ((trial, base), at) in
                trial.stores.iter_mut().zip(&mut self.base.stores).zip(&self.step_at)
            {
                if !at.is_empty() {
                    std::mem::swap(trial, base);
                    trial.plus_all(&**base, &self.steps, at);
                }
            }
            let to: &Values = trial;
            let mut tasks = Self::tasks(&mut self.chunks, &mut self.steps, structure, sums);
            for_chunks(&structure.chunks, &mut tasks, |chunk, (part, _, sums)| {
                part.judge(problem, to, chunk, &sums.costs, worth);
            });
            for (part, chunk) in self.chunks.iter().zip(&structure.chunks) {
                for &cell in &part.worse {
                    let Cell { store, slot, .. } = chunk.cells[cell as usize];
                    let (trial, base) =
                        (&mut trial.stores[store as usize], &self.base.stores[store as usize]);
                    trial.copy_one(&**base, slot as usize);
                }
            }
            if !self.chunks.iter().any(|part| part.active.contains(&true)) {
                break;
            }
        }
    }

    /// What each chunk needs.
    fn tasks<'a>(
        parts: &'a mut [Part],
        steps: &'a mut [f64],
        structure: &Structure,
        sums: &'a [Sums],
    ) -> Vec<(&'a mut Part, &'a mut [f64], &'a Sums)> {
        let mut rest = steps;
        let mut tasks = Vec::with_capacity(parts.len());
        for ((part, chunk), sums) in parts.iter_mut().zip(&structure.chunks).zip(sums) {
            let (steps, others) = rest.split_at_mut(chunk.steps.len().min(rest.len()));
            tasks.push((part, steps, sums));
            rest = others;
        }
        tasks
    }

    /// Takes a cell out of the first round: its variable is not where [`Refine::evaluate`] found
    /// it.
    pub(crate) fn leave_out(&mut self, chunk: usize, cell: usize, structure: &Structure) {
        if let Some(active) = self.chunks[chunk].active.get_mut(cell) {
            *active = false;
            let Cell { step, dof, .. } = structure.chunks[chunk].cells[cell];
            self.steps[step - structure.kept_len..][..dof as usize].fill(0.0);
        }
    }
}

/// How many numbers the rows of a batch have.
fn batch_len(problem: &Problem, chunk: &Chunk, stretches: Range<usize>) -> usize {
    let own = chunk.stretches[stretches].iter().filter(|stretch| stretch.own != NO_OWN);
    own.map(|stretch| {
        let run = &problem.runs[stretch.run as usize];
        (stretch.end - stretch.start) * run.rows() * (run.dofs()[stretch.own as usize] + 1)
    })
    .sum()
}

/// The next stretch of active cells of a batch.
fn next_active(active: &[bool], cells: &mut Range<usize>) -> Option<Range<usize>> {
    let start = cells.clone().find(|&cell| active[cell])?;
    let end = (start..cells.end).find(|&cell| !active[cell]).unwrap_or(cells.end);
    cells.start = end;
    Some(start..end)
}

/// The factors of some cells of a batch, by stretch.
fn stretches_of<'a>(
    chunk: &'a Chunk,
    batch: &Batch,
    factors: &Range<usize>,
) -> impl Iterator<Item = (u16, u8, Range<usize>)> + use<'a> {
    let Range { start, end } = *factors;
    (chunk.stretches[batch.stretches.clone()].iter())
        .map(move |stretch| {
            (stretch.run, stretch.own, stretch.start.max(start)..stretch.end.min(end))
        })
        .filter(|(_, _, range)| !range.is_empty())
}

impl Part {
    /// Sums up the costs, and looks whether all factors exist that have `counted`.
    pub(crate) fn sum(&mut self, counted: &[f64]) {
        (self.cost, self.alive) = (0.0, true);
        for (&before, &after) in counted.iter().zip(&self.costs) {
            self.cost += if before.is_nan() { 0.0 } else { after };
            self.alive &= survives(before, after);
        }
    }

    /// The steps of a chunk's active variables, and zero for the others; and the costs of their
    /// factors, if they are not known.
    fn step(
        &mut self,
        problem: &Problem,
        from: &Values,
        chunk: &Chunk,
        steps: &mut [f64],
        costs: bool,
    ) {
        steps.fill(0.0);
        for batch in &chunk.batches {
            let mut rest = batch.cells.clone();
            while let Some(cells) = next_active(&self.active, &mut rest) {
                let factors =
                    chunk.factors_of(cells.start).start..chunk.cells[cells.end - 1].end as usize;
                let mut at = 0;
                for (run, own, range) in stretches_of(chunk, batch, &factors) {
                    let run = &problem.runs[run as usize];
                    let len = range.len() * run.rows() * (run.dofs()[own as usize] + 1);
                    let costs = if costs {
                        &mut self.costs[range.clone()]
                    } else {
                        &mut self.next_costs[range.start - factors.start..range.end - factors.start]
                    };
                    let rows = Rows { rows: &mut self.rows[at..at + len], costs };
                    run.linearize_own(own, from, &chunk.factors.numbers[range.start..], rows);
                    at += len;
                }
                let mut rows = &mut self.rows[..at];
                let mut factor = factors.start;
                for cell in &chunk.cells[cells] {
                    let to = &mut steps[cell.step - chunk.steps.start..];
                    let count = match cell.dof {
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
    }

    /// Takes over the costs of what has become better, and lists the cells that have not. Those
    /// that gained less than `worth` are done.
    fn judge(
        &mut self,
        problem: &Problem,
        to: &Values,
        chunk: &Chunk,
        counted: &[f64],
        worth: f64,
    ) {
        self.worse.clear();
        for batch in &chunk.batches {
            let mut rest = batch.cells.clone();
            while let Some(cells) = next_active(&self.active, &mut rest) {
                let mut start = chunk.factors_of(cells.start).start;
                let factors = start..chunk.cells[cells.end - 1].end as usize;
                for (run, _, range) in stretches_of(chunk, batch, &factors) {
                    let run = &problem.runs[run as usize];
                    let costs = &mut self.next_costs
                        [range.start - factors.start..range.end - factors.start];
                    run.costs(to, &chunk.factors.numbers[range.start..], costs);
                }
                for cell in cells {
                    let range = start..chunk.cells[cell].end as usize;
                    start = range.end;
                    let (mut old, mut new) = (0.0, 0.0);
                    let mut alive = true;
                    let next_costs =
                        &self.next_costs[range.start - factors.start..range.end - factors.start];
                    for (i, &next) in range.clone().zip(next_costs) {
                        alive &= survives(counted[i], next);
                        if !counted[i].is_nan() {
                            old += self.costs[i];
                            new += next;
                        }
                    }
                    self.active[cell] = alive && old - new > worth;
                    if alive && new < old {
                        self.costs[range.clone()].copy_from_slice(next_costs);
                    } else {
                        self.worse.push(cell as u32);
                    }
                }
            }
        }
        self.sum(counted);
    }
}

/// The Gauss-Newton step of one variable. Gives the length of its factors' rows.
fn step<const P: usize>(
    chunk: &Chunk,
    cell: &Cell,
    first: usize,
    rows: &mut [f64],
    to: &mut [f64],
) -> usize {
    let (mut v, mut g, mut at) = ([[0.0; P]; P], [0.0; P], 0);
    for &shape in &chunk.factors.shape_of[first..cell.end as usize] {
        let shape = &chunk.factors.shapes[shape as usize];
        let rows = &mut rows[at..][..shape.rows * (P + 1)];
        at += rows.len();
        for held in shape
            .held
            .iter()
            .filter_map(|column| column.checked_sub(shape.eliminated))
            .filter(|&i| i < P)
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
        v[i][i] += marquardt(v[i][i], LAMBDA);
    }
    // V = L D Lᵀ with ones on the diagonal of L: without square roots, which so short a loop hangs
    // on. Meanwhile L⁻¹ g.
    let mut inverse = [0.0; P];
    for j in 0..P {
        inverse[j] = 1.0 / v[j][j];
        for i in j + 1..P {
            let l = v[i][j] * inverse[j];
            for k in j + 1..=i {
                v[i][k] -= l * v[k][j];
            }
            g[i] -= l * g[j];
        }
    }
    for i in (0..P).rev() {
        let mut sum = g[i];
        for j in i + 1..P {
            sum += v[j][i] * to[j];
        }
        to[i] = -sum * inverse[i];
    }
    at
}
