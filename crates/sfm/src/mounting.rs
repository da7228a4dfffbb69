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

mod members;
mod outcome;
mod persistence;
mod rematch;
mod rigid;
mod tighten;

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_ba::Factor;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Vector3, Vector6};
use tiepoint_geometry::numeric::median;
use tiepoint_rig::{Clock, Mounted, RelativePose, spread};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use crate::adjust::{
    AdjustOptions, MountingCovariance, Scope, adjust_mounted, keep_going, mounting_covariances,
};
use crate::companion::{Companion, Moment, Timing, companions};
use crate::event::{MountedCamera, tell};
use crate::filter::{FilterOptions, filter_all_points};
use crate::hold_out::hold_out_tracks;
use crate::tracks::{TrackOptions, recreate_tracks};
use crate::{Error, Event, RigTerm};
use members::Unmatched;
use outcome::{Judge, held_out, make_frames, make_rigid};
use persistence::persistence;
pub use rematch::Descriptors;
use rematch::{Closed, rematch};
pub use rigid::{RigidCamera, hold_rigidly};
use tighten::Tight;

/// A camera's mounting beside the first one, and how firmly it holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Mounting {
    /// Which cameras, and the other one's clock; that is adjusted where it is free.
    pub companion: Companion,
    /// Where the two are held to each other.
    pub moments: Vec<Moment>,
    /// The calibration to begin with; it is adjusted.
    pub right_from_left: Rigid3,
    /// How firmly.
    pub hold: Hold,
    /// At these of the moments the model had the camera elsewhere, for want of matches with the first one.
    pub(crate) closed: Vec<Closed>,
}

/// How firmly a mounting holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hold {
    /// Up to standard deviations.
    Soft {
        /// Of each coordinate of the centre, in baselines, or in the unit of cameras that see nothing in common.
        sigma_translation: f64,
        /// Of each component of the rotation, in radians.
        sigma_rotation_rad: f64,
    },
    /// Exactly: the right camera's pose is the left one's, moved by the calibration.
    Rigid,
}

impl Hold {
    fn soft(sigmas: (f64, f64)) -> Self {
        Self::Soft { sigma_translation: sigmas.0, sigma_rotation_rad: sigmas.1 }
    }

    /// With standard deviations that many times as large.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Soft { sigma_translation, sigma_rotation_rad } => {
                Self::soft((factor * sigma_translation, factor * sigma_rotation_rad))
            }
            Self::Rigid => Self::Rigid,
        }
    }
}

/// Share of the tracks that take no part until the end.
const HELD_OUT_SHARE: f64 = 0.1;
/// A rigid rig may cost the held-out tracks this much more than the firmest soft one: between the two they tell biases of the lenses. On KITTI 04
/// it costs 0.2 %, on KITTI 01 0.8 %, where the trajectory is a sixth better for it; a mount that gives has not reached the floor.
const RIGID_TOLERANCE: f64 = 0.01;
/// Cameras are held when their relative poses end within this many standard deviations of the mounting. Where clocks disagree or a mount
/// gives, they do not follow, and the firmest deviations at which they did are kept. With 3 a mount that swings passed, and pulled the clock by 6 ms.
const MAX_LEFT: f64 = 2.0;
/// Where an offset's standard deviation is larger than this, its value would be an accident of the lenses.
const MAX_CLOCK_SD_S: f64 = 0.02;
/// The motion tells nothing of a camera's place along a direction when it leaves a standard deviation of more than this share of the unit: what
/// the models have drifted apart would decide it.
const MAX_PLACE_SD: f64 = 0.1;
/// Tracks are merged across cameras that were just brought together with this many times the usual error.
const WIDENED: f64 = 2.0;
const ITERATIONS: usize = 50;

/// What the steps need of the mapper.
pub(crate) struct Context<'a> {
    pub(crate) graph: &'a CorrespondenceGraph,
    pub(crate) tracks: &'a TrackOptions,
    pub(crate) filter: &'a FilterOptions,
    pub(crate) adjust: AdjustOptions<'a>,
    pub(crate) seed: u64,
}

/// Holds the cameras of a finished model to their mountings, as `term` says. Where that closes splits whose images had no matches with
/// their partners, those are matched again, with what `descriptors` gives, and everything is done anew with what was found.
pub(crate) fn hold_to_mountings(
    context: &Context,
    model: &mut Reconstruction,
    term: RigTerm,
    descriptors: &mut Descriptors,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<(), Error> {
    let Some(found) = context.find_hold(model, term)? else { return Ok(()) };
    let Some(Held { model: closed, mountings, .. }) =
        found.best.as_ref().filter(|_| !found.closed.is_empty())
    else {
        return context.finish(model, found, watch);
    };
    let two_views = rematch(context.graph, closed, &found.closed, descriptors, context.seed);
    let (num_images, num_pairs) = (found.closed.len(), two_views.len());
    tell(watch, &Event::SplitClosed { num_images, num_pairs })?;
    if two_views.is_empty() {
        return context.finish(model, found, watch);
    }
    let graph = context.graph.extended(two_views);
    let context = Context { graph: &graph, ..*context };
    *model = closed.clone();
    context.refine(model, &mut mountings.clone(), WIDENED)?;
    match context.find_hold(model, term)? {
        Some(found) => context.finish(model, found, watch),
        None => Ok(()),
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

/// A model whose cameras are held.
struct Held {
    model: Reconstruction,
    mountings: Vec<Mounting>,
    error_px: f64,
    sigmas: (f64, f64),
}

impl Held {
    /// Whether all cameras follow in translation, and in rotation.
    fn follows(&self) -> [bool; 2] {
        let each = self.mountings.iter().map(|mounting| mounting.follows(&self.model));
        each.fold([true; 2], |all, one| [all[0] && one[0], all[1] && one[1]])
    }

    fn is_anything_together(&self) -> bool {
        self.mountings.iter().any(|mounting| mounting.companion.timing == Timing::Together)
    }
}

impl Mounting {
    /// With standard deviations that many times as large, also of what is doubtful about its moments.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        let mut scaled = Self { hold: self.hold.scaled(factor), ..self.clone() };
        scaled.moments.iter_mut().for_each(|moment| moment.scale_doubts(factor));
        scaled
    }

    /// What is left between the cameras at each moment, in standard deviations: of the translation, then of the rotation; none of cameras
    /// that are held exactly.
    fn left(&self, model: &Reconstruction) -> Vec<Vector6<f64>> {
        let Hold::Soft { sigma_translation, sigma_rotation_rad } = self.hold else { return Vec::new() };
        let mounted = Mounted { sigma_translation, sigma_rotation_rad, unit: self.companion.unit };
        let left_over = |moment: &Moment| {
            let left = moment.left_from_world(model, &self.companion.clock)?;
            let right = model.image(moment.right).cam_from_world()?;
            let residual = mounted.residual((&left, right, &self.right_from_left))?;
            Some(moment.whitening(&mounted, &left, &self.right_from_left) * residual)
        };
        self.moments.iter().filter_map(left_over).collect()
    }

    /// Whether the cameras follow in translation, and in rotation: half of the moments are within a few standard deviations.
    fn follows(&self, model: &Reconstruction) -> [bool; 2] {
        let left = self.left(model);
        [0, 3].map(|first| {
            let mut norms: Vec<f64> = left.iter().map(|r| r.fixed_rows::<3>(first).norm()).collect();
            median(&mut norms).is_none_or(|norm| norm <= MAX_LEFT * MEDIAN_OF_THREE)
        })
    }

    /// With standard deviations so large that moments count as if what is left at one told nothing of the next: what a mount that swings leaves goes
    /// on from moment to moment, and n of them tell less than n would.
    pub(crate) fn as_if_independent(&self, model: &Reconstruction) -> Self {
        let Hold::Soft { sigma_translation, sigma_rotation_rad } = self.hold else { return self.clone() };
        let left = self.left(model);
        let [translation, rotation] = [0, 3].map(|first| {
            let series: Vec<Vector3<f64>> =
                left.iter().map(|r| r.fixed_rows::<3>(first).into_owned()).collect();
            persistence(&series).sqrt()
        });
        let hold = Hold::soft((translation * sigma_translation, rotation * sigma_rotation_rad));
        Self { hold, ..self.clone() }
    }

    /// Moves the further camera to where a calibration has it, at every moment.
    fn place(&self, model: &mut Reconstruction, right_from_left: &Rigid3) {
        for moment in &self.moments {
            if let Some(left) = moment.left_from_world(model, &self.companion.clock) {
                model.register(moment.right, *right_from_left * left);
            }
        }
    }

    /// The direction of the camera's centre, in the first camera's frame, that the motion does not tell.
    fn blind(&self, covariance: &MountingCovariance) -> Option<Vector3<f64>> {
        let unit = self.companion.unit?;
        // c = -Rᵀ t; what the rotation adds is less by the baseline over a radian.
        let rotation = self.right_from_left.rotation.to_rotation_matrix().into_inner();
        let of_centre = rotation.transpose() * covariance.fixed_view::<3, 3>(3, 3) * rotation;
        let eigen = of_centre.symmetric_eigen();
        let (index, variance) = eigen.eigenvalues.argmax();
        (variance.max(0.0).sqrt() > MAX_PLACE_SD * unit).then(|| {
            let direction = eigen.eigenvectors.column(index);
            // Of the two signs, that of its largest part.
            direction * direction[direction.iamax()].signum()
        })
    }

    /// Along the direction that the motion does not tell, a place is known by what was believed beforehand.
    fn with_belief(&self, mut covariance: MountingCovariance) -> MountingCovariance {
        if let Companion { unit: Some(unit), blind: Some(blind), .. } = self.companion {
            let along = self.right_from_left.rotation * blind * unit;
            let mut of_place = covariance.fixed_view_mut::<3, 3>(3, 3);
            of_place += along * along.transpose();
        }
        covariance
    }
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

    /// Makes a model what was found, with all its tracks, and tells.
    fn finish(
        &self,
        model: &mut Reconstruction,
        found: Found,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
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
        for (mounting, covariance) in
            mountings.iter().zip(mounting_covariances(model, &self.adjust, &mountings)?)
        {
            let held: BTreeSet<ImageId> = mounting.moments.iter().map(|moment| moment.right).collect();
            let all = mounting.companion.moments(model);
            for moment in all.iter().filter(|moment| !held.contains(&moment.right)) {
                let left = moment.nearest_left(&mounting.companion.clock);
                tell(watch, &Event::BadPair { left, right: moment.right })?;
            }
            let poses = relative_poses(model, &mounting.moments, &mounting.companion.clock);
            let camera = MountedCamera {
                companion: mounting.companion,
                right_from_left: mounting.right_from_left,
                covariance: covariance.map(|covariance| mounting.with_belief(covariance)),
                hold: mounting.hold,
                num_moments: all.len(),
                spread: spread(&poses),
            };
            tell(watch, &Event::MountedCamera(Box::new(camera)))?;
        }
        let num_pairs = mountings.iter().map(|mounting| mounting.moments.len()).sum();
        let hold = mountings.first().map(|mounting| mounting.hold);
        tell(watch, &Event::Mounted { hold, num_pairs, error_off_px, error_px })
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

    /// Adjusts, re-creates tracks between the poses that came out, and adjusts again.
    fn refine(
        &self,
        model: &mut Reconstruction,
        mountings: &mut [Mounting],
        widened: f64,
    ) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        adjust_mounted(model, &Scope::Global, &options, mountings, &mut keep_going)?;
        let tracks =
            TrackOptions { max_merge_error_px: widened * self.tracks.max_merge_error_px, ..*self.tracks };
        recreate_tracks(self.graph, model, &tracks);
        adjust_mounted(model, &Scope::Global, &options, mountings, &mut keep_going)?;
        filter_all_points(model, self.filter);
        Ok(())
    }
}

/// The relative poses at those of some moments where both cameras have one.
fn relative_poses(model: &Reconstruction, moments: &[Moment], clock: &Clock) -> Vec<RelativePose> {
    moments.iter().filter_map(|moment| moment.relative_pose(model, clock)).collect()
}

/// Distance of the centres in baselines, and angle.
fn deviation(a: &RelativePose, b: &RelativePose, baseline: f64) -> (f64, f64) {
    let (distance, angle) = a.apart(b);
    (distance / baseline.max(f64::MIN_POSITIVE), angle)
}

/// Medians of the deviations as standard deviations of a component.
fn spread_of(poses: &[RelativePose], average: &RelativePose, unit: Option<f64>) -> (f64, f64) {
    let baseline = unit.unwrap_or_else(|| average.translation.norm());
    let (mut ts, mut rs): (Vec<f64>, Vec<f64>) =
        poses.iter().map(|pose| deviation(pose, average, baseline)).unzip();
    let sigma = |norms: &mut [f64]| median(norms).unwrap_or(0.0) / MEDIAN_OF_THREE;
    (sigma(&mut ts), sigma(&mut rs))
}

/// The median length of a vector of three unit normals.
const MEDIAN_OF_THREE: f64 = 1.538;
