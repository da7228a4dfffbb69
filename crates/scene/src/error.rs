use crate::{CameraId, FrameId, ImageId, PointId, RigId};

/// A broken invariant, found by [`crate::Reconstruction::validate`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// An image refers to a camera that does not exist.
    #[error("image {image} refers to camera {camera}, but there are {cameras} cameras")]
    NoSuchCamera {
        /// The image.
        image: ImageId,
        /// The camera.
        camera: CameraId,
        /// Number of cameras.
        cameras: usize,
    },
    /// A track has an observation whose keypoint refers to another point or to none.
    #[error(
        "point {point} observes keypoint {keypoint} of image {image}, which belongs to {}",
        .found.map_or_else(|| "no point".to_owned(), |found| format!("point {found}"))
    )]
    TrackMismatch {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
        /// The point that the keypoint refers to.
        found: Option<PointId>,
    },
    /// A keypoint refers to a point whose track does not contain it.
    #[error(
        "keypoint {keypoint} of image {image} belongs to point {point}, whose track does not \
        hold it"
    )]
    DanglingKeypoint {
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
        /// The point.
        point: PointId,
    },
    /// A track contains an observation in an unregistered image.
    #[error("point {point} is observed by image {image}, which has no pose")]
    UnposedObservation {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
    },
    /// A number is not finite.
    #[error("{what} is not finite")]
    NotFinite {
        /// The number.
        what: String,
    },
    /// A focal length is not positive.
    #[error("a focal length of camera {camera} is {value}, and not above zero")]
    FocalLength {
        /// The camera.
        camera: CameraId,
        /// Its focal length, or one of two, in pixels.
        value: f64,
    },
    /// The quaternion of a rotation does not have unit norm.
    #[error("the rotation of {of} is no unit quaternion")]
    NotUnit {
        /// An image, a frame, or a camera on a rig.
        of: String,
    },
    /// A rig has no sensor.
    #[error("rig {rig} has no camera")]
    EmptyRig {
        /// The rig.
        rig: RigId,
    },
    /// A rig refers to a camera that does not exist.
    #[error("rig {rig} has camera {camera}, but there are {cameras} cameras")]
    NoSuchRigCamera {
        /// The rig.
        rig: RigId,
        /// The camera.
        camera: CameraId,
        /// Number of cameras.
        cameras: usize,
    },
    /// A camera is a sensor twice.
    #[error("camera {camera} is on two rigs, or twice on one")]
    CameraOnTwoRigs {
        /// The camera.
        camera: CameraId,
    },
    /// The reference sensor of a rig has a pose other than the identity.
    #[error(
        "the first camera of rig {rig} is its reference and has another pose than the identity"
    )]
    ReferenceWithPose {
        /// The rig.
        rig: RigId,
    },
    /// A frame refers to a rig that does not exist.
    #[error("frame {frame} is of rig {rig}, but there are {rigs} rigs")]
    NoSuchRig {
        /// The frame.
        frame: FrameId,
        /// The rig.
        rig: RigId,
        /// Number of rigs.
        rigs: usize,
    },
    /// A frame refers to an image that does not exist.
    #[error("frame {frame} holds image {image}, but there are {images} images")]
    NoSuchImage {
        /// The frame.
        frame: FrameId,
        /// The image.
        image: ImageId,
        /// Number of images.
        images: usize,
    },
    /// An image is in two frames, or twice in one.
    #[error("image {image} is in two frames, or twice in one")]
    ImageInTwoFrames {
        /// The image.
        image: ImageId,
    },
    /// A frame contains an image of a camera that is not on its rig.
    #[error("frame {frame} holds image {image}, whose camera is not on its rig")]
    CameraNotOnRig {
        /// The frame.
        frame: FrameId,
        /// The image.
        image: ImageId,
    },
    /// A frame contains two images of one camera.
    #[error("frame {frame} holds two images of camera {camera}")]
    TwoImagesOfOneCamera {
        /// The frame.
        frame: FrameId,
        /// The camera.
        camera: CameraId,
    },
    /// A frame contains an unregistered image.
    #[error("frame {frame} holds image {image}, which has no pose")]
    UnposedImage {
        /// The frame.
        frame: FrameId,
        /// The image.
        image: ImageId,
    },
    /// The pose of an image differs from the one composed of its frame and rig.
    #[error("the pose of image {image} is not the one that its frame and rig give it")]
    PoseNotOfFrame {
        /// The image.
        image: ImageId,
    },
    /// A track contains an observation twice.
    #[error("point {point} observes keypoint {keypoint} of image {image} twice")]
    RepeatedObservation {
        /// The point.
        point: PointId,
        /// The image.
        image: ImageId,
        /// The keypoint.
        keypoint: u32,
    },
}
