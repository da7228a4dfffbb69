//! How to map.

use tiepoint_geometry::Loss;

use crate::adjust::RefineIntrinsics;
use crate::register::RegisterOptions;
use crate::rolling_shutter::Readout;
use crate::tracks::{FilterOptions, TrackOptions};

/// What holds cameras that ride together to each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RigTerm {
    /// Nothing.
    #[default]
    Off,
    /// The baseline constraint of Huang, Elhashash & Qin 2022, Eq. (2)-(4), to the letter. What the
    /// paper leaves open: one unit is the distance of the initial pair, which is held, with the
    /// pose of its first image, and never normalised again.
    Paper,
    /// One mounting for each camera, held up to standard deviations that are found by held-out
    /// tracks.
    Soft,
    /// One mounting for each camera, held exactly.
    Hard,
    /// Of off, soft and hard the firmest that held-out tracks do not contradict.
    Auto,
}

/// How to map.
#[derive(Clone, Copy, Debug)]
pub struct MapperOptions {
    /// What may be refined of the cameras.
    pub refine: RefineIntrinsics,
    /// Tracks.
    pub tracks: TrackOptions,
    /// Filters.
    pub filter: FilterOptions,
    /// Registration.
    pub register: RegisterOptions,
    /// Fewer triangulated matches cannot start a model.
    pub min_initial_inliers: usize,
    /// Models with fewer images are dropped, unless it is the only one.
    pub min_model_size: usize,
    /// Of each weighted residual while the model grows.
    pub loss: Loss,
    /// Images in a local adjustment.
    pub local_images: usize,
    /// A global adjustment follows when images or points have grown by this factor.
    pub global_growth: f64,
    /// Between cameras that ride together.
    pub rig: RigTerm,
    /// Of cameras with a rolling shutter; by default all rows count as exposed at once.
    pub readout: Option<Readout>,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for MapperOptions {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::ALL,
            tracks: TrackOptions::default(),
            filter: FilterOptions::default(),
            register: RegisterOptions::default(),
            min_initial_inliers: 30,
            min_model_size: 3,
            loss: Loss::SoftL1(4.0),
            local_images: 6,
            global_growth: 1.1,
            rig: RigTerm::Off,
            readout: None,
            seed: 0,
        }
    }
}
