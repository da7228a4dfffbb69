//! A problem: variables with their values, and factors between them.

use std::any::{TypeId, type_name};

use nalgebra::SVector;
use tiepoint_geometry::{Loss, Manifold};

use crate::error::Error;
use crate::factor::{Factor, IntoKeys, ValuesRef, Vars};
use crate::factor_group::{AnyFactorGroup, FactorGroup};
use crate::retraction::Retraction;
use crate::variable::{
    AnyKey, EliminationOrder, Key, MAX_DOF, MAX_ELIMINATED_DOF, Meta, Role, Values, all_free,
};

/// A nonlinear least-squares problem: variables on manifolds and factors between them, which
/// minimises Σ ½ ρ(|r|²).
#[derive(Default)]
pub struct Problem {
    pub(crate) values: Values,
    /// Role and free directions of each variable, in the order of `values`.
    pub(crate) metas: Vec<Vec<Meta>>,
    pub(crate) factor_groups: Vec<Box<dyn AnyFactorGroup>>,
    /// Incremented by every change that invalidates a solver's structure.
    pub(crate) revision: u64,
    /// Retraction of all variables, if they do not move independently.
    pub(crate) retraction: Option<Box<dyn Retraction>>,
}

/// Key of a factor in the [`Problem`] that [`Problem::add`] added it to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FactorKey {
    /// Index of its type, in the order of their first factors.
    pub(crate) group: u32,
    /// Index among the factors of this type.
    pub(crate) index: u32,
}

/// Cost of all factors at the current values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Σ ½ ρ(|r|²) over the valid factors; infinite if a residual is not finite.
    pub total: f64,
    /// Number of factors that are invalid at these values (points behind cameras).
    pub missing: usize,
}

impl Problem {
    /// A problem without variables and factors.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a variable that stays in the reduced system. `order` is its place in the elimination
    /// order.
    pub fn add_parameter<V: Manifold>(&mut self, value: V, order: EliminationOrder) -> Key<V> {
        self.insert(value, Role::Kept(order))
    }

    /// Adds a variable that is eliminated from the linear system before it is solved (Schur
    /// complement), such as a point. No factor may join two of them. At most 6 degrees of freedom.
    pub fn add_landmark<V: Manifold>(&mut self, value: V) -> Key<V> {
        const { assert!(V::DOF <= MAX_ELIMINATED_DOF, "too many degrees of freedom to eliminate") };
        self.insert(value, Role::Eliminated)
    }

    fn insert<V: Manifold>(&mut self, value: V, role: Role) -> Key<V> {
        const {
            assert!(
                V::DOF >= 1 && V::DOF <= MAX_DOF,
                "a variable has 1 to 64 degrees of \
        freedom"
            )
        };
        let (store, values) = self.values.store_mut::<V>();
        let slot = values.len() as u32;
        values.push(value);
        if store == self.metas.len() {
            self.metas.push(Vec::new());
        }
        self.metas[store].push(Meta { role, free: all_free(V::DOF) });
        self.revision += 1;
        Key::new(slot)
    }

    /// Adds a factor between the variables `keys`. Its cost is ½ ρ(|r|²) with the loss ρ. Returns
    /// its key.
    ///
    /// # Errors
    /// [`Error::LossScale`] if the loss has no positive scale, [`Error::UnknownKey`] if the problem
    /// does not have a variable, [`Error::RepeatedVariable`] if two of the keys are the same.
    pub fn add<const R: usize, F: Factor<R>>(
        &mut self,
        keys: impl IntoKeys<F::Vars>,
        factor: F,
        loss: Loss,
    ) -> Result<FactorKey, Error> {
        check_loss::<F>(&loss)?;
        let slots = F::Vars::slots(keys.into_keys());
        let group_index = match self
            .factor_groups
            .iter()
            .position(|group| group.as_any().is::<FactorGroup<F, R>>())
        {
            Some(index) => index,
            None => {
                let mut stores = Vec::with_capacity(F::Vars::COUNT);
                for (position, store) in
                    F::Vars::stores(&ValuesRef(&self.values)).into_iter().enumerate()
                {
                    let slot = slots.as_ref()[position];
                    let unknown =
                        Error::UnknownKey { factor: type_name::<F>(), position, slot, len: 0 };
                    stores.push(store.ok_or(unknown)?);
                }
                self.factor_groups.push(Box::new(FactorGroup::<F, R>::new(stores)));
                self.factor_groups.len() - 1
            }
        };
        let group = self.factor_groups[group_index]
            .as_any_mut()
            .downcast_mut::<FactorGroup<F, R>>()
            .expect("found by its type");
        check_slots::<F>(&self.metas, group.stores(), slots.as_ref())?;
        let key = FactorKey { group: group_index as u32, index: group.len() as u32 };
        group.push(slots, factor, loss);
        self.revision += 1;
        Ok(key)
    }

    /// Sets the retraction that all following solves use.
    pub fn set_retraction(&mut self, retraction: impl Retraction + 'static) {
        self.retraction = Some(Box::new(retraction));
    }

    /// Holds a variable constant. A key that the problem does not have is ignored.
    pub fn fix<V: Manifold>(&mut self, key: Key<V>) {
        self.set_free(key, 0);
    }

    /// Makes all directions of a variable free again.
    pub fn free<V: Manifold>(&mut self, key: Key<V>) {
        self.set_free(key, all_free(V::DOF));
    }

    /// Holds the listed tangent directions of a variable constant, in addition to those already
    /// fixed. For a pose (δ, τ), fixing all three of τ fixes its centre; a single one of τ is a
    /// direction that rotates with the camera (see CONVENTIONS.md of `tiepoint-geometry`).
    ///
    /// # Errors
    /// [`Error::UnknownVariable`] if the problem does not have the variable,
    /// [`Error::TangentIndex`] if it has fewer degrees of freedom.
    pub fn fix_dofs<V: Manifold>(&mut self, key: Key<V>, indices: &[usize]) -> Result<(), Error> {
        let mut free = self.meta(key)?.free;
        for &index in indices {
            if index >= V::DOF {
                return Err(Error::TangentIndex { variable: type_name::<V>(), index, dof: V::DOF });
            }
            free &= !(1 << index);
        }
        self.set_free(key, free);
        Ok(())
    }

    fn set_free<V: Manifold>(&mut self, key: Key<V>, free: u64) {
        let store = self.values.find(TypeId::of::<V>());
        if let Some(meta) = store.and_then(|store| self.metas[store].get_mut(key.slot as usize)) {
            meta.free = free;
            self.revision += 1;
        }
    }

    fn meta<V: Manifold>(&self, key: Key<V>) -> Result<Meta, Error> {
        let (store, slot) = self.locate(&key.into())?;
        Ok(self.metas[store][slot])
    }

    /// Index of its store and slot in the store.
    pub(crate) fn locate(&self, key: &AnyKey) -> Result<(usize, usize), Error> {
        let store = self.values.find(key.type_id);
        let len = store.map_or(0, |store| self.metas[store].len());
        match store {
            Some(store) if (key.slot as usize) < len => Ok((store, key.slot as usize)),
            _ => Err(Error::UnknownVariable { variable: key.type_name, slot: key.slot, len }),
        }
    }

    /// The value of a variable.
    ///
    /// # Panics
    /// If the key belongs to another problem and this one has no variable in its slot.
    pub fn get<V: Manifold>(&self, key: Key<V>) -> V {
        let store = self
            .values
            .find(TypeId::of::<V>())
            .expect("a key names a variable of the problem that made it");
        self.values.slice::<V>(store as u16)[key.slot as usize]
    }

    /// Sets the value of a variable. A key that the problem does not have is ignored.
    pub fn set<V: Manifold>(&mut self, key: Key<V>, value: V) {
        if self.meta(key).is_ok() {
            self.values.store_mut::<V>().1[key.slot as usize] = value;
        }
    }

    /// Number of factors.
    pub fn num_factors(&self) -> usize {
        self.factor_groups.iter().map(|group| group.len()).sum()
    }

    /// Number of variables.
    pub fn num_variables(&self) -> usize {
        self.metas.iter().map(Vec::len).sum()
    }

    /// Number of residuals: rows of the Jacobian.
    pub fn num_residuals(&self) -> usize {
        self.factor_groups.iter().map(|group| group.len() * group.rows()).sum()
    }

    /// The cost at the current values.
    pub fn cost(&self) -> Cost {
        let mut cost = Cost { total: 0.0, missing: 0 };
        for group in &self.factor_groups {
            let factors: Vec<u32> = (0..group.len() as u32).collect();
            let mut costs = vec![0.0; factors.len()];
            group.costs(&self.values, &factors, &mut costs);
            for value in costs {
                if value.is_nan() {
                    cost.missing += 1;
                } else {
                    cost.total += value;
                }
            }
        }
        cost
    }

    /// The residuals of all factors of type `F` at the current values, in order of insertion;
    /// `None` for an invalid factor.
    pub fn residuals<const R: usize, F: Factor<R>>(&self) -> Vec<Option<SVector<f64, R>>> {
        let group = self
            .factor_groups
            .iter()
            .find_map(|group| group.as_any().downcast_ref::<FactorGroup<F, R>>());
        group.map_or_else(Vec::new, |group| group.residuals(&self.values))
    }
}

fn check_loss<F>(loss: &Loss) -> Result<(), Error> {
    let scale = match *loss {
        Loss::Trivial => 1.0,
        Loss::Huber(a)
        | Loss::SoftL1(a)
        | Loss::Cauchy(a)
        | Loss::GemanMcClure(a)
        | Loss::Tukey(a)
        | Loss::Truncated(a) => a,
    };
    if scale > 0.0 && scale.is_finite() {
        Ok(())
    } else {
        Err(Error::LossScale { factor: type_name::<F>(), loss: format!("{loss:?}") })
    }
}

fn check_slots<F>(metas: &[Vec<Meta>], stores: &[u16], slots: &[u32]) -> Result<(), Error> {
    for (position, (&store, &slot)) in stores.iter().zip(slots).enumerate() {
        let len = metas[store as usize].len();
        if slot as usize >= len {
            return Err(Error::UnknownKey { factor: type_name::<F>(), position, slot, len });
        }
        if let Some(first) = (0..position).find(|&i| stores[i] == store && slots[i] == slot) {
            return Err(Error::RepeatedVariable {
                factor: type_name::<F>(),
                first,
                second: position,
            });
        }
    }
    Ok(())
}
