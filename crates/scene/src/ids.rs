//! Typed ids: indices into the lists of one [`crate::Reconstruction`]. In messages an id is its
//! plain number, counted from 0. Ids of different kinds do not convert into each other:
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
            /// The index in its list.
            pub fn index(self) -> usize {
                self.0 as usize
            }
            /// The id of an index in its list.
            pub fn from_index(index: usize) -> Self {
                Self(u32::try_from(index).expect("fewer than 2³² of a kind fit in memory"))
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }
    )* };
}

ids! {
    /// A camera.
    CameraId
    /// An image.
    ImageId
    /// A frame: images of one instant.
    FrameId
    /// A rig: cameras that are rigidly connected.
    RigId
    /// A 3D point with its track.
    PointId
}
