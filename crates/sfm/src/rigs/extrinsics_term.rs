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
use super::sensor_pair::{ClockState, ReferencePose, ReferencedImage};
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
        let poses: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        for (index, extrinsics) in self.all_extrinsics.iter().enumerate() {
            let (pose_key, clock) = add_pose_and_clock(extrinsics, noise, variables.problem_mut())?;
            self.keys.push((pose_key, clock));
            for referenced in &extrinsics.referenced_images {
                match extrinsics.constraint {
                    RigConstraint::Soft { sigma_translation, sigma_rotation_rad } => {
                        let soft = Soft {
                            extrinsics,
                            factor: SynchronousExtrinsics {
                                sigma_translation,
                                sigma_rotation_rad,
                                assumed_baseline: extrinsics.sensor_pair.assumed_baseline,
                            },
                            pose_key,
                            clock,
                        };
                        soft.add(model, referenced, &poses, variables.problem_mut())?;
                    }
                    // A rigid constraint needs images of the same instant.
                    RigConstraint::Rigid => {
                        if let ReferencePose::Synchronous(reference) = referenced.reference
                            && let Some(&reference) = poses.get(&reference)
                            && let Some(&(by_index, _)) = self.rigid.get(&referenced.image)
                            && by_index == index
                        {
                            variables.compose_pose(referenced.image, pose_key, reference);
                        }
                    }
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

/// Adds the extrinsics, and the clock if poses are interpolated, with their priors.
fn add_pose_and_clock(
    extrinsics: &RigExtrinsics,
    noise: f64,
    problem: &mut Problem,
) -> Result<(Key<Rigid3>, Option<Key<Clock>>), Error> {
    let pose_key = problem.add_parameter(extrinsics.cam_from_rig, EliminationOrder::Last);
    let is_interpolated = extrinsics
        .referenced_images
        .iter()
        .any(|m| matches!(m.reference, ReferencePose::Interpolated { .. }));
    let clock = is_interpolated
        .then(|| problem.add_parameter(extrinsics.sensor_pair.clock, EliminationOrder::Last));
    if let Some(clock) = clock {
        match extrinsics.sensor_pair.clock_state {
            ClockState::Estimated => {
                let sigmas = [CLOCK_SIGMA_S, DRIFT_SIGMA].map(|sigma| sigma / noise);
                let stamps = Clock { drift: 0.0, ..extrinsics.sensor_pair.clock };
                problem.add(clock, Prior::new(stamps, &sigmas)?, Loss::Trivial)?;
            }
            ClockState::Synchronised | ClockState::Unobservable => problem.fix(clock),
        }
    }
    if let Some(assumed_baseline) = extrinsics.sensor_pair.assumed_baseline {
        let prior = extrinsics_prior(extrinsics, assumed_baseline, noise)?;
        problem.add(pose_key, prior, Loss::Trivial)?;
    }
    Ok((pose_key, clock))
}

/// The soft constraint of a camera.
struct Soft<'a> {
    extrinsics: &'a RigExtrinsics,
    factor: SynchronousExtrinsics,
    pose_key: Key<Rigid3>,
    clock: Option<Key<Clock>>,
}

impl Soft<'_> {
    /// Constrains an image whose pose and reference poses are variables.
    fn add(
        &self,
        model: &Reconstruction,
        referenced: &ReferencedImage,
        poses: &BTreeMap<ImageId, Key<Rigid3>>,
        problem: &mut Problem,
    ) -> Result<(), Error> {
        let key = |image: &ImageId| poses.get(image).copied();
        let Some(cam) = key(&referenced.image) else { return Ok(()) };
        match (referenced.reference, self.clock) {
            (ReferencePose::Synchronous(reference), _) => {
                let Some(reference) = key(&reference) else { return Ok(()) };
                problem.add((reference, cam, self.pose_key), self.factor, Loss::Trivial)?;
            }
            (ReferencePose::Interpolated { images, times_s, image_time_s, .. }, Some(clock)) => {
                let [Some(a), Some(b), Some(c), Some(d)] = images.each_ref().map(key) else {
                    return Ok(());
                };
                let RigExtrinsics { sensor_pair, cam_from_rig, .. } = self.extrinsics;
                let Some(reference) = referenced.rig_from_world(model, &sensor_pair.clock) else {
                    return Ok(());
                };
                let factor = InterpolatedExtrinsics {
                    whitening: referenced.whitening(&self.factor, &reference, cam_from_rig),
                    extrinsics: self.factor,
                    reference_times_s: times_s,
                    image_time_s,
                };
                let variables = (a, b, c, d, cam, self.pose_key, clock);
                problem.add(variables, factor, Loss::Trivial)?;
            }
            (ReferencePose::Interpolated { .. }, None) => {}
        }
        Ok(())
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
