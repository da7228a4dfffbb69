use crate::{CameraId, ImageId, PointId};

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
    #[error("point {point:?} observes keypoint {keypoint} of image {image:?}, which belongs to {found:?}")]
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
        "keypoint {keypoint} of image {image:?} belongs to point {point:?}, whose track does not hold it"
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
}
