//! How a step moves the variables: each by itself along its tangent, and then as a [`Retraction`]
//! has it.

use std::any::TypeId;

use tiepoint_geometry::Manifold;

use crate::variable::{AnyKey, FIXED, Values};

/// Moves variables by a step otherwise than each by itself. To first order it has to be the same
/// step, since the linear system that the step solves knows of no other.
pub trait Retraction: Send + Sync {
    /// Moves all variables. In `moved` each has been moved by itself; those that are fixed are
    /// where they were.
    fn retract(&self, step: &Step<'_>, moved: &mut Moved<'_>);

    /// Moves one variable by `tangent` in place of its part of the step. In `moved` it has been
    /// moved by itself, and all others are where [`Retraction::retract`] has left them.
    fn retract_one(&self, step: &Step<'_>, key: AnyKey, tangent: &[f64], moved: &mut Moved<'_>);
}

/// A step of all variables, and the values that it starts from.
#[derive(Clone, Copy)]
pub struct Step<'a> {
    pub(crate) values: &'a Values,
    pub(crate) numbers: &'a [f64],
    /// For each store, where in `numbers` its variables are.
    pub(crate) at: &'a [Vec<u32>],
}

/// The part of a step that belongs to the variables of one type, which are numbered as
/// [`Key::index`](crate::Key::index) does.
#[derive(Clone, Copy)]
pub struct StepOf<'a, V> {
    values: &'a [V],
    numbers: &'a [f64],
    at: &'a [u32],
}

/// The values that a step leads to.
pub struct Moved<'a>(&'a mut Values);

impl<'a> Step<'a> {
    /// That of the variables of type `V`; `None` where there are none.
    pub fn of<V: Manifold>(&self) -> Option<StepOf<'a, V>> {
        let store = self.values.find(TypeId::of::<V>())?;
        Some(StepOf {
            values: self.values.slice(store as u16),
            numbers: self.numbers,
            at: &self.at[store],
        })
    }

    /// Moves everything from the values to `to`.
    pub(crate) fn take(&self, retraction: Option<&dyn Retraction>, to: &mut Values) {
        for ((to, from), at) in to.stores.iter_mut().zip(&self.values.stores).zip(self.at) {
            to.plus_all(&**from, self.numbers, at);
        }
        if let Some(retraction) = retraction {
            retraction.retract(self, &mut Moved(to));
        }
    }

    /// Moves one variable to `to` by another tangent than its part of the step.
    pub(crate) fn take_one(
        &self,
        retraction: Option<&dyn Retraction>,
        (store, slot): (usize, usize),
        tangent: &[f64],
        to: &mut Values,
    ) {
        to.stores[store].plus_one(&*self.values.stores[store], slot, tangent);
        if let Some(retraction) = retraction {
            retraction.retract_one(self, self.values.key(store, slot), tangent, &mut Moved(to));
        }
    }
}

impl<'a, V: Manifold> StepOf<'a, V> {
    /// Where the step starts from.
    pub fn values(&self) -> &'a [V] {
        self.values
    }

    /// The tangent by which a variable moves; `None` where it is fixed.
    pub fn tangent(&self, index: usize) -> Option<&'a [f64]> {
        let at = self.at[index];
        (at != FIXED).then(|| &self.numbers[at as usize..][..V::DOF])
    }
}

impl Moved<'_> {
    /// The values of two types; `None` where one of them has none, or they are the same.
    pub fn two_mut<A: Manifold, B: Manifold>(&mut self) -> Option<(&mut [A], &mut [B])> {
        self.0.two_mut()
    }
}
