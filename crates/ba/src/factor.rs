//! What a problem is made of: a factor is a measurement, with a residual of the variables it joins
//! and its derivatives.

use nalgebra::SVector;
use tiepoint_geometry::{Block, Manifold};

use crate::variable::{Key, Values};

/// One term of the cost: ½ ρ(|r|²) with a residual r of `R` numbers, which should have unit
/// variance when the measurement is right (divide by its standard deviation).
///
/// The method that must be written is [`Factor::linearize`]; write [`Factor::residual`] too where
/// it is much cheaper. To write the residual alone and have it differentiated, see
/// [`AutoDiff`](crate::AutoDiff).
///
/// `None` means that the factor does not exist at these values, such as the pixel of a point behind
/// the camera: see the crate's front page for what the solver makes of it.
pub trait Factor<const R: usize>: Send + Sync + 'static {
    /// The types of its variables, as a tuple: `(Rigid3, Vector3<f64>)`.
    type Vars: Vars;

    /// The residual and its derivatives by each variable's tangent, see [`Linear`].
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
    /// How many variables.
    const COUNT: usize;
    /// Their degrees of freedom.
    const DOFS: &'static [usize];
    /// References to their values.
    type Refs<'a>: Copy;
    /// Their keys.
    type Keys: Copy;
    /// Derivatives of `R` residuals by each of them.
    type Jacobians<const R: usize>: Send;
    #[doc(hidden)]
    type Indices: Copy + AsRef<[u32]> + Send + Sync;
    #[doc(hidden)]
    type Slices<'a>: Copy;

    #[doc(hidden)]
    fn slots(keys: Self::Keys) -> Self::Indices;
    /// The indices of several factors, one after the other.
    #[doc(hidden)]
    fn flat(indices: &[Self::Indices]) -> &[u32];
    /// Numbers of the stores of the variables' types, which may not exist.
    #[doc(hidden)]
    fn stores(values: &ValuesRef<'_>) -> Vec<Option<u16>>;
    #[doc(hidden)]
    fn slices<'a>(values: &ValuesRef<'a>, stores: &[u16]) -> Self::Slices<'a>;
    #[doc(hidden)]
    fn refs<'a>(slices: Self::Slices<'a>, slots: &Self::Indices) -> Self::Refs<'a>;
    /// Asks for their memory.
    #[doc(hidden)]
    fn fetch(slices: Self::Slices<'_>, slots: &Self::Indices);
    /// Writes the Jacobian times `weight` as rows of `stride` numbers, the variables side by side.
    #[doc(hidden)]
    fn write_rows<const R: usize>(
        jacobians: &Self::Jacobians<R>,
        weight: f64,
        rows: &mut [f64],
        stride: usize,
    );
    /// The same for variable number `I` alone.
    #[doc(hidden)]
    fn write_own<const R: usize, const I: usize>(
        jacobians: &Self::Jacobians<R>,
        weight: f64,
        rows: &mut [f64],
        stride: usize,
    );
}

/// Hides the crate's value storage from the public trait.
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

/// Key or keys of a factor's variables: a tuple of [`Key`], or one key where there is one variable.
pub trait IntoKeys<V: Vars> {
    /// As the tuple.
    fn into_keys(self) -> V::Keys;
}

impl<A: Manifold> IntoKeys<(A,)> for Key<A> {
    fn into_keys(self) -> (Key<A>,) {
        (self,)
    }
}

/// Asks for the memory of an item that will be needed soon, where the machine can.
#[inline(always)]
pub(crate) fn fetch<T>(items: &[T], index: usize) {
    // Miri has no memory that could be asked for.
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint, which may point anywhere.
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
            fn fetch(slices: Self::Slices<'_>, slots: &Self::Indices) {
                $(fetch(slices.$i, slots[$i] as usize);)*
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
            fn write_own<const R: usize, const I: usize>(
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
