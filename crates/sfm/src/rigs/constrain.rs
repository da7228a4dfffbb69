//! Cameras held to the mounting that they share, found from the model itself: `--rig soft`, `hard`
//! and `auto`.
//!
//! A model without any such term comes first, and the clocks of its cameras from how it has them
//! move ([`crate::rig_sensors`]). Then, per camera beside the first: (i) the mounting is the robust
//! average of the relative poses, the first camera's being interpolated at the times of the other's
//! images, and images far from it are gated: where two images' own two-view geometry agrees with
//! the mounting, the model is wrong there (a split) and the image takes part; so it does in a row
//! of images that have no matches with their partners and stand together, elsewhere (for as long as
//! tracks that took no part do not object); else the image is wrong and does not; (ii) the term is
//! added, quadratic, and everything adjusted, clocks with it (a robust loss lets go of what it
//! should bring together: on KITTI 01 it springs back); (iii) tracks are re-created, completed and
//! merged across the cameras, which is what keeps a closed split closed; (iv) the standard
//! deviations are tightened threefold, down to a floor, for as long as tracks that took no part are
//! explained no worse, the rotation's no further where it alone makes them worse. How much the
//! mounting gives is thereby found and not assumed. A clock of which the images tell too little
//! stays at what its stamps say, and everything is done again.

use std::collections::BTreeSet;

use tiepoint_rig::{Clock, relative_pose_statistics};
use tiepoint_scene::{ImageId, Reconstruction};

use super::context::{Context, WIDENED};
use super::covariance::extrinsics_covariances;
use super::extrinsics::{Closed, RigConstraint, RigExtrinsics, relative_poses};
use super::frames::{make_frames, make_rigid};
use super::held_out::{HeldOutComparison, held_out};
use super::members::Unmatched;
use super::pairs::RigPair;
use super::rematch::{Descriptors, rematch};
use super::rig_sensor::{ClockState, RigSensor, rig_sensors};
use super::sigma_selection::{ConstrainedModel, SigmaSelection};
use super::solution::{CalibratedCamera, CalibratedRig, ClosedSplit};
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::options::RigTerm;
use crate::tracks::hold_out_tracks;

/// Share of the tracks that take no part until the end.
const HELD_OUT_SHARE: f64 = 0.1;
/// A rigid rig may cost the held-out tracks this much more than the firmest soft one: between the
/// two they tell biases of the lenses. On KITTI 04 it costs 0.2 %, on KITTI 01 0.8 %, where the
/// trajectory is a sixth better for it; a mount that gives has not reached the floor.
const RIGID_TOLERANCE: f64 = 0.01;
/// Where an offset's standard deviation is larger than this, its value would be an accident of the
/// lenses.
const MAX_CLOCK_SD_S: f64 = 0.02;

/// Holds the cameras of a finished model to their mountings, as `term` says; `None` where nothing
/// is to be held. Where that closes splits whose images had no matches with their partners, those
/// are matched again, with what `descriptors` gives, and everything is done anew with what was
/// found.
pub(crate) fn constrain_rig(
    context: &Context,
    model: &mut Reconstruction,
    term: RigTerm,
    descriptors: &mut Descriptors,
) -> Result<Option<CalibratedRig>, Error> {
    let Some(found) = context.find_constraint(model, term)? else { return Ok(None) };
    let Some(ConstrainedModel { model: closed, all_extrinsics, .. }) =
        found.best.as_ref().filter(|_| !found.closed.is_empty())
    else {
        return context.finish(model, found, None).map(Some);
    };
    let two_views = rematch(context.graph, closed, &found.closed, descriptors, context.seed);
    let split =
        ClosedSplit { num_images: found.closed.len(), num_pairs_matched_again: two_views.len() };
    if two_views.is_empty() {
        return context.finish(model, found, Some(split)).map(Some);
    }
    let graph = context.graph.extended(two_views);
    let context = Context { graph: &graph, ..*context };
    *model = closed.clone();
    context.refine(model, &mut all_extrinsics.clone(), WIDENED)?;
    match context.find_constraint(model, term)? {
        Some(found) => context.finish(model, found, Some(split)).map(Some),
        None => Ok(None),
    }
}

/// What was found for the cameras of a model.
struct Found {
    /// The model without any term.
    off: Reconstruction,
    error_off_px: f64,
    /// The best way to hold its cameras, if any is good.
    best: Option<ConstrainedModel>,
    /// Images that were brought back from a split without a word from their own matches.
    closed: BTreeSet<Closed>,
}

impl Context<'_> {
    /// Finds how the cameras of a model are held best; `None` where nothing is to be held. The
    /// model is left as it comes.
    fn find_constraint(
        &self,
        model: &mut Reconstruction,
        term: RigTerm,
    ) -> Result<Option<Found>, Error> {
        let mut rig_sensors = rig_sensors(model);
        if rig_sensors.iter().all(|rig_sensor| rig_sensor.referenced_images(model).is_empty()) {
            return Ok(None);
        }
        hold_out_tracks(model, HELD_OUT_SHARE, self.seed);
        let held_out = held_out(model);
        self.refine(model, &mut [], 1.0)?;
        let held_out = HeldOutComparison::new(held_out, model);
        let off = model.clone();
        let mut tight = SigmaSelection::default();
        // Once more when a clock or a place turns out not to be observable.
        for _ in 0..2 {
            *model = off.clone();
            tight = self.select_sigmas(model, &mut rig_sensors, term, &held_out)?;
            let Some(ConstrainedModel { all_extrinsics, .. }) = &tight.best else { break };
            if !self.give_up(model, all_extrinsics, &mut rig_sensors)? {
                break;
            }
        }
        let SigmaSelection { mut best, is_firm, closed } = tight;
        let is_wanted = term == RigTerm::Hard || term == RigTerm::Auto && is_firm;
        if let Some(soft) = best.as_ref().filter(|soft| is_wanted && soft.is_anything_together()) {
            let mut candidate = soft.model.clone();
            let mut all_extrinsics = self.rig_extrinsics(
                &candidate,
                &rig_sensors,
                RigConstraint::Rigid,
                soft.sigmas,
                Unmatched::None,
            );
            make_rigid(&mut candidate, &all_extrinsics);
            self.refine(&mut candidate, &mut all_extrinsics, 1.0)?;
            let error_px = held_out.error_px(&candidate);
            if term == RigTerm::Hard || error_px <= (1.0 + RIGID_TOLERANCE) * soft.error_px {
                best = Some(ConstrainedModel {
                    model: candidate,
                    all_extrinsics,
                    error_px,
                    sigmas: soft.sigmas,
                });
            }
        }
        Ok(Some(Found { off, error_off_px: held_out.error_off_px, best, closed }))
    }

    /// Makes a model what was found, with all its tracks, and says what became of its cameras.
    fn finish(
        &self,
        model: &mut Reconstruction,
        found: Found,
        split: Option<ClosedSplit>,
    ) -> Result<CalibratedRig, Error> {
        let Found { off, error_off_px, best, .. } = found;
        let (mut all_extrinsics, mut error_px) = (Vec::new(), error_off_px);
        match best {
            Some(held) => {
                (*model, all_extrinsics, error_px) =
                    (held.model, held.all_extrinsics, held.error_px)
            }
            None => *model = off,
        }
        hold_out_tracks(model, 0.0, self.seed);
        let all =
            Context { adjust: AdjustOptions { selects_points: false, ..self.adjust }, ..*self };
        all.refine(model, &mut all_extrinsics, 1.0)?;
        make_frames(model, &all_extrinsics);
        let (mut cameras, mut bad_pairs) = (Vec::new(), Vec::new());
        for (extrinsics, covariance) in
            all_extrinsics.iter().zip(extrinsics_covariances(model, &self.adjust, &all_extrinsics)?)
        {
            let held: BTreeSet<ImageId> =
                extrinsics.referenced_images.iter().map(|referenced| referenced.right).collect();
            let all = extrinsics.rig_sensor.referenced_images(model);
            bad_pairs.extend(
                all.iter().filter(|referenced| !held.contains(&referenced.right)).map(
                    |referenced| RigPair {
                        left: referenced.nearest_left(&extrinsics.rig_sensor.clock),
                        right: referenced.right,
                    },
                ),
            );
            let poses =
                relative_poses(model, &extrinsics.referenced_images, &extrinsics.rig_sensor.clock);
            cameras.push(CalibratedCamera {
                rig_sensor: extrinsics.rig_sensor,
                right_from_left: extrinsics.right_from_left,
                covariance: covariance.map(|covariance| extrinsics.with_belief(covariance)),
                constraint: extrinsics.constraint,
                num_referenced_images: all.len(),
                statistics: relative_pose_statistics(&poses),
            });
        }
        let constraint = all_extrinsics.first().map(|extrinsics| extrinsics.constraint);
        Ok(CalibratedRig { constraint, cameras, bad_pairs, split, error_off_px, error_px })
    }

    /// Puts clocks of which the images tell too little back to what their stamps say, and holds
    /// places of which the motion tells too little. Returns whether there were any.
    fn give_up(
        &self,
        model: &Reconstruction,
        all_extrinsics: &[RigExtrinsics],
        rig_sensors: &mut [RigSensor],
    ) -> Result<bool, Error> {
        let is_open = |c: &RigSensor| {
            c.clock_state == ClockState::Estimated
                || c.assumed_baseline.is_some() && c.unobservable_direction.is_none()
        };
        if !rig_sensors.iter().any(is_open) {
            return Ok(false);
        }
        let covariances = extrinsics_covariances(model, &self.adjust, all_extrinsics)?;
        let mut is_any = false;
        for (extrinsics, covariance) in all_extrinsics.iter().zip(covariances) {
            // Where rounding leaves no covariance, the motion's word stands.
            let Some(covariance) = covariance else { continue };
            let sd_s = covariance[(6, 6)].sqrt();
            for rig_sensor in
                rig_sensors.iter_mut().filter(|c| c.right == extrinsics.rig_sensor.right)
            {
                if rig_sensor.clock_state == ClockState::Estimated
                    && sd_s.is_nan() | (sd_s > MAX_CLOCK_SD_S)
                {
                    rig_sensor.clock_state = ClockState::Unobservable;
                    rig_sensor.clock = Clock { offset_s: 0.0, drift: 0.0, ..rig_sensor.clock };
                    is_any = true;
                }
                if rig_sensor.unobservable_direction.is_none() {
                    rig_sensor.unobservable_direction =
                        extrinsics.unobservable_direction(&covariance);
                    is_any |= rig_sensor.unobservable_direction.is_some();
                }
            }
        }
        Ok(is_any)
    }
}
