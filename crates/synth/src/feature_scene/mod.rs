//! Scenes of features from the same street, without rendering: keypoints, tracks and matches with
//! truth, of any size.
//!
//! A point is what a random pixel of a random image sees, so points lie as densely as features do
//! in pictures. Its blob has a size in metres; an image sees it where nothing is in front, where
//! the blob is a few pixels wide, and from directions from which it looks alike, as the invariance
//! of descriptors allows (Mikolajczyk & Schmid 2005). Tracks therefore begin, end, skip images and
//! close loops by themselves.

mod matches;
mod options;
mod scene;
mod visibility;

pub use matches::{MatchOptions, PairMatches};
pub use options::FeatureOptions;
pub use scene::FeatureScene;
