//! Feature-level scenes of the same street without rendering: keypoints, tracks and matches with
//! ground truth, of any size.
//!
//! A point is the surface point of a random pixel of a random image, so that the density of points
//! is that of features in images. Its blob has a size in metres. An image observes it where nothing
//! occludes it, where the blob is a few pixels wide, and from directions within the invariance of
//! descriptors (Mikolajczyk & Schmid 2005). Tracks therefore begin, end, skip images and close
//! loops as real ones.

mod matches;
mod options;
mod scene;
mod visibility;

pub use matches::{MatchOptions, PairMatches};
pub use options::FeatureOptions;
pub use scene::FeatureScene;
