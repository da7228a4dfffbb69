//! All factors of one type, behind an interface without that type. Loops over factors are
//! monomorphised; virtual calls are made once per range of factors.

use std::any::{Any, type_name};

use nalgebra::SVector;
use tiepoint_geometry::Loss;
use tiepoint_simd::{Isa, Level};

use crate::factor::{Factor, ValuesRef, Vars, prefetch, total_dof};
use crate::variable::Values;

/// Cost of a factor that is invalid at these values ([`Factor::residual`] returned `None`).
pub(crate) const INVALID: f64 = f64::NAN;

/// Whether a factor with these costs is still valid, or was not valid before.
pub(crate) fn stays_valid(before: f64, after: f64) -> bool {
    before.is_nan() || after.is_finite()
}

/// Stands for all variables in place of the position of one.
const ALL_VARIABLES: usize = usize::MAX;

/// Variables with at most so many degrees of freedom, such as points, have loops of their own when
/// they are linearised alone: derivatives by the other variables are then never computed. Each loop
/// is compiled for each type of factor; eliminated poses are rare.
const MAX_DOF_ALONE: usize = 3;

/// Factors are prefetched so many iterations ahead, because those of a landmark may be anywhere in
/// memory.
const PREFETCH_DISTANCE: usize = 16;

/// Padded length of a row of the Jacobian and the residual.
const fn row_len(dofs: &[usize]) -> usize {
    (total_dof(dofs) + 1).next_multiple_of(4)
}

/// The losses of a group, nearly always the same for all factors.
enum Losses {
    Same(Loss),
    Each(Vec<Loss>),
}

impl Losses {
    fn push(&mut self, len: usize, loss: Loss) {
        match self {
            Losses::Same(same) if len == 0 => *same = loss,
            Losses::Same(same) if *same == loss => {}
            Losses::Same(same) => {
                let mut each = vec![*same; len];
                each.push(loss);
                *self = Losses::Each(each);
            }
            Losses::Each(each) => each.push(loss),
        }
    }

    #[inline(always)]
    fn get(&self, index: usize) -> &Loss {
        match self {
            Losses::Same(loss) => loss,
            Losses::Each(each) => &each[index],
        }
    }
}

/// Factors of type `F` with their variables and losses.
pub(crate) struct FactorGroup<F: Factor<R>, const R: usize> {
    pub(crate) factors: Vec<F>,
    slots: Vec<<F::Vars as Vars>::Indices>,
    losses: Losses,
    stores: Vec<u16>,
}

impl<F: Factor<R>, const R: usize> FactorGroup<F, R> {
    /// An empty group. `stores` are the indices of the variables' stores.
    pub(crate) fn new(stores: Vec<u16>) -> Self {
        Self { factors: Vec::new(), slots: Vec::new(), losses: Losses::Same(Loss::Trivial), stores }
    }

    pub(crate) fn push(&mut self, slots: <F::Vars as Vars>::Indices, factor: F, loss: Loss) {
        self.losses.push(self.factors.len(), loss);
        self.factors.push(factor);
        self.slots.push(slots);
    }

    /// Prefetches factors that follow number `i` of a list.
    #[inline(always)]
    fn prefetch(&self, slices: <F::Vars as Vars>::Slices<'_>, factors: &[u32], i: usize) {
        if let Some(&ahead) = factors.get(i + PREFETCH_DISTANCE) {
            prefetch(&self.factors, ahead as usize);
            prefetch(&self.slots, ahead as usize);
        }
        if let Some(slots) =
            factors.get(i + PREFETCH_DISTANCE / 2).and_then(|&ahead| self.slots.get(ahead as usize))
        {
            F::Vars::prefetch(slices, slots);
        }
    }

    /// Linearises with respect to the variable at position `I`, or to [`ALL_VARIABLES`].
    ///
    /// `Factor::linearize` should be inlined.
    #[inline(always)]
    fn linearize_here<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        let (columns, stride) = if I == ALL_VARIABLES {
            const { (total_dof(<F::Vars as Vars>::DOFS), row_len(<F::Vars as Vars>::DOFS)) }
        } else {
            (F::Vars::DOFS[I], F::Vars::DOFS[I] + 1)
        };
        let records = out.rows.chunks_exact_mut(R * stride).zip(out.costs);
        for (i, (&index, (rows, cost))) in factors.iter().zip(records).enumerate() {
            self.prefetch(slices, factors, i);
            let index = index as usize;
            let x = F::Vars::refs(slices, &self.slots[index]);
            let Some((residual, jacobians)) = self.factors[index].linearize(x) else {
                rows.fill(0.0);
                *cost = INVALID;
                continue;
            };
            let (half_rho, weight) = robustify(self.losses.get(index), residual.norm_squared());
            *cost = half_rho;
            if I == ALL_VARIABLES {
                F::Vars::write_rows::<R>(&jacobians, weight, rows, stride);
            } else {
                F::Vars::write_one::<R, I>(&jacobians, weight, rows, stride);
            }
            for r in 0..R {
                rows[r * stride + columns] = weight * residual[r];
            }
        }
    }

    /// The same, compiled for wider registers. The compiler neither fuses nor reorders, so the bits
    /// are the same.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn linearize_avx2<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        self.linearize_here::<I>(values, factors, out);
    }

    fn linearize_by<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        match Isa::best().level() {
            // SAFETY: an `Isa` of these levels is only constructed after detection of AVX2.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 | Level::Avx2 => unsafe {
                self.linearize_avx2::<I>(values, factors, out);
            },
            Level::Portable => self.linearize_here::<I>(values, factors, out),
        }
    }

    fn linearize_alone<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        // A constant, so that the loop is not compiled where it is not called.
        if const { I < F::Vars::COUNT && F::Vars::DOFS[I] <= MAX_DOF_ALONE } {
            self.linearize_by::<I>(values, factors, out);
        } else {
            linearize_block(self, I, values, factors, out);
        }
    }

    #[inline(always)]
    fn costs_here(&self, values: &Values, factors: &[u32], out: &mut [f64]) {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        for (i, (&index, cost)) in factors.iter().zip(out).enumerate() {
            self.prefetch(slices, factors, i);
            let index = index as usize;
            let residual = self.factors[index].residual(F::Vars::refs(slices, &self.slots[index]));
            *cost =
                residual.map_or(INVALID, |r| robustify(self.losses.get(index), r.norm_squared()).0);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn costs_avx2(&self, values: &Values, factors: &[u32], out: &mut [f64]) {
        self.costs_here(values, factors, out);
    }

    /// All residuals, in order of insertion.
    pub(crate) fn residuals(&self, values: &Values) -> Vec<Option<SVector<f64, R>>> {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        let at = |(factor, slots): (&F, &_)| factor.residual(F::Vars::refs(slices, slots));
        self.factors.iter().zip(&self.slots).map(at).collect()
    }
}

/// Output of [`AnyFactorGroup::linearize`]: for each factor its cost, and `rows()` rows of
/// `stride()` numbers. A row is the Jacobian of all its variables side by side, then the residual,
/// both times the square root of the loss' derivative ρ'.
pub(crate) struct Rows<'a> {
    pub(crate) rows: &'a mut [f64],
    pub(crate) costs: &'a mut [f64],
}

/// A group whose factor type is erased.
pub(crate) trait AnyFactorGroup: Any + Send + Sync {
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
    fn factor_type(&self) -> &'static str;
    fn len(&self) -> usize;
    /// Residuals of one factor.
    fn rows(&self) -> usize;
    /// Degrees of freedom of each variable.
    fn dofs(&self) -> &'static [usize];
    fn stores(&self) -> &[u16];
    /// Slots of the variables of one factor.
    fn slots(&self, factor: usize) -> &[u32];
    /// Slots of the variables of all factors.
    fn all_slots(&self) -> &[u32];
    /// Length of a row in [`Rows`].
    fn stride(&self) -> usize {
        row_len(self.dofs())
    }
    /// Linearises the first `out.costs.len()` of the listed factors; further ones are only
    /// prefetched. An invalid factor gets zero rows and [`INVALID`]; one with a non-finite residual
    /// gets an infinite cost.
    fn linearize(&self, values: &Values, factors: &[u32], out: Rows<'_>);
    /// The same with respect to the variable at `position` alone: rows of its degrees of freedom
    /// and the residual, without padding.
    fn linearize_landmark(&self, position: u8, values: &Values, factors: &[u32], out: Rows<'_>);
    /// Costs of the listed factors, as in [`AnyFactorGroup::linearize`].
    fn costs(&self, values: &Values, factors: &[u32], out: &mut [f64]);
    /// The first factor that is not finite: its index, the quantity, and its value.
    fn find_not_finite(&self, values: &Values) -> Option<(usize, &'static str, f64)>;
}

/// [`AnyFactorGroup::linearize_landmark`] by the rows of all variables.
fn linearize_block(
    group: &dyn AnyFactorGroup,
    position: usize,
    values: &Values,
    factors: &[u32],
    out: Rows<'_>,
) {
    let (dofs, stride) = (group.dofs(), group.stride());
    let (start, total) = (total_dof(&dofs[..position]), total_dof(dofs));
    let block = start..start + dofs[position];
    let mut all = vec![0.0; out.costs.len() * group.rows() * stride];
    group.linearize(values, factors, Rows { rows: &mut all, costs: out.costs });
    for (row, to) in all.chunks_exact(stride).zip(out.rows.chunks_exact_mut(block.len() + 1)) {
        to[..block.len()].copy_from_slice(&row[block.clone()]);
        to[block.len()] = row[total];
    }
}

/// The cost ½ρ of a squared norm, and √ρ' as the weight of iteratively reweighted least squares:
/// ½ρ'|r + Jδ|² has the gradient of ½ρ and, for ρ'' ≤ 0, is an upper bound.
#[inline(always)]
fn robustify(loss: &Loss, squared_norm: f64) -> (f64, f64) {
    let [rho, slope] = match *loss {
        Loss::Trivial => [squared_norm, 1.0],
        // Most residuals of most problems, without a call.
        Loss::Huber(a) if squared_norm <= a * a => [squared_norm, 1.0],
        _ => {
            let [rho, slope, _] = loss.evaluate(squared_norm);
            [rho, slope.sqrt()]
        }
    };
    let cost = 0.5 * rho;
    // The square may overflow although the residual is finite.
    (if squared_norm.is_finite() && !cost.is_nan() { cost } else { f64::INFINITY }, slope)
}

impl<F: Factor<R>, const R: usize> AnyFactorGroup for FactorGroup<F, R> {
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
    fn factor_type(&self) -> &'static str {
        type_name::<F>()
    }
    fn len(&self) -> usize {
        self.factors.len()
    }
    fn rows(&self) -> usize {
        R
    }
    fn dofs(&self) -> &'static [usize] {
        F::Vars::DOFS
    }
    fn stores(&self) -> &[u16] {
        &self.stores
    }
    fn slots(&self, factor: usize) -> &[u32] {
        self.slots[factor].as_ref()
    }
    fn all_slots(&self) -> &[u32] {
        F::Vars::flat(&self.slots)
    }

    fn linearize(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        self.linearize_by::<ALL_VARIABLES>(values, factors, out);
    }

    fn linearize_landmark(&self, position: u8, values: &Values, factors: &[u32], out: Rows<'_>) {
        match position {
            0 => self.linearize_alone::<0>(values, factors, out),
            1 => self.linearize_alone::<1>(values, factors, out),
            2 => self.linearize_alone::<2>(values, factors, out),
            3 => self.linearize_alone::<3>(values, factors, out),
            4 => self.linearize_alone::<4>(values, factors, out),
            5 => self.linearize_alone::<5>(values, factors, out),
            6 => self.linearize_alone::<6>(values, factors, out),
            _ => self.linearize_alone::<7>(values, factors, out),
        }
    }

    fn costs(&self, values: &Values, factors: &[u32], out: &mut [f64]) {
        match Isa::best().level() {
            // SAFETY: an `Isa` of these levels is only constructed after detection of AVX2.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 | Level::Avx2 => unsafe { self.costs_avx2(values, factors, out) },
            Level::Portable => self.costs_here(values, factors, out),
        }
    }

    fn find_not_finite(&self, values: &Values) -> Option<(usize, &'static str, f64)> {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        let (total, stride) = (total_dof(F::Vars::DOFS), self.stride());
        let mut rows = vec![0.0; R * stride];
        for (index, (factor, slots)) in self.factors.iter().zip(&self.slots).enumerate() {
            let Some((residual, jacobians)) = factor.linearize(F::Vars::refs(slices, slots)) else {
                continue;
            };
            if let Some(&value) = residual.iter().find(|value| !value.is_finite()) {
                return Some((index, "residual", value));
            }
            if !residual.norm_squared().is_finite() {
                return Some((index, "squared residual", residual.norm_squared()));
            }
            F::Vars::write_rows::<R>(&jacobians, 1.0, &mut rows, stride);
            let jacobian = rows.chunks_exact(stride).flat_map(|row| &row[..total]);
            // A number whose square overflows invalidates the normal equations as well.
            if let Some(&value) = jacobian.into_iter().find(|value| !(*value * *value).is_finite())
            {
                return Some((index, "Jacobian", value));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::Rigid3;
    use tiepoint_geometry::cameras::SimplePinhole;

    use super::*;
    use crate::factors::Reprojection;
    use crate::{EliminationOrder, Problem};

    #[test]
    fn variable_alone_has_its_columns_of_all() {
        let mut problem = Problem::new();
        let intrinsics =
            problem.add_parameter(Vector3::new(600.0, 320.0, 240.0), EliminationOrder::Last);
        let pose = problem.add_landmark(Rigid3::identity());
        // The last one is behind the camera.
        for z in [5.0, 7.0, -5.0] {
            let point = problem.add_landmark(Vector3::new(1.0, 0.5, z));
            let factor = Reprojection::<SimplePinhole>::new(Vector2::new(330.0, 240.0), 2.0);
            problem.add((intrinsics, pose, point), factor, Loss::Cauchy(1.0)).unwrap();
        }
        let (group, factors) = (&*problem.factor_groups[0], [2, 0, 1]);
        let (count, stride) = (factors.len() * group.rows(), group.stride());
        let (mut all, mut all_costs) = (vec![f64::NAN; count * stride], [0.0; 3]);
        group.linearize(&problem.values, &factors, Rows { rows: &mut all, costs: &mut all_costs });
        assert!(all_costs[0].is_nan() && all_costs[1] > 0.0 && all_costs[2] > 0.0);
        let total = total_dof(group.dofs());
        for (position, &dof) in group.dofs().iter().enumerate() {
            let start = total_dof(&group.dofs()[..position]);
            let (mut alone, mut costs) = (vec![f64::NAN; count * (dof + 1)], [0.0; 3]);
            let out = Rows { rows: &mut alone, costs: &mut costs };
            group.linearize_landmark(position as u8, &problem.values, &factors, out);
            assert_eq!(costs.map(f64::to_bits), all_costs.map(f64::to_bits));
            for (row, all) in alone.chunks_exact(dof + 1).zip(all.chunks_exact(stride)) {
                assert_eq!((&row[..dof], row[dof]), (&all[start..][..dof], all[total]));
            }
        }
    }
}
