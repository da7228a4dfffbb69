use std::fmt;

use serde::{Deserialize, Serialize};

/// A stage of the pipeline, whose result is kept on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(expecting = "the name of a stage")]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Keypoints and descriptors of every image.
    Features,
    /// Matches and two-view geometries of image pairs.
    Match,
    /// Poses and points.
    Map,
    /// Depth maps and the dense cloud.
    Dense,
}

impl Stage {
    /// All stages in order.
    pub const ALL: [Self; 4] = [Self::Features, Self::Match, Self::Map, Self::Dense];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Features => "features",
            Self::Match => "match",
            Self::Map => "map",
            Self::Dense => "dense",
        }
    }

    /// Its results, as a plural noun for messages.
    pub(crate) fn products(self) -> &'static str {
        match self {
            Self::Features => "features",
            Self::Match => "matches",
            Self::Map => "models",
            Self::Dense => "depth maps",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
