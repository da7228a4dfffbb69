//! What an adjustment may move, and how hard it tries.

use std::collections::BTreeSet;

use tiepoint_geometry::Loss;
use tiepoint_scene::{ImageId, ImagePair, PointId, Reconstruction};

use crate::noise::relative_noise;
use crate::two_view::FocalPrior;

/// Which intrinsics an adjustment may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineIntrinsics {
    /// Focal lengths, in the ratio that they have: the pixels of cameras are square. From a street,
    /// which leaves itself as it is when heights grow and no camera rolls, keypoints that are a
    /// twentieth of a pixel off tell another one, by a thousandth.
    pub focal: bool,
    /// The principal point, held near the middle of the image by a prior.
    pub principal_point: bool,
    /// Distortion.
    pub distortion: bool,
}

impl RefineIntrinsics {
    /// Nothing: the calibration is known.
    pub const NONE: Self = Self { focal: false, principal_point: false, distortion: false };
    /// Focal length and distortion, the principal point staying where it is.
    pub const FOCAL_AND_DISTORTION: Self =
        Self { focal: true, principal_point: false, distortion: true };
    /// Everything.
    pub const ALL: Self = Self { focal: true, principal_point: true, distortion: true };
}

/// How to adjust.
#[derive(Clone, Copy, Debug)]
pub struct AdjustOptions<'a> {
    /// What may move of the cameras.
    pub refine: RefineIntrinsics,
    /// Whether points that are enough to place the images take part alone: those seen most often,
    /// all over every image.
    pub selects_points: bool,
    /// Of the weighted residual.
    pub loss: Loss,
    /// Standard deviation of the principal point's prior, as a share of the image's larger side.
    pub principal_point_sigma: f64,
    /// Standard deviation of the prior on each distortion coefficient, around 0.
    pub distortion_sigma: f64,
    /// Standard deviation of the keypoints, as a multiple of [`crate::keypoint_sigma_px`], against
    /// which the priors are weighed.
    pub noise: f64,
    /// What is believed of the focal lengths; of cameras that are not listed, nothing.
    pub focal_priors: &'a [FocalPrior],
    /// The images that hold place, orientation and size of the world: the first one's pose, and one
    /// coordinate in which the second one's centre moves. By default the first and the one farthest
    /// from it.
    pub gauge: Option<ImagePair>,
    /// Steps at most.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this share.
    pub function_tolerance: f64,
}

impl Default for AdjustOptions<'_> {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::FOCAL_AND_DISTORTION,
            selects_points: false,
            loss: Loss::SoftL1(4.0),
            principal_point_sigma: 0.01,
            distortion_sigma: 0.2,
            noise: 1.0,
            focal_priors: &[],
            gauge: None,
            max_iterations: 50,
            function_tolerance: 1e-6,
        }
    }
}

/// Where the loss of a finished model departs from the square, in standard deviations of its
/// keypoints: 95 % as efficient as the square on Gaussian noise (Holland and Welsch 1977).
const CAUCHY_SIGMAS: f64 = 2.385;
/// No keypoint is more precise, in standard deviations of [`crate::keypoint_sigma_px`]: where
/// synthetic ones are, rounding is no outlier.
const MIN_NOISE: f64 = 0.05;

impl AdjustOptions<'_> {
    /// With priors and loss weighed against the noise that a finished model leaves
    /// ([`AdjustOptions::noise`]): precise keypoints decide alone, and one that is off by much more
    /// than most counts little. Noise beyond what was expected is the model's own, and gives the
    /// priors no more weight.
    pub fn weighed_against(self, model: &Reconstruction) -> Self {
        self.with_noise(relative_noise(model))
    }

    pub(crate) fn with_noise(self, noise: f64) -> Self {
        Self {
            noise: noise.min(1.0),
            loss: Loss::Cauchy(CAUCHY_SIGMAS * noise.max(MIN_NOISE)),
            ..self
        }
    }
}

/// Which images and points an adjustment moves.
#[derive(Clone, Debug)]
pub enum Scope<'a> {
    /// Everything that is registered.
    Global,
    /// These images and the points that they see; the other images that see those points hold them
    /// in place.
    Local(&'a BTreeSet<ImageId>),
}

impl Scope<'_> {
    /// Whether an image's pose is adjusted.
    pub fn moves(&self, image: ImageId) -> bool {
        match self {
            Self::Global => true,
            Self::Local(images) => images.contains(&image),
        }
    }

    /// The points that the images see, held out or not, in order.
    pub(super) fn points(&self, model: &Reconstruction) -> Vec<PointId> {
        match self {
            Self::Global => model.tracks().map(|(point, _)| point).collect(),
            Self::Local(images) => model.points_seen_by(*images),
        }
    }
}
