//! Which rigs and frames COLMAP gets to see for a reconstruction.

use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{CameraId, ImageId, Reconstruction, RigId, RigSensor};

use crate::{Error, Result};

/// How far an image's pose may be from the one that its frame gives it: radians, and units of length per unit of the
/// translation's. Far above rounding, far below what anything can measure.
pub(super) const MAX_RIG_DEVIATION: f64 = 1e-6;

/// A rig as it stands in the files; the first sensor is the reference and has no pose.
pub(super) struct RigRow {
    pub(super) id: u32,
    pub(super) cameras: Vec<(u32, Option<Rigid3>)>,
}

/// A frame as it stands in the files.
pub(super) struct FrameRow {
    pub(super) id: u32,
    pub(super) rig: u32,
    pub(super) rig_from_world: Rigid3,
    /// Camera and image.
    pub(super) images: Vec<(u32, u32)>,
}

/// The rigs and frames to write.
pub(super) struct Layout {
    pub(super) rigs: Vec<RigRow>,
    pub(super) frames: Vec<FrameRow>,
}

/// The number that stands in the files for an index.
pub(super) fn file_id(index: usize) -> u32 {
    u32::try_from(index + 1).expect("ids of a scene are below 2³² − 1")
}

/// Whether two poses are one but for rounding.
pub(super) fn agree(one: &Rigid3, other: &Rigid3) -> bool {
    let rotation_rad = one.rotation.angle_to(&other.rotation);
    let translation = (one.translation - other.translation).norm();
    rotation_rad <= MAX_RIG_DEVIATION && translation <= MAX_RIG_DEVIATION * (1.0 + one.translation.norm())
}

impl Layout {
    pub(super) fn new(dir: &Path, model: &Reconstruction) -> Result<Self> {
        let bad = |what: String| Error::content(dir, what);
        // A rig is real if a frame of it has an image with a pose.
        let registered = |image: &ImageId| model.image(*image).cam_from_world().is_some();
        let mut rig_is_used = vec![false; model.rigs.len()];
        for (index, frame) in model.frames.iter().enumerate() {
            let used = rig_is_used
                .get_mut(frame.rig.index())
                .ok_or_else(|| bad(format!("frame {index} names rig {}, which there is not", frame.rig.0)))?;
            *used |= frame.images.iter().any(registered);
        }
        let mut place: Vec<Option<(RigId, RigSensor)>> = vec![None; model.cameras().count()];
        let mut rigs = Vec::new();
        for (index, rig) in model.rigs.iter().enumerate().filter(|(index, _)| rig_is_used[*index]) {
            for sensor in &rig.sensors {
                let slot = place
                    .get_mut(sensor.camera.index())
                    .ok_or_else(|| bad(format!("rig {index} names camera {}", sensor.camera.0)))?;
                if slot.replace((RigId::from_index(index), *sensor)).is_some() {
                    return Err(bad(format!("camera {} is on two rigs, or twice on one", sensor.camera.0)));
                }
            }
            let cameras = rig.sensors.iter().enumerate().map(|(k, sensor)| {
                (file_id(sensor.camera.index()), if k == 0 { None } else { sensor.cam_from_rig })
            });
            rigs.push(RigRow { id: file_id(index), cameras: cameras.collect() });
        }
        for (camera, _) in model.cameras().filter(|(camera, _)| place[camera.index()].is_none()) {
            let id = file_id(model.rigs.len() + camera.index());
            rigs.push(RigRow { id, cameras: vec![(file_id(camera.index()), None)] });
        }

        let cam_from_rig = |camera: CameraId| match &place[camera.index()] {
            None => Some(Rigid3::identity()),
            Some((rig, sensor)) if model.rigs[rig.index()].sensors[0].camera == sensor.camera => {
                Some(Rigid3::identity())
            }
            Some((_, sensor)) => sensor.cam_from_rig,
        };
        let mut in_frame = vec![false; model.images().count()];
        let mut frames = Vec::new();
        for (index, frame) in model.frames.iter().enumerate() {
            let mut images = Vec::new();
            for &id in frame.images.iter().filter(|image| registered(image)) {
                let image = model.image(id);
                if place[image.camera.index()].is_none_or(|(rig, _)| rig != frame.rig) {
                    return Err(bad(format!(
                        "image {} is in a frame of a rig that its camera is not on",
                        image.name
                    )));
                }
                if std::mem::replace(&mut in_frame[id.index()], true) {
                    return Err(bad(format!("image {} is in two frames", image.name)));
                }
                let given =
                    cam_from_rig(image.camera).map(|cam_from_rig| cam_from_rig * frame.rig_from_world);
                let own = image.cam_from_world();
                if !given.zip(own.copied()).is_some_and(|(given, own)| agree(&own, &given)) {
                    return Err(bad(format!(
                        "the pose of image {} is not the one that its frame and rig give it",
                        image.name
                    )));
                }
                images.push((file_id(image.camera.index()), file_id(id.index())));
            }
            if !images.is_empty() {
                let (id, rig) = (file_id(index), file_id(frame.rig.index()));
                frames.push(FrameRow { id, rig, rig_from_world: frame.rig_from_world, images });
            }
        }
        for (id, image, cam_from_world) in model.registered().filter(|(id, ..)| !in_frame[id.index()]) {
            let camera = image.camera.index();
            let rig = place[camera].map_or(model.rigs.len() + camera, |(rig, _)| rig.index());
            let cam_from_rig = cam_from_rig(image.camera).ok_or_else(|| {
                bad(format!("image {} is in no frame, and its camera has no pose on its rig", image.name))
            })?;
            frames.push(FrameRow {
                id: file_id(model.frames.len() + id.index()),
                rig: file_id(rig),
                // An identity inverted and multiplied may differ in the last bit.
                rig_from_world: if cam_from_rig == Rigid3::identity() {
                    *cam_from_world
                } else {
                    cam_from_rig.inverse() * *cam_from_world
                },
                images: vec![(file_id(camera), file_id(id.index()))],
            });
        }
        Ok(Self { rigs, frames })
    }
}
