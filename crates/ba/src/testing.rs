//! Checks that every factor has to pass, as plain functions on values: one line in a test for a new
//! factor.

use tiepoint_geometry::{Block, Manifold};

use crate::factor::{Factor, Linear, Refs, Vars};

/// A tuple of variables that can be perturbed one direction at a time. Implemented for all
/// [`Vars`].
pub trait PerturbVars: Vars {
    /// Tuple of values: `(Rigid3, Vector3<f64>)`.
    type Owned: Copy;
    /// Tuple of references to the values.
    fn refs_of(values: &Self::Owned) -> Refs<'_, Self>;
    /// The values with one tangent direction perturbed by `step`; directions are counted over all
    /// variables.
    fn perturbed(values: &Self::Owned, direction: usize, step: f64) -> Self::Owned;
    /// One column of the Jacobian over all variables.
    fn column<const R: usize>(jacobians: &Self::Jacobians<R>, direction: usize) -> Vec<f64>;
}

macro_rules! impl_perturb_vars {
    ($($V:ident $i:tt),*) => {
        impl<$($V: Manifold),*> PerturbVars for ($($V,)*) {
            type Owned = ($($V,)*);
            fn refs_of(values: &Self::Owned) -> Refs<'_, Self> {
                ($(&values.$i,)*)
            }
            fn perturbed(values: &Self::Owned, direction: usize, step: f64) -> Self::Owned {
                let mut values = *values;
                let mut first = 0;
                $(
                    if (first..first + $V::DOF).contains(&direction) {
                        let mut tangent = $V::Tangent::zeros();
                        tangent.as_mut_slice()[direction - first] = step;
                        values.$i = values.$i.plus(&tangent);
                    }
                    first += $V::DOF;
                )*
                let _ = first;
                values
            }
            fn column<const R: usize>(
                jacobians: &Self::Jacobians<R>,
                direction: usize,
            ) -> Vec<f64> {
                let mut first = 0;
                $(
                    if (first..first + $V::DOF).contains(&direction) {
                        return jacobians.$i.as_slice()[(direction - first) * R..][..R].to_vec();
                    }
                    first += $V::DOF;
                )*
                let _ = first;
                Vec::new()
            }
        }
    };
}

impl_perturb_vars!(A 0);
impl_perturb_vars!(A 0, B 1);
impl_perturb_vars!(A 0, B 1, C 2);
impl_perturb_vars!(A 0, B 1, C 2, D 3);
impl_perturb_vars!(A 0, B 1, C 2, D 3, E 4);
impl_perturb_vars!(A 0, B 1, C 2, D 3, E 4, F 5);
impl_perturb_vars!(A 0, B 1, C 2, D 3, E 4, F 5, G 6);
impl_perturb_vars!(A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7);

/// Step of the numeric derivative. The error of Richardson extrapolation is of order step⁴, that of
/// rounding ε / step: 1e-3 makes both about 1e-12.
const STEP: f64 = 1e-3;

/// Checks a factor's Jacobian against numeric derivatives (central differences, extrapolated once),
/// and its `residual` against its `linearize`. `tolerance` is relative to the largest element of
/// the Jacobian and the residual.
///
/// # Errors
/// A message with the column that differs and its difference, or that the factor is invalid near
/// these values.
pub fn check_jacobians<F, const R: usize>(
    factor: &F,
    values: <F::Vars as PerturbVars>::Owned,
    tolerance: f64,
) -> Result<(), String>
where
    F: Factor<R>,
    F::Vars: PerturbVars,
{
    let residual_at = |values: &<F::Vars as PerturbVars>::Owned| {
        factor
            .residual(F::Vars::refs_of(values))
            .ok_or("the factor is invalid (None) near these values".to_owned())
    };
    let linear: Option<Linear<F::Vars, R>> = factor.linearize(F::Vars::refs_of(&values));
    let (residual, jacobians) = linear.ok_or("the factor is invalid (None) at these values")?;
    let again = residual_at(&values)?;
    let directions: usize = F::Vars::DOFS.iter().sum();
    let columns: Vec<Vec<f64>> = (0..directions).map(|i| F::Vars::column(&jacobians, i)).collect();
    let largest = columns
        .iter()
        .flatten()
        .chain(residual.iter())
        .fold(1e-300, |max: f64, x| max.max(x.abs()));
    if (residual - again).amax() > tolerance * largest {
        return Err(format!("residual() gives {again:?}, linearize() {residual:?}"));
    }
    for (direction, column) in columns.iter().enumerate() {
        let central = |step: f64| -> Result<_, String> {
            let plus = residual_at(&F::Vars::perturbed(&values, direction, step))?;
            let minus = residual_at(&F::Vars::perturbed(&values, direction, -step))?;
            Ok((plus - minus) / (2.0 * step))
        };
        let numeric = (central(STEP / 2.0)? * 4.0 - central(STEP)?) / 3.0;
        let error = numeric.iter().zip(column).fold(0.0, |max: f64, (a, b)| max.max((a - b).abs()));
        if error.is_nan() || error > tolerance * largest {
            return Err(format!(
                "column {direction}: analytic {column:?}, numeric {:?}",
                numeric.as_slice()
            ));
        }
    }
    Ok(())
}
