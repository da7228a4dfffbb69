//! Variables: values on manifolds, stored by type, named by typed keys.

use std::any::{Any, TypeId, type_name};
use std::fmt;
use std::marker::PhantomData;

use rayon::prelude::*;
use tiepoint_geometry::{Block, Manifold};

/// Degrees of freedom of one variable: the set of free directions is a 64-bit mask.
pub(crate) const MAX_DOF: usize = 64;
/// Largest variable that can be eliminated: beyond, the reduced system is the better place.
pub(crate) const MAX_ELIMINATED_DOF: usize = 6;

/// Stores longer than this are moved in parallel: below, waking a thread costs more than the work.
pub(crate) const PARALLEL_VALUES: usize = 4_000;

/// In [`AnyStore::plus_all`]: this variable does not move.
pub(crate) const FIXED: u32 = u32::MAX;

/// The name of one variable of type `V` in the [`Problem`](crate::Problem) that made it.
pub struct Key<V> {
    pub(crate) slot: u32,
    of: PhantomData<fn() -> V>,
}

impl<V> Key<V> {
    pub(crate) fn new(slot: u32) -> Self {
        Self { slot, of: PhantomData }
    }

    /// Which of the problem's variables of this type, in the order of insertion.
    pub fn index(self) -> usize {
        self.slot as usize
    }
}

// Written out because `derive` would ask for `V: Clone` and so on.
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

/// A key that has forgotten its type, for lists of variables of several types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnyKey {
    pub(crate) type_id: TypeId,
    pub(crate) type_name: &'static str,
    pub(crate) slot: u32,
}

impl AnyKey {
    /// The key with its type; `None` where it is another one.
    pub fn typed<V: Manifold>(&self) -> Option<Key<V>> {
        (self.type_id == TypeId::of::<V>()).then(|| Key::new(self.slot))
    }
}

impl<V: Manifold> From<Key<V>> for AnyKey {
    fn from(key: Key<V>) -> Self {
        Self { type_id: TypeId::of::<V>(), type_name: type_name::<V>(), slot: key.slot }
    }
}

/// Where a kept variable stands in the order in which the reduced system is factorised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Order {
    /// With the others of this moment, say a frame number: variables that share factors should be
    /// near in time.
    At(u32),
    /// Last: a variable that many moments share, such as the intrinsics of a camera or the
    /// calibration of a rig.
    Shared,
}

/// What the solver does with a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Role {
    Kept(Order),
    Eliminated,
}

/// A variable without its value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meta {
    pub(crate) role: Role,
    /// Bit i: tangent direction i is free.
    pub(crate) free: u64,
}

/// All directions of a variable of `dof` dimensions.
pub(crate) fn all_free(dof: usize) -> u64 {
    if dof >= MAX_DOF { u64::MAX } else { (1 << dof) - 1 }
}

/// The values of all variables of one type.
pub(crate) struct Store<V>(pub(crate) Vec<V>);

/// A [`Store`] whose type is not known.
pub(crate) trait AnyStore: Any + Send + Sync {
    fn value_type(&self) -> (TypeId, &'static str);
    fn dof(&self) -> usize;
    fn len(&self) -> usize;
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
    fn clone_boxed(&self) -> Box<dyn AnyStore>;
    /// `self[i] = base[i].plus(delta[at[i]..][..dof])`, and `base[i]` where `at[i]` is [`FIXED`].
    fn plus_all(&mut self, base: &dyn AnyStore, delta: &[f64], at: &[u32]);
    /// The same for one variable that moves.
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
    /// Number of the store of type `V`, if there is one.
    pub(crate) fn find(&self, type_id: TypeId) -> Option<usize> {
        self.stores.iter().position(|store| store.value_type().0 == type_id)
    }

    /// All values of type `V`, given the number of their store.
    pub(crate) fn slice<V: Manifold>(&self, store: u16) -> &[V] {
        typed(&*self.stores[store as usize])
    }

    /// The key of a variable, given the number of its store.
    pub(crate) fn key(&self, store: usize, slot: usize) -> AnyKey {
        let (type_id, type_name) = self.stores[store].value_type();
        AnyKey { type_id, type_name, slot: slot as u32 }
    }

    /// All values of two types; `None` where one of them has no store, or they are the same.
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
