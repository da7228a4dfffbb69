//! How firmly cameras hold: standard deviations, tightened for as long as tracks that took no part are explained no worse.

use std::collections::BTreeSet;

use tiepoint_rig::robust_average;
use tiepoint_scene::Reconstruction;

use super::companion::{Companion, Timing};
use super::context::{Context, ITERATIONS, WIDENED};
use super::judge::Judge;
use super::members::Unmatched;
use super::mounting::{Closed, Hold, Mounting, relative_poses, spread_of};
use super::mounting_term::adjust_mounted;
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::options::RigTerm;

/// Least standard deviations: what holds by a ten-thousandth of a baseline is rigid to any image. Where it is less firm than the mount, small
/// biases of the lenses, seen by all tracks, bend a drive with more confidence than they deserve: on KITTI 01 half a percent left 29 cm
/// of error, a twentieth of a percent 11.6 cm, a fiftieth 10.2 cm, where a rigid rig has 9.7 cm.
const SIGMA_FLOOR: (f64, f64) = (0.0001, 0.0006 * std::f64::consts::PI / 180.0);
/// Greatest standard deviations to begin with.
const SIGMA_CEILING: (f64, f64) = (0.3, 0.05);
/// How much the standard deviations are tightened from step to step, and how often at most.
const TIGHTEN: f64 = 3.0;
const MAX_STEPS: usize = 8;
/// The term may cost the held-out tracks this much, relatively, for the same reason: on KITTI 01 a rigid rig costs them 6 %. Clocks
/// that disagree by as much as matters cost them far more.
const HELD_OUT_TOLERANCE: f64 = 0.08;
/// To tighten the rotation as well as the translation may cost the held-out tracks this much more than the translation alone; else the
/// mount gives, and the rotation stays as firm as it was. It costs 3 % where a mount swings by a tenth of a degree (features, 0.5 px of
/// noise), and on KITTI 01, where the term costs 4 % in all, 0.1 % a step.
const ROTATION_TOLERANCE: f64 = 0.003;
/// Images from far away are brought nearer with standard deviations that are so many times as large, one after the other.
const CLOSING_STEPS: [f64; 3] = [30.0, 10.0, 3.0];
/// Before tracks are all re-created, a split that was closed may cost held-out tracks this much.
const CLOSING_TOLERANCE: f64 = 0.3;

/// A model whose cameras are held.
pub(super) struct Held {
    pub(super) model: Reconstruction,
    pub(super) mountings: Vec<Mounting>,
    pub(super) error_px: f64,
    pub(super) sigmas: (f64, f64),
}

impl Held {
    /// Whether all cameras follow in translation, and in rotation.
    fn follows(&self) -> [bool; 2] {
        let each = self.mountings.iter().map(|mounting| mounting.follows(&self.model));
        each.fold([true; 2], |all, one| [all[0] && one[0], all[1] && one[1]])
    }

    pub(super) fn is_anything_together(&self) -> bool {
        self.mountings.iter().any(|mounting| mounting.companion.timing == Timing::Together)
    }
}

/// Cameras held as firmly as they can be.
#[derive(Default)]
pub(super) struct Tight {
    pub(super) best: Option<Held>,
    /// Whether that is as firmly as can be asked for.
    pub(super) is_firm: bool,
    /// Images that were brought back from a split without a word from their own matches.
    pub(super) closed: BTreeSet<Closed>,
}

impl Context<'_> {
    /// Soft mountings, tighter from step to step. `model` and the companions' clocks are left where the
    /// last accepted step had them. Splits without a word from their own matches are closed for as long as held-out tracks allow.
    pub(super) fn tighten(
        &self,
        model: &mut Reconstruction,
        companions: &mut [Companion],
        term: RigTerm,
        judge: &Judge,
    ) -> Result<Tight, Error> {
        let (mut closed, mut clocks) = (model.clone(), companions.to_vec());
        let tight = self.tighten_with(&mut closed, &mut clocks, term, judge, Unmatched::Rows)?;
        let is_worse = |held: &Held| judge.objects(held.error_px, HELD_OUT_TOLERANCE);
        if !tight.closed.is_empty() && tight.best.as_ref().is_none_or(is_worse) {
            return self.tighten_with(model, companions, term, judge, Unmatched::None);
        }
        *model = closed;
        companions.copy_from_slice(&clocks);
        Ok(tight)
    }

    /// The same with splits closed or left alone.
    fn tighten_with(
        &self,
        model: &mut Reconstruction,
        companions: &mut [Companion],
        term: RigTerm,
        judge: &Judge,
        unmatched: Unmatched,
    ) -> Result<Tight, Error> {
        let found = widest_spread(model, companions);
        let mut sigmas =
            (found.0.clamp(SIGMA_FLOOR.0, SIGMA_CEILING.0), found.1.clamp(SIGMA_FLOOR.1, SIGMA_CEILING.1));
        let mut tight = Tight::default();
        // Whether the rotation gives more than the translation; error and standard deviation of the rotation of the last step.
        let (mut gives, mut last) = (false, None);
        for step in 0..MAX_STEPS {
            let widened = if step == 0 { WIDENED } else { 1.0 };
            let (mut held, tolerance) =
                self.hold_softly(model, companions, sigmas, unmatched, widened, judge)?;
            if let Some((last_px, last_rotation)) = last.filter(|_| !gives)
                && (judge.share(held.error_px - last_px) > ROTATION_TOLERANCE || !held.follows()[1])
            {
                let looser = (sigmas.0, last_rotation);
                let (loose, _) = self.hold_softly(model, companions, looser, unmatched, widened, judge)?;
                let costs = judge.share(held.error_px - loose.error_px) > ROTATION_TOLERANCE;
                gives = costs || !held.follows()[1];
                if gives {
                    (held, sigmas) = (loose, looser);
                }
            }
            let Held { model: candidate, mountings, error_px, .. } = held;
            tight.closed.extend(mountings.iter().flat_map(|mounting| mounting.closed.iter().copied()));
            let is_asked_for = term != RigTerm::Auto && step == 0;
            if !is_asked_for && judge.objects(error_px, tolerance) {
                break;
            }
            for mounting in &mountings {
                companions
                    .iter_mut()
                    .filter(|companion| companion.right == mounting.companion.right)
                    .for_each(|companion| companion.clock = mounting.companion.clock);
            }
            let held = Held { model: candidate.clone(), mountings, error_px, sigmas };
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

    /// A model with its cameras held up to standard deviations, and what that may cost held-out tracks.
    fn hold_softly(
        &self,
        model: &Reconstruction,
        companions: &[Companion],
        sigmas: (f64, f64),
        unmatched: Unmatched,
        widened: f64,
        judge: &Judge,
    ) -> Result<(Held, f64), Error> {
        let mut model = model.clone();
        let mut mountings = self.mountings(&model, companions, Hold::soft(sigmas), sigmas, unmatched);
        let tolerance = if mountings.iter().any(|mounting| !mounting.closed.is_empty()) {
            self.close(&mut model, &mut mountings)?;
            CLOSING_TOLERANCE
        } else {
            HELD_OUT_TOLERANCE
        };
        self.refine(&mut model, &mut mountings, widened)?;
        let error_px = judge.error_px(&model);
        Ok((Held { model, mountings, error_px, sigmas }, tolerance))
    }

    /// Brings images that stand far away near to where their mountings have them, step by step, at the clocks of now: all at once the
    /// adjustment would need hundreds of steps, and lead the clocks astray meanwhile.
    fn close(&self, model: &mut Reconstruction, mountings: &mut [Mounting]) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        for factor in CLOSING_STEPS {
            let mut loose: Vec<Mounting> = mountings
                .iter()
                .map(|m| {
                    let companion = Companion { timing: m.companion.timing.held(), ..m.companion };
                    Mounting { hold: m.hold.scaled(factor), companion, ..m.clone() }
                })
                .collect();
            adjust_mounted(model, &options, &mut loose)?;
            for (mounting, loose) in mountings.iter_mut().zip(loose) {
                mounting.right_from_left = loose.right_from_left;
            }
        }
        Ok(())
    }
}

/// The widest spread of any camera, as standard deviations of components.
fn widest_spread(model: &Reconstruction, companions: &[Companion]) -> (f64, f64) {
    let mut widest = (0.0_f64, 0.0_f64);
    for companion in companions {
        let poses = relative_poses(model, &companion.moments(model), &companion.clock);
        let Some(average) = robust_average(&poses) else { continue };
        let (t, r) = spread_of(&poses, &average, companion.unit);
        widest = (widest.0.max(t), widest.1.max(r));
    }
    widest
}
