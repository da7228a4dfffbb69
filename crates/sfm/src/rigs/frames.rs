//! What rigid mountings make of a model: poses, rigs and frames.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::robust_average;
use tiepoint_scene::{Frame, ImageId, Reconstruction, Rig, RigId, RigSensor};

use super::companion::Left;
use super::mounting::{Hold, Mounting, relative_poses};

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
