//! Options of the mapper.

use tiepoint_adjust::RefineIntrinsics;
use tiepoint_geometry::{Loss, OptionError};

use crate::register::RegisterOptions;
use crate::rolling_shutter::Readout;
use crate::tracks::{FilterOptions, TrackOptions};

/// Constraint between the cameras of a rig.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RigMode {
    /// No constraint.
    #[default]
    Off,
    /// The baseline constraint of Huang, Elhashash & Qin 2022, Eq. (2)-(4). The paper leaves the
    /// gauge open: the unit is the baseline of the initial pair. Baseline and pose of the pair's
    /// first image stay fixed, without later normalisation.
    Paper,
    /// One relative pose for each camera, with standard deviations selected on held-out tracks.
    Soft,
    /// One relative pose for each camera, exactly.
    Rigid,
    /// The strongest of off, soft and rigid that does not increase the error of held-out tracks
    /// beyond a tolerance.
    Auto,
}

impl RigMode {
    /// All modes.
    pub const ALL: [Self; 5] = [Self::Off, Self::Paper, Self::Soft, Self::Rigid, Self::Auto];

    /// The name: off, paper, soft, rigid or auto.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Paper => "paper",
            Self::Soft => "soft",
            Self::Rigid => "rigid",
            Self::Auto => "auto",
        }
    }

    /// The mode of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.name() == name)
    }
}

/// Options of the mapper.
#[derive(Clone, Copy, Debug)]
pub struct MapperOptions {
    /// Intrinsics that bundle adjustment refines.
    pub refine: RefineIntrinsics,
    /// Whether calibrations ([`tiepoint_scene::Reconstruction::intrinsics_priors`]) are kept as
    /// they are, unless the images contradict them ([`crate::adjust::calibration_evidence`]).
    /// Otherwise they are refined.
    pub keep_calibrations: bool,
    /// Whether cameras with unknown intrinsics get the camera model that their images ask for:
    /// one of SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE and THIN_PRISM_FISHEYE becomes a later
    /// one where the evidence is very strong ([`crate::adjust::better_camera_models`]).
    pub select_camera_models: bool,
    /// Options of track creation.
    pub tracks: TrackOptions,
    /// Options of the point filter.
    pub filter: FilterOptions,
    /// Options of registration.
    pub register: RegisterOptions,
    /// Minimum number of triangulated matches of the initial pair.
    pub min_initial_inliers: usize,
    /// Smaller models are dropped, but for the first, whatever its size.
    pub min_model_size: usize,
    /// Loss on each weighted residual while the model grows.
    pub loss: Loss,
    /// Number of images in a local bundle adjustment.
    pub local_images: usize,
    /// Global bundle adjustment runs when the number of images or points has grown by this factor.
    pub global_growth: f64,
    /// Constraint between the cameras of a rig.
    pub rig: RigMode,
    /// Readout time of rolling-shutter cameras; `None` for global shutters.
    pub readout: Option<Readout>,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl MapperOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.tracks.validate()?;
        self.filter.validate()?;
        self.register.validate()?;
        self.loss.validate()?;
        for (name, value, least) in [
            ("min_initial_inliers", self.min_initial_inliers, 1),
            // The new image and one that it shares points with.
            ("local_images", self.local_images, 2),
        ] {
            let range = if least == 1 { "at least 1" } else { "at least 2" };
            OptionError::check(name, value as f64, value >= least, range)?;
        }
        let growth = self.global_growth;
        let is_valid = growth.is_finite() && growth > 1.0;
        OptionError::check("global_growth", growth, is_valid, "finite and above 1")?;
        match self.readout {
            // It is negative if the last row is exposed first.
            Some(Readout::Known(seconds)) => {
                OptionError::check("readout", seconds, seconds.is_finite(), "finite")
            }
            Some(Readout::Estimated) | None => Ok(()),
        }
    }
}

impl Default for MapperOptions {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::ALL,
            keep_calibrations: true,
            select_camera_models: false,
            tracks: TrackOptions::default(),
            filter: FilterOptions::default(),
            register: RegisterOptions::default(),
            min_initial_inliers: 30,
            min_model_size: 3,
            loss: Loss::SoftL1(4.0),
            local_images: 6,
            global_growth: 1.1,
            rig: RigMode::Off,
            readout: None,
            seed: 0,
        }
    }
}
