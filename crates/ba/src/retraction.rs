//! Retractions: how a step moves the variables.

use std::any::TypeId;

use tiepoint_geometry::Manifold;

use crate::variable::{AnyKey, FIXED, Values};

/// Moves the variables by a step, in place of x ⊞ δ for each of them. It has to agree with x ⊞ δ to
/// first order, because the linear system is that of x ⊞ δ.
pub trait Retraction: Send + Sync {
    /// Moves all variables. `retracted` holds x ⊞ δ of each variable; fixed ones keep
    /// their values.
    fn retract(&self, step: &Step<'_>, retracted: &mut RetractedValues<'_>);

    /// Moves one variable by `tangent` instead of its part of the step. `retracted` holds
    /// x ⊞ `tangent` of this variable, and the results of [`Retraction::retract`] of the others.
    fn retract_one(
        &self,
        step: &Step<'_>,
        key: AnyKey,
        tangent: &[f64],
        retracted: &mut RetractedValues<'_>,
    );
}

/// A step of all variables, and the values before it.
#[derive(Clone, Copy)]
pub struct Step<'a> {
    pub(crate) values: &'a Values,
    pub(crate) tangents: &'a [f64],
    /// For each store, the offsets of its variables in `tangents`.
    pub(crate) offsets: &'a [Vec<u32>],
}

/// The step of the variables of one type, which are indexed as in
/// [`Key::index`](crate::Key::index).
#[derive(Clone, Copy)]
pub struct TypedStep<'a, V> {
    values: &'a [V],
    tangents: &'a [f64],
    offsets: &'a [u32],
}

/// The values after a step.
pub struct RetractedValues<'a>(&'a mut Values);

impl<'a> Step<'a> {
    /// The step of the variables of type `V`; `None` if there are none.
    pub fn of<V: Manifold>(&self) -> Option<TypedStep<'a, V>> {
        let store = self.values.find(TypeId::of::<V>())?;
        Some(TypedStep {
            values: self.values.slice(store as u16),
            tangents: self.tangents,
            offsets: &self.offsets[store],
        })
    }

    /// Moves all variables to `to`.
    pub(crate) fn take(&self, retraction: Option<&dyn Retraction>, to: &mut Values) {
        for ((to, from), offsets) in to.stores.iter_mut().zip(&self.values.stores).zip(self.offsets)
        {
            to.plus_all(&**from, self.tangents, offsets);
        }
        if let Some(retraction) = retraction {
            retraction.retract(self, &mut RetractedValues(to));
        }
    }

    /// Moves one variable to `to` by `tangent` instead of its part of the step.
    pub(crate) fn take_one(
        &self,
        retraction: Option<&dyn Retraction>,
        (store, slot): (usize, usize),
        tangent: &[f64],
        to: &mut Values,
    ) {
        to.stores[store].plus_one(&*self.values.stores[store], slot, tangent);
        if let Some(retraction) = retraction {
            retraction.retract_one(
                self,
                self.values.key(store, slot),
                tangent,
                &mut RetractedValues(to),
            );
        }
    }
}

impl<'a, V: Manifold> TypedStep<'a, V> {
    /// The values before the step.
    pub fn values(&self) -> &'a [V] {
        self.values
    }

    /// Tangent of one variable, of `V::DOF` tangents; `None` if it is fixed.
    pub fn tangent(&self, index: usize) -> Option<&'a [f64]> {
        let offset = self.offsets[index];
        (offset != FIXED).then(|| &self.tangents[offset as usize..][..V::DOF])
    }
}

impl RetractedValues<'_> {
    /// The values of two types; `None` if one of them has none, or they are the same type.
    pub fn two_mut<A: Manifold, B: Manifold>(&mut self) -> Option<(&mut [A], &mut [B])> {
        self.0.two_mut()
    }
}
