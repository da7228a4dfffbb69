//! Rig extrinsics and clocks as variables of a bundle adjustment: soft residuals and composed
//! poses.

use std::collections::BTreeMap;

use tiepoint_adjust::{
    AdjustOptions, Error, Scope, Term, TermContext, Variables, adjust, keep_going,
};
use tiepoint_ba::factors::Prior;
use tiepoint_ba::{EliminationOrder, Key, Problem, Summary};
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Loss, Rigid3};
use tiepoint_rig::{Clock, InterpolatedExtrinsics, SynchronousExtrinsics};
use tiepoint_scene::{ImageId, Reconstruction};

use super::extrinsics::{RigConstraint, RigExtrinsics};
use super::sensor_pair::{ClockState, ReferencePose};
use crate::terms::with_terms;

/// Prior standard deviations of the clock offset around its initial estimate, and of the drift
/// (quartz: tens of parts per million).
const CLOCK_SIGMA_S: f64 = 1.0;
const DRIFT_SIGMA: f64 = 5e-5;

/// Prior standard deviation of the extrinsic rotation between cameras without common points. That
/// of the centre is the assumed baseline.
const PRIOR_SIGMA_ROTATION_RAD: f64 = 1.0;
/// Factor on the prior standard deviation of the centre along an unobservable direction.
const UNOBSERVABLE_SIGMA_FACTOR: f64 = 1e-3;

/// Bundle adjustment with extrinsics and clocks as variables, and further terms.
pub(super) fn adjust_with_extrinsics(
    model: &mut Reconstruction,
    options: &AdjustOptions,
    all_extrinsics: &mut [RigExtrinsics],
    terms: &mut [&mut dyn Term],
) -> Result<Summary, Error> {
    let extrinsics = &mut ExtrinsicsTerm::new(all_extrinsics);
    let terms = &mut with_terms(extrinsics, terms);
    adjust(model, &Scope::Global, options, terms, &mut keep_going)
}

/// Extrinsics as a term of an adjustment. The estimates are written back to `all_extrinsics`.
pub(super) struct ExtrinsicsTerm<'a> {
    all_extrinsics: &'a mut [RigExtrinsics],
    /// Keys of the extrinsics and, if estimated, of the clock.
    pub(super) keys: Vec<(Key<Rigid3>, Option<Key<Clock>>)>,
    /// Images with composed poses: index of the extrinsics, and the image of the reference camera.
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

    /// Adds the extrinsics as variables, a residual per image for soft constraints, and priors. The
    /// standard deviations of priors are divided by the noise of the keypoints.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let TermContext { model, noise, .. } = *context;
        self.keys.clear();
        let keys: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        let key = |image: &ImageId| keys.get(image).copied();
        for (index, extrinsics) in self.all_extrinsics.iter().enumerate() {
            let pose_key = variables
                .problem_mut()
                .add_parameter(extrinsics.cam_from_rig, EliminationOrder::Last);
            let is_interpolated = extrinsics
                .referenced_images
                .iter()
                .any(|m| matches!(m.reference, ReferencePose::Interpolated { .. }));
            let clock = is_interpolated.then(|| {
                variables
                    .problem_mut()
                    .add_parameter(extrinsics.sensor_pair.clock, EliminationOrder::Last)
            });
            if let Some(clock) = clock {
                match extrinsics.sensor_pair.clock_state {
                    ClockState::Estimated => {
                        let sigmas = [CLOCK_SIGMA_S, DRIFT_SIGMA].map(|sigma| sigma / noise);
                        let stamps = Clock { drift: 0.0, ..extrinsics.sensor_pair.clock };
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
            if let Some(assumed_baseline) = extrinsics.sensor_pair.assumed_baseline {
                variables.problem_mut().add(
                    pose_key,
                    extrinsics_prior(extrinsics, assumed_baseline, noise)?,
                    Loss::Trivial,
                )?;
            }
            self.keys.push((pose_key, clock));
            for referenced in &extrinsics.referenced_images {
                let cam = key(&referenced.image);
                match (extrinsics.constraint, referenced.reference, clock) {
                    (RigConstraint::Rigid, ReferencePose::Synchronous(reference), _) => {
                        if let (Some(reference), Some(&(by_index, _))) =
                            (key(&reference), self.rigid.get(&referenced.image))
                            && by_index == index
                        {
                            variables.compose_pose(referenced.image, pose_key, reference);
                        }
                    }
                    (
                        RigConstraint::Soft { sigma_translation, sigma_rotation_rad },
                        ReferencePose::Synchronous(reference),
                        _,
                    ) => {
                        let (Some(reference), Some(cam)) = (key(&reference), cam) else { continue };
                        let factor = SynchronousExtrinsics {
                            sigma_translation,
                            sigma_rotation_rad,
                            assumed_baseline: extrinsics.sensor_pair.assumed_baseline,
                        };
                        variables.problem_mut().add(
                            (reference, cam, pose_key),
                            factor,
                            Loss::Trivial,
                        )?;
                    }
                    (
                        RigConstraint::Soft { sigma_translation, sigma_rotation_rad },
                        ReferencePose::Interpolated { images, times_s, image_time_s, .. },
                        Some(clock),
                    ) => {
                        let [a, b, c, d] = images.each_ref().map(key);
                        let (Some(a), Some(b), Some(c), Some(d), Some(cam)) = (a, b, c, d, cam)
                        else {
                            continue;
                        };
                        let synchronous = SynchronousExtrinsics {
                            sigma_translation,
                            sigma_rotation_rad,
                            assumed_baseline: extrinsics.sensor_pair.assumed_baseline,
                        };
                        let Some(reference) =
                            referenced.rig_from_world(model, &extrinsics.sensor_pair.clock)
                        else {
                            continue;
                        };
                        let whitening = referenced.whitening(
                            &synchronous,
                            &reference,
                            &extrinsics.cam_from_rig,
                        );
                        let factor = InterpolatedExtrinsics {
                            extrinsics: synchronous,
                            reference_times_s: times_s,
                            image_time_s,
                            whitening,
                        };
                        variables.problem_mut().add(
                            (a, b, c, d, cam, pose_key, clock),
                            factor,
                            Loss::Trivial,
                        )?;
                    }
                    // A rigid constraint needs images of the same instant.
                    (_, ReferencePose::Interpolated { .. }, _) => {}
                }
            }
        }
        Ok(())
    }

    fn read(&mut self, problem: &Problem) {
        for (extrinsics, (pose_key, clock)) in self.all_extrinsics.iter_mut().zip(&self.keys) {
            extrinsics.cam_from_rig = problem.get(*pose_key);
            if let Some(clock) = clock {
                extrinsics.sensor_pair.clock = problem.get(*clock);
            }
        }
    }
}

/// Prior on the extrinsics of cameras without common points: the rotation around its current value,
/// the centre around zero, with a small standard deviation along an unobservable direction.
fn extrinsics_prior(
    extrinsics: &RigExtrinsics,
    assumed_baseline: f64,
    noise: f64,
) -> Result<Prior<Rigid3, 6>, Error> {
    let sigmas: [f64; 6] = std::array::from_fn(
        |k| if k < 3 { PRIOR_SIGMA_ROTATION_RAD } else { assumed_baseline } / noise,
    );
    let rotation = extrinsics.cam_from_rig.rotation;
    let mut prior = Prior::new(Rigid3::new(rotation, Vector3::zeros()), &sigmas)?;
    if let Some(unobservable_direction) = extrinsics.sensor_pair.unobservable_direction {
        let along = rotation * unobservable_direction;
        let firmer = Matrix3::identity()
            + along * along.transpose() * (1.0 / UNOBSERVABLE_SIGMA_FACTOR - 1.0);
        let of_place = prior.sqrt_information.fixed_view::<3, 3>(3, 3) * firmer;
        prior.sqrt_information.fixed_view_mut::<3, 3>(3, 3).copy_from(&of_place);
    }
    Ok(prior)
}

/// Returns the images with composed poses: index of the extrinsics, and the image of the reference
/// camera.
fn rigid_pairs(
    all_extrinsics: &[RigExtrinsics],
    posed: &[ImageId],
) -> BTreeMap<ImageId, (usize, ImageId)> {
    let mut rigid = BTreeMap::new();
    for (index, extrinsics) in
        all_extrinsics.iter().enumerate().filter(|(_, m)| m.constraint == RigConstraint::Rigid)
    {
        for referenced in &extrinsics.referenced_images {
            let ReferencePose::Synchronous(reference) = referenced.reference else { continue };
            if posed.binary_search(&reference).is_ok()
                && posed.binary_search(&referenced.image).is_ok()
            {
                rigid.insert(referenced.image, (index, reference));
            }
        }
    }
    rigid
}
