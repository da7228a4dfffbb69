use std::num::NonZeroUsize;
use std::path::PathBuf;

use tiepoint_pipeline::sfm::matching::PairSelection;
use tiepoint_synth::{Effects, RouteKind};

/// The street and the drive of an experiment.
#[derive(Clone, Debug)]
pub struct Scenery {
    /// Output folder. A later call resumes an interrupted one.
    pub folder: PathBuf,
    /// Largest number of images of each camera.
    pub frames: Option<NonZeroUsize>,
    /// Width and height of the images, in pixels.
    pub size: [u32; 2],
    /// Seed of the street, the drive and all random numbers.
    pub seed: u64,
    /// Images per second of each camera.
    pub rate_hz: f64,
    /// Course of the street.
    pub route: RouteKind,
    /// Length of the route, in metres.
    pub length_m: f64,
    /// Imperfections to simulate.
    pub effects: Effects,
    /// Image pairs to match.
    pub pairs: PairSelection,
    /// Whether dense clouds are made and compared, too.
    pub has_dense_clouds: bool,
}
