//! The frames of rigs whose extrinsics are known, while a model grows.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::rig::KnownFrame;
use tiepoint_scene::{ImageId, KnownRigs, Reconstruction};

/// The known frames of a scene by their images.
#[derive(Clone, Debug, Default)]
pub(crate) struct KnownFrames {
    frames: Vec<KnownFrame>,
    frame_of: BTreeMap<ImageId, usize>,
}

impl KnownFrames {
    /// The frames, without images of cameras that are not on the rig and without those of earlier
    /// models.
    pub(crate) fn new(
        rigs: &KnownRigs,
        scene: &Reconstruction,
        mapped_images: &BTreeSet<ImageId>,
    ) -> Self {
        let mut this = Self::default();
        for frame in &rigs.frames {
            let is_known = |image: &ImageId| {
                !mapped_images.contains(image) && rigs.cam_from_rig(scene, frame, *image).is_some()
            };
            let images: Vec<ImageId> = frame.images.iter().copied().filter(is_known).collect();
            this.frame_of.extend(images.iter().map(|image| (*image, this.frames.len())));
            this.frames.push(KnownFrame { rig: frame.rig, images });
        }
        this
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &KnownFrame> {
        self.frames.iter()
    }

    /// The frame of an image in a model that has the rigs; `None` before it has them, when each
    /// image is registered alone.
    pub(crate) fn frame_of(&self, model: &Reconstruction, image: ImageId) -> Option<&KnownFrame> {
        let frame = self.frames.get(*self.frame_of.get(&image)?)?;
        (!model.rigs.is_empty()).then_some(frame)
    }

    /// The images that are registered with an image: those of its frame, or the image alone.
    pub(crate) fn registered_with(&self, model: &Reconstruction, image: ImageId) -> Vec<ImageId> {
        self.frame_of(model, image).map_or_else(|| vec![image], |frame| frame.images.clone())
    }

    /// The image that stands for an image in the selection: the first of its frame, or itself.
    pub(crate) fn first_of(&self, model: &Reconstruction, image: ImageId) -> ImageId {
        let frame = self.frame_of(model, image);
        frame.and_then(|frame| frame.images.first().copied()).unwrap_or(image)
    }
}
