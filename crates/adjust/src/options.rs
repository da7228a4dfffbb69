//! Scope and options of a bundle adjustment.

use std::collections::BTreeSet;

use tiepoint_geometry::{Loss, OptionError};
use tiepoint_scene::{CameraId, ImageId, PointId, Reconstruction};

use crate::gauge::Gauge;
use crate::noise::relative_noise;

/// Intrinsics that a bundle adjustment refines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineIntrinsics {
    /// Focal lengths.
    pub focal: bool,
    /// The ratio of the focal lengths of models that have two; else it is constant, since pixels
    /// are square. On a street where no camera rolls, a change of the ratio is nearly equivalent to
    /// scaling all heights. A keypoint error of a twentieth of a pixel would change the ratio by a
    /// thousandth. Anamorphic video needs it.
    pub aspect: bool,
    /// The principal point.
    pub principal_point: bool,
    /// Distortion coefficients.
    pub distortion: bool,
    /// Also the coefficients that act like a rotation of the camera, as those of a thin prism
    /// ([`tiepoint_geometry::CameraModelKind::rotation_degenerate_indices`]).
    pub prism: bool,
}

impl RefineIntrinsics {
    /// No intrinsics, for a known calibration.
    pub const NONE: Self = Self {
        focal: false,
        aspect: false,
        principal_point: false,
        distortion: false,
        prism: false,
    };
    /// Focal length and distortion with a constant principal point.
    pub const FOCAL_AND_DISTORTION: Self = Self { focal: true, distortion: true, ..Self::NONE };
    /// All intrinsics of a camera with square pixels and without a prism.
    pub const ALL: Self = Self { principal_point: true, ..Self::FOCAL_AND_DISTORTION };
}

/// Prior on the focal length of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FocalPrior {
    /// The camera.
    pub camera: CameraId,
    /// Mean, in pixels.
    pub mean_px: f64,
    /// Standard deviation, in pixels. It is wide enough for any model that determines the focal
    /// length. It keeps the focal length near the mean in a model that does not, such as a few
    /// images of straight motion.
    pub sigma_px: f64,
}

/// Options of a bundle adjustment.
#[derive(Clone, Copy, Debug)]
pub struct AdjustOptions<'a> {
    /// Intrinsics to refine.
    pub refine: RefineIntrinsics,
    /// Intrinsics to refine of cameras that have a prior from a calibration
    /// ([`Reconstruction::intrinsics_priors`]); `None`: those of [`AdjustOptions::refine`].
    pub refine_calibrated: Option<RefineIntrinsics>,
    /// Whether to adjust a grid-based selection of the tracks only: the longest ones, distributed
    /// over every image.
    pub select_tracks: bool,
    /// Loss on the weighted residuals.
    pub loss: Loss,
    /// Standard deviation of the principal point's prior, relative to the larger side of the image.
    pub principal_point_sigma: f64,
    /// Standard deviation of the prior on each distortion coefficient.
    pub distortion_sigma: f64,
    /// Noise scale of the keypoints as a multiple of [`crate::keypoint_sigma_px`]. Standard
    /// deviations of priors are divided by it.
    pub noise: f64,
    /// Priors on focal lengths. Cameras that are not listed have none.
    pub focal_priors: &'a [FocalPrior],
    /// What fixes the gauge.
    pub gauge: Gauge,
    /// Images whose poses are constant, in every scope. Those of a frame are held as a whole, and
    /// if [`AdjustOptions::constant_rigs`] holds the rig.
    pub constant_poses: Option<&'a BTreeSet<ImageId>>,
    /// Whether the extrinsics of the model's rigs are constant. Then they determine the scale.
    pub constant_rigs: bool,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// Relative decrease of the cost below which the adjustment ends.
    pub function_tolerance: f64,
}

impl AdjustOptions<'_> {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.loss.validate()?;
        for (name, value) in [
            ("principal_point_sigma", self.principal_point_sigma),
            ("distortion_sigma", self.distortion_sigma),
            ("noise", self.noise),
        ] {
            OptionError::check_positive(name, value)?;
        }
        for prior in self.focal_priors {
            OptionError::check_positive("focal_priors.mean_px", prior.mean_px)?;
            OptionError::check_positive("focal_priors.sigma_px", prior.sigma_px)?;
        }
        let tolerance = self.function_tolerance;
        let is_valid = (0.0..1.0).contains(&tolerance);
        OptionError::check("function_tolerance", tolerance, is_valid, "0 to below 1")
    }
}

impl Default for AdjustOptions<'_> {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::FOCAL_AND_DISTORTION,
            refine_calibrated: None,
            select_tracks: false,
            loss: Loss::SoftL1(4.0),
            principal_point_sigma: 0.01,
            distortion_sigma: 0.2,
            noise: 1.0,
            focal_priors: &[],
            gauge: Gauge::FirstAndFarthest,
            constant_poses: None,
            constant_rigs: false,
            max_iterations: 50,
            function_tolerance: 1e-6,
        }
    }
}

/// Scale of the Cauchy loss in standard deviations of the keypoints: 95 % efficiency on Gaussian
/// noise (Holland and Welsch 1977).
const CAUCHY_SIGMAS: f64 = 2.385;
/// Minimum noise scale as a multiple of [`crate::keypoint_sigma_px`]. On synthetic keypoints with
/// less noise, rounding errors would count as outliers.
const MIN_NOISE: f64 = 0.05;

impl AdjustOptions<'_> {
    /// Whether the pose of an image is variable in a scope.
    pub(crate) fn is_variable(&self, scope: &Scope, image: ImageId) -> bool {
        scope.is_variable(image)
            && !self.constant_poses.is_some_and(|images| images.contains(&image))
    }

    /// Sets priors and loss for the noise scale of a finished model ([`AdjustOptions::noise`]). The
    /// weight of the priors does not increase beyond that for a noise scale of 1, because larger
    /// residuals are errors of the model.
    pub fn with_noise_of(self, model: &Reconstruction) -> Self {
        self.with_noise(relative_noise(model))
    }

    /// As [`AdjustOptions::with_noise_of`], for a known noise scale ([`crate::relative_noise`]).
    pub fn with_noise(self, noise: f64) -> Self {
        Self {
            noise: noise.min(1.0),
            loss: Loss::Cauchy(CAUCHY_SIGMAS * noise.max(MIN_NOISE)),
            ..self
        }
    }
}

/// The images and points that an adjustment changes.
#[derive(Clone, Debug)]
pub enum Scope<'a> {
    /// All registered images and all points.
    Global,
    /// The given images and the points that they observe. Other images that observe these points
    /// are constant.
    Local(&'a BTreeSet<ImageId>),
}

impl Scope<'_> {
    /// Whether the image's pose is variable.
    pub fn is_variable(&self, image: ImageId) -> bool {
        match self {
            Self::Global => true,
            Self::Local(images) => images.contains(&image),
        }
    }

    /// The points that the images observe, held out or not, in order of their ids.
    pub(crate) fn points(&self, model: &Reconstruction) -> Vec<PointId> {
        match self {
            Self::Global => model.tracks().map(|(point, _)| point).collect(),
            Self::Local(images) => model.points_observed_by(*images),
        }
    }
}
