//! Ids are indices into the lists of one [`crate::Reconstruction`], each kind a type of its own:
//!
//! ```compile_fail
//! use tiepoint_scene::{CameraId, ImageId};
//! let camera: CameraId = ImageId(3);
//! ```

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident)*) => { $(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u32);

        impl $name {
            /// The position in its list.
            pub fn index(self) -> usize {
                self.0 as usize
            }
            /// From a position in its list.
            pub fn from_index(index: usize) -> Self {
                Self(u32::try_from(index).expect("fewer than 2³² of a kind fit in memory"))
            }
        }
    )* };
}

ids! {
    /// A camera: one lens and sensor.
    CameraId
    /// An image.
    ImageId
    /// The images of one moment.
    FrameId
    /// Cameras that ride together.
    RigId
    /// A point of the cloud, with its track.
    PointId
}
