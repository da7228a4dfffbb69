//! Covariance of variables whose residuals are correlated within clusters.
//!
//! The cluster-robust covariance (sandwich) is H⁻¹ (Σ_c g_c g_cᵀ) H⁻¹ with H = JᵀJ and the score
//! g_c = Jᵀr over the factors of cluster c (Liang and Zeger 1986). It needs no model of the
//! correlation. J and r are weighted by their losses, as in the solver.
//!
//! Let X be the columns of H⁻¹ that belong to the requested directions. A factor moves the estimate
//! by −(JX)ᵀr, so that g_c itself is never formed, only Xᵀg_c. The rows of X that belong to a
//! landmark p are X_p = −V⁻¹WᵀX_c (see `eliminate`), which eliminates it from the scores: JX =
//! (J_c − J_p V⁻¹Wᵀ) X_c.

use std::collections::BTreeMap;
use std::ops::AddAssign;

use nalgebra::{DMatrix, DVector, DVectorView};
use rayon::prelude::*;

use crate::covariance::{Covariance, InverseColumns};
use crate::eliminate::LandmarkStash;
use crate::error::Error;
use crate::factor_group::Rows;
use crate::problem::{FactorKey, Problem};
use crate::structure::{Batch, LandmarkBlock, Task};
use crate::variable::{AnyKey, FIXED, Role};

/// Smallest share of a direction of a landmark that the factors outside a cluster must determine.
const MIN_SHARE: f64 = 1e-3;

/// Joint covariances of some variables if residuals are correlated within landmarks or within other
/// clusters.
///
/// Each is H⁻¹ (Σ_c g_c g_cᵀ) H⁻¹ C/(C − 1) over C clusters of factors. The factor is that of
/// Cameron and Miller (2015), section II.B, for many more residuals than variables. If residuals
/// are correlated in both ways, the covariance is `by_landmark` + `by_cluster` − `by_both`
/// (Cameron, Gelbach and Miller 2011).
#[derive(Clone, Debug, PartialEq)]
pub struct ClusteredCovariance {
    /// Each landmark with its factors is a cluster, and so is each factor without a landmark.
    pub by_landmark: Covariance,
    /// The clusters are those of the caller. It is zero if there is only one.
    pub by_cluster: Covariance,
    /// Factors that have both the landmark and the caller's cluster in common are a cluster.
    pub by_both: Covariance,
    /// H⁻¹ JᵀJ H⁻¹ with J of the factors in no cluster: their residuals are independent and have
    /// unit variance. It is to be added to each of the others.
    pub independent: Covariance,
}

impl Problem {
    /// The cluster-robust covariances of some variables at the current values, which are a minimum
    /// of the cost. Fixed directions have zero rows and columns.
    ///
    /// `cluster_of` returns the number of a factor's cluster, or `None` for a factor whose residual
    /// is independent of all others. Residuals of one cluster may have any variances and
    /// correlations. The residual of a prior or of a tight constraint is small however wrong it is,
    /// so it should be in no cluster.
    ///
    /// # Errors
    /// Those of [`Problem::covariance`].
    pub fn clustered_covariance(
        &self,
        keys: &[AnyKey],
        cluster_of: impl Fn(FactorKey) -> Option<u32> + Sync,
    ) -> Result<ClusteredCovariance, Error> {
        let inverse = InverseColumns::new(self, keys)?;
        let scorer = Scorer::new(self, &inverse, keys, cluster_of)?;
        let tasks = &inverse.system.structure.tasks;
        let of_tasks: Vec<Scores> =
            tasks.par_iter().with_max_len(1).map(|task| scorer.scores(task)).collect();
        // In order, whichever thread was first.
        let mut scores = Scores::new(inverse.kept.ncols());
        of_tasks.iter().for_each(|of_task| scores += of_task);
        let covariance = |matrix| Covariance { matrix, ..inverse.covariance.clone() };
        let mut by_cluster = Middle::new(inverse.kept.ncols());
        scores.clusters.values().for_each(|score| by_cluster.add(score));
        Ok(ClusteredCovariance {
            by_landmark: covariance(scores.by_landmark.corrected()),
            by_cluster: covariance(by_cluster.corrected()),
            by_both: covariance(scores.by_both.corrected()),
            independent: covariance(scores.independent),
        })
    }
}

/// Σ_c Xᵀg_c g_cᵀX over some clusters.
struct Middle {
    sum: DMatrix<f64>,
    count: usize,
}

impl Middle {
    fn new(directions: usize) -> Self {
        Self { sum: DMatrix::zeros(directions, directions), count: 0 }
    }

    fn add(&mut self, score: &DVector<f64>) {
        self.sum.ger(1.0, score, score, 1.0);
        self.count += 1;
    }

    /// The scores of all clusters sum up to about zero. So does that of a single one, which tells
    /// nothing.
    fn corrected(self) -> DMatrix<f64> {
        let count = self.count as f64;
        self.sum * if self.count > 1 { count / (count - 1.0) } else { 0.0 }
    }
}

/// Sums over the factors of a task, or of all.
struct Scores {
    by_landmark: Middle,
    by_both: Middle,
    /// Xᵀg_c of each of the caller's clusters.
    clusters: BTreeMap<u32, DVector<f64>>,
    independent: DMatrix<f64>,
}

impl Scores {
    fn new(directions: usize) -> Self {
        Self {
            by_landmark: Middle::new(directions),
            by_both: Middle::new(directions),
            clusters: BTreeMap::new(),
            independent: DMatrix::zeros(directions, directions),
        }
    }

    fn add_to_cluster(&mut self, number: u32, score: &DVector<f64>) {
        *self.clusters.entry(number).or_insert_with(|| DVector::zeros(score.len())) += score;
    }
}

impl AddAssign<&Self> for Scores {
    fn add_assign(&mut self, other: &Self) {
        for (middle, other) in
            [(&mut self.by_landmark, &other.by_landmark), (&mut self.by_both, &other.by_both)]
        {
            middle.sum += &other.sum;
            middle.count += other.count;
        }
        other.clusters.iter().for_each(|(number, score)| self.add_to_cluster(*number, score));
        self.independent += &other.independent;
    }
}

/// Computes scores of factors.
struct Scorer<'a, F> {
    problem: &'a Problem,
    inverse: &'a InverseColumns,
    cluster_of: F,
    /// X of the kept variables, row by row: at the offset of their steps.
    kept: Vec<f64>,
    /// First requested direction of each requested landmark, by its store and slot.
    landmarks: BTreeMap<(u32, u32), usize>,
}

/// A factor of a batch of landmarks, linearised.
struct Linearised<'a> {
    key: FactorKey,
    landmark_position: u8,
    is_valid: bool,
    /// Its rows of the Jacobian and the residual.
    rows: &'a [f64],
}

impl<'a, F: Fn(FactorKey) -> Option<u32> + Sync> Scorer<'a, F> {
    fn new(
        problem: &'a Problem,
        inverse: &'a InverseColumns,
        keys: &[AnyKey],
        cluster_of: F,
    ) -> Result<Self, Error> {
        let directions = inverse.kept.ncols();
        let structure = &inverse.system.structure;
        let mut kept = vec![0.0; structure.kept_len * directions];
        for block in &structure.blocks {
            for (column, i) in block.free_columns().enumerate() {
                for direction in 0..directions {
                    kept[(block.padded_start + i) * directions + direction] =
                        inverse.kept[(block.first_column + column, direction)];
                }
            }
        }
        let mut landmarks = BTreeMap::new();
        for (key, &first) in keys.iter().zip(&inverse.covariance.first) {
            let (store, slot) = problem.locate(key)?;
            if problem.metas[store][slot].role == Role::Eliminated {
                landmarks.insert((store as u32, slot as u32), first);
            }
        }
        Ok(Self { problem, inverse, cluster_of, kept, landmarks })
    }

    /// Scores of a task's factors.
    fn scores(&self, task: &Task) -> Scores {
        let mut scores = Scores::new(self.inverse.kept.ncols());
        let (mut rows, mut costs) = (vec![0.0; task.rows_len], Vec::new());
        for batch in &task.batches {
            let factors = self.linearize(task, batch, &mut rows, &mut costs);
            let mut rest = &factors[..];
            for index in batch.landmarks.clone() {
                let (these, others) = rest.split_at(task.factors_of(index).len());
                rest = others;
                let landmark = &task.landmarks[index];
                if landmark.dof > 0 {
                    self.add_scores(task, landmark, these, &mut scores);
                } else {
                    for factor in these {
                        let factor = std::slice::from_ref(factor);
                        self.add_scores(task, landmark, factor, &mut scores);
                    }
                }
            }
        }
        scores
    }

    /// Linearises the factors of a batch of landmarks.
    fn linearize<'r>(
        &self,
        task: &Task,
        batch: &Batch,
        mut rows: &'r mut [f64],
        costs: &mut Vec<f64>,
    ) -> Vec<Linearised<'r>> {
        let mut linearised = Vec::new();
        for range in &task.factor_ranges[batch.factor_ranges.clone()] {
            let group = &self.problem.factor_groups[range.group as usize];
            let factor_len = group.rows() * group.stride();
            costs.clear();
            costs.resize(range.end - range.start, 0.0);
            let these;
            (these, rows) = std::mem::take(&mut rows).split_at_mut(costs.len() * factor_len);
            let indices = &task.factors.indices[range.start..];
            group.linearize(&self.problem.values, indices, Rows { rows: these, costs });
            let factors = these.chunks_exact(factor_len).zip(&*costs).zip(indices);
            linearised.extend(factors.map(|((rows, cost), &index)| Linearised {
                key: FactorKey { group: u32::from(range.group), index },
                landmark_position: range.landmark_position,
                is_valid: !cost.is_nan(),
                rows,
            }));
        }
        linearised
    }

    /// Adds the scores of a landmark's factors.
    fn add_scores(
        &self,
        task: &Task,
        landmark: &LandmarkBlock,
        factors: &[Linearised<'_>],
        scores: &mut Scores,
    ) {
        let (directions, p) = (self.inverse.kept.ncols(), landmark.dof as usize);
        let part = || ScorePart::new(directions, p);
        let (mut whole, mut parts): (_, Vec<(u32, ScorePart)>) = (part(), Vec::new());
        for Row { cluster, jx, z, residual } in self.rows(task, landmark, factors) {
            let Some(number) = cluster else {
                scores.independent.ger(1.0, &jx, &jx, 1.0);
                continue;
            };
            let at = parts.iter().position(|(other, _)| *other == number);
            let at = at.unwrap_or_else(|| {
                parts.push((number, part()));
                parts.len() - 1
            });
            whole.add(&jx, &z, residual);
            parts[at].1.add(&jx, &z, residual);
        }
        if !parts.is_empty() {
            scores.by_landmark.add(&whole.score());
        }
        for (number, part) in parts {
            let score = part.score();
            scores.by_both.add(&score);
            scores.add_to_cluster(number, &score);
        }
    }

    /// The rows of a landmark's factors.
    fn rows(&self, task: &Task, landmark: &LandmarkBlock, factors: &[Linearised<'_>]) -> Vec<Row> {
        let (p, store, slot) = (landmark.dof as usize, landmark.store, landmark.slot);
        // LᵀX_p = L⁻¹ (E − WᵀX_c), with E = 1 in the requested directions of the landmark itself.
        let mut x = DMatrix::zeros(p, self.inverse.kept.ncols());
        let (mut l, mut free) = (DMatrix::zeros(0, 0), 0);
        if p > 0 {
            let stash = LandmarkStash::of(&self.inverse.system.memory, landmark, task);
            l = DMatrix::from_fn(p, p, |i, j| if j <= i { stash.factor(i, j) } else { 0.0 });
            free = self.problem.metas[store as usize][slot as usize].free;
            if let Some(&first) = self.landmarks.get(&(store, slot)) {
                let moving = (0..p).filter(|k| free >> k & 1 == 1);
                moving.for_each(|k| x[(k, first + k)] = 1.0);
                l.solve_lower_triangular_unchecked_mut(&mut x);
            }
        }
        let mut rows = Vec::new();
        for factor in factors.iter().filter(|factor| factor.is_valid) {
            let group = &self.problem.factor_groups[factor.key.group as usize];
            let total: usize = group.dofs().iter().sum();
            let before = group.dofs().iter().take(factor.landmark_position as usize);
            let start: usize = before.sum();
            let cluster = (self.cluster_of)(factor.key);
            for row in factor.rows.chunks_exact(group.stride()) {
                let mut z =
                    DVector::from_fn(
                        p,
                        |k, _| if free >> k & 1 == 1 { row[start + k] } else { 0.0 },
                    );
                l.solve_lower_triangular_unchecked_mut(&mut z);
                let jx = self.kept_product(factor, row);
                x.ger(-1.0, &z, &jx, 1.0);
                rows.push(Row { cluster, jx, z, residual: row[total] });
            }
        }
        rows.iter_mut().for_each(|row| row.jx.gemv_tr(1.0, &x, &row.z, 1.0));
        rows
    }

    /// The product of a factor's row with X of its kept variables.
    fn kept_product(&self, factor: &Linearised<'_>, row: &[f64]) -> DVector<f64> {
        let directions = self.inverse.kept.ncols();
        let group = &self.problem.factor_groups[factor.key.group as usize];
        let offsets = &self.inverse.system.structure.step_offsets;
        let variables = group.stores().iter().zip(group.slots(factor.key.index as usize));
        let (mut product, mut column) = (DVector::zeros(directions), 0);
        for (position, ((&store, &slot), &dof)) in (0u8..).zip(variables.zip(group.dofs())) {
            let offset = offsets[store as usize][slot as usize];
            if position != factor.landmark_position && offset != FIXED {
                let x = self.kept[offset as usize * directions..].chunks(directions);
                for (j, x) in row[column..][..dof].iter().zip(x) {
                    product.axpy(*j, &DVectorView::from_slice(x, directions), 1.0);
                }
            }
            column += dof;
        }
        product
    }
}

/// A row of a factor's Jacobian.
struct Row {
    cluster: Option<u32>,
    /// JX.
    jx: DVector<f64>,
    /// Z = J_p L⁻ᵀ.
    z: DVector<f64>,
    residual: f64,
}

/// Sums over the factors that a landmark and a cluster have in common.
///
/// A landmark is pulled to the errors of its factors, which makes their residuals r smaller. With
/// the landmark that the other factors give, they are r + Z (I − ZᵀZ)⁻¹ Zᵀr with Z = J_p L⁻ᵀ: the
/// jackknife over clusters (CV₃ of MacKinnon, Nielsen and Webb 2023) as far as landmarks go. Kept
/// variables have so many factors that a cluster pulls them little.
struct ScorePart {
    /// (JX)ᵀ r.
    score: DVector<f64>,
    /// (JX)ᵀ Z.
    coupling: DMatrix<f64>,
    /// Zᵀ r.
    pull: DVector<f64>,
    /// ZᵀZ: shares of these factors in the landmark's V.
    share: DMatrix<f64>,
}

impl ScorePart {
    fn new(directions: usize, p: usize) -> Self {
        Self {
            score: DVector::zeros(directions),
            coupling: DMatrix::zeros(directions, p),
            pull: DVector::zeros(p),
            share: DMatrix::zeros(p, p),
        }
    }

    fn add(&mut self, jx: &DVector<f64>, z: &DVector<f64>, residual: f64) {
        self.score.axpy(residual, jx, 1.0);
        self.coupling.ger(1.0, jx, z, 1.0);
        self.pull.axpy(residual, z, 1.0);
        self.share.ger(1.0, z, z, 1.0);
    }

    fn score(self) -> DVector<f64> {
        let shares = self.share.symmetric_eigen();
        let mut pull = shares.eigenvectors.tr_mul(&self.pull);
        for (pull, share) in pull.iter_mut().zip(&shares.eigenvalues) {
            // A direction that only these factors determine follows them, and does not pull.
            let others = 1.0 - share;
            *pull = if others > MIN_SHARE { *pull / others } else { 0.0 };
        }
        self.score + self.coupling * (shares.eigenvectors * pull)
    }
}
