//! Mountings in an adjustment: as variables with their clocks, as terms or as rigid poses.

use std::collections::BTreeMap;

use tiepoint_ba::factors::Prior;
use tiepoint_ba::{Key, Order, Problem, Summary};
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Loss, Rigid3};
use tiepoint_rig::{Clock, Mounted, MountedInTime};
use tiepoint_scene::{ImageId, Reconstruction};

use super::companion::{Left, Timing};
use super::mounting::{Hold, Mounting};
use crate::Error;
use crate::adjust::{AdjustOptions, Scope, Term, TermContext, Variables, adjust, keep_going};

/// What is believed of a clock's offset beside what was found by motion, and of its drift (quartz: tens of parts per million).
const CLOCK_SIGMA_S: f64 = 1.0;
const DRIFT_SIGMA: f64 = 5e-5;

/// What is believed of the rotation of a mounting between cameras that see nothing in common; of the centre it is the unit.
const UNSEEN_SIGMA_RAD: f64 = 1.0;
/// How firmly a place that the motion does not tell stays at zero, as a share of what is believed of it.
const BLIND_SIGMA: f64 = 1e-3;

/// Adjusts everything with cameras held to mountings, which are adjusted with it: calibration and clock.
pub(super) fn adjust_mounted(
    model: &mut Reconstruction,
    options: &AdjustOptions,
    mountings: &mut [Mounting],
) -> Result<Summary, Error> {
    adjust(model, &Scope::Global, options, &mut [&mut MountingTerm::new(mountings)], &mut keep_going)
}

/// Mountings as a term of an adjustment; what comes out for them is written back.
pub(super) struct MountingTerm<'a> {
    mountings: &'a mut [Mounting],
    /// Calibration and clock of each mounting.
    pub(super) keys: Vec<(Key<Rigid3>, Option<Key<Clock>>)>,
    /// Images that take their pose from another's: by which mounting, and whose.
    rigid: BTreeMap<ImageId, (usize, ImageId)>,
}

impl<'a> MountingTerm<'a> {
    pub(super) fn new(mountings: &'a mut [Mounting]) -> Self {
        Self { mountings, keys: Vec::new(), rigid: BTreeMap::new() }
    }
}

impl Term for MountingTerm<'_> {
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        self.rigid = rigid_pairs(self.mountings, posed);
        self.rigid.keys().copied().collect()
    }

    /// Adds the mountings as variables, soft ones with a term for each moment; what is believed of them is weighed against the noise.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let TermContext { model, noise, .. } = *context;
        let keys: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        let key = |image: &ImageId| keys.get(image).copied();
        for (index, mounting) in self.mountings.iter().enumerate() {
            let mount = variables.problem_mut().keep(mounting.right_from_left, Order::Shared);
            let moves = mounting.moments.iter().any(|m| matches!(m.left, Left::Between { .. }));
            let clock = moves.then(|| variables.problem_mut().keep(mounting.companion.clock, Order::Shared));
            if let Some(clock) = clock {
                match mounting.companion.timing {
                    Timing::Free => {
                        let sigmas = [CLOCK_SIGMA_S, DRIFT_SIGMA].map(|sigma| sigma / noise);
                        let stamps = Clock { drift: 0.0, ..mounting.companion.clock };
                        variables.problem_mut().add(clock, Prior::new(stamps, &sigmas)?, Loss::Trivial)?;
                    }
                    Timing::Together | Timing::NotObservable => variables.problem_mut().fix(clock),
                }
            }
            if let Some(unit) = mounting.companion.unit {
                variables.problem_mut().add(mount, belief(mounting, unit, noise)?, Loss::Trivial)?;
            }
            self.keys.push((mount, clock));
            for moment in &mounting.moments {
                let right = key(&moment.right);
                match (mounting.hold, moment.left, clock) {
                    (Hold::Rigid, Left::At(left), _) => {
                        if let (Some(left), Some(&(by, _))) = (key(&left), self.rigid.get(&moment.right))
                            && by == index
                        {
                            variables.compose_pose(moment.right, mount, left);
                        }
                    }
                    (Hold::Soft { sigma_translation, sigma_rotation_rad }, Left::At(left), _) => {
                        let (Some(left), Some(right)) = (key(&left), right) else { continue };
                        let factor =
                            Mounted { sigma_translation, sigma_rotation_rad, unit: mounting.companion.unit };
                        variables.problem_mut().add((left, right, mount), factor, Loss::Trivial)?;
                    }
                    (
                        Hold::Soft { sigma_translation, sigma_rotation_rad },
                        Left::Between { images, times_s, right_time_s, .. },
                        Some(clock),
                    ) => {
                        let [a, b, c, d] = images.each_ref().map(key);
                        let (Some(a), Some(b), Some(c), Some(d), Some(right)) = (a, b, c, d, right) else {
                            continue;
                        };
                        let mounted =
                            Mounted { sigma_translation, sigma_rotation_rad, unit: mounting.companion.unit };
                        let Some(left) = moment.left_from_world(model, &mounting.companion.clock) else {
                            continue;
                        };
                        let whitening = moment.whitening(&mounted, &left, &mounting.right_from_left);
                        let factor =
                            MountedInTime { mounted, left_times_s: times_s, right_time_s, whitening };
                        variables.problem_mut().add(
                            (a, b, c, d, right, mount, clock),
                            factor,
                            Loss::Trivial,
                        )?;
                    }
                    // Images of different instants are never rigid.
                    (_, Left::Between { .. }, _) => {}
                }
            }
        }
        Ok(())
    }

    fn read(&mut self, problem: &Problem) {
        for (mounting, (mount, clock)) in self.mountings.iter_mut().zip(&self.keys) {
            mounting.right_from_left = problem.get(*mount);
            if let Some(clock) = clock {
                mounting.companion.clock = problem.get(*clock);
            }
        }
    }
}

/// What is believed of a camera that sees nothing in common with the first one: its rotation is as it comes, its centre near the other's, and at zero
/// where the motion does not tell it.
fn belief(mounting: &Mounting, unit: f64, noise: f64) -> Result<Prior<Rigid3, 6>, Error> {
    let sigmas: [f64; 6] = std::array::from_fn(|k| if k < 3 { UNSEEN_SIGMA_RAD } else { unit } / noise);
    let rotation = mounting.right_from_left.rotation;
    let mut prior = Prior::new(Rigid3::new(rotation, Vector3::zeros()), &sigmas)?;
    if let Some(blind) = mounting.companion.blind {
        let along = rotation * blind;
        let firmer = Matrix3::identity() + along * along.transpose() * (1.0 / BLIND_SIGMA - 1.0);
        let of_place = prior.sqrt_information.fixed_view::<3, 3>(3, 3) * firmer;
        prior.sqrt_information.fixed_view_mut::<3, 3>(3, 3).copy_from(&of_place);
    }
    Ok(prior)
}

/// Images that take their pose from another's: by which mounting, and whose.
fn rigid_pairs(mountings: &[Mounting], posed: &[ImageId]) -> BTreeMap<ImageId, (usize, ImageId)> {
    let mut rigid = BTreeMap::new();
    for (index, mounting) in mountings.iter().enumerate().filter(|(_, m)| m.hold == Hold::Rigid) {
        for moment in &mounting.moments {
            let Left::At(left) = moment.left else { continue };
            if posed.binary_search(&left).is_ok() && posed.binary_search(&moment.right).is_ok() {
                rigid.insert(moment.right, (index, left));
            }
        }
    }
    rigid
}
