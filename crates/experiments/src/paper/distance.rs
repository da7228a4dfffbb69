//! Distances of a cloud to the scan, as in the tables of the paper.

use serde::{Deserialize, Serialize};
use tiepoint_pipeline::evaluation::RegisteredCloud;

/// Mean and standard deviation of point distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Distance {
    pub(crate) mean_m: f64,
    pub(crate) std_m: f64,
}

impl From<&RegisteredCloud> for Distance {
    fn from(cloud: &RegisteredCloud) -> Self {
        Self { mean_m: cloud.distance.mean, std_m: cloud.distance.std }
    }
}
