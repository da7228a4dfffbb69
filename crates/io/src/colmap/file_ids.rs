//! The ids that the cameras, images and points of a model have in its files.

use std::path::Path;

use tiepoint_scene::{CameraId, ImageId, OriginalIds, PointId, Reconstruction};

use crate::{Error, Result};

/// Point id of a keypoint without a point.
pub(super) const NO_POINT: u64 = u64::MAX;

/// The ids of a model in the files.
pub(super) struct FileIds<'a>(&'a OriginalIds);

impl<'a> FileIds<'a> {
    /// The ids of a model; an error if they do not fit into the files.
    pub(super) fn new(dir: &Path, model: &'a Reconstruction) -> Result<Self> {
        let ids = &model.original_ids;
        // A camera in no rig and an image in no frame have ids beyond those of rigs and frames.
        let cameras = model.cameras().map(|(id, _)| ids.camera(id)).max();
        let cameras = cameras.unwrap_or(0).saturating_add(model.rigs.len() as u64);
        let images = model.images().map(|(id, _)| ids.image(id)).max();
        let images = images.unwrap_or(0).saturating_add(model.frames.len() as u64);
        let points = model.tracks().map(|(id, _)| ids.point(id)).max().unwrap_or(0);
        for (kind, id, none) in [
            ("cameras", cameras, u64::from(u32::MAX)),
            ("images", images, u64::from(u32::MAX)),
            ("points", points, NO_POINT),
        ] {
            if id >= none {
                let what = format!("the ids of the {kind} are too large for a model of COLMAP");
                return Err(Error::content(dir, what));
            }
        }
        Ok(Self(ids))
    }

    pub(super) fn camera(&self, id: CameraId) -> u32 {
        u32::try_from(self.0.camera(id)).expect("the largest id fits")
    }

    pub(super) fn image(&self, id: ImageId) -> u32 {
        u32::try_from(self.0.image(id)).expect("the largest id fits")
    }

    pub(super) fn point(&self, id: PointId) -> u64 {
        self.0.point(id)
    }
}
