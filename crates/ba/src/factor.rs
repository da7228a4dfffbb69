//! Factors: a measurement with its residual and Jacobian.

use nalgebra::SVector;
use tiepoint_geometry::{Block, Manifold};

use crate::variable::{Key, Values};

/// One term of the cost: ½ ρ(|r|²) with a residual r of `R` numbers. Divide the residual by the
/// standard deviation of the measurement, so that it has unit variance.
///
/// [`Factor::linearize`] is required. Implement [`Factor::residual`] too if it is much cheaper.
/// [`AutoDiff`](crate::autodiff::AutoDiff) differentiates a residual automatically.
///
/// `None` means that the factor is invalid at these values, such as the projection of a point
/// behind the camera. The front page of the crate describes how the solver treats invalid factors.
pub trait Factor<const R: usize>: Send + Sync + 'static {
    /// Types of its variables, as a tuple: `(Rigid3, Vector3<f64>)`.
    type Vars: Vars;

    /// The residual and its Jacobian with respect to the tangent of each variable, see [`Linear`].
    fn linearize(&self, x: Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, R>>;

    /// The residual alone.
    fn residual(&self, x: Refs<'_, Self::Vars>) -> Option<SVector<f64, R>> {
        self.linearize(x).map(|(residual, _)| residual)
    }
}

/// The values of a factor's variables: `(&Rigid3, &Vector3<f64>)`.
pub type Refs<'a, V> = <V as Vars>::Refs<'a>;

/// A residual with its Jacobian blocks: `(Vector2<f64>, (SMatrix<f64, 2, 6>, SMatrix<f64, 2, 3>))`.
pub type Linear<V, const R: usize> = (SVector<f64, R>, <V as Vars>::Jacobians<R>);

/// A tuple of one to eight manifolds. Implemented by the macro below only.
pub trait Vars: Sized + 'static {
    /// Number of variables.
    const COUNT: usize;
    /// Their degrees of freedom.
    const DOFS: &'static [usize];
    /// References to their values.
    type Refs<'a>: Copy;
    /// Their keys.
    type Keys: Copy;
    /// Jacobian blocks of `R` residuals with respect to each variable.
    type Jacobians<const R: usize>: Send;
    #[doc(hidden)]
    type Indices: Copy + AsRef<[u32]> + Send + Sync;
    #[doc(hidden)]
    type Slices<'a>: Copy;

    #[doc(hidden)]
    fn slots(keys: Self::Keys) -> Self::Indices;
    /// The indices of several factors as one slice.
    #[doc(hidden)]
    fn flat(indices: &[Self::Indices]) -> &[u32];
    /// Indices of the stores of the variables' types, `None` if a store does not exist.
    #[doc(hidden)]
    fn stores(values: &ValuesRef<'_>) -> Vec<Option<u16>>;
    #[doc(hidden)]
    fn slices<'a>(values: &ValuesRef<'a>, stores: &[u16]) -> Self::Slices<'a>;
    #[doc(hidden)]
    fn refs<'a>(slices: Self::Slices<'a>, slots: &Self::Indices) -> Self::Refs<'a>;
    /// Prefetches the values.
    #[doc(hidden)]
    fn prefetch(slices: Self::Slices<'_>, slots: &Self::Indices);
    /// Writes the Jacobian times `weight` as rows of `stride` numbers, the blocks of the variables
    /// side by side.
    #[doc(hidden)]
    fn write_rows<const R: usize>(
        jacobians: &Self::Jacobians<R>,
        weight: f64,
        rows: &mut [f64],
        stride: usize,
    );
    /// Writes the block of the variable at position `I` alone.
    #[doc(hidden)]
    fn write_one<const R: usize, const I: usize>(
        jacobians: &Self::Jacobians<R>,
        weight: f64,
        rows: &mut [f64],
        stride: usize,
    );
}

/// Keeps the crate's value storage out of the public trait.
#[doc(hidden)]
#[derive(Clone, Copy)]
pub struct ValuesRef<'a>(pub(crate) &'a Values);

/// Total degrees of freedom of a factor's variables.
pub(crate) const fn total_dof(dofs: &[usize]) -> usize {
    let (mut total, mut i) = (0, 0);
    while i < dofs.len() {
        total += dofs[i];
        i += 1;
    }
    total
}

/// Keys of a factor's variables: a tuple of [`Key`], or a single key.
pub trait IntoKeys<V: Vars> {
    /// The keys as a tuple.
    fn into_keys(self) -> V::Keys;
}

impl<A: Manifold> IntoKeys<(A,)> for Key<A> {
    fn into_keys(self) -> (Key<A>,) {
        (self,)
    }
}

/// Prefetches an item, if the processor supports it.
#[inline(always)]
pub(crate) fn prefetch<T>(items: &[T], index: usize) {
    // Miri does not support prefetching.
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch is a hint, whose address may be invalid.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(items.as_ptr().wrapping_add(index).cast()) };
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (items, index);
}

#[inline(always)]
fn write_block<B: Block, const R: usize>(
    block: &B,
    dof: usize,
    weight: f64,
    rows: &mut [f64],
    stride: usize,
) {
    let numbers = &block.as_slice()[..R * dof];
    for r in 0..R {
        let row = &mut rows[r * stride..][..dof];
        for (c, out) in row.iter_mut().enumerate() {
            *out = weight * numbers[c * R + r];
        }
    }
}

macro_rules! impl_vars {
    ($count:literal: $($V:ident $i:tt),*) => {
        impl<$($V: Manifold),*> Vars for ($($V,)*) {
            const COUNT: usize = $count;
            const DOFS: &'static [usize] = &[$($V::DOF),*];
            type Refs<'a> = ($(&'a $V,)*);
            type Keys = ($(Key<$V>,)*);
            type Jacobians<const R: usize> = ($($V::Jacobian<R>,)*);
            type Indices = [u32; $count];
            type Slices<'a> = ($(&'a [$V],)*);

            fn slots(keys: Self::Keys) -> Self::Indices {
                [$(keys.$i.slot),*]
            }
            fn flat(indices: &[Self::Indices]) -> &[u32] {
                indices.as_flattened()
            }
            fn stores(values: &ValuesRef<'_>) -> Vec<Option<u16>> {
                vec![$(values.0.find(std::any::TypeId::of::<$V>()).map(|store| store as u16)),*]
            }
            fn slices<'a>(values: &ValuesRef<'a>, stores: &[u16]) -> Self::Slices<'a> {
                ($(values.0.slice::<$V>(stores[$i]),)*)
            }
            #[inline(always)]
            fn refs<'a>(slices: Self::Slices<'a>, slots: &Self::Indices) -> Self::Refs<'a> {
                ($(&slices.$i[slots[$i] as usize],)*)
            }
            #[inline(always)]
            fn prefetch(slices: Self::Slices<'_>, slots: &Self::Indices) {
                $(prefetch(slices.$i, slots[$i] as usize);)*
            }
            #[inline(always)]
            fn write_rows<const R: usize>(
                jacobians: &Self::Jacobians<R>,
                weight: f64,
                rows: &mut [f64],
                stride: usize,
            ) {
                let start = 0;
                $(
                    write_block::<_, R>(&jacobians.$i, $V::DOF, weight, &mut rows[start..], stride);
                    let start = start + $V::DOF;
                )*
                let _ = start;
            }
            #[inline(always)]
            fn write_one<const R: usize, const I: usize>(
                jacobians: &Self::Jacobians<R>,
                weight: f64,
                rows: &mut [f64],
                stride: usize,
            ) {
                match I {
                    $($i => write_block::<_, R>(&jacobians.$i, $V::DOF, weight, rows, stride),)*
                    _ => {}
                }
            }
        }

        impl<$($V: Manifold),*> IntoKeys<($($V,)*)> for ($(Key<$V>,)*) {
            fn into_keys(self) -> ($(Key<$V>,)*) {
                self
            }
        }
    };
}

impl_vars!(1: A 0);
impl_vars!(2: A 0, B 1);
impl_vars!(3: A 0, B 1, C 2);
impl_vars!(4: A 0, B 1, C 2, D 3);
impl_vars!(5: A 0, B 1, C 2, D 3, E 4);
impl_vars!(6: A 0, B 1, C 2, D 3, E 4, F 5);
impl_vars!(7: A 0, B 1, C 2, D 3, E 4, F 5, G 6);
impl_vars!(8: A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7);
