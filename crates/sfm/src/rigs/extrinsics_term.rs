//! Mountings in an adjustment: as variables with their clocks, as terms or as rigid poses.

use std::collections::BTreeMap;

use tiepoint_ba::factors::Prior;
use tiepoint_ba::{Key, Order, Problem, Summary};
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Loss, Rigid3};
use tiepoint_rig::{Clock, InterpolatedExtrinsics, SynchronousExtrinsics};
use tiepoint_scene::{ImageId, Reconstruction};

use super::extrinsics::{RigConstraint, RigExtrinsics};
use super::rig_sensor::{ClockState, ReferencePose};
use crate::Error;
use crate::adjust::{AdjustOptions, Scope, Term, TermContext, Variables, adjust, keep_going};

/// What is believed of a clock's offset beside what was found by motion, and of its drift (quartz:
/// tens of parts per million).
const CLOCK_SIGMA_S: f64 = 1.0;
const DRIFT_SIGMA: f64 = 5e-5;

/// What is believed of the rotation of a mounting between cameras that see nothing in common; of
/// the centre it is the unit.
const UNSEEN_SIGMA_RAD: f64 = 1.0;
/// How firmly a place that the motion does not tell stays at zero, as a share of what is believed
/// of it.
const BLIND_SIGMA: f64 = 1e-3;

/// Adjusts everything with cameras held to mountings, which are adjusted with it: calibration and
/// clock.
pub(super) fn adjust_with_extrinsics(
    model: &mut Reconstruction,
    options: &AdjustOptions,
    all_extrinsics: &mut [RigExtrinsics],
) -> Result<Summary, Error> {
    adjust(
        model,
        &Scope::Global,
        options,
        &mut [&mut ExtrinsicsTerm::new(all_extrinsics)],
        &mut keep_going,
    )
}

/// Mountings as a term of an adjustment; what comes out for them is written back.
pub(super) struct ExtrinsicsTerm<'a> {
    all_extrinsics: &'a mut [RigExtrinsics],
    /// Calibration and clock of each mounting.
    pub(super) keys: Vec<(Key<Rigid3>, Option<Key<Clock>>)>,
    /// Images that take their pose from another's: by which mounting, and whose.
    rigid: BTreeMap<ImageId, (usize, ImageId)>,
}

impl<'a> ExtrinsicsTerm<'a> {
    pub(super) fn new(all_extrinsics: &'a mut [RigExtrinsics]) -> Self {
        Self { all_extrinsics, keys: Vec::new(), rigid: BTreeMap::new() }
    }
}

impl Term for ExtrinsicsTerm<'_> {
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        self.rigid = rigid_pairs(self.all_extrinsics, posed);
        self.rigid.keys().copied().collect()
    }

    /// Adds the mountings as variables, soft ones with a term for each moment; what is believed of
    /// them is weighed against the noise.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let TermContext { model, noise, .. } = *context;
        let keys: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        let key = |image: &ImageId| keys.get(image).copied();
        for (index, extrinsics) in self.all_extrinsics.iter().enumerate() {
            let mount =
                variables.problem_mut().add_parameter(extrinsics.right_from_left, Order::Shared);
            let moves = extrinsics
                .referenced_images
                .iter()
                .any(|m| matches!(m.reference, ReferencePose::Interpolated { .. }));
            let clock = moves.then(|| {
                variables.problem_mut().add_parameter(extrinsics.rig_sensor.clock, Order::Shared)
            });
            if let Some(clock) = clock {
                match extrinsics.rig_sensor.clock_state {
                    ClockState::Estimated => {
                        let sigmas = [CLOCK_SIGMA_S, DRIFT_SIGMA].map(|sigma| sigma / noise);
                        let stamps = Clock { drift: 0.0, ..extrinsics.rig_sensor.clock };
                        variables.problem_mut().add(
                            clock,
                            Prior::new(stamps, &sigmas)?,
                            Loss::Trivial,
                        )?;
                    }
                    ClockState::Synchronised | ClockState::Unobservable => {
                        variables.problem_mut().fix(clock)
                    }
                }
            }
            if let Some(assumed_baseline) = extrinsics.rig_sensor.assumed_baseline {
                variables.problem_mut().add(
                    mount,
                    belief(extrinsics, assumed_baseline, noise)?,
                    Loss::Trivial,
                )?;
            }
            self.keys.push((mount, clock));
            for referenced in &extrinsics.referenced_images {
                let right = key(&referenced.right);
                match (extrinsics.constraint, referenced.reference, clock) {
                    (RigConstraint::Rigid, ReferencePose::Synchronous(left), _) => {
                        if let (Some(left), Some(&(by, _))) =
                            (key(&left), self.rigid.get(&referenced.right))
                            && by == index
                        {
                            variables.compose_pose(referenced.right, mount, left);
                        }
                    }
                    (
                        RigConstraint::Soft { sigma_translation, sigma_rotation_rad },
                        ReferencePose::Synchronous(left),
                        _,
                    ) => {
                        let (Some(left), Some(right)) = (key(&left), right) else { continue };
                        let factor = SynchronousExtrinsics {
                            sigma_translation,
                            sigma_rotation_rad,
                            assumed_baseline: extrinsics.rig_sensor.assumed_baseline,
                        };
                        variables.problem_mut().add((left, right, mount), factor, Loss::Trivial)?;
                    }
                    (
                        RigConstraint::Soft { sigma_translation, sigma_rotation_rad },
                        ReferencePose::Interpolated { images, times_s, right_time_s, .. },
                        Some(clock),
                    ) => {
                        let [a, b, c, d] = images.each_ref().map(key);
                        let (Some(a), Some(b), Some(c), Some(d), Some(right)) = (a, b, c, d, right)
                        else {
                            continue;
                        };
                        let mounted = SynchronousExtrinsics {
                            sigma_translation,
                            sigma_rotation_rad,
                            assumed_baseline: extrinsics.rig_sensor.assumed_baseline,
                        };
                        let Some(left) =
                            referenced.left_from_world(model, &extrinsics.rig_sensor.clock)
                        else {
                            continue;
                        };
                        let whitening =
                            referenced.whitening(&mounted, &left, &extrinsics.right_from_left);
                        let factor = InterpolatedExtrinsics {
                            extrinsics: mounted,
                            left_times_s: times_s,
                            right_time_s,
                            whitening,
                        };
                        variables.problem_mut().add(
                            (a, b, c, d, right, mount, clock),
                            factor,
                            Loss::Trivial,
                        )?;
                    }
                    // Images of different instants are never rigid.
                    (_, ReferencePose::Interpolated { .. }, _) => {}
                }
            }
        }
        Ok(())
    }

    fn read(&mut self, problem: &Problem) {
        for (extrinsics, (mount, clock)) in self.all_extrinsics.iter_mut().zip(&self.keys) {
            extrinsics.right_from_left = problem.get(*mount);
            if let Some(clock) = clock {
                extrinsics.rig_sensor.clock = problem.get(*clock);
            }
        }
    }
}

/// What is believed of a camera that sees nothing in common with the first one: its rotation is as
/// it comes, its centre near the other's, and at zero where the motion does not tell it.
fn belief(
    extrinsics: &RigExtrinsics,
    assumed_baseline: f64,
    noise: f64,
) -> Result<Prior<Rigid3, 6>, Error> {
    let sigmas: [f64; 6] =
        std::array::from_fn(|k| if k < 3 { UNSEEN_SIGMA_RAD } else { assumed_baseline } / noise);
    let rotation = extrinsics.right_from_left.rotation;
    let mut prior = Prior::new(Rigid3::new(rotation, Vector3::zeros()), &sigmas)?;
    if let Some(unobservable_direction) = extrinsics.rig_sensor.unobservable_direction {
        let along = rotation * unobservable_direction;
        let firmer = Matrix3::identity() + along * along.transpose() * (1.0 / BLIND_SIGMA - 1.0);
        let of_place = prior.sqrt_information.fixed_view::<3, 3>(3, 3) * firmer;
        prior.sqrt_information.fixed_view_mut::<3, 3>(3, 3).copy_from(&of_place);
    }
    Ok(prior)
}

/// Images that take their pose from another's: by which mounting, and whose.
fn rigid_pairs(
    all_extrinsics: &[RigExtrinsics],
    posed: &[ImageId],
) -> BTreeMap<ImageId, (usize, ImageId)> {
    let mut rigid = BTreeMap::new();
    for (index, extrinsics) in
        all_extrinsics.iter().enumerate().filter(|(_, m)| m.constraint == RigConstraint::Rigid)
    {
        for referenced in &extrinsics.referenced_images {
            let ReferencePose::Synchronous(left) = referenced.reference else { continue };
            if posed.binary_search(&left).is_ok() && posed.binary_search(&referenced.right).is_ok()
            {
                rigid.insert(referenced.right, (index, left));
            }
        }
    }
    rigid
}
