//! Variables: values on manifolds, stored by type, named by typed keys.

use std::any::{Any, TypeId, type_name};
use std::fmt;
use std::marker::PhantomData;

use rayon::prelude::*;
use tiepoint_geometry::{Block, Manifold};

/// Limit on the degrees of freedom of one variable: free directions are a 64-bit mask.
pub(crate) const MAX_DOF: usize = 64;
/// Limit for eliminated variables. Larger variables should stay in the reduced system.
pub(crate) const MAX_ELIMINATED_DOF: usize = 6;

/// Stores longer than this are moved in parallel. Below, waking a thread costs more than the work.
pub(crate) const PARALLEL_VALUES: usize = 4_000;

/// Marks a variable that does not move, in [`AnyStore::plus_all`].
pub(crate) const FIXED: u32 = u32::MAX;

/// Key of a variable of type `V` in the [`Problem`](crate::Problem) that made it.
pub struct Key<V> {
    pub(crate) slot: u32,
    of: PhantomData<fn() -> V>,
}

impl<V> Key<V> {
    pub(crate) fn new(slot: u32) -> Self {
        Self { slot, of: PhantomData }
    }

    /// Index among the problem's variables of this type, in order of insertion.
    pub fn index(self) -> usize {
        self.slot as usize
    }
}

// Not derived, because `derive` would require `V: Clone` and so on.
impl<V> Clone for Key<V> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<V> Copy for Key<V> {}
impl<V> PartialEq for Key<V> {
    fn eq(&self, other: &Self) -> bool {
        self.slot == other.slot
    }
}
impl<V> Eq for Key<V> {}
impl<V> PartialOrd for Key<V> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<V> Ord for Key<V> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.slot.cmp(&other.slot)
    }
}
impl<V> fmt::Debug for Key<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key<{}>({})", type_name::<V>(), self.slot)
    }
}

/// A key without its type, for lists of variables of several types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnyKey {
    pub(crate) type_id: TypeId,
    pub(crate) type_name: &'static str,
    pub(crate) slot: u32,
}

impl AnyKey {
    /// The key with its type; `None` if it is of another type.
    pub fn typed<V: Manifold>(&self) -> Option<Key<V>> {
        (self.type_id == TypeId::of::<V>()).then(|| Key::new(self.slot))
    }
}

impl<V: Manifold> From<Key<V>> for AnyKey {
    fn from(key: Key<V>) -> Self {
        Self { type_id: TypeId::of::<V>(), type_name: type_name::<V>(), slot: key.slot }
    }
}

/// Position of a kept variable in the elimination order of the reduced system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EliminationOrder {
    /// At a time, such as a frame number: variables that share factors should have nearby times.
    At(u32),
    /// After all others, for a variable that many frames share: intrinsics or rig extrinsics.
    Last,
}

/// Treatment of a variable by the solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Role {
    Kept(EliminationOrder),
    Eliminated,
}

/// A variable without its value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meta {
    pub(crate) role: Role,
    /// Bit i: tangent direction i is free.
    pub(crate) free: u64,
}

/// Mask of all directions of a variable of `dof` dimensions.
pub(crate) fn all_free(dof: usize) -> u64 {
    if dof >= MAX_DOF { u64::MAX } else { (1 << dof) - 1 }
}

/// The values of all variables of one type.
pub(crate) struct Store<V>(pub(crate) Vec<V>);

/// A [`Store`] whose value type is erased.
pub(crate) trait AnyStore: Any + Send + Sync {
    fn value_type(&self) -> (TypeId, &'static str);
    fn dof(&self) -> usize;
    fn len(&self) -> usize;
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
    fn clone_boxed(&self) -> Box<dyn AnyStore>;
    /// `self[i] = base[i].plus(delta[at[i]..][..dof])`, and `base[i]` where `at[i]` is [`FIXED`].
    fn plus_all(&mut self, base: &dyn AnyStore, delta: &[f64], at: &[u32]);
    /// [`AnyStore::plus_all`] for one variable that moves.
    fn plus_one(&mut self, base: &dyn AnyStore, slot: usize, delta: &[f64]);
    /// `self[slot] = base[slot]`.
    fn copy_one(&mut self, base: &dyn AnyStore, slot: usize);
}

fn moved<V: Manifold>(base: &V, delta: &[f64]) -> V {
    let mut tangent = V::Tangent::zeros();
    tangent.as_mut_slice().copy_from_slice(&delta[..V::DOF]);
    base.plus(&tangent)
}

fn typed<V: Manifold>(store: &dyn AnyStore) -> &[V] {
    &store.as_any().downcast_ref::<Store<V>>().expect("stores of equal index have equal type").0
}

impl<V: Manifold> AnyStore for Store<V> {
    fn value_type(&self) -> (TypeId, &'static str) {
        (TypeId::of::<V>(), type_name::<V>())
    }
    fn dof(&self) -> usize {
        V::DOF
    }
    fn len(&self) -> usize {
        self.0.len()
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
    fn clone_boxed(&self) -> Box<dyn AnyStore> {
        Box::new(Store(self.0.clone()))
    }
    fn plus_all(&mut self, base: &dyn AnyStore, delta: &[f64], at: &[u32]) {
        let step = |(value, (base, &at)): (&mut V, (&V, &u32))| {
            *value = if at == FIXED { *base } else { moved(base, &delta[at as usize..]) };
        };
        let base = typed::<V>(base);
        if self.0.len() < PARALLEL_VALUES {
            self.0.iter_mut().zip(base.iter().zip(at)).for_each(step);
        } else {
            self.0
                .par_iter_mut()
                .zip(base.par_iter().zip(at))
                .with_min_len(PARALLEL_VALUES / 8)
                .for_each(step);
        }
    }
    fn plus_one(&mut self, base: &dyn AnyStore, slot: usize, delta: &[f64]) {
        self.0[slot] = moved(&typed::<V>(base)[slot], delta);
    }
    fn copy_one(&mut self, base: &dyn AnyStore, slot: usize) {
        self.0[slot] = typed::<V>(base)[slot];
    }
}

/// The values of all variables.
#[derive(Default)]
pub(crate) struct Values {
    pub(crate) stores: Vec<Box<dyn AnyStore>>,
}

impl Clone for Values {
    fn clone(&self) -> Self {
        Self { stores: self.stores.iter().map(|store| store.clone_boxed()).collect() }
    }
}

impl Values {
    /// Index of the store of a type, if there is one.
    pub(crate) fn find(&self, type_id: TypeId) -> Option<usize> {
        self.stores.iter().position(|store| store.value_type().0 == type_id)
    }

    /// All values of type `V`, given the index of their store.
    pub(crate) fn slice<V: Manifold>(&self, store: u16) -> &[V] {
        typed(&*self.stores[store as usize])
    }

    /// Key of a variable, given the index of its store.
    pub(crate) fn key(&self, store: usize, slot: usize) -> AnyKey {
        let (type_id, type_name) = self.stores[store].value_type();
        AnyKey { type_id, type_name, slot: slot as u32 }
    }

    /// All values of two types; `None` if one of them has no store, or they are the same type.
    pub(crate) fn two_mut<A: Manifold, B: Manifold>(&mut self) -> Option<(&mut [A], &mut [B])> {
        let stores = [self.find(TypeId::of::<A>())?, self.find(TypeId::of::<B>())?];
        let [a, b] = self.stores.get_disjoint_mut(stores).ok()?;
        let a = a.as_any_mut().downcast_mut::<Store<A>>()?;
        let b = b.as_any_mut().downcast_mut::<Store<B>>()?;
        Some((&mut a.0, &mut b.0))
    }

    pub(crate) fn store_mut<V: Manifold>(&mut self) -> (usize, &mut Vec<V>) {
        let index = self.find(TypeId::of::<V>()).unwrap_or_else(|| {
            self.stores.push(Box::new(Store::<V>(Vec::new())));
            self.stores.len() - 1
        });
        let store = self.stores[index].as_any_mut().downcast_mut::<Store<V>>();
        (index, &mut store.expect("found by its type").0)
    }
}
