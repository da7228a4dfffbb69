//! Rigid constraints applied to a model: poses, rigs and frames.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::robust_average;
use tiepoint_scene::{Frame, ImageId, Reconstruction, Rig, RigId, RigSensor};

use super::extrinsics::{RigConstraint, RigExtrinsics, relative_poses};
use super::sensor_pair::ReferencePose;

/// Registers the non-reference cameras at the robust average of their relative poses.
pub(super) fn register_rigidly(model: &mut Reconstruction, all_extrinsics: &[RigExtrinsics]) {
    for extrinsics in
        all_extrinsics.iter().filter(|extrinsics| extrinsics.constraint == RigConstraint::Rigid)
    {
        // After an adjustment all relative poses are equal, and the average is exact.
        let poses =
            relative_poses(model, &extrinsics.referenced_images, &extrinsics.sensor_pair.clock);
        let Some(average) = robust_average(&poses) else { continue };
        extrinsics.register_images(model, &average.cam_from_rig());
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
                ReferencePose::Synchronous(reference) => {
                    Some((reference, referenced.image, pose(reference)?, pose(referenced.image)?))
                }
                ReferencePose::Interpolated { .. } => None,
            }
        });
        for (reference, image, rig_from_world, cam_from_world) in both {
            if sensors.is_empty() {
                sensors.push(RigSensor {
                    camera: extrinsics.sensor_pair.reference,
                    cam_from_rig: Some(Rigid3::identity()),
                });
            }
            if sensors.iter().all(|sensor| sensor.camera != extrinsics.sensor_pair.other) {
                let cam_from_rig = Some(cam_from_world * rig_from_world.inverse());
                sensors.push(RigSensor { camera: extrinsics.sensor_pair.other, cam_from_rig });
            }
            images.entry(reference).or_insert_with(|| vec![reference]).push(image);
        }
    }
    if sensors.len() < 2 {
        return;
    }
    model.rigs.push(Rig { sensors });
    let rig = RigId::from_index(model.rigs.len() - 1);
    for (reference, images) in images {
        if let Some(rig_from_world) = model.image(reference).cam_from_world().copied() {
            model.frames.push(Frame { rig, rig_from_world, images });
        }
    }
}
