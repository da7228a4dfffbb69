//! QR factorisation of the whole Jacobian as one dense matrix, for small ill-conditioned problems.
//! The tests compare the elimination with it.

use std::time::Instant;

use faer::Mat;
use faer::linalg::solvers::SolveLstsqCore;

use crate::damping::marquardt;
use crate::error::Error;
use crate::factor_group::Rows;
use crate::linear_system::{Attempt, LinearSystem, Linearised};
use crate::problem::Problem;
use crate::retraction::Step;
use crate::structure::{Elimination, Structure};
use crate::summary::Times;
use crate::variable::Values;

/// If a column vanishes, because an exponential underflows, only damping bounds its variable. Its
/// damping is therefore at least this fraction of its first damping. Ceres achieves the same by
/// scaling columns once and bounding their diagonal; MGH17 of the NIST problems depends on it.
const LEAST_SCALE: f64 = 1e-6;

pub(crate) struct QrSystem {
    structure: Structure,
    rows: usize,
    /// J, with room for √(λD) below it.
    jacobian: Mat<f64>,
    residual: Vec<f64>,
    costs: Vec<f64>,
    /// Offset of each column of J in the padded step.
    column_at: Vec<usize>,
    step: Vec<f64>,
    /// Lower bound of the damping of each column, set at the first linearisation where it is not
    /// zero.
    least_scale: Vec<f64>,
}

impl QrSystem {
    pub(crate) fn new(problem: &Problem) -> Result<Self, Error> {
        let structure = Structure::new(problem, Elimination::Ignore)?;
        let rows = problem.num_residuals();
        let column_at: Vec<usize> = (structure.blocks.iter())
            .flat_map(|block| {
                block.free_columns().map(|i| block.padded_start + i).collect::<Vec<_>>()
            })
            .collect();
        Ok(Self {
            rows,
            jacobian: Mat::zeros(rows, structure.columns),
            residual: vec![0.0; rows],
            costs: vec![0.0; problem.num_factors()],
            column_at,
            step: vec![0.0; structure.step_len],
            least_scale: vec![0.0; structure.columns],
            structure,
        })
    }

    /// The diagonal of JᵀJ, and Jᵀr.
    fn normal(&self) -> (Vec<f64>, Vec<f64>) {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        (0..self.structure.columns)
            .map(|j| {
                let column: Vec<f64> = self.jacobian.col(j).iter().copied().collect();
                (dot(&column, &column), dot(&column, &self.residual))
            })
            .unzip()
    }
}

impl LinearSystem for QrSystem {
    fn name(&self) -> &'static str {
        "dense QR"
    }

    fn columns(&self) -> (usize, usize) {
        (self.structure.columns, 0)
    }

    fn linearize(
        &mut self,
        problem: &Problem,
        values: &Values,
        _: f64,
        times: &mut Times,
    ) -> Linearised {
        let begin = Instant::now();
        self.jacobian.fill(0.0);
        let (mut first_row, mut at) = (0, 0);
        for group in &problem.factor_groups {
            let factors: Vec<u32> = (0..group.len() as u32).collect();
            let (height, stride) = (group.rows(), group.stride());
            let mut numbers = vec![0.0; group.len() * height * stride];
            let costs = &mut self.costs[at..][..group.len()];
            at += group.len();
            group.linearize(values, &factors, Rows { rows: &mut numbers, costs });
            for (factor, rows) in numbers.chunks_exact((height * stride).max(1)).enumerate() {
                let mut column = 0;
                for ((&store, &slot), &dof) in
                    group.stores().iter().zip(group.slots(factor)).zip(group.dofs())
                {
                    let location = self.structure.locations[store as usize][slot as usize];
                    if location.block != crate::structure::NONE {
                        let block = &self.structure.blocks[location.block as usize];
                        let before =
                            (block.free & ((1u64 << location.offset) - 1)).count_ones() as usize;
                        let free = (0..dof)
                            .filter(|i| block.free >> (location.offset as usize + i) & 1 == 1);
                        for (to, i) in (block.first_column + before..).zip(free) {
                            for r in 0..height {
                                self.jacobian[(first_row + r, to)] = rows[r * stride + column + i];
                            }
                        }
                    }
                    column += dof;
                }
                for r in 0..height {
                    self.residual[first_row + r] = rows[r * stride + column];
                }
                first_row += height;
            }
        }
        let (diagonal, gradient) = self.normal();
        for (least, diagonal) in self.least_scale.iter_mut().zip(&diagonal) {
            if *least == 0.0 {
                *least = LEAST_SCALE * (1.0 + diagonal.sqrt()).powi(2) * f64::from(*diagonal > 0.0);
            }
        }
        let existing = self.costs.iter().filter(|cost| !cost.is_nan());
        let missing = self.costs.len() - existing.clone().count();
        let cost = existing.sum();
        let finite = diagonal.iter().chain(&gradient).all(|value| value.is_finite());
        let largest = gradient.iter().fold(0.0, |max: f64, g| max.max(g.abs()));
        times.linearize += begin.elapsed();
        Linearised { cost, missing, gradient_max: if finite { largest } else { f64::INFINITY } }
    }

    fn attempt(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        lambda: f64,
        times: &mut Times,
    ) -> Option<Attempt> {
        let predicted_reduction = self.step(lambda, times)?;
        let step = Step { values, tangents: &self.step, offsets: &self.structure.step_offsets };
        step.take(problem.retraction.as_deref(), trial);
        let cost = self.trial_cost(problem, trial, times);
        Some(Attempt { predicted_reduction, cost: cost.unwrap_or(f64::INFINITY), dropped: 0 })
    }
}

impl QrSystem {
    fn step(&mut self, lambda: f64, times: &mut Times) -> Option<f64> {
        let begin = Instant::now();
        let columns = self.structure.columns;
        let (mut diagonal, gradient) = self.normal();
        for (diagonal, least) in diagonal.iter_mut().zip(&self.least_scale) {
            *diagonal = diagonal.max(*least);
        }
        let mut matrix = Mat::<f64>::zeros(self.rows + columns, columns);
        matrix.as_mut().subrows_mut(0, self.rows).copy_from(&self.jacobian);
        let mut right = Mat::<f64>::zeros(self.rows + columns, 1);
        for (i, residual) in self.residual.iter().enumerate() {
            right[(i, 0)] = -residual;
        }
        for (j, &diagonal) in diagonal.iter().enumerate() {
            matrix[(self.rows + j, j)] = marquardt(diagonal, lambda).sqrt();
        }
        matrix.col_piv_qr().solve_lstsq_in_place_with_conj(faer::Conj::No, right.as_mut());
        let [mut g_step, mut damped] = [0.0; 2];
        for j in 0..columns {
            let step = right[(j, 0)];
            self.step[self.column_at[j]] = step;
            g_step += gradient[j] * step;
            damped += lambda * diagonal[j] * step * step;
        }
        times.solve += begin.elapsed();
        let predicted_reduction = 0.5 * (damped - g_step);
        predicted_reduction.is_finite().then_some(predicted_reduction)
    }

    fn trial_cost(&mut self, problem: &Problem, trial: &Values, times: &mut Times) -> Option<f64> {
        let begin = Instant::now();
        let (mut cost, mut at) = (0.0, 0);
        for group in &problem.factor_groups {
            let factors: Vec<u32> = (0..group.len() as u32).collect();
            let mut costs = vec![0.0; group.len()];
            group.costs(trial, &factors, &mut costs);
            for (before, after) in self.costs[at..].iter().zip(costs) {
                // NaN if a factor has become invalid, and then the sum is NaN.
                cost += if before.is_nan() { 0.0 } else { after };
            }
            at += group.len();
        }
        times.evaluate += begin.elapsed();
        cost.is_finite().then_some(cost)
    }
}
