//! How firmly cameras hold: standard deviations, tightened for as long as tracks that took no part
//! are explained no worse.

use std::collections::BTreeSet;

use tiepoint_rig::robust_average;
use tiepoint_scene::Reconstruction;

use super::context::{Context, ITERATIONS, WIDENED};
use super::extrinsics::{Closed, RigConstraint, RigExtrinsics, relative_poses, spread_of};
use super::extrinsics_term::adjust_with_extrinsics;
use super::held_out::HeldOutComparison;
use super::members::Unmatched;
use super::rig_sensor::{ClockState, RigSensor};
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::options::RigTerm;

/// Least standard deviations: what holds by a ten-thousandth of a baseline is rigid to any image.
/// Where it is less firm than the mount, small biases of the lenses, seen by all tracks, bend a
/// drive with more confidence than they deserve: on KITTI 01 half a percent left 29 cm of error, a
/// twentieth of a percent 11.6 cm, a fiftieth 10.2 cm, where a rigid rig has 9.7 cm.
const SIGMA_FLOOR: (f64, f64) = (0.0001, 0.0006 * std::f64::consts::PI / 180.0);
/// Greatest standard deviations to begin with.
const SIGMA_CEILING: (f64, f64) = (0.3, 0.05);
/// How much the standard deviations are tightened from step to step, and how often at most.
const TIGHTEN: f64 = 3.0;
const MAX_STEPS: usize = 8;
/// The term may cost the held-out tracks this much, relatively, for the same reason: on KITTI 01 a
/// rigid rig costs them 6 %. Clocks that disagree by as much as matters cost them far more.
const HELD_OUT_TOLERANCE: f64 = 0.08;
/// To tighten the rotation as well as the translation may cost the held-out tracks this much more
/// than the translation alone; else the mount gives, and the rotation stays as firm as it was. It
/// costs 3 % where a mount swings by a tenth of a degree (features, 0.5 px of noise), and on KITTI
/// 01, where the term costs 4 % in all, 0.1 % a step.
const ROTATION_TOLERANCE: f64 = 0.003;
/// Images from far away are brought nearer with standard deviations that are so many times as
/// large, one after the other.
const CLOSING_STEPS: [f64; 3] = [30.0, 10.0, 3.0];
/// Before tracks are all re-created, a split that was closed may cost held-out tracks this much.
const CLOSING_TOLERANCE: f64 = 0.3;

/// A model whose cameras are held.
pub(super) struct ConstrainedModel {
    pub(super) model: Reconstruction,
    pub(super) all_extrinsics: Vec<RigExtrinsics>,
    pub(super) error_px: f64,
    pub(super) sigmas: (f64, f64),
}

impl ConstrainedModel {
    /// Whether all cameras follow in translation, and in rotation.
    fn follows(&self) -> [bool; 2] {
        let each = self.all_extrinsics.iter().map(|extrinsics| extrinsics.follows(&self.model));
        each.fold([true; 2], |all, one| [all[0] && one[0], all[1] && one[1]])
    }

    pub(super) fn is_anything_together(&self) -> bool {
        self.all_extrinsics
            .iter()
            .any(|extrinsics| extrinsics.rig_sensor.clock_state == ClockState::Synchronised)
    }
}

/// Cameras held as firmly as they can be.
#[derive(Default)]
pub(super) struct SigmaSelection {
    pub(super) best: Option<ConstrainedModel>,
    /// Whether that is as firmly as can be asked for.
    pub(super) is_firm: bool,
    /// Images that were brought back from a split without a word from their own matches.
    pub(super) closed: BTreeSet<Closed>,
}

impl Context<'_> {
    /// Soft mountings, tighter from step to step. `model` and the sensors' clocks are left where
    /// the last accepted step had them. Splits without a word from their own matches are closed for
    /// as long as held-out tracks allow.
    pub(super) fn select_sigmas(
        &self,
        model: &mut Reconstruction,
        rig_sensors: &mut [RigSensor],
        term: RigTerm,
        held_out: &HeldOutComparison,
    ) -> Result<SigmaSelection, Error> {
        let (mut closed, mut clocks) = (model.clone(), rig_sensors.to_vec());
        let tight =
            self.select_sigmas_with(&mut closed, &mut clocks, term, held_out, Unmatched::Rows)?;
        let is_worse =
            |held: &ConstrainedModel| held_out.is_worse(held.error_px, HELD_OUT_TOLERANCE);
        if !tight.closed.is_empty() && tight.best.as_ref().is_none_or(is_worse) {
            return self.select_sigmas_with(model, rig_sensors, term, held_out, Unmatched::None);
        }
        *model = closed;
        rig_sensors.copy_from_slice(&clocks);
        Ok(tight)
    }

    /// The same with splits closed or left alone.
    fn select_sigmas_with(
        &self,
        model: &mut Reconstruction,
        rig_sensors: &mut [RigSensor],
        term: RigTerm,
        held_out: &HeldOutComparison,
        unmatched: Unmatched,
    ) -> Result<SigmaSelection, Error> {
        let found = widest_spread(model, rig_sensors);
        let mut sigmas = (
            found.0.clamp(SIGMA_FLOOR.0, SIGMA_CEILING.0),
            found.1.clamp(SIGMA_FLOOR.1, SIGMA_CEILING.1),
        );
        let mut tight = SigmaSelection::default();
        // Whether the rotation gives more than the translation; error and standard deviation of the
        // rotation of the last step.
        let (mut gives, mut last) = (false, None);
        for step in 0..MAX_STEPS {
            let widened = if step == 0 { WIDENED } else { 1.0 };
            let (mut held, tolerance) =
                self.constrain_softly(model, rig_sensors, sigmas, unmatched, widened, held_out)?;
            if let Some((last_px, last_rotation)) = last.filter(|_| !gives)
                && (held_out.share(held.error_px - last_px) > ROTATION_TOLERANCE
                    || !held.follows()[1])
            {
                let looser = (sigmas.0, last_rotation);
                let (loose, _) = self.constrain_softly(
                    model,
                    rig_sensors,
                    looser,
                    unmatched,
                    widened,
                    held_out,
                )?;
                let costs = held_out.share(held.error_px - loose.error_px) > ROTATION_TOLERANCE;
                gives = costs || !held.follows()[1];
                if gives {
                    (held, sigmas) = (loose, looser);
                }
            }
            let ConstrainedModel { model: candidate, all_extrinsics, error_px, .. } = held;
            tight.closed.extend(
                all_extrinsics.iter().flat_map(|extrinsics| extrinsics.closed.iter().copied()),
            );
            let is_asked_for = term != RigTerm::Auto && step == 0;
            if !is_asked_for && held_out.is_worse(error_px, tolerance) {
                break;
            }
            for extrinsics in &all_extrinsics {
                rig_sensors
                    .iter_mut()
                    .filter(|rig_sensor| rig_sensor.right == extrinsics.rig_sensor.right)
                    .for_each(|rig_sensor| rig_sensor.clock = extrinsics.rig_sensor.clock);
            }
            let held =
                ConstrainedModel { model: candidate.clone(), all_extrinsics, error_px, sigmas };
            if held.follows() == [true; 2] || is_asked_for {
                tight.best = Some(held);
                tight.is_firm = sigmas == SIGMA_FLOOR;
            }
            *model = candidate;
            last = Some((error_px, sigmas.1));
            let tightened = |sigma: f64, floor: f64| (sigma / TIGHTEN).max(floor);
            let rotation = if gives { sigmas.1 } else { tightened(sigmas.1, SIGMA_FLOOR.1) };
            let next = (tightened(sigmas.0, SIGMA_FLOOR.0), rotation);
            if next == sigmas {
                break;
            }
            sigmas = next;
        }
        Ok(tight)
    }

    /// A model with its cameras held up to standard deviations, and what that may cost held-out
    /// tracks.
    fn constrain_softly(
        &self,
        model: &Reconstruction,
        rig_sensors: &[RigSensor],
        sigmas: (f64, f64),
        unmatched: Unmatched,
        widened: f64,
        held_out: &HeldOutComparison,
    ) -> Result<(ConstrainedModel, f64), Error> {
        let mut model = model.clone();
        let mut all_extrinsics = self.rig_extrinsics(
            &model,
            rig_sensors,
            RigConstraint::soft(sigmas),
            sigmas,
            unmatched,
        );
        let tolerance = if all_extrinsics.iter().any(|extrinsics| !extrinsics.closed.is_empty()) {
            self.close(&mut model, &mut all_extrinsics)?;
            CLOSING_TOLERANCE
        } else {
            HELD_OUT_TOLERANCE
        };
        self.refine(&mut model, &mut all_extrinsics, widened)?;
        let error_px = held_out.error_px(&model);
        Ok((ConstrainedModel { model, all_extrinsics, error_px, sigmas }, tolerance))
    }

    /// Brings images that stand far away near to where their mountings have them, step by step, at
    /// the clocks of now: all at once the adjustment would need hundreds of steps, and lead the
    /// clocks astray meanwhile.
    fn close(
        &self,
        model: &mut Reconstruction,
        all_extrinsics: &mut [RigExtrinsics],
    ) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        for factor in CLOSING_STEPS {
            let mut loose: Vec<RigExtrinsics> = all_extrinsics
                .iter()
                .map(|m| {
                    let rig_sensor =
                        RigSensor { clock_state: m.rig_sensor.clock_state.held(), ..m.rig_sensor };
                    RigExtrinsics {
                        constraint: m.constraint.scaled(factor),
                        rig_sensor,
                        ..m.clone()
                    }
                })
                .collect();
            adjust_with_extrinsics(model, &options, &mut loose)?;
            for (extrinsics, loose) in all_extrinsics.iter_mut().zip(loose) {
                extrinsics.right_from_left = loose.right_from_left;
            }
        }
        Ok(())
    }
}

/// The widest spread of any camera, as standard deviations of components.
fn widest_spread(model: &Reconstruction, rig_sensors: &[RigSensor]) -> (f64, f64) {
    let mut widest = (0.0_f64, 0.0_f64);
    for rig_sensor in rig_sensors {
        let poses = relative_poses(model, &rig_sensor.referenced_images(model), &rig_sensor.clock);
        let Some(average) = robust_average(&poses) else { continue };
        let (t, r) = spread_of(&poses, &average, rig_sensor.assumed_baseline);
        widest = (widest.0.max(t), widest.1.max(r));
    }
    widest
}
