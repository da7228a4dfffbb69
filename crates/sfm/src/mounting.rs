//! Cameras held to the mounting that they share, found from the model itself: `--rig soft`, `hard` and `auto`.
//!
//! A model without any such term comes first. Then, per camera beside the first: (i) the mounting is the robust average of the
//! relative poses, and pairs far from it are gated: where the pair's own two-view geometry agrees with the mounting, the model is wrong
//! there (a split) and the pair takes part, else the pair is wrong and does not; (ii) the term is added, quadratic, and everything
//! adjusted (a robust loss lets go of what it should bring together: on KITTI 01 it springs back); (iii) tracks are re-created, completed and merged across the cameras, which is what keeps a closed split
//! closed; (iv) the standard deviations are tightened threefold, down to a floor, for as long as tracks that took no part are
//! explained no worse. How much the mounting gives, and how far the clocks disagree, is thereby found and not assumed.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use tiepoint_geometry::{Rigid3, so3};
use tiepoint_rig::{RelativePose, robust_average};
use tiepoint_scene::{
    CorrespondenceGraph, Frame, ImageId, ImagePair, Observation, Reconstruction, Rig, RigId, RigSensor,
};

use crate::adjust::{AdjustOptions, Scope, adjust, keep_going};
use crate::event::tell;
use crate::filter::{FilterOptions, filter_all_points};
use crate::hold_out::hold_out_tracks;
use crate::initial_pair::relative_pose;
use crate::rig_pairs::{RigPair, RigPairs, relative_poses};
use crate::tracks::{TrackOptions, recreate_tracks};
use crate::triangulation::{Sight, nearest_to_rays};
use crate::{Error, Event, RigTerm};

/// Cameras that share a mounting, and how firmly it holds them.
#[derive(Clone, Debug, PartialEq)]
pub struct Mounting {
    /// Moments of the two cameras.
    pub pairs: Vec<RigPair>,
    /// The calibration to begin with; it is adjusted.
    pub right_from_left: Rigid3,
    /// How firmly.
    pub hold: Hold,
}

/// How firmly a mounting holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hold {
    /// Up to standard deviations.
    Soft {
        /// Of each coordinate of the centre, in baselines.
        sigma_translation: f64,
        /// Of each component of the rotation, in radians.
        sigma_rotation_rad: f64,
    },
    /// Exactly: the right camera's pose is the left one's, moved by the calibration.
    Rigid,
}

/// Least standard deviations. Ten times less than any mounting gives: small biases of the lenses, seen by all tracks, bend a drive
/// with more confidence than they deserve. On KITTI 01 half a percent left 29 cm of error, where a rigid rig has 10 cm.
const SIGMA_FLOOR: (f64, f64) = (0.0005, 0.003 * std::f64::consts::PI / 180.0);
/// Greatest standard deviations to begin with.
const SIGMA_CEILING: (f64, f64) = (0.3, 0.05);
/// How much the standard deviations are tightened from step to step, and how often at most.
const TIGHTEN: f64 = 3.0;
const MAX_STEPS: usize = 6;
/// A pair this far from the mounting, in standard deviations of the spread, is looked at more closely; no less than this in baselines
/// and radians, though.
const GATE: f64 = 5.0;
const GATE_FLOOR: (f64, f64) = (0.2, 0.035);
/// A pair's own two-view geometry agrees with the mounting when their rotations and directions of translation differ by less (1° and
/// 5°, and what a pair of neighbours leaves uncertain).
const MAX_OWN_ROTATION_RAD: f64 = 0.026;
const MAX_OWN_DIRECTION_RAD: f64 = 0.175;
/// Fewer matches tell no two-view geometry.
const MIN_OWN_MATCHES: usize = 30;
/// Share of the tracks that take no part until the end.
const HELD_OUT_SHARE: f64 = 0.1;
/// Held-out observations count up to this error, in pixels.
const MAX_HELD_OUT_ERROR_PX: f64 = 4.0;
/// The term may cost the held-out tracks this much, relatively, for the same reason: on KITTI 01 a rigid rig costs them 6 %. Clocks
/// that disagree by as much as matters cost them far more.
const HELD_OUT_TOLERANCE: f64 = 0.08;
/// Cameras are held when their relative poses end within this many standard deviations of the mounting. Where clocks disagree or a mount
/// gives, they do not follow, and the firmest deviations at which they did are kept.
const MAX_LEFT: f64 = 3.0;
/// Tracks are merged across cameras that were just brought together with this many times the usual error.
const WIDENED: f64 = 2.0;
const ITERATIONS: usize = 50;

/// What the steps need of the mapper.
pub(crate) struct Context<'a> {
    pub(crate) graph: &'a CorrespondenceGraph,
    pub(crate) rigs: &'a [RigPairs],
    pub(crate) tracks: &'a TrackOptions,
    pub(crate) filter: &'a FilterOptions,
    pub(crate) adjust: AdjustOptions<'a>,
    pub(crate) seed: u64,
}

/// Holds the cameras of a finished model to their mountings, as `term` says.
pub(crate) fn hold_to_mountings(
    context: &Context,
    model: &mut Reconstruction,
    term: RigTerm,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<(), Error> {
    hold_out_tracks(model, HELD_OUT_SHARE, context.seed);
    let held_out = held_out(model);
    context.refine(model, &[], 1.0)?;
    let error_off_px = held_out_error_px(model, &held_out);
    let found = spread(context, model);
    let mut sigmas =
        (found.0.clamp(SIGMA_FLOOR.0, SIGMA_CEILING.0), found.1.clamp(SIGMA_FLOOR.1, SIGMA_CEILING.1));
    let off = model.clone();
    let mut best: Option<(Reconstruction, Vec<Mounting>, f64)> = None;
    let mut is_firm = false;
    for step in 0..MAX_STEPS {
        let hold = Hold::Soft { sigma_translation: sigmas.0, sigma_rotation_rad: sigmas.1 };
        let mut candidate = model.clone();
        let mountings = context.mountings(&candidate, hold);
        context.refine(&mut candidate, &mountings, if step == 0 { WIDENED } else { 1.0 })?;
        let error_px = held_out_error_px(&candidate, &held_out);
        let is_asked_for = term != RigTerm::Auto && step == 0;
        if !is_asked_for && error_px > (1.0 + HELD_OUT_TOLERANCE) * error_off_px {
            break;
        }
        let left = spread(context, &candidate);
        let is_held = left.0 <= MAX_LEFT * sigmas.0 && left.1 <= MAX_LEFT * sigmas.1;
        if is_held || is_asked_for {
            best = Some((candidate.clone(), mountings, error_px));
            is_firm = sigmas.0 <= SIGMA_FLOOR.0 && sigmas.1 <= SIGMA_FLOOR.1;
        }
        *model = candidate;
        if sigmas.0 <= SIGMA_FLOOR.0 && sigmas.1 <= SIGMA_FLOOR.1 {
            break;
        }
        sigmas = ((sigmas.0 / TIGHTEN).max(SIGMA_FLOOR.0), (sigmas.1 / TIGHTEN).max(SIGMA_FLOOR.1));
    }
    if (term == RigTerm::Hard || term == RigTerm::Auto && is_firm)
        && let Some((soft, _, error_soft_px)) = &best
    {
        let mut candidate = soft.clone();
        let mountings = context.mountings(&candidate, Hold::Rigid);
        make_rigid(&mut candidate, &mountings);
        context.refine(&mut candidate, &mountings, 1.0)?;
        let error_px = held_out_error_px(&candidate, &held_out);
        if term == RigTerm::Hard || error_px <= *error_soft_px {
            best = Some((candidate, mountings, error_px));
        }
    }
    let (mut mountings, mut error_px) = (Vec::new(), error_off_px);
    match best {
        Some((chosen, held, error)) => (*model, mountings, error_px) = (chosen, held, error),
        None => *model = off,
    }
    hold_out_tracks(model, 0.0, context.seed);
    context.refine(model, &mountings, 1.0)?;
    make_frames(model, &mountings);
    let held: BTreeSet<RigPair> = mountings.iter().flat_map(|m| m.pairs.iter().copied()).collect();
    for pair in context.rigs.iter().flat_map(|rig| &rig.pairs) {
        let has_poses = [pair.left, pair.right].iter().all(|id| model.image(*id).cam_from_world().is_some());
        if !mountings.is_empty() && has_poses && !held.contains(pair) {
            tell(watch, &Event::BadPair { left: pair.left, right: pair.right })?;
        }
    }
    let hold = mountings.first().map(|mounting| mounting.hold);
    tell(watch, &Event::Mounted { hold, num_pairs: held.len(), error_off_px, error_px })
}

impl Context<'_> {
    /// Adjusts, re-creates tracks between the poses that came out, and adjusts again.
    fn refine(&self, model: &mut Reconstruction, mountings: &[Mounting], widened: f64) -> Result<(), Error> {
        let options = AdjustOptions { mountings, max_iterations: ITERATIONS, ..self.adjust };
        adjust(model, &Scope::Global, &options, &mut keep_going)?;
        let tracks =
            TrackOptions { max_merge_error_px: widened * self.tracks.max_merge_error_px, ..*self.tracks };
        recreate_tracks(self.graph, model, &tracks);
        adjust(model, &Scope::Global, &options, &mut keep_going)?;
        filter_all_points(model, self.filter);
        Ok(())
    }

    /// The mountings as the model has them now, with the pairs that are to be held to them.
    fn mountings(&self, model: &Reconstruction, hold: Hold) -> Vec<Mounting> {
        let mounting = |rig: &RigPairs| -> Option<Mounting> {
            let (pairs, poses): (Vec<RigPair>, Vec<RelativePose>) =
                relative_poses(model, &rig.pairs).into_iter().unzip();
            let average = robust_average(&poses)?;
            let (spread_t, spread_r) = spread_of(&poses, &average);
            let gate = ((GATE * spread_t).max(GATE_FLOOR.0), (GATE * spread_r).max(GATE_FLOOR.1));
            let is_sound = |(pair, pose): &(&RigPair, &RelativePose)| {
                let (t, r) = deviation(pose, &average);
                (t <= gate.0 && r <= gate.1) || self.agrees_itself(model, pair, &average)
            };
            let pairs: Vec<RigPair> =
                pairs.iter().zip(&poses).filter(is_sound).map(|(pair, _)| *pair).collect();
            (pairs.len() >= 2).then(|| Mounting { pairs, right_from_left: average.right_from_left(), hold })
        };
        self.rigs.iter().filter_map(mounting).collect()
    }

    /// Whether the matches of a pair alone agree with the mounting.
    fn agrees_itself(&self, model: &Reconstruction, pair: &RigPair, average: &RelativePose) -> bool {
        let own = || -> Option<RelativePose> {
            let key = ImagePair::new(pair.left, pair.right)?;
            let two_view = self.graph.pairs().get(&key)?;
            if two_view.matches.len() < MIN_OWN_MATCHES {
                return None;
            }
            let b_from_a = relative_pose(model, &key, two_view)?;
            let right_from_left = if key.a == pair.left { b_from_a } else { b_from_a.inverse() };
            Some(RelativePose::between(&Rigid3::identity(), &right_from_left))
        };
        own().is_some_and(|own| {
            let (own_t, t) = (own.translation.normalize(), average.translation.normalize());
            let rotation = so3::exp(&own.axis_angle).angle_to(&so3::exp(&average.axis_angle));
            rotation < MAX_OWN_ROTATION_RAD
                && own_t.cross(&t).norm() < MAX_OWN_DIRECTION_RAD
                && own_t.dot(&t) > 0.0
        })
    }
}

/// Distance of the centre in baselines, and angle.
fn deviation(pose: &RelativePose, average: &RelativePose) -> (f64, f64) {
    let baseline = average.translation.norm().max(f64::MIN_POSITIVE);
    (
        (pose.translation - average.translation).norm() / baseline,
        so3::exp(&pose.axis_angle).angle_to(&so3::exp(&average.axis_angle)),
    )
}

/// Medians of the deviations as standard deviations of a component.
fn spread_of(poses: &[RelativePose], average: &RelativePose) -> (f64, f64) {
    // The median length of a vector of three unit normals.
    const MEDIAN_OF_THREE: f64 = 1.538;
    let (mut ts, mut rs): (Vec<f64>, Vec<f64>) = poses.iter().map(|pose| deviation(pose, average)).unzip();
    ts.sort_by(f64::total_cmp);
    rs.sort_by(f64::total_cmp);
    (ts[ts.len() / 2] / MEDIAN_OF_THREE, rs[rs.len() / 2] / MEDIAN_OF_THREE)
}

/// The widest spread of any camera, as standard deviations of components.
fn spread(context: &Context, model: &Reconstruction) -> (f64, f64) {
    let mut widest = (0.0_f64, 0.0_f64);
    for rig in context.rigs {
        let poses: Vec<RelativePose> =
            relative_poses(model, &rig.pairs).into_iter().map(|(_, pose)| pose).collect();
        let Some(average) = robust_average(&poses) else { continue };
        let (t, r) = spread_of(&poses, &average);
        widest = (widest.0.max(t), widest.1.max(r));
    }
    widest
}

/// Moves the right cameras to where rigid mountings have them.
fn make_rigid(model: &mut Reconstruction, mountings: &[Mounting]) {
    for mounting in mountings.iter().filter(|mounting| mounting.hold == Hold::Rigid) {
        // After an adjustment all pairs have one relative pose, before it their average serves.
        let poses: Vec<RelativePose> =
            relative_poses(model, &mounting.pairs).into_iter().map(|(_, pose)| pose).collect();
        let Some(average) = robust_average(&poses) else { continue };
        for pair in &mounting.pairs {
            let Some(left) = model.image(pair.left).cam_from_world().copied() else { continue };
            model.register(pair.right, average.right_from_left() * left);
        }
    }
}

/// Rigid mountings become the model's rig, their moments its frames.
fn make_frames(model: &mut Reconstruction, mountings: &[Mounting]) {
    let mut sensors: Vec<RigSensor> = Vec::new();
    let mut images: BTreeMap<ImageId, Vec<ImageId>> = BTreeMap::new();
    for mounting in mountings.iter().filter(|mounting| mounting.hold == Hold::Rigid) {
        let pose = |image| model.image(image).cam_from_world().copied();
        let both = mounting.pairs.iter().filter_map(|pair| Some((pair, pose(pair.left)?, pose(pair.right)?)));
        for (pair, left, right) in both {
            let camera = model.image(pair.right).camera;
            if sensors.is_empty() {
                let reference = model.image(pair.left).camera;
                sensors.push(RigSensor { camera: reference, cam_from_rig: Some(Rigid3::identity()) });
            }
            if sensors.iter().all(|sensor| sensor.camera != camera) {
                sensors.push(RigSensor { camera, cam_from_rig: Some(right * left.inverse()) });
            }
            images.entry(pair.left).or_insert_with(|| vec![pair.left]).push(pair.right);
        }
    }
    if sensors.len() < 2 {
        return;
    }
    model.rigs.push(Rig { sensors });
    let rig = RigId::from_index(model.rigs.len() - 1);
    for (left, images) in images {
        if let Some(rig_from_world) = model.image(left).cam_from_world().copied() {
            model.frames.push(Frame { rig, rig_from_world, images });
        }
    }
}

/// Observations of the tracks that are held out and can contradict the poses.
fn held_out(model: &Reconstruction) -> Vec<Vec<Observation>> {
    model
        .tracks()
        .filter(|(_, track)| track.is_held_out && track.observations.len() >= 3)
        .map(|(_, track)| track.observations.clone())
        .collect()
}

/// Root mean square of the truncated errors of tracks that are triangulated anew between the poses of now: the same observations
/// whatever the model did with them.
fn held_out_error_px(model: &Reconstruction, tracks: &[Vec<Observation>]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for observations in tracks {
        let sights: Vec<Sight> = observations.iter().filter_map(|o| Sight::of(model, o)).collect();
        let xyz = nearest_to_rays(sights.iter());
        for observation in observations {
            let error = xyz.and_then(|xyz| model.error_of_px(observation, &xyz));
            sum += error.unwrap_or(f64::INFINITY).min(MAX_HELD_OUT_ERROR_PX).powi(2);
            count += 1;
        }
    }
    (sum / count.max(1) as f64).sqrt()
}
