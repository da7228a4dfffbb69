//! Cost of a step, and embedded point iterations: Gauss-Newton steps of each landmark with the kept
//! variables constant. They are cheap, because only small blocks are solved, and they reduce the
//! nonlinearity in the landmarks (Jeong, Nister, Steedly, Szeliski, Kweon 2012, "Pushing the
//! envelope of modern methods for bundle adjustment", section 5.2). A landmark keeps a step only if
//! it lowers the cost of its own factors, so the total cost never rises. It takes another step only
//! if the last one lowered the cost enough.
#![allow(clippy::needless_range_loop)] // one index factor_groups through several arrays

use std::ops::Range;

use crate::damping::marquardt;
use crate::eliminate::Sums;
use crate::factor_group::{Rows, stays_valid};
use crate::problem::Problem;
use crate::structure::{Batch, LandmarkBlock, NO_LANDMARK, Structure, Task, for_each_task};
use crate::variable::{FIXED, Values};

/// λ of these steps, which only has to keep singular blocks solvable.
const LAMBDA: f64 = 1e-6;
/// A landmark continues while a step lowers its cost by more than this fraction of the mean cost
/// per landmark.
const MIN_RELATIVE_GAIN: f64 = 1e-2;

/// Evaluation and refinement of a step.
pub(crate) struct LandmarkRefinement {
    rounds: usize,
    pub(crate) tasks: Vec<TaskRefinement>,
    /// For each store: offsets of the landmarks' steps, or [`FIXED`]; empty for stores without
    /// landmarks.
    step_offsets: Vec<Vec<u32>>,
    /// Steps of the landmarks.
    steps: Vec<f64>,
    /// Values before the steps, of stores with landmarks.
    base: Values,
}

/// State of one task.
#[derive(Default)]
pub(crate) struct TaskRefinement {
    /// Cost of each factor, [`INVALID`](crate::factor_group::INVALID) if it is invalid.
    pub(crate) costs: Vec<f64>,
    /// Sum over the factors that were valid before the step.
    pub(crate) cost: f64,
    /// Whether all factors are valid that were valid before the step.
    pub(crate) all_valid: bool,
    rows: Vec<f64>,
    /// Costs after a round, of the factors of a batch.
    next_costs: Vec<f64>,
    /// Whether a landmark takes state in the next round.
    active: Vec<bool>,
    /// Landmark blocks whose step is undone.
    rejected: Vec<u32>,
}

impl LandmarkRefinement {
    pub(crate) fn new(problem: &Problem, structure: &Structure, rounds: usize) -> Self {
        let state = |task: &Task| TaskRefinement {
            costs: vec![0.0; task.factors.indices.len()],
            ..TaskRefinement::default()
        };
        let mut this = Self {
            rounds,
            tasks: structure.tasks.iter().map(state).collect(),
            step_offsets: Vec::new(),
            steps: Vec::new(),
            base: Values::default(),
        };
        if rounds > 0 {
            this.allocate_rounds(problem, structure);
        }
        this
    }

    /// Allocates the buffers of the rounds.
    fn allocate_rounds(&mut self, problem: &Problem, structure: &Structure) {
        self.step_offsets = structure.step_offsets.clone();
        for at in self.step_offsets.iter_mut().flatten() {
            // Offsets without the steps of the kept variables.
            *at = if *at == FIXED {
                FIXED
            } else {
                at.checked_sub(structure.kept_len as u32).unwrap_or(FIXED)
            };
        }
        for at in &mut self.step_offsets {
            if at.iter().all(|&at| at == FIXED) {
                at.clear();
            }
        }
        for (state, task) in self.tasks.iter_mut().zip(&structure.tasks) {
            let longest = task
                .batches
                .iter()
                .map(|batch| batch_len(problem, task, batch.factor_ranges.clone()));
            state.rows = vec![0.0; longest.max().unwrap_or(0)];
            let factors = |batch: &Batch| {
                let factor_ranges = &task.factor_ranges[batch.factor_ranges.clone()];
                factor_ranges.iter().map(|factor_range| factor_range.end - factor_range.start).sum()
            };
            state.next_costs = vec![0.0; task.batches.iter().map(factors).max().unwrap_or(0)];
            state.active = vec![false; task.landmarks.len()];
        }
        self.steps = vec![0.0; structure.step_len - structure.kept_len];
        self.base = problem.values.clone();
    }

    /// Evaluates the cost at `trial`. Factors with a landmark are linearised, which gives the
    /// landmarks' steps of the first round as well. `sums` holds the costs before the step.
    pub(crate) fn evaluate(
        &mut self,
        problem: &Problem,
        trial: &Values,
        structure: &Structure,
        sums: &[Sums],
    ) {
        let refine = self.rounds > 0;
        let mut work_items = Self::work_items(&mut self.tasks, &mut self.steps, structure, sums);
        for_each_task(&structure.tasks, &mut work_items, |task, (state, steps, sums)| {
            if refine {
                state
                    .active
                    .iter_mut()
                    .zip(&task.landmarks)
                    .for_each(|(active, landmark)| *active = landmark.dof > 0);
                state.compute_steps(problem, trial, task, steps, true);
            }
            for factor_range in task
                .factor_ranges
                .iter()
                .filter(|factor_range| !refine || factor_range.landmark_position == NO_LANDMARK)
            {
                let range = factor_range.start..factor_range.end;
                let group = &problem.factor_groups[factor_range.group as usize];
                group.costs(trial, &task.factors.indices[range.start..], &mut state.costs[range]);
            }
            state.sum(&sums.costs);
        });
    }

    /// Total cost.
    pub(crate) fn cost(&self) -> f64 {
        self.tasks.iter().fold(0.0, |sum, state| sum + state.cost)
    }

    /// Refines the landmarks from `trial` on, after [`LandmarkRefinement::evaluate`] there.
    pub(crate) fn refine_landmarks(
        &mut self,
        problem: &Problem,
        trial: &mut Values,
        structure: &Structure,
        sums: &[Sums],
    ) {
        let landmarks = structure
            .tasks
            .iter()
            .flat_map(|task| &task.landmarks)
            .filter(|landmark| landmark.dof > 0)
            .count();
        for round in 0..self.rounds {
            if round > 0 {
                let mut work_items =
                    Self::work_items(&mut self.tasks, &mut self.steps, structure, sums);
                let from: &Values = trial;
                for_each_task(&structure.tasks, &mut work_items, |task, (state, steps, _)| {
                    state.compute_steps(problem, from, task, steps, false);
                });
            }
            let min_gain = MIN_RELATIVE_GAIN * self.cost() / landmarks.max(1) as f64;
            for ((trial, base), at) in
                trial.stores.iter_mut().zip(&mut self.base.stores).zip(&self.step_offsets)
            {
                if !at.is_empty() {
                    std::mem::swap(trial, base);
                    trial.plus_all(&**base, &self.steps, at);
                }
            }
            let to: &Values = trial;
            let mut work_items =
                Self::work_items(&mut self.tasks, &mut self.steps, structure, sums);
            for_each_task(&structure.tasks, &mut work_items, |task, (state, _, sums)| {
                state.keep_improvements(problem, to, task, &sums.costs, min_gain);
            });
            for (state, task) in self.tasks.iter().zip(&structure.tasks) {
                for &landmark in &state.rejected {
                    let LandmarkBlock { store, slot, .. } = task.landmarks[landmark as usize];
                    let (trial, base) =
                        (&mut trial.stores[store as usize], &self.base.stores[store as usize]);
                    trial.copy_one(&**base, slot as usize);
                }
            }
            if !self.tasks.iter().any(|state| state.active.contains(&true)) {
                break;
            }
        }
    }

    /// State, steps and sums of each task.
    fn work_items<'a>(
        states: &'a mut [TaskRefinement],
        steps: &'a mut [f64],
        structure: &Structure,
        sums: &'a [Sums],
    ) -> Vec<(&'a mut TaskRefinement, &'a mut [f64], &'a Sums)> {
        let mut rest = steps;
        let mut work_items = Vec::with_capacity(states.len());
        for ((state, task), sums) in states.iter_mut().zip(&structure.tasks).zip(sums) {
            let (steps, others) = rest.split_at_mut(task.steps.len().min(rest.len()));
            work_items.push((state, steps, sums));
            rest = others;
        }
        work_items
    }

    /// Excludes a landmark from the first round, because it has moved since
    /// [`LandmarkRefinement::evaluate`].
    pub(crate) fn exclude(&mut self, task: usize, landmark: usize, structure: &Structure) {
        if let Some(active) = self.tasks[task].active.get_mut(landmark) {
            *active = false;
            let LandmarkBlock { step, dof, .. } = structure.tasks[task].landmarks[landmark];
            self.steps[step - structure.kept_len..][..dof as usize].fill(0.0);
        }
    }
}

/// Length of the rows of a batch.
fn batch_len(problem: &Problem, task: &Task, factor_ranges: Range<usize>) -> usize {
    let position = task.factor_ranges[factor_ranges]
        .iter()
        .filter(|factor_range| factor_range.landmark_position != NO_LANDMARK);
    position
        .map(|factor_range| {
            let group = &problem.factor_groups[factor_range.group as usize];
            (factor_range.end - factor_range.start)
                * group.rows()
                * (group.dofs()[factor_range.landmark_position as usize] + 1)
        })
        .sum()
}

/// The next range of active landmark blocks.
fn next_active(active: &[bool], landmarks: &mut Range<usize>) -> Option<Range<usize>> {
    let start = landmarks.clone().find(|&landmark| active[landmark])?;
    let end = (start..landmarks.end).find(|&landmark| !active[landmark]).unwrap_or(landmarks.end);
    landmarks.start = end;
    Some(start..end)
}

/// The factors with indices in `factors`, by factor range: group, position of the landmark, and
/// indices.
fn factor_ranges_of<'a>(
    task: &'a Task,
    batch: &Batch,
    factors: &Range<usize>,
) -> impl Iterator<Item = (u16, u8, Range<usize>)> + use<'a> {
    let Range { start, end } = *factors;
    (task.factor_ranges[batch.factor_ranges.clone()].iter())
        .map(move |factor_range| {
            (
                factor_range.group,
                factor_range.landmark_position,
                factor_range.start.max(start)..factor_range.end.min(end),
            )
        })
        .filter(|(_, _, range)| !range.is_empty())
}

impl TaskRefinement {
    /// Sums the costs, and checks that all factors are valid that were valid before.
    pub(crate) fn sum(&mut self, costs_before: &[f64]) {
        (self.cost, self.all_valid) = (0.0, true);
        for (&before, &after) in costs_before.iter().zip(&self.costs) {
            self.cost += if before.is_nan() { 0.0 } else { after };
            self.all_valid &= stays_valid(before, after);
        }
    }

    /// Computes the steps of a task's active landmarks, zero for the others; and their factors'
    /// costs, if `costs` is set.
    fn compute_steps(
        &mut self,
        problem: &Problem,
        from: &Values,
        task: &Task,
        steps: &mut [f64],
        costs: bool,
    ) {
        steps.fill(0.0);
        for batch in &task.batches {
            let mut rest = batch.landmarks.clone();
            while let Some(landmarks) = next_active(&self.active, &mut rest) {
                let factors = task.factors_of(landmarks.start).start
                    ..task.landmarks[landmarks.end - 1].end as usize;
                let mut at = 0;
                for (group, position, range) in factor_ranges_of(task, batch, &factors) {
                    let group = &problem.factor_groups[group as usize];
                    let len = range.len() * group.rows() * (group.dofs()[position as usize] + 1);
                    let costs = if costs {
                        &mut self.costs[range.clone()]
                    } else {
                        &mut self.next_costs[range.start - factors.start..range.end - factors.start]
                    };
                    let rows = Rows { rows: &mut self.rows[at..at + len], costs };
                    group.linearize_landmark(
                        position,
                        from,
                        &task.factors.indices[range.start..],
                        rows,
                    );
                    at += len;
                }
                let mut rows = &mut self.rows[..at];
                let mut factor = factors.start;
                for landmark in &task.landmarks[landmarks] {
                    let to = &mut steps[landmark.step - task.steps.start..];
                    let count = match landmark.dof {
                        1 => gauss_newton_step::<1>(task, landmark, factor, rows, to),
                        2 => gauss_newton_step::<2>(task, landmark, factor, rows, to),
                        3 => gauss_newton_step::<3>(task, landmark, factor, rows, to),
                        4 => gauss_newton_step::<4>(task, landmark, factor, rows, to),
                        5 => gauss_newton_step::<5>(task, landmark, factor, rows, to),
                        _ => gauss_newton_step::<6>(task, landmark, factor, rows, to),
                    };
                    rows = &mut rows[count..];
                    factor = landmark.end as usize;
                }
            }
        }
    }

    /// Keeps the steps that lowered the cost, and lists the others in `rejected`. Landmarks that
    /// gained less than `min_gain` become inactive.
    fn keep_improvements(
        &mut self,
        problem: &Problem,
        to: &Values,
        task: &Task,
        costs_before: &[f64],
        min_gain: f64,
    ) {
        self.rejected.clear();
        for batch in &task.batches {
            let mut rest = batch.landmarks.clone();
            while let Some(landmarks) = next_active(&self.active, &mut rest) {
                let mut start = task.factors_of(landmarks.start).start;
                let factors = start..task.landmarks[landmarks.end - 1].end as usize;
                for (group, _, range) in factor_ranges_of(task, batch, &factors) {
                    let group = &problem.factor_groups[group as usize];
                    let costs = &mut self.next_costs
                        [range.start - factors.start..range.end - factors.start];
                    group.costs(to, &task.factors.indices[range.start..], costs);
                }
                for landmark in landmarks {
                    let range = start..task.landmarks[landmark].end as usize;
                    start = range.end;
                    let (mut old, mut new) = (0.0, 0.0);
                    let mut all_valid = true;
                    let next_costs =
                        &self.next_costs[range.start - factors.start..range.end - factors.start];
                    for (i, &next) in range.clone().zip(next_costs) {
                        all_valid &= stays_valid(costs_before[i], next);
                        if !costs_before[i].is_nan() {
                            old += self.costs[i];
                            new += next;
                        }
                    }
                    self.active[landmark] = all_valid && old - new > min_gain;
                    if all_valid && new < old {
                        self.costs[range.clone()].copy_from_slice(next_costs);
                    } else {
                        self.rejected.push(landmark as u32);
                    }
                }
            }
        }
        self.sum(costs_before);
    }
}

/// Gauss-Newton step of one landmark. Returns the length of its factors' rows.
fn gauss_newton_step<const P: usize>(
    task: &Task,
    landmark: &LandmarkBlock,
    first: usize,
    rows: &mut [f64],
    to: &mut [f64],
) -> usize {
    let (mut v, mut g, mut at) = ([[0.0; P]; P], [0.0; P], 0);
    for &shape in &task.factors.shape_of[first..landmark.end as usize] {
        let shape = &task.factors.shapes[shape as usize];
        let rows = &mut rows[at..][..shape.rows * (P + 1)];
        at += rows.len();
        for fixed in shape
            .fixed_columns
            .iter()
            .filter_map(|column| column.checked_sub(shape.eliminated))
            .filter(|&i| i < P)
        {
            rows.chunks_exact_mut(P + 1).for_each(|row| row[fixed] = 0.0);
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
    // V = L D Lᵀ with unit diagonal of L, which avoids the latency of square roots, and L⁻¹ g.
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
