use tiepoint_geometry::{Rigid3, nalgebra::Matrix3};

use crate::ImageId;

/// Two images, the smaller id first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ImagePair {
    /// The smaller id.
    pub a: ImageId,
    /// The larger id.
    pub b: ImageId,
}

impl ImagePair {
    /// Orders the two; `None` for an image with itself.
    pub fn new(one: ImageId, other: ImageId) -> Option<Self> {
        (one != other).then(|| Self { a: one.min(other), b: one.max(other) })
    }
}

/// Keypoint `a` of the first image corresponds to keypoint `b` of the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Match {
    /// Keypoint of the first image.
    pub a: u32,
    /// Keypoint of the second image.
    pub b: u32,
}

/// What relates two images; numbers and names are COLMAP's configurations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TwoViewKind {
    /// Not examined.
    #[default]
    Undefined = 0,
    /// Too few inliers.
    Degenerate = 1,
    /// An essential matrix, both cameras being calibrated.
    Calibrated = 2,
    /// A fundamental matrix.
    Uncalibrated = 3,
    /// A homography, of a plane seen from two places.
    Planar = 4,
    /// A homography, of a camera that turned without moving.
    Panoramic = 5,
    /// A homography, of either kind.
    PlanarOrPanoramic = 6,
    /// Inliers that do not move between the images: a watermark or a dirty lens.
    Watermark = 7,
    /// Several models, each with its own inliers.
    Multiple = 8,
}

/// The verified relation of an image pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TwoView {
    /// What kind of relation.
    pub kind: TwoViewKind,
    /// x₂ᵀ F x₁ = 0, in pixels.
    pub fundamental: Option<Matrix3<f64>>,
    /// y₂ᵀ E y₁ = 0, for bearings.
    pub essential: Option<Matrix3<f64>>,
    /// x₂ ~ H x₁, in pixels.
    pub homography: Option<Matrix3<f64>>,
    /// Relative pose with a translation of unit length (zero for a panoramic pair).
    pub cam2_from_cam1: Option<Rigid3>,
    /// The matches that agree with it.
    pub matches: Vec<Match>,
}

impl TwoView {
    /// Whether it relates the two images at all.
    pub fn is_verified(&self) -> bool {
        !matches!(
            self.kind,
            TwoViewKind::Undefined | TwoViewKind::Degenerate | TwoViewKind::Watermark
        )
    }
}
