use crate::{CameraId, FrameId, ImageId, PointId, RigId};

/// What [`crate::Reconstruction::validate`] found broken.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// An image names a camera that does not exist.
    #[error("image {image:?} refers to camera {camera:?}, but there are {cameras} cameras")]
    NoSuchCamera {
        /// The image.
        image: ImageId,
        /// The camera it names.
        camera: CameraId,
        /// How many there are.
        cameras: usize,
    },
    /// A track and the keypoint that it observes disagree.
    #[error(
        "point {point:?} observes keypoint {keypoint} of image {image:?}, which belongs to \
        {found:?}"
    )]
    TrackMismatch {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
        /// What the keypoint says.
        found: Option<PointId>,
    },
    /// A keypoint belongs to a point whose track does not hold it.
    #[error(
        "keypoint {keypoint} of image {image:?} belongs to point {point:?}, whose track does not \
        hold it"
    )]
    DanglingKeypoint {
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
        /// The point it names.
        point: PointId,
    },
    /// A track is seen by an image without a pose.
    #[error("point {point:?} is observed by image {image:?}, which has no pose")]
    UnposedObservation {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
    },
    /// A number is not finite.
    #[error("{what} is not finite")]
    NotFinite {
        /// Which number.
        what: String,
    },
    /// A rotation is not one.
    #[error("the rotation of {of} is no unit quaternion")]
    NotUnit {
        /// Of an image, a frame, or a camera on its rig.
        of: String,
    },
    /// A rig without its reference.
    #[error("rig {rig:?} has no camera")]
    EmptyRig {
        /// The rig.
        rig: RigId,
    },
    /// A rig names a camera that does not exist.
    #[error("rig {rig:?} has camera {camera:?}, but there are {cameras} cameras")]
    NoSuchRigCamera {
        /// The rig.
        rig: RigId,
        /// The camera it names.
        camera: CameraId,
        /// How many there are.
        cameras: usize,
    },
    /// A camera has two places.
    #[error("camera {camera:?} is on two rigs, or twice on one")]
    CameraOnTwoRigs {
        /// The camera.
        camera: CameraId,
    },
    /// The reference of a rig is where its frames are.
    #[error(
        "the first camera of rig {rig:?} is its reference and has another pose than the identity"
    )]
    ReferenceWithPose {
        /// The rig.
        rig: RigId,
    },
    /// A frame names a rig that does not exist.
    #[error("frame {frame:?} is of rig {rig:?}, but there are {rigs} rigs")]
    NoSuchRig {
        /// The frame.
        frame: FrameId,
        /// The rig it names.
        rig: RigId,
        /// How many there are.
        rigs: usize,
    },
    /// A frame names an image that does not exist.
    #[error("frame {frame:?} holds image {image:?}, but there are {images} images")]
    NoSuchImage {
        /// The frame.
        frame: FrameId,
        /// The image it names.
        image: ImageId,
        /// How many there are.
        images: usize,
    },
    /// An image has two frames.
    #[error("image {image:?} is in two frames, or twice in one")]
    ImageInTwoFrames {
        /// The image.
        image: ImageId,
    },
    /// A frame holds an image of a camera that its rig does not have.
    #[error("frame {frame:?} holds image {image:?}, whose camera is not on its rig")]
    CameraNotOnRig {
        /// The frame.
        frame: FrameId,
        /// The image.
        image: ImageId,
    },
    /// A camera took two images at one moment.
    #[error("frame {frame:?} holds two images of camera {camera:?}")]
    TwoImagesOfOneCamera {
        /// The frame.
        frame: FrameId,
        /// The camera.
        camera: CameraId,
    },
    /// A frame holds an image without a pose.
    #[error("frame {frame:?} holds image {image:?}, which has no pose")]
    UnposedImage {
        /// The frame.
        frame: FrameId,
        /// The image.
        image: ImageId,
    },
    /// An image, its frame and its rig disagree.
    #[error("the pose of image {image:?} is not the one that its frame and rig give it")]
    PoseNotOfFrame {
        /// The image.
        image: ImageId,
    },
    /// A track holds a keypoint twice.
    #[error("point {point:?} observes keypoint {keypoint} of image {image:?} twice")]
    RepeatedObservation {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
    },
}
