//! Pairs of the rig's reference camera and another camera of the rig, and the clock offset between
//! them. The rig frame is the frame of the reference camera, so `rig_from_world` is its pose.
//!
//! Cameras of a rig need not be triggered at the same instants. The time of another camera's image
//! is converted to the reference camera's clock, and the pose of the reference camera at that time
//! is interpolated between four of its images. Images of synchronised cameras are paired one to
//! one. Images without times are paired by their names, unless the motion contradicts that those of
//! the same number were taken at the same instant: then the numbers of frames take the place of
//! times.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_rig::{
    Clock, InterpolatedExtrinsics, OffsetEstimate, RelativePose, SynchronousExtrinsics, Trajectory,
    find_offset, find_unrelated_offset, interval_s, scaled_motion, timestamp_jitter_s,
};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::pairs::{RigPair, by_name, by_time};
use super::succession::rig_candidates_apart;
use crate::timeline::{NUMBERED_FRAME_S, TwoTimelines, images_of_cameras, two_timelines};

/// An image of the non-reference camera, and the source of the reference camera's pose at that
/// time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencedImage {
    /// The image of the non-reference camera.
    pub image: ImageId,
    /// Source of the reference camera's pose.
    pub reference: ReferencePose,
}

/// Source of the reference camera's pose at the time of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "where one referenced is large, nearly all are")]
pub enum ReferencePose {
    /// An image of the same instant.
    Synchronous(ImageId),
    /// Interpolation between four consecutive images around the time.
    Interpolated {
        /// The four images, in order of time.
        images: [ImageId; 4],
        /// Their times on the reference camera's clock, in seconds.
        times_s: [f64; 4],
        /// Time of the other camera's image on its own clock, in seconds.
        image_time_s: f64,
        /// Perturbations of the interpolated pose, one standard deviation each: interpolation error
        /// and time-stamp jitter.
        pose_perturbations: [Rigid3; 5],
    },
}

impl ReferencedImage {
    /// Returns the pose of the reference camera at the time of the image; `None` if an image has no
    /// pose.
    pub fn rig_from_world(&self, model: &Reconstruction, clock: &Clock) -> Option<Rigid3> {
        let pose = |image: ImageId| model.image(image).cam_from_world();
        match self.reference {
            ReferencePose::Synchronous(image) => pose(image).copied(),
            ReferencePose::Interpolated { images: [a, b, c, d], times_s, image_time_s, .. } => {
                let poses = [pose(a)?, pose(b)?, pose(c)?, pose(d)?];
                let knots = tiepoint_rig::Knots { poses, times_s };
                Some(knots.at(clock.reference_time_s(image_time_s)))
            }
        }
    }

    /// Returns the relative pose of the two cameras; `None` if an image has no pose.
    pub fn relative_pose(&self, model: &Reconstruction, clock: &Clock) -> Option<RelativePose> {
        let reference = self.rig_from_world(model, clock)?;
        Some(RelativePose::between(&reference, model.image(self.image).cam_from_world()?))
    }

    /// Multiplies the standard deviations of the interpolated pose by `factor`.
    pub(crate) fn scale_perturbations(&mut self, factor: f64) {
        if let ReferencePose::Interpolated { pose_perturbations, .. } = &mut self.reference {
            *pose_perturbations =
                pose_perturbations.map(|perturbation| scaled_motion(&perturbation, factor));
        }
    }

    /// Returns the 6×6 whitening of the extrinsics residual that accounts for the covariance of the
    /// interpolated reference pose.
    pub(crate) fn whitening(
        &self,
        synchronous: &SynchronousExtrinsics,
        rig_from_world: &Rigid3,
        cam_from_rig: &Rigid3,
    ) -> SMatrix<f64, 6, 6> {
        match &self.reference {
            ReferencePose::Synchronous(_) => SMatrix::identity(),
            ReferencePose::Interpolated { pose_perturbations, .. } => {
                InterpolatedExtrinsics::whitening(
                    synchronous,
                    rig_from_world,
                    cam_from_rig,
                    pose_perturbations,
                )
            }
        }
    }

    /// Returns the image of the reference camera that is nearest in time.
    pub fn nearest_reference(&self, clock: &Clock) -> ImageId {
        match self.reference {
            ReferencePose::Synchronous(image) => image,
            ReferencePose::Interpolated { images, times_s, image_time_s, .. } => {
                let time_s = clock.reference_time_s(image_time_s);
                let nearest = (0..4).min_by(|&a, &b| {
                    (times_s[a] - time_s).abs().total_cmp(&(times_s[b] - time_s).abs())
                });
                images[nearest.unwrap_or(0)]
            }
        }
    }
}

/// State of the time offset between two cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockState {
    /// The cameras are triggered at the same instants. The offset is exact.
    Synchronised,
    /// Offset and drift are estimated.
    Estimated,
    /// The motion does not determine the offset, for example on a straight road at constant speed.
    /// The offset follows the time stamps and is not estimated.
    Unobservable,
}

impl ClockState {
    /// The state with a constant clock.
    pub(crate) fn constant(self) -> Self {
        if self == Self::Estimated { Self::Unobservable } else { self }
    }
}

/// A reference camera and another camera on the same rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorPair {
    /// The reference camera.
    pub reference: CameraId,
    /// The other camera.
    pub other: CameraId,
    /// Clock of the other camera: `t_reference = t_other + offset`.
    pub clock: Clock,
    /// State of the clock.
    pub clock_state: ClockState,
    /// Set when the two cameras have no common points, so that their motion may not determine the
    /// baseline. The median distance between consecutive images of the reference camera then
    /// replaces the baseline as the unit of length.
    pub assumed_baseline: Option<f64>,
    /// Direction along which the motion does not determine the other camera's centre: a unit vector
    /// in the reference camera's frame, for example upwards on a flat road. The centre is kept at
    /// zero along it.
    pub unobservable_direction: Option<Vector3<f64>>,
}

impl SensorPair {
    /// Two cameras with common points and one clock.
    pub fn synchronised(reference: CameraId, other: CameraId) -> Self {
        Self {
            reference,
            other,
            clock: Clock::default(),
            clock_state: ClockState::Synchronised,
            assumed_baseline: None,
            unobservable_direction: None,
        }
    }
}

/// Maximum standard deviation, in seconds, of an offset that the motion determines. Above it the
/// time stamps are used unless the motion contradicts them: at constant speed small lens biases
/// change the trajectory by more than the noise of the keypoints predicts.
const MAX_MOTION_SD_S: f64 = 0.002;
/// Two cameras are synchronised if at some offset this fraction of their images coincides.
const COINCIDING: f64 = 0.9;
/// Two images coincide if their times differ by at most this fraction of the image interval.
const MAX_JITTER: f64 = 0.02;
/// The offset at which images coincide must agree with the estimated one: within this many standard
/// deviations and this fraction of the image interval, or within `MIN_PHASE_S` seconds.
const MAX_DEVIATIONS: f64 = 6.0;
const MAX_PHASE: f64 = 0.1;
const MIN_PHASE_S: f64 = 0.001;

/// Pairs each camera that may be on a rig with the reference camera, which is the first one, and
/// initialises the clocks from times, file names and motion.
pub fn sensor_pairs(model: &Reconstruction) -> Vec<SensorPair> {
    let cameras = rig_candidates_apart(model);
    let mut cameras = cameras.iter();
    let Some((&reference, reference_images)) = cameras.next() else { return Vec::new() };
    cameras
        .filter_map(|(&other, other_images)| {
            let assumed_baseline = if have_common_points(model, reference, other) {
                None
            } else {
                median_step(model, reference_images)
            };
            let sensor_pair = |clock, clock_state| SensorPair {
                reference,
                other,
                clock,
                clock_state,
                assumed_baseline,
                unobservable_direction: None,
            };
            let one_instant = sensor_pair(Clock::default(), ClockState::Synchronised);
            let Some(TwoTimelines { references, others, are_numbers }) =
                two_timelines(model, [reference_images, other_images])
            else {
                return Some(one_instant);
            };
            let pivot_s = 0.5 * (others.first()?.0 + others.last()?.0);
            let common_s = references.last()?.0.min(others.last()?.0)
                - references.first()?.0.max(others.first()?.0);
            // Only registered images are used.
            let posed = |times: &[(f64, ImageId)]| -> Vec<(f64, Rigid3)> {
                let pose = |id: ImageId| model.image(id).cam_from_world().copied();
                times.iter().filter_map(|&(time_s, id)| Some((time_s, pose(id)?))).collect()
            };
            let (references, others) = (Trajectory::new(posed(&references)), posed(&others));
            let clock = |offset_s| Clock { offset_s, drift: 0.0, pivot_s };
            if are_numbers {
                let offset = offset_of_numbers(&references, &others, common_s > 0.0);
                return Some(
                    offset.map_or(one_instant, |(offset_s, state)| {
                        sensor_pair(clock(offset_s), state)
                    }),
                );
            }
            let Some(found) = find_offset(&references, &others) else {
                return Some(sensor_pair(clock(0.0), ClockState::Synchronised));
            };
            // The offset is zero unless the gain is significant.
            let is_zero = found.gain < OffsetEstimate::MIN_GAIN;
            let offset_s = if is_zero { 0.0 } else { found.offset_s };
            let tolerance_s =
                (MAX_DEVIATIONS * found.sd_s).min(MAX_PHASE * references.interval_s());
            let is_near = |exact_s: f64| {
                (exact_s - offset_s).abs() <= MIN_PHASE_S
                    || (exact_s - found.offset_s).abs() <= tolerance_s
            };
            Some(match synchronous_offset(references.times_s(), &others, offset_s) {
                Some(exact_s) if is_near(exact_s) => {
                    sensor_pair(clock(exact_s), ClockState::Synchronised)
                }
                _ if is_zero && found.sd_s > MAX_MOTION_SD_S => {
                    sensor_pair(clock(offset_s), ClockState::Unobservable)
                }
                _ => sensor_pair(clock(offset_s), ClockState::Estimated),
            })
        })
        .collect()
}

/// Whether the frames of a camera that may be on a rig are numbered like those of the reference
/// camera, and no image has a time. The numbers need not be those of one instant.
pub fn have_numbered_frames(scene: &Reconstruction) -> bool {
    let cameras = rig_candidates_apart(scene);
    let mut cameras = cameras.values();
    let Some(references) = cameras.next() else { return false };
    let mut timelines = cameras.filter_map(|others| two_timelines(scene, [references, others]));
    timelines.any(|timelines| timelines.are_numbers)
}

/// Offset between the frame numbers of two cameras, each of which was numbered on its own; `None`
/// if the same number means the same instant, which holds unless the motion determines one other
/// offset. A whole number of frames is the offset of cameras that are triggered together.
/// `have_common`: whether the ranges of the numbers overlap. If few of the images in both ranges
/// have a pose, nothing contradicts that they are of one instant.
fn offset_of_numbers(
    references: &Trajectory,
    others: &[(f64, Rigid3)],
    have_common: bool,
) -> Option<(f64, ClockState)> {
    let found = find_unrelated_offset(references, others)?;
    let gain = found.gain_at_any_overlap;
    if gain.min(found.gain_apart) < OffsetEstimate::MIN_GAIN || have_common && gain.is_infinite() {
        return None;
    }
    let whole_s = NUMBERED_FRAME_S * (found.offset_s / NUMBERED_FRAME_S).round();
    // What moves the log-likelihood by less than the gain that an offset needs.
    let tolerance_s = (2.0 * OffsetEstimate::MIN_GAIN).sqrt() * found.sd_s;
    if (found.offset_s - whole_s).abs() > tolerance_s.min(MAX_PHASE * NUMBERED_FRAME_S) {
        return Some((found.offset_s, ClockState::Estimated));
    }
    (whole_s != 0.0).then_some((whole_s, ClockState::Synchronised))
}

/// Returns whether both cameras observe some point.
fn have_common_points(model: &Reconstruction, reference: CameraId, other: CameraId) -> bool {
    model.tracks().any(|(_, track)| {
        let is_seen_by =
            |camera| track.observations.iter().any(|o| model.image(o.image).camera == camera);
        is_seen_by(reference) && is_seen_by(other)
    })
}

/// Median distance between consecutive images, in units of the model.
fn median_step(model: &Reconstruction, images: &[ImageId]) -> Option<f64> {
    let pose = |id: &ImageId| model.image(*id).cam_from_world().map(Rigid3::origin_in_a);
    let centres: Vec<_> = images.iter().filter_map(pose).collect();
    let mut steps: Vec<f64> = centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    median(&mut steps).filter(|step| *step > 0.0)
}

/// Returns the offset nearest to `offset_s` at which the images of the two cameras coincide; `None`
/// if they coincide at none.
fn synchronous_offset(reference_s: &[f64], others: &[(f64, Rigid3)], offset_s: f64) -> Option<f64> {
    let interval_s = interval_s(reference_s);
    let phase = |&(time_s, _): &(f64, Rigid3)| {
        let time_s = time_s + offset_s;
        let after = reference_s.partition_point(|reference| *reference < time_s);
        [after.checked_sub(1), Some(after)]
            .into_iter()
            .filter_map(|index| Some(time_s - reference_s.get(index?)?))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .filter(|phase| phase.abs() <= interval_s)
    };
    let mut phases: Vec<f64> = others.iter().filter_map(phase).collect();
    let median = median(&mut phases)?;
    let coincide =
        phases.iter().filter(|phase| (*phase - median).abs() <= MAX_JITTER * interval_s).count();
    (coincide as f64 >= COINCIDING * phases.len() as f64).then_some(offset_s - median)
}

impl SensorPair {
    /// Whether the clock compares the numbers of frames, as [`NUMBERED_FRAME_S`] seconds each:
    /// images have no times, and the same number is not the same instant.
    pub fn counts_frames(&self, model: &Reconstruction) -> bool {
        let is_one_instant =
            self.clock_state == ClockState::Synchronised && self.clock.offset_s == 0.0;
        let mut others = model.images().filter(|(_, image)| image.camera == self.other);
        !is_one_instant && others.all(|(_, image)| image.time_s.is_none())
    }

    /// Returns the registered images of the other camera at whose times the reference camera has a
    /// pose, in order of time.
    pub fn referenced_images(&self, model: &Reconstruction) -> Vec<ReferencedImage> {
        let images: BTreeMap<CameraId, Vec<ImageId>> = images_of_cameras(model);
        let (Some(reference_images), Some(other_images)) =
            (images.get(&self.reference), images.get(&self.other))
        else {
            return Vec::new();
        };
        let has_pose = |id: ImageId| model.image(id).cam_from_world().is_some();
        let of_one_instant = |pairs: Vec<RigPair>| -> Vec<ReferencedImage> {
            let both = pairs.iter().filter(|pair| has_pose(pair.reference) && has_pose(pair.other));
            both.map(|pair| ReferencedImage {
                image: pair.other,
                reference: ReferencePose::Synchronous(pair.reference),
            })
            .collect()
        };
        // Where the same number is the same instant, names tell it, also those with several
        // numbers.
        let timelines = two_timelines(model, [reference_images, other_images])
            .filter(|timelines| !timelines.are_numbers || self.counts_frames(model));
        let Some(TwoTimelines { references, mut others, .. }) = timelines else {
            return of_one_instant(by_name(model, reference_images, other_images));
        };
        if self.clock_state == ClockState::Synchronised {
            others
                .iter_mut()
                .for_each(|(time_s, _)| *time_s = self.clock.reference_time_s(*time_s));
            return of_one_instant(by_time(&references, &others));
        }
        let references: Vec<(f64, ImageId, Rigid3)> = references
            .iter()
            .filter_map(|&(time_s, id)| Some((time_s, id, *model.image(id).cam_from_world()?)))
            .collect();
        let trajectory =
            Trajectory::new(references.iter().map(|(time_s, _, pose)| (*time_s, *pose)));
        let other_s: Vec<f64> = others.iter().map(|(time_s, _)| *time_s).collect();
        let time_sigma_s =
            timestamp_jitter_s(trajectory.times_s()).hypot(timestamp_jitter_s(&other_s));
        let referenced = |&(image_time_s, image): &(f64, ImageId)| {
            let time_s = self.clock.reference_time_s(image_time_s);
            let first = trajectory.knots_around(time_s)?;
            let pose_perturbations = trajectory.pose_perturbations(first, time_s, time_sigma_s);
            let images = std::array::from_fn(|k| references[first + k].1);
            let times_s = std::array::from_fn(|k| references[first + k].0);
            Some(ReferencedImage {
                image,
                reference: ReferencePose::Interpolated {
                    images,
                    times_s,
                    image_time_s,
                    pose_perturbations,
                },
            })
        };
        others.iter().filter(|(_, image)| has_pose(*image)).filter_map(referenced).collect()
    }
}
