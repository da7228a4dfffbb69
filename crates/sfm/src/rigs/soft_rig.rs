//! The rig of a finished model as a term of further adjustments.

use std::collections::BTreeSet;

use tiepoint_adjust::Term;
use tiepoint_scene::{ImageId, Reconstruction};

use super::extrinsics::{RigConstraint, RigExtrinsics};
use super::extrinsics_term::ExtrinsicsTerm;
use super::solution::CalibratedRig;

/// The soft constraints of a finished model's rig. Rigid ones are the frames of the model, which
/// every adjustment keeps.
pub struct SoftRig(Vec<RigExtrinsics>);

impl SoftRig {
    /// The constraints of a rig, without the pairs that contradict it.
    pub fn new(model: &Reconstruction, rig: &CalibratedRig) -> Self {
        let bad: BTreeSet<ImageId> = rig.bad_pairs.iter().map(|pair| pair.other).collect();
        let soft = rig.cameras.iter().filter(|camera| camera.constraint != RigConstraint::Rigid);
        let extrinsics = soft.map(|camera| {
            let mut referenced_images = camera.sensor_pair.referenced_images(model);
            referenced_images.retain(|referenced| !bad.contains(&referenced.image));
            RigExtrinsics {
                sensor_pair: camera.sensor_pair,
                referenced_images,
                cam_from_rig: camera.cam_from_rig,
                constraint: camera.constraint,
                split_images: Vec::new(),
            }
        });
        Self(extrinsics.collect())
    }

    /// The term, whose extrinsics and clocks are refined.
    pub fn term(&mut self) -> impl Term + '_ {
        ExtrinsicsTerm::new(&mut self.0)
    }

    /// Takes over the extrinsics and clocks after an adjustment: those of soft constraints, and of
    /// the frames of the model.
    pub fn update(&self, model: &Reconstruction, rig: &mut CalibratedRig) {
        for camera in &mut rig.cameras {
            let other = camera.sensor_pair.other;
            let soft = self.0.iter().find(|soft| soft.sensor_pair.other == other);
            let sensors = model.rigs.iter().flat_map(|rig| &rig.sensors);
            let of_frames = sensors.clone().find(|sensor| sensor.camera == other);
            if let Some(soft) = soft {
                camera.cam_from_rig = soft.cam_from_rig;
                camera.sensor_pair.clock = soft.sensor_pair.clock;
            } else if let Some(pose) = of_frames.and_then(|sensor| sensor.cam_from_rig) {
                camera.cam_from_rig = pose;
            }
        }
    }
}
