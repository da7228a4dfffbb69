//! Cameras held to the mounting that they share, found from the model itself: `--rig soft`, `hard` and `auto`.
//!
//! A model without any such term comes first, and the clocks of its cameras from how it has them move ([`crate::companions`]). Then, per
//! camera beside the first: (i) the mounting is the robust average of the relative poses, the first camera's being interpolated at the
//! times of the other's images, and images far from it are gated: where two images' own two-view geometry agrees with the mounting, the
//! model is wrong there (a split) and the image takes part; so it does in a row of images that have no matches with their partners and
//! stand together, elsewhere (for as long as tracks that took no part do not object); else the image is wrong and does not; (ii) the term is added, quadratic, and
//! everything adjusted, clocks with it (a robust loss lets go of what it should bring together: on KITTI 01 it springs back); (iii) tracks
//! are re-created, completed and merged across the cameras, which is what keeps a closed split closed; (iv) the standard deviations are
//! tightened threefold, down to a floor, for as long as tracks that took no part are explained no worse, the rotation's no further where
//! it alone makes them worse. How much the mounting gives is
//! thereby found and not assumed. A clock of which the images tell too little stays at what its stamps say, and everything is done again.

use std::collections::BTreeSet;

use tiepoint_rig::{Clock, spread};
use tiepoint_scene::{ImageId, Reconstruction};

use super::companion::{Companion, Timing, companions};
use super::context::{Context, WIDENED};
use super::covariance::mounting_covariances;
use super::frames::{make_frames, make_rigid};
use super::judge::{Judge, held_out};
use super::members::Unmatched;
use super::mounting::{Closed, Hold, Mounting, relative_poses};
use super::pairs::RigPair;
use super::rematch::{Descriptors, rematch};
use super::solution::{ClosedSplit, MountedCamera, MountedRig};
use super::tighten::{Held, Tight};
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::options::RigTerm;
use crate::tracks::hold_out_tracks;

/// Share of the tracks that take no part until the end.
const HELD_OUT_SHARE: f64 = 0.1;
/// A rigid rig may cost the held-out tracks this much more than the firmest soft one: between the two they tell biases of the lenses. On KITTI 04
/// it costs 0.2 %, on KITTI 01 0.8 %, where the trajectory is a sixth better for it; a mount that gives has not reached the floor.
const RIGID_TOLERANCE: f64 = 0.01;
/// Where an offset's standard deviation is larger than this, its value would be an accident of the lenses.
const MAX_CLOCK_SD_S: f64 = 0.02;

/// Holds the cameras of a finished model to their mountings, as `term` says; `None` where nothing is to be held. Where that closes
/// splits whose images had no matches with their partners, those are matched again, with what `descriptors` gives, and everything
/// is done anew with what was found.
pub(crate) fn hold_to_mountings(
    context: &Context,
    model: &mut Reconstruction,
    term: RigTerm,
    descriptors: &mut Descriptors,
) -> Result<Option<MountedRig>, Error> {
    let Some(found) = context.find_hold(model, term)? else { return Ok(None) };
    let Some(Held { model: closed, mountings, .. }) =
        found.best.as_ref().filter(|_| !found.closed.is_empty())
    else {
        return context.finish(model, found, None).map(Some);
    };
    let two_views = rematch(context.graph, closed, &found.closed, descriptors, context.seed);
    let split = ClosedSplit { num_images: found.closed.len(), num_pairs_matched_again: two_views.len() };
    if two_views.is_empty() {
        return context.finish(model, found, Some(split)).map(Some);
    }
    let graph = context.graph.extended(two_views);
    let context = Context { graph: &graph, ..*context };
    *model = closed.clone();
    context.refine(model, &mut mountings.clone(), WIDENED)?;
    match context.find_hold(model, term)? {
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
    best: Option<Held>,
    /// Images that were brought back from a split without a word from their own matches.
    closed: BTreeSet<Closed>,
}

impl Context<'_> {
    /// Finds how the cameras of a model are held best; `None` where nothing is to be held. The model is left as it comes.
    fn find_hold(&self, model: &mut Reconstruction, term: RigTerm) -> Result<Option<Found>, Error> {
        let mut companions = companions(model);
        if companions.iter().all(|companion| companion.moments(model).is_empty()) {
            return Ok(None);
        }
        hold_out_tracks(model, HELD_OUT_SHARE, self.seed);
        let held_out = held_out(model);
        self.refine(model, &mut [], 1.0)?;
        let judge = Judge::new(held_out, model);
        let off = model.clone();
        let mut tight = Tight::default();
        // Once more when a clock or a place turns out not to be observable.
        for _ in 0..2 {
            *model = off.clone();
            tight = self.tighten(model, &mut companions, term, &judge)?;
            let Some(Held { mountings, .. }) = &tight.best else { break };
            if !self.give_up(model, mountings, &mut companions)? {
                break;
            }
        }
        let Tight { mut best, is_firm, closed } = tight;
        let is_wanted = term == RigTerm::Hard || term == RigTerm::Auto && is_firm;
        if let Some(soft) = best.as_ref().filter(|soft| is_wanted && soft.is_anything_together()) {
            let mut candidate = soft.model.clone();
            let mut mountings =
                self.mountings(&candidate, &companions, Hold::Rigid, soft.sigmas, Unmatched::None);
            make_rigid(&mut candidate, &mountings);
            self.refine(&mut candidate, &mut mountings, 1.0)?;
            let error_px = judge.error_px(&candidate);
            if term == RigTerm::Hard || error_px <= (1.0 + RIGID_TOLERANCE) * soft.error_px {
                best = Some(Held { model: candidate, mountings, error_px, sigmas: soft.sigmas });
            }
        }
        Ok(Some(Found { off, error_off_px: judge.error_off_px, best, closed }))
    }

    /// Makes a model what was found, with all its tracks, and says what became of its cameras.
    fn finish(
        &self,
        model: &mut Reconstruction,
        found: Found,
        split: Option<ClosedSplit>,
    ) -> Result<MountedRig, Error> {
        let Found { off, error_off_px, best, .. } = found;
        let (mut mountings, mut error_px) = (Vec::new(), error_off_px);
        match best {
            Some(held) => (*model, mountings, error_px) = (held.model, held.mountings, held.error_px),
            None => *model = off,
        }
        hold_out_tracks(model, 0.0, self.seed);
        let all = Context { adjust: AdjustOptions { spread: false, ..self.adjust }, ..*self };
        all.refine(model, &mut mountings, 1.0)?;
        make_frames(model, &mountings);
        let (mut cameras, mut bad_pairs) = (Vec::new(), Vec::new());
        for (mounting, covariance) in
            mountings.iter().zip(mounting_covariances(model, &self.adjust, &mountings)?)
        {
            let held: BTreeSet<ImageId> = mounting.moments.iter().map(|moment| moment.right).collect();
            let all = mounting.companion.moments(model);
            bad_pairs.extend(all.iter().filter(|moment| !held.contains(&moment.right)).map(|moment| {
                RigPair { left: moment.nearest_left(&mounting.companion.clock), right: moment.right }
            }));
            let poses = relative_poses(model, &mounting.moments, &mounting.companion.clock);
            cameras.push(MountedCamera {
                companion: mounting.companion,
                right_from_left: mounting.right_from_left,
                covariance: covariance.map(|covariance| mounting.with_belief(covariance)),
                hold: mounting.hold,
                num_moments: all.len(),
                spread: spread(&poses),
            });
        }
        let hold = mountings.first().map(|mounting| mounting.hold);
        Ok(MountedRig { hold, cameras, bad_pairs, split, error_off_px, error_px })
    }

    /// Puts clocks of which the images tell too little back to what their stamps say, and holds places of which the motion tells too little.
    /// Returns whether there were any.
    fn give_up(
        &self,
        model: &Reconstruction,
        mountings: &[Mounting],
        companions: &mut [Companion],
    ) -> Result<bool, Error> {
        let is_open = |c: &Companion| c.timing == Timing::Free || c.unit.is_some() && c.blind.is_none();
        if !companions.iter().any(is_open) {
            return Ok(false);
        }
        let covariances = mounting_covariances(model, &self.adjust, mountings)?;
        let mut is_any = false;
        for (mounting, covariance) in mountings.iter().zip(covariances) {
            // Where rounding leaves no covariance, the motion's word stands.
            let Some(covariance) = covariance else { continue };
            let sd_s = covariance[(6, 6)].sqrt();
            for companion in companions.iter_mut().filter(|c| c.right == mounting.companion.right) {
                if companion.timing == Timing::Free && sd_s.is_nan() | (sd_s > MAX_CLOCK_SD_S) {
                    companion.timing = Timing::NotObservable;
                    companion.clock = Clock { offset_s: 0.0, drift: 0.0, ..companion.clock };
                    is_any = true;
                }
                if companion.blind.is_none() {
                    companion.blind = mounting.blind(&covariance);
                    is_any |= companion.blind.is_some();
                }
            }
        }
        Ok(is_any)
    }
}
