//! The rigs and frames of a reconstruction as COLMAP stores them.

use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{ImageId, Reconstruction, RigId};

use super::file_ids::FileIds;
use crate::{Error, Result};

/// A rig in the files; the first camera is the reference sensor and has no pose.
pub(super) struct RigRow {
    pub(super) id: u32,
    pub(super) cameras: Vec<(u32, Option<Rigid3>)>,
}

/// A frame in the files.
pub(super) struct FrameRow {
    pub(super) id: u32,
    pub(super) rig: u32,
    pub(super) rig_from_world: Rigid3,
    /// Ids of camera and image.
    pub(super) images: Vec<(u32, u32)>,
}

/// The rigs and frames to write. Every camera is in a rig, every registered image in a frame.
pub(super) struct RigTables {
    pub(super) rigs: Vec<RigRow>,
    pub(super) frames: Vec<FrameRow>,
}

/// The id in the files for an index of a rig or frame.
fn file_id(index: usize) -> u32 {
    u32::try_from(index + 1).expect("ids of a scene are below 2³² − 1")
}

impl RigTables {
    /// The rigs and frames of a valid model.
    pub(super) fn new(dir: &Path, model: &Reconstruction, ids: &FileIds) -> Result<Self> {
        // A camera in no rig has one of its own, beyond the others.
        let single_rig = |camera: u32| model.rigs.len() as u32 + camera;
        // Only a rig with an image in one of its frames is written.
        let mut rig_of: Vec<Option<RigId>> = vec![None; model.num_cameras()];
        let mut rigs = Vec::new();
        for (index, rig) in model.rigs.iter().enumerate() {
            let id = RigId::from_index(index);
            if model.frames.iter().all(|frame| frame.rig != id || frame.images.is_empty()) {
                continue;
            }
            let cameras = rig.sensors.iter().enumerate().map(|(k, sensor)| {
                rig_of[sensor.camera.index()] = Some(id);
                (ids.camera(sensor.camera), if k == 0 { None } else { sensor.cam_from_rig })
            });
            rigs.push(RigRow { id: file_id(index), cameras: cameras.collect() });
        }
        for (camera, _) in model.cameras().filter(|(camera, _)| rig_of[camera.index()].is_none()) {
            let id = single_rig(ids.camera(camera));
            rigs.push(RigRow { id, cameras: vec![(ids.camera(camera), None)] });
        }

        let mut in_frame = vec![false; model.num_images()];
        let mut frames = Vec::new();
        for (index, frame) in model.frames.iter().enumerate() {
            let row = |image: &ImageId| {
                in_frame[image.index()] = true;
                (ids.camera(model.image(*image).camera), ids.image(*image))
            };
            let images: Vec<(u32, u32)> = frame.images.iter().map(row).collect();
            if !images.is_empty() {
                let (id, rig) = (file_id(index), file_id(frame.rig.index()));
                frames.push(FrameRow { id, rig, rig_from_world: frame.rig_from_world, images });
            }
        }
        for (id, image, cam_from_world) in
            model.registered().filter(|(id, ..)| !in_frame[id.index()])
        {
            let camera = image.camera;
            let (rig, cam_from_rig) = match rig_of[camera.index()] {
                None => (single_rig(ids.camera(camera)), Some(Rigid3::identity())),
                Some(rig) => (file_id(rig.index()), model.rigs[rig.index()].cam_from_rig(camera)),
            };
            let cam_from_rig = cam_from_rig.ok_or_else(|| {
                let name = &image.name;
                Error::content(
                    dir,
                    format!("image {name} is in no frame, and its camera has no pose on its rig"),
                )
            })?;
            // Inverting and multiplying by the identity could change the last bit.
            let rig_from_world = if cam_from_rig == Rigid3::identity() {
                *cam_from_world
            } else {
                cam_from_rig.inverse() * *cam_from_world
            };
            if !rig_from_world.translation.iter().all(|value| value.is_finite()) {
                let name = &image.name;
                return Err(Error::content(
                    dir,
                    format!("the pose of the rig at image {name} overflows"),
                ));
            }
            frames.push(FrameRow {
                id: model.frames.len() as u32 + ids.image(id),
                rig,
                rig_from_world,
                images: vec![(ids.camera(camera), ids.image(id))],
            });
        }
        Ok(Self { rigs, frames })
    }
}
