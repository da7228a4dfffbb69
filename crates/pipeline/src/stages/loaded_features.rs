//! Features of an image in memory, ready to be matched.

use tiepoint_io::features::Features;
use tiepoint_sfm::convert::{keypoint, matched};
use tiepoint_sfm::matching::{Options, Prepared, match_prepared};
use tiepoint_sfm::scene::{Keypoint, Match};

/// Features of an image in memory.
pub(crate) struct LoadedFeatures {
    pub(crate) keypoints: Vec<Keypoint>,
    descriptors: Prepared,
}

impl LoadedFeatures {
    pub(crate) fn new(features: &Features) -> Self {
        Self {
            keypoints: features.keypoints.iter().map(keypoint).collect(),
            descriptors: Prepared::new(&features.descriptors),
        }
    }

    /// The matches of this image, which is `a`, with another one.
    pub(crate) fn matches(&self, other: &Self, options: &Options) -> Vec<Match> {
        let matches = match_prepared(&self.descriptors, &other.descriptors, options);
        matches.iter().map(matched).collect()
    }
}
