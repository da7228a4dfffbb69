//! Rigid constraints applied to a model: poses, rigs and frames.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::robust_average;
use tiepoint_scene::{Frame, ImageId, Reconstruction, Rig, RigId, RigSensor};

use super::extrinsics::{RigConstraint, RigExtrinsics, relative_poses};
use super::sensor_pair::ReferencePose;

/// Registers the right cameras at the robust average of their relative poses.
pub(super) fn register_rigidly(model: &mut Reconstruction, all_extrinsics: &[RigExtrinsics]) {
    for extrinsics in
        all_extrinsics.iter().filter(|extrinsics| extrinsics.constraint == RigConstraint::Rigid)
    {
        // After an adjustment all relative poses are equal, and the average is exact.
        let poses =
            relative_poses(model, &extrinsics.referenced_images, &extrinsics.sensor_pair.clock);
        let Some(average) = robust_average(&poses) else { continue };
        extrinsics.register_images(model, &average.right_from_left());
    }
}

/// Converts rigid extrinsics to a rig of the model, and synchronous images to its frames.
pub(super) fn add_frames(model: &mut Reconstruction, all_extrinsics: &[RigExtrinsics]) {
    let mut sensors: Vec<RigSensor> = Vec::new();
    let mut images: BTreeMap<ImageId, Vec<ImageId>> = BTreeMap::new();
    for extrinsics in
        all_extrinsics.iter().filter(|extrinsics| extrinsics.constraint == RigConstraint::Rigid)
    {
        let pose = |image| model.image(image).cam_from_world().copied();
        let both = extrinsics.referenced_images.iter().filter_map(|referenced| {
            match referenced.reference {
                ReferencePose::Synchronous(left) => {
                    Some((left, referenced.right, pose(left)?, pose(referenced.right)?))
                }
                ReferencePose::Interpolated { .. } => None,
            }
        });
        for (left, right, left_from_world, right_from_world) in both {
            if sensors.is_empty() {
                sensors.push(RigSensor {
                    camera: extrinsics.sensor_pair.left,
                    cam_from_rig: Some(Rigid3::identity()),
                });
            }
            if sensors.iter().all(|sensor| sensor.camera != extrinsics.sensor_pair.right) {
                let cam_from_rig = Some(right_from_world * left_from_world.inverse());
                sensors.push(RigSensor { camera: extrinsics.sensor_pair.right, cam_from_rig });
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
