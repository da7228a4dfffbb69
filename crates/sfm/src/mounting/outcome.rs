//! What mountings make of a model, rigid poses and frames, and how it is judged: by tracks that took no part.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::robust_average;
use tiepoint_scene::{Frame, ImageId, Observation, Reconstruction, Rig, RigId, RigSensor};

use super::{Hold, Mounting, relative_poses};
use crate::companion::Left;
use crate::triangulation::seen_at;

/// Held-out observations count up to this error, in pixels.
const MAX_HELD_OUT_ERROR_PX: f64 = 4.0;

/// Moves the right cameras to where rigid mountings have them.
pub(super) fn make_rigid(model: &mut Reconstruction, mountings: &[Mounting]) {
    for mounting in mountings.iter().filter(|mounting| mounting.hold == Hold::Rigid) {
        // After an adjustment all moments have one relative pose, before it their average serves.
        let poses = relative_poses(model, &mounting.moments, &mounting.companion.clock);
        let Some(average) = robust_average(&poses) else { continue };
        mounting.place(model, &average.right_from_left());
    }
}

/// Rigid mountings become the model's rig, their moments its frames.
pub(super) fn make_frames(model: &mut Reconstruction, mountings: &[Mounting]) {
    let mut sensors: Vec<RigSensor> = Vec::new();
    let mut images: BTreeMap<ImageId, Vec<ImageId>> = BTreeMap::new();
    for mounting in mountings.iter().filter(|mounting| mounting.hold == Hold::Rigid) {
        let pose = |image| model.image(image).cam_from_world().copied();
        let both = mounting.moments.iter().filter_map(|moment| match moment.left {
            Left::At(left) => Some((left, moment.right, pose(left)?, pose(moment.right)?)),
            Left::Between { .. } => None,
        });
        for (left, right, left_from_world, right_from_world) in both {
            if sensors.is_empty() {
                sensors.push(RigSensor {
                    camera: mounting.companion.left,
                    cam_from_rig: Some(Rigid3::identity()),
                });
            }
            if sensors.iter().all(|sensor| sensor.camera != mounting.companion.right) {
                let cam_from_rig = Some(right_from_world * left_from_world.inverse());
                sensors.push(RigSensor { camera: mounting.companion.right, cam_from_rig });
            }
            images.entry(left).or_insert_with(|| vec![left]).push(right);
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
pub(super) fn held_out(model: &Reconstruction) -> Vec<Vec<Observation>> {
    model
        .tracks()
        .filter(|(_, track)| track.is_held_out && track.observations.len() >= 3)
        .map(|(_, track)| track.observations.clone())
        .collect()
}

/// Tracks that took no part, and how well a model without any term explains them.
pub(super) struct Judge {
    tracks: Vec<Vec<Observation>>,
    pub(super) error_off_px: f64,
}

impl Judge {
    pub(super) fn new(tracks: Vec<Vec<Observation>>, off: &Reconstruction) -> Self {
        let mut judge = Self { tracks, error_off_px: 0.0 };
        judge.error_off_px = judge.error_px(off);
        judge
    }

    /// Root mean square of the truncated errors of the tracks, triangulated anew between the poses of now: the same observations
    /// whatever the model did with them.
    pub(super) fn error_px(&self, model: &Reconstruction) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for observations in &self.tracks {
            let xyz = seen_at(model, observations);
            for observation in observations {
                let error = xyz.and_then(|xyz| model.error_of_px(observation, &xyz));
                sum += error.unwrap_or(f64::INFINITY).min(MAX_HELD_OUT_ERROR_PX).powi(2);
                count += 1;
            }
        }
        (sum / count.max(1) as f64).sqrt()
    }

    /// A difference of errors as a share of the error without any term.
    pub(super) fn share(&self, difference_px: f64) -> f64 {
        difference_px / self.error_off_px
    }

    /// Whether an error is larger than that without any term by more than a share of it.
    pub(super) fn objects(&self, error_px: f64, tolerance: f64) -> bool {
        error_px > (1.0 + tolerance) * self.error_off_px
    }
}
