//! Estimation of the rig extrinsics from a finished model, and the choice of the constraint: `--rig
//! soft`, `rigid` and `auto`.
//!
//! 1. The model is adjusted without a rig constraint. The motion of the cameras gives initial clock
//!    offsets ([`crate::rigs::sensor_pairs`]).
//! 2. The extrinsics of each camera are the robust average of its poses relative to the
//!    interpolated poses of the reference camera. Images far from the average are gated. A gated
//!    image is constrained if its two-view geometry agrees with the extrinsics (the model is split
//!    there), or if it belongs to a run of images without matches across cameras that is displaced
//!    as a whole, as long as the error of the held-out tracks permits it. Other gated images stay
//!    free.
//! 3. The constraint is added with a quadratic loss, and everything is adjusted including the
//!    clocks. A robust loss gives low weight to the largest deviations, which are the ones to
//!    remove; on KITTI 01 the split opens again.
//! 4. Tracks are re-created, completed and merged across the cameras. The merged tracks keep a
//!    repaired split together.
//! 5. The standard deviations are divided by three, down to a floor, while the error of the
//!    held-out tracks does not increase beyond a tolerance. That of the rotation stays, or becomes
//!    larger again, where a smaller one costs more than a standard error. The result
//!    measures how rigid the mount is.
//!
//! If the images do not determine a clock, it is set to its time stamps and steps 2 to 5 are
//! repeated.

use std::collections::BTreeSet;

use tiepoint_adjust::AdjustOptions;
use tiepoint_rig::{Clock, relative_pose_statistics};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::context::{Context, HeldIntrinsics, MERGE_ERROR_FACTOR};
use super::covariance::extrinsics_covariances;
use super::extrinsics::{
    ExtrinsicsCovariance, RigConstraint, RigExtrinsics, SplitImage, relative_poses,
};
use super::frames::{add_frames, register_rigidly};
use super::gating::UnmatchedImages;
use super::held_out::{HeldOutChange, HeldOutComparison, held_out_observations};
use super::pairs::RigPair;
use super::rematch::{Descriptors, rematch};
use super::sensor_pair::{ClockState, SensorPair, sensor_pairs};
use super::sigma_selection::{ConstrainedModel, SigmaSelection};
use super::solution::{CalibratedCamera, CalibratedRig, ConstraintLimit, SplitRepair};
use crate::Error;
use crate::options::RigMode;
use crate::terms::reborrow;
use crate::tracks::hold_out_tracks;

/// Fraction of the tracks that are held out until the last refinement.
const HELD_OUT_SHARE: f64 = 0.1;
/// Maximum relative increase of the held-out error from the smallest soft standard deviations to a
/// rigid constraint. The standard deviations of a flexible mount do not reach the floor, so that
/// differences of this size come from lens biases.
const RIGID_TOLERANCE: f64 = 0.01;
/// Maximum standard deviation of an estimated offset. Above it lens biases dominate the estimate.
const MAX_CLOCK_SD_S: f64 = 0.02;

/// Constrains the cameras of a finished model as `mode` says; `None` if there are no images to
/// constrain. If this repairs splits whose images have no matches across cameras, these images are
/// matched again using `descriptors`, and the estimation is repeated with the new pairs.
///
/// # Errors
///
/// Fails if an adjustment fails.
pub(crate) fn constrain_rig(
    context: &mut Context,
    model: &mut Reconstruction,
    mode: RigMode,
    descriptors: &mut Descriptors,
) -> Result<Option<CalibratedRig>, Error> {
    let Some(found) = context.find_constraint(model, mode)? else { return Ok(None) };
    let Some(ConstrainedModel { model: repaired, all_extrinsics, .. }) =
        found.best.as_ref().filter(|_| !found.split_images.is_empty())
    else {
        return context.refine_and_report(model, found, None).map(Some);
    };
    let two_views =
        rematch(context.graph, repaired, &found.split_images, descriptors, context.seed);
    let split =
        SplitRepair { num_images: found.split_images.len(), num_rematched_pairs: two_views.len() };
    if two_views.is_empty() {
        return context.refine_and_report(model, found, Some(split)).map(Some);
    }
    let graph = context.graph.extended(two_views);
    let terms = reborrow(&mut context.terms);
    let context = &mut Context { graph: &graph, terms, ..*context };
    *model = repaired.clone();
    context.refine(model, &mut all_extrinsics.clone(), MERGE_ERROR_FACTOR)?;
    match context.find_constraint(model, mode)? {
        Some(found) => context.refine_and_report(model, found, Some(split)).map(Some),
        None => Ok(None),
    }
}

/// Result of [`Context::find_constraint`].
struct ConstraintSearch {
    /// The model without a rig constraint.
    off: Reconstruction,
    error_off_px: f64,
    /// Change of the error by the accepted constraint.
    held_out_change: Option<HeldOutChange>,
    /// The accepted constraint, if any.
    best: Option<ConstrainedModel>,
    /// Cameras that permit no constraint although others do.
    unconstrained: Vec<CameraId>,
    /// Images of repaired splits that had no matches across cameras.
    split_images: BTreeSet<SplitImage>,
    /// Why the constraint is not tighter.
    limit: Option<ConstraintLimit>,
}

impl Context<'_> {
    /// Finds the constraint for the cameras of a model; `None` if there are no images to constrain.
    /// The model is left in an intermediate state.
    fn find_constraint(
        &mut self,
        model: &mut Reconstruction,
        mode: RigMode,
    ) -> Result<Option<ConstraintSearch>, Error> {
        let mut sensor_pairs = sensor_pairs(model);
        if sensor_pairs.iter().all(|sensor_pair| sensor_pair.referenced_images(model).is_empty()) {
            return Ok(None);
        }
        hold_out_tracks(model, HELD_OUT_SHARE, self.seed);
        let held_out = held_out_observations(model);
        self.refine(model, &mut [], 1.0)?;
        let comparison = HeldOutComparison::new(held_out, model);
        let off = model.clone();
        let mut selection = SigmaSelection::default();
        // The second pass runs if a clock or a direction is unobservable.
        for _ in 0..2 {
            *model = off.clone();
            selection = self.select_sigmas(model, &mut sensor_pairs, mode, &comparison)?;
            let Some(ConstrainedModel { all_extrinsics, .. }) = &selection.best else { break };
            if !self.fix_unobservable(model, all_extrinsics, &mut sensor_pairs)? {
                break;
            }
        }
        let SigmaSelection { mut best, is_at_floor, split_images, limit, unconstrained } =
            selection;
        let mut limit = match (mode, is_at_floor) {
            (RigMode::Rigid, _) | (RigMode::Auto, true) => Some(ConstraintLimit::Unsynchronised),
            (_, true) => Some(ConstraintLimit::Smallest),
            (_, false) => limit,
        };
        let wants_rigid = mode == RigMode::Rigid || mode == RigMode::Auto && is_at_floor;
        if let Some(soft) =
            best.as_ref().filter(|soft| wants_rigid && soft.has_synchronised_sensors())
        {
            let mut candidate = soft.model.clone();
            let mut all_extrinsics = self.rig_extrinsics(
                &candidate,
                &sensor_pairs,
                RigConstraint::Rigid,
                soft.sigmas,
                UnmatchedImages::Exclude,
            );
            register_rigidly(&mut candidate, &all_extrinsics);
            self.refine(&mut candidate, &mut all_extrinsics, 1.0)?;
            let error_px = comparison.error_px(&candidate);
            if mode == RigMode::Rigid || error_px <= (1.0 + RIGID_TOLERANCE) * soft.error_px {
                best = Some(ConstrainedModel {
                    model: candidate,
                    all_extrinsics,
                    error_px,
                    sigmas: soft.sigmas,
                });
                limit = None;
            } else {
                limit = Some(ConstraintLimit::RigidIsWorse { error_px });
            }
        }
        Ok(Some(ConstraintSearch {
            off,
            error_off_px: comparison.error_off_px,
            held_out_change: best.as_ref().and_then(|best| comparison.change(&best.model)),
            best,
            unconstrained,
            split_images,
            limit,
        }))
    }

    /// Refines the selected model with all its tracks, and reports the calibrated cameras.
    fn refine_and_report(
        &mut self,
        model: &mut Reconstruction,
        found: ConstraintSearch,
        split: Option<SplitRepair>,
    ) -> Result<CalibratedRig, Error> {
        let ConstraintSearch {
            off, error_off_px, held_out_change, best, unconstrained, limit, ..
        } = found;
        let (mut all_extrinsics, mut error_px) = (Vec::new(), error_off_px);
        match best {
            Some(constrained) => {
                (*model, all_extrinsics, error_px) =
                    (constrained.model, constrained.all_extrinsics, constrained.error_px)
            }
            None => *model = off,
        }
        hold_out_tracks(model, 0.0, self.seed);
        let adjust = AdjustOptions { select_tracks: false, ..self.adjust };
        Context { adjust, terms: reborrow(&mut self.terms), ..*self }.refine(
            model,
            &mut all_extrinsics,
            1.0,
        )?;
        add_frames(model, &all_extrinsics);
        let (mut cameras, mut bad_pairs) = (Vec::new(), Vec::new());
        let covariances = self.covariances(model, &all_extrinsics)?;
        for (extrinsics, covariance) in all_extrinsics.iter().zip(covariances) {
            let constrained: BTreeSet<ImageId> =
                extrinsics.referenced_images.iter().map(|referenced| referenced.image).collect();
            let all = extrinsics.sensor_pair.referenced_images(model);
            bad_pairs.extend(
                all.iter().filter(|referenced| !constrained.contains(&referenced.image)).map(
                    |referenced| RigPair {
                        reference: referenced.nearest_reference(&extrinsics.sensor_pair.clock),
                        other: referenced.image,
                    },
                ),
            );
            let poses =
                relative_poses(model, &extrinsics.referenced_images, &extrinsics.sensor_pair.clock);
            cameras.push(CalibratedCamera {
                sensor_pair: extrinsics.sensor_pair,
                cam_from_rig: extrinsics.cam_from_rig,
                covariance: covariance.map(|covariance| extrinsics.with_prior_variance(covariance)),
                constraint: extrinsics.constraint,
                num_referenced_images: all.len(),
                statistics: relative_pose_statistics(&poses),
            });
        }
        Ok(CalibratedRig {
            constraint: loosest(&all_extrinsics),
            cameras,
            bad_pairs,
            split,
            error_off_px,
            error_px,
            held_out_change,
            unconstrained,
            limit,
        })
    }

    /// The covariance of each camera's extrinsics and clock. Intrinsics that are held though nobody
    /// knows them are free, with their priors: an error of a principal point becomes one of the
    /// rotation. The cost has a slope there, which makes the deviations larger.
    fn covariances(
        &mut self,
        model: &Reconstruction,
        all_extrinsics: &[RigExtrinsics],
    ) -> Result<Vec<Option<ExtrinsicsCovariance>>, Error> {
        let HeldIntrinsics { unknown, constant } = self.held;
        let mut model = model.clone();
        model.calibrated.retain(|camera| !constant.contains(camera));
        let options = AdjustOptions { refine: unknown, ..self.adjust };
        extrinsics_covariances(&model, &options, all_extrinsics, &mut self.terms)
    }

    /// Resets unobservable clocks to their time stamps and stores unobservable directions. Returns
    /// whether there were any.
    fn fix_unobservable(
        &mut self,
        model: &Reconstruction,
        all_extrinsics: &[RigExtrinsics],
        sensor_pairs: &mut [SensorPair],
    ) -> Result<bool, Error> {
        let may_be_unobservable = |c: &SensorPair| {
            c.clock_state == ClockState::Estimated
                || c.assumed_baseline.is_some() && c.unobservable_direction.is_none()
        };
        if !sensor_pairs.iter().any(may_be_unobservable) {
            return Ok(false);
        }
        let covariances =
            extrinsics_covariances(model, &self.adjust, all_extrinsics, &mut self.terms)?;
        let mut has_changed = false;
        for (extrinsics, covariance) in all_extrinsics.iter().zip(covariances) {
            // Without a covariance the initial estimate is kept.
            let Some(covariance) = covariance else { continue };
            let sd_s = covariance[(6, 6)].sqrt();
            for sensor_pair in
                sensor_pairs.iter_mut().filter(|c| c.other == extrinsics.sensor_pair.other)
            {
                if sensor_pair.clock_state == ClockState::Estimated
                    && sd_s.is_nan() | (sd_s > MAX_CLOCK_SD_S)
                {
                    if sensor_pair.counts_frames(model) {
                        sensor_pair.clock_state = ClockState::Synchronised;
                        sensor_pair.clock = Clock::default();
                    } else {
                        sensor_pair.clock_state = ClockState::Unobservable;
                        sensor_pair.clock =
                            Clock { offset_s: 0.0, drift: 0.0, ..sensor_pair.clock };
                    }
                    has_changed = true;
                }
                if sensor_pair.unobservable_direction.is_none() {
                    sensor_pair.unobservable_direction =
                        extrinsics.unobservable_direction(&covariance);
                    has_changed |= sensor_pair.unobservable_direction.is_some();
                }
            }
        }
        Ok(has_changed)
    }
}

/// The constraint with the largest standard deviations: first of the centre, then of the rotation.
fn loosest(all_extrinsics: &[RigExtrinsics]) -> Option<RigConstraint> {
    let sigmas = |constraint: &RigConstraint| match *constraint {
        RigConstraint::Soft { sigma_translation, sigma_rotation_rad } => {
            [sigma_translation, sigma_rotation_rad]
        }
        RigConstraint::Rigid => [0.0; 2],
    };
    let constraints = all_extrinsics.iter().map(|extrinsics| extrinsics.constraint);
    constraints.max_by(|a, b| {
        let [a, b] = [sigmas(a), sigmas(b)];
        a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
    })
}
