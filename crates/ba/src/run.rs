//! All factors of one type, behind an interface that does not know the type: what is done per
//! factor is monomorphised, what is called through a table is called per stretch of factors.

use std::any::{Any, type_name};

use nalgebra::SVector;
use tiepoint_geometry::Loss;

use crate::factor::{Factor, ValuesRef, Vars, fetch, total_dof};
use crate::variable::Values;

/// Cost of a factor that does not exist at these values ([`Factor::residual`] gave `None`).
pub(crate) const NO_COST: f64 = f64::NAN;

/// Whether a factor that had the one cost still exists with the other.
pub(crate) fn survives(before: f64, after: f64) -> bool {
    before.is_nan() || after.is_finite()
}

/// In place of the number of one variable: all of them.
const ALL: usize = usize::MAX;

/// So many factors ahead their memory is asked for: those of other points may lie anywhere.
const AHEAD: usize = 16;

/// Numbers in a row of the Jacobian and the residual.
const fn row_len(dofs: &[usize]) -> usize {
    (total_dof(dofs) + 1).next_multiple_of(4)
}

/// The losses of a run: nearly always one for all.
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
pub(crate) struct Run<F: Factor<R>, const R: usize> {
    pub(crate) factors: Vec<F>,
    slots: Vec<<F::Vars as Vars>::Indices>,
    losses: Losses,
    stores: Vec<u16>,
}

impl<F: Factor<R>, const R: usize> Run<F, R> {
    /// An empty run on the stores of these numbers.
    pub(crate) fn new(stores: Vec<u16>) -> Self {
        Self { factors: Vec::new(), slots: Vec::new(), losses: Losses::Same(Loss::Trivial), stores }
    }

    pub(crate) fn push(&mut self, slots: <F::Vars as Vars>::Indices, factor: F, loss: Loss) {
        self.losses.push(self.factors.len(), loss);
        self.factors.push(factor);
        self.slots.push(slots);
    }

    /// Asks for the memory of what comes some way behind number `i` of a list.
    #[inline(always)]
    fn fetch(&self, slices: <F::Vars as Vars>::Slices<'_>, factors: &[u32], i: usize) {
        if let Some(&ahead) = factors.get(i + AHEAD) {
            fetch(&self.factors, ahead as usize);
            fetch(&self.slots, ahead as usize);
        }
        if let Some(slots) =
            factors.get(i + AHEAD / 2).and_then(|&ahead| self.slots.get(ahead as usize))
        {
            F::Vars::fetch(slices, slots);
        }
    }

    /// The derivatives by variable number `I`, or by [`ALL`].
    ///
    /// The factors' linearisation is inlined, or should be: then what the other variables would get
    /// is never computed.
    #[inline(always)]
    fn linearize_here<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        let (columns, stride) = if I == ALL {
            const { (total_dof(<F::Vars as Vars>::DOFS), row_len(<F::Vars as Vars>::DOFS)) }
        } else {
            (F::Vars::DOFS[I], F::Vars::DOFS[I] + 1)
        };
        let records = out.rows.chunks_exact_mut(R * stride).zip(out.costs);
        for (i, (&index, (rows, cost))) in factors.iter().zip(records).enumerate() {
            self.fetch(slices, factors, i);
            let index = index as usize;
            let x = F::Vars::refs(slices, &self.slots[index]);
            let Some((residual, jacobians)) = self.factors[index].linearize(x) else {
                rows.fill(0.0);
                *cost = NO_COST;
                continue;
            };
            let (half_rho, weight) = rate(self.losses.get(index), residual.norm_squared());
            *cost = half_rho;
            if I == ALL {
                F::Vars::write_rows::<R>(&jacobians, weight, rows, stride);
            } else {
                F::Vars::write_own::<R, I>(&jacobians, weight, rows, stride);
            }
            for r in 0..R {
                rows[r * stride + columns] = weight * residual[r];
            }
        }
    }

    /// The same, compiled for wider registers: the compiler neither fuses nor reorders, so that the
    /// bits are the same.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn linearize_avx2<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        self.linearize_here::<I>(values, factors, out);
    }

    fn linearize_by<const I: usize>(&self, values: &Values, factors: &[u32], out: Rows<'_>) {
        if I != ALL && I >= F::Vars::COUNT {
            return;
        }
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the feature that the function is compiled for has just been found.
            unsafe { self.linearize_avx2::<I>(values, factors, out) };
            return;
        }
        self.linearize_here::<I>(values, factors, out);
    }

    #[inline(always)]
    fn costs_here(&self, values: &Values, factors: &[u32], out: &mut [f64]) {
        let slices = F::Vars::slices(&ValuesRef(values), &self.stores);
        for (i, (&index, cost)) in factors.iter().zip(out).enumerate() {
            self.fetch(slices, factors, i);
            let index = index as usize;
            let residual = self.factors[index].residual(F::Vars::refs(slices, &self.slots[index]));
            *cost = residual.map_or(NO_COST, |r| rate(self.losses.get(index), r.norm_squared()).0);
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

/// What [`AnyRun::linearize`] fills: for each factor, `rows()` rows of `stride()` numbers — the
/// Jacobian of all its variables side by side, then the residual, both times the square root of the
/// loss' slope — and its cost.
pub(crate) struct Rows<'a> {
    pub(crate) rows: &'a mut [f64],
    pub(crate) costs: &'a mut [f64],
}

/// A run whose type is not known.
pub(crate) trait AnyRun: Any + Send + Sync {
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
    fn factor_type(&self) -> &'static str;
    fn len(&self) -> usize;
    /// Residuals of one factor.
    fn rows(&self) -> usize;
    /// Degrees of freedom of each variable.
    fn dofs(&self) -> &'static [usize];
    fn stores(&self) -> &[u16];
    /// Of one factor.
    fn slots(&self, factor: usize) -> &[u32];
    /// Of all factors, one after the other.
    fn all_slots(&self) -> &[u32];
    /// Length of a row in [`Rows`].
    fn stride(&self) -> usize {
        row_len(self.dofs())
    }
    /// Linearises the first of the listed factors, as many as there are costs; to know of more of
    /// them helps to have their memory in time. A factor that does not exist gets rows of zeros and
    /// [`NO_COST`]; one whose residual is not finite gets an infinite cost.
    fn linearize(&self, values: &Values, factors: &[u32], out: Rows<'_>);
    /// The same by variable number `own` alone: rows of its degrees of freedom and the residual,
    /// without padding.
    fn linearize_own(&self, own: u8, values: &Values, factors: &[u32], out: Rows<'_>);
    /// Costs of the listed factors, as in [`AnyRun::linearize`].
    fn costs(&self, values: &Values, factors: &[u32], out: &mut [f64]);
    /// The first factor that is not finite: its number, what, and the value.
    fn find_not_finite(&self, values: &Values) -> Option<(usize, &'static str, f64)>;
}

/// The cost ½ρ of a squared norm, and √ρ': iteratively reweighted least squares, for ½ρ'|r + Jδ|²
/// has the gradient of ½ρ and, for ρ'' ≤ 0, lies above it.
#[inline(always)]
fn rate(loss: &Loss, squared_norm: f64) -> (f64, f64) {
    let [rho, slope] = match *loss {
        Loss::Trivial => [squared_norm, 1.0],
        // Most residuals of most problems: without a call.
        Loss::Huber(a) if squared_norm <= a * a => [squared_norm, 1.0],
        _ => {
            let [rho, slope, _] = loss.evaluate(squared_norm);
            [rho, slope.sqrt()]
        }
    };
    let cost = 0.5 * rho;
    // The square also overflows when the residual is finite but absurd.
    (if squared_norm.is_finite() && !cost.is_nan() { cost } else { f64::INFINITY }, slope)
}

impl<F: Factor<R>, const R: usize> AnyRun for Run<F, R> {
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
        self.linearize_by::<ALL>(values, factors, out);
    }

    fn linearize_own(&self, own: u8, values: &Values, factors: &[u32], out: Rows<'_>) {
        match own {
            0 => self.linearize_by::<0>(values, factors, out),
            1 => self.linearize_by::<1>(values, factors, out),
            2 => self.linearize_by::<2>(values, factors, out),
            3 => self.linearize_by::<3>(values, factors, out),
            4 => self.linearize_by::<4>(values, factors, out),
            5 => self.linearize_by::<5>(values, factors, out),
            6 => self.linearize_by::<6>(values, factors, out),
            _ => self.linearize_by::<7>(values, factors, out),
        }
    }

    fn costs(&self, values: &Values, factors: &[u32], out: &mut [f64]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the feature that the function is compiled for has just been found.
            unsafe { self.costs_avx2(values, factors, out) };
            return;
        }
        self.costs_here(values, factors, out);
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
            // A number whose square overflows spoils the normal equations as much as one that is
            // not finite.
            if let Some(&value) = jacobian.into_iter().find(|value| !(*value * *value).is_finite())
            {
                return Some((index, "Jacobian", value));
            }
        }
        None
    }
}
