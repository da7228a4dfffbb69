//! Rigs whose extrinsics are known, and the frames that their cameras took.

use tiepoint_geometry::Rigid3;

use crate::rig::KnownFrame;
use crate::{ImageId, Reconstruction, Rig};

/// Rigs with known extrinsics, and their frames: an input of a mapper.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownRigs {
    /// The rigs. Their unit of length becomes that of the model.
    pub rigs: Vec<Rig>,
    /// The frames. An image is in at most one of them.
    pub frames: Vec<KnownFrame>,
    /// Whether the extrinsics are initial values, which bundle adjustment refines. Else they are
    /// constant.
    pub refine_extrinsics: bool,
}

impl KnownRigs {
    /// Pose of an image's camera on the rig of a frame; `None` if the camera is not on the rig.
    pub fn cam_from_rig(
        &self,
        model: &Reconstruction,
        frame: &KnownFrame,
        image: ImageId,
    ) -> Option<Rigid3> {
        self.rigs.get(frame.rig.index())?.cam_from_rig(model.image(image).camera)
    }
}
