//! Cameras that ride with the first one: at which moments the two are compared, by whose clock.
//!
//! The images of a further camera need no partner. Where the first camera was when one of them was
//! taken is interpolated between four of its images, at the time that the further camera's clock
//! gives; only where the cameras are triggered together, or nothing is known of times, two images
//! are of one instant.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_rig::{
    Clock, InterpolatedExtrinsics, RelativePose, SynchronousExtrinsics, Trajectory, find_offset,
    interval_s, scaled_motion, timestamp_jitter_s,
};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::pairs::{RigPair, by_name, by_time};
use crate::timeline::{images_in_time, images_of_cameras};

/// An image of a further camera, and where the first camera was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencedImage {
    /// The image.
    pub right: ImageId,
    /// What tells where the first camera was.
    pub reference: ReferencePose,
}

/// What tells where the first camera was at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "where one referenced is large, nearly all are")]
pub enum ReferencePose {
    /// Its image of the same instant.
    Synchronous(ImageId),
    /// Four consecutive images around it.
    Interpolated {
        /// The images.
        images: [ImageId; 4],
        /// When they were taken.
        times_s: [f64; 4],
        /// When the further camera's image was taken, on its own clock.
        right_time_s: f64,
        /// Motions by which the pose in between may be off, one standard deviation each.
        pose_perturbations: [Rigid3; 5],
    },
}

impl ReferencedImage {
    /// The pose of the first camera then; `None` where an image has no pose.
    pub fn left_from_world(&self, model: &Reconstruction, clock: &Clock) -> Option<Rigid3> {
        let pose = |image: ImageId| model.image(image).cam_from_world();
        match self.reference {
            ReferencePose::Synchronous(image) => pose(image).copied(),
            ReferencePose::Interpolated { images: [a, b, c, d], times_s, right_time_s, .. } => {
                let poses = [pose(a)?, pose(b)?, pose(c)?, pose(d)?];
                let knots = tiepoint_rig::Knots { poses, times_s };
                Some(knots.at(clock.reference_time_s(right_time_s)))
            }
        }
    }

    /// The relative pose of the two cameras then.
    pub fn relative_pose(&self, model: &Reconstruction, clock: &Clock) -> Option<RelativePose> {
        let left = self.left_from_world(model, clock)?;
        Some(RelativePose::between(&left, model.image(self.right).cam_from_world()?))
    }

    /// Makes what is doubtful about the first camera's pose that many times as large.
    pub(crate) fn scale_perturbations(&mut self, factor: f64) {
        if let ReferencePose::Interpolated { pose_perturbations, .. } = &mut self.reference {
            *pose_perturbations =
                pose_perturbations.map(|perturbation| scaled_motion(&perturbation, factor));
        }
    }

    /// What the residual of a mounting is multiplied by, for what is doubtful about the first
    /// camera's pose.
    pub(crate) fn whitening(
        &self,
        mounted: &SynchronousExtrinsics,
        left_from_world: &Rigid3,
        right_from_left: &Rigid3,
    ) -> SMatrix<f64, 6, 6> {
        match &self.reference {
            ReferencePose::Synchronous(_) => SMatrix::identity(),
            ReferencePose::Interpolated { pose_perturbations, .. } => {
                InterpolatedExtrinsics::whitening(
                    mounted,
                    left_from_world,
                    right_from_left,
                    pose_perturbations,
                )
            }
        }
    }

    /// The first camera's image that is nearest in time.
    pub fn nearest_left(&self, clock: &Clock) -> ImageId {
        match self.reference {
            ReferencePose::Synchronous(image) => image,
            ReferencePose::Interpolated { images, times_s, right_time_s, .. } => {
                let time_s = clock.reference_time_s(right_time_s);
                let nearest = (0..4).min_by(|&a, &b| {
                    (times_s[a] - time_s).abs().total_cmp(&(times_s[b] - time_s).abs())
                });
                images[nearest.unwrap_or(0)]
            }
        }
    }
}

/// How the times of two cameras relate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockState {
    /// Their images are of the same instants: the clock is known, and exact.
    Synchronised,
    /// The clock is to be found.
    Estimated,
    /// Nothing tells the clock, as on a straight road at one speed: it stays at what the time
    /// stamps say.
    Unobservable,
}

impl ClockState {
    /// A clock that is to stay for now.
    pub(crate) fn held(self) -> Self {
        if self == Self::Estimated { Self::Unobservable } else { self }
    }
}

/// A camera that rides with the first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigSensor {
    /// The first camera.
    pub left: CameraId,
    /// The other one.
    pub right: CameraId,
    /// The other one's clock.
    pub clock: Clock,
    /// How well that is known.
    pub clock_state: ClockState,
    /// Where the two cameras see nothing in common, what stands for their distance, of which their
    /// motion may tell nothing: the usual distance of consecutive images of the first camera.
    pub assumed_baseline: Option<f64>,
    /// Where their motion tells nothing of the camera's place along some direction (a unit vector
    /// in the first camera's frame, upwards on a flat road): it stays at zero along it.
    pub unobservable_direction: Option<Vector3<f64>>,
}

/// An offset is moved away from what the stamps say only if the images say so this much more likely
/// (natural logarithm); far more than chance asks for, since errors of neighbours in a model go
/// together.
const MIN_GAIN: f64 = 10.0;
/// Where the motion tells an offset no better than this, in seconds, and does not contradict the
/// stamps, they are believed: small biases of lenses bend a drive at one speed more than its
/// keypoints' noise lets the adjustment think.
const MAX_MOTION_SD_S: f64 = 0.002;
/// Cameras are triggered together when an offset at which nine in ten of their images coincide (to
/// this share of the interval) is this near to the one found: so many standard deviations of it,
/// for the same reason, but no more than this share of the interval; or so many seconds.
const MAX_JITTER: f64 = 0.02;
const COINCIDING: f64 = 0.9;
const MAX_DEVIATIONS: f64 = 6.0;
const MAX_PHASE: f64 = 0.1;
const MIN_PHASE_S: f64 = 0.001;

/// Every camera that rides with the first one, as far as times, names or motion tell.
pub fn rig_sensors(model: &Reconstruction) -> Vec<RigSensor> {
    let cameras = images_of_cameras(model);
    let mut cameras = cameras.iter();
    let Some((&left, left_images)) = cameras.next() else { return Vec::new() };
    cameras
        .filter_map(|(&right, right_images)| {
            let assumed_baseline = if have_common_points(model, left, right) {
                None
            } else {
                usual_step(model, left_images)
            };
            let rig_sensor = |clock, clock_state| RigSensor {
                left,
                right,
                clock,
                clock_state,
                assumed_baseline,
                unobservable_direction: None,
            };
            let (Some(lefts), Some(rights)) =
                (images_in_time(model, left_images), images_in_time(model, right_images))
            else {
                return Some(rig_sensor(Clock::default(), ClockState::Synchronised));
            };
            let pivot_s = 0.5 * (rights.first()?.0 + rights.last()?.0);
            // What has no pose tells nothing.
            let posed = |times: &[(f64, ImageId)]| -> Vec<(f64, Rigid3)> {
                let pose = |id: ImageId| model.image(id).cam_from_world().copied();
                times.iter().filter_map(|&(time_s, id)| Some((time_s, pose(id)?))).collect()
            };
            let (lefts, rights) = (Trajectory::new(posed(&lefts)), posed(&rights));
            let clock = |offset_s| Clock { offset_s, drift: 0.0, pivot_s };
            let Some(found) = find_offset(&lefts, &rights) else {
                return Some(rig_sensor(clock(0.0), ClockState::Synchronised));
            };
            // What is not clearly better than no offset is none.
            let agrees = found.gain < MIN_GAIN;
            let offset_s = if agrees { 0.0 } else { found.offset_s };
            let tolerance_s = (MAX_DEVIATIONS * found.sd_s).min(MAX_PHASE * lefts.interval_s());
            let is_near = |exact_s: f64| {
                (exact_s - offset_s).abs() <= MIN_PHASE_S
                    || (exact_s - found.offset_s).abs() <= tolerance_s
            };
            Some(match coinciding(lefts.times_s(), &rights, offset_s) {
                Some(exact_s) if is_near(exact_s) => {
                    rig_sensor(clock(exact_s), ClockState::Synchronised)
                }
                _ if agrees && found.sd_s > MAX_MOTION_SD_S => {
                    rig_sensor(clock(offset_s), ClockState::Unobservable)
                }
                _ => rig_sensor(clock(offset_s), ClockState::Estimated),
            })
        })
        .collect()
}

/// Whether some point is seen by both cameras.
fn have_common_points(model: &Reconstruction, left: CameraId, right: CameraId) -> bool {
    model.tracks().any(|(_, track)| {
        let is_seen_by =
            |camera| track.observations.iter().any(|o| model.image(o.image).camera == camera);
        is_seen_by(left) && is_seen_by(right)
    })
}

/// The median distance of consecutive images of a camera.
fn usual_step(model: &Reconstruction, images: &[ImageId]) -> Option<f64> {
    let pose = |id: &ImageId| model.image(*id).cam_from_world().map(Rigid3::origin_in_a);
    let centres: Vec<_> = images.iter().filter_map(pose).collect();
    let mut steps: Vec<f64> = centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    median(&mut steps).filter(|step| *step > 0.0)
}

/// The offset nearest to the given one at which images of the two cameras coincide; `None` where
/// they do not at any.
fn coinciding(left_s: &[f64], rights: &[(f64, Rigid3)], offset_s: f64) -> Option<f64> {
    let interval_s = interval_s(left_s);
    let phase = |&(time_s, _): &(f64, Rigid3)| {
        let time_s = time_s + offset_s;
        let after = left_s.partition_point(|left| *left < time_s);
        [after.checked_sub(1), Some(after)]
            .into_iter()
            .filter_map(|index| Some(time_s - left_s.get(index?)?))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .filter(|phase| phase.abs() <= interval_s)
    };
    let mut phases: Vec<f64> = rights.iter().filter_map(phase).collect();
    let median = median(&mut phases)?;
    let coincide =
        phases.iter().filter(|phase| (*phase - median).abs() <= MAX_JITTER * interval_s).count();
    (coincide as f64 >= COINCIDING * phases.len() as f64).then_some(offset_s - median)
}

impl RigSensor {
    /// The moments at which both have poses, in order of time.
    pub fn referenced_images(&self, model: &Reconstruction) -> Vec<ReferencedImage> {
        let images: BTreeMap<CameraId, Vec<ImageId>> = images_of_cameras(model);
        let (Some(left_images), Some(right_images)) =
            (images.get(&self.left), images.get(&self.right))
        else {
            return Vec::new();
        };
        let has_pose = |id: ImageId| model.image(id).cam_from_world().is_some();
        let of_one_instant = |pairs: Vec<RigPair>| -> Vec<ReferencedImage> {
            let both = pairs.iter().filter(|pair| has_pose(pair.left) && has_pose(pair.right));
            both.map(|pair| ReferencedImage {
                right: pair.right,
                reference: ReferencePose::Synchronous(pair.left),
            })
            .collect()
        };
        let (Some(lefts), Some(mut rights)) =
            (images_in_time(model, left_images), images_in_time(model, right_images))
        else {
            return of_one_instant(by_name(model, left_images, right_images));
        };
        if self.clock_state == ClockState::Synchronised {
            rights
                .iter_mut()
                .for_each(|(time_s, _)| *time_s = self.clock.reference_time_s(*time_s));
            return of_one_instant(by_time(&lefts, &rights));
        }
        let lefts: Vec<(f64, ImageId, Rigid3)> = lefts
            .iter()
            .filter_map(|&(time_s, id)| Some((time_s, id, *model.image(id).cam_from_world()?)))
            .collect();
        let trajectory = Trajectory::new(lefts.iter().map(|(time_s, _, pose)| (*time_s, *pose)));
        let right_s: Vec<f64> = rights.iter().map(|(time_s, _)| *time_s).collect();
        let time_sigma_s =
            timestamp_jitter_s(trajectory.times_s()).hypot(timestamp_jitter_s(&right_s));
        let referenced = |&(right_time_s, right): &(f64, ImageId)| {
            let time_s = self.clock.reference_time_s(right_time_s);
            let first = trajectory.knots_around(time_s)?;
            let pose_perturbations = trajectory.pose_perturbations(first, time_s, time_sigma_s);
            let images = std::array::from_fn(|k| lefts[first + k].1);
            let times_s = std::array::from_fn(|k| lefts[first + k].0);
            Some(ReferencedImage {
                right,
                reference: ReferencePose::Interpolated {
                    images,
                    times_s,
                    right_time_s,
                    pose_perturbations,
                },
            })
        };
        rights.iter().filter(|(_, right)| has_pose(*right)).filter_map(referenced).collect()
    }
}
