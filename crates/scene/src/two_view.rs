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
    /// Orders two images; `None` if they are the same.
    pub fn new(one: ImageId, other: ImageId) -> Option<Self> {
        (one != other).then(|| Self { a: one.min(other), b: one.max(other) })
    }
}

/// A correspondence between two images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Match {
    /// Keypoint of the first image.
    pub a: u32,
    /// Keypoint of the second image.
    pub b: u32,
}

/// Kind of a two-view geometry. Numbers and names are COLMAP's configurations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TwoViewKind {
    /// Not verified.
    #[default]
    Undefined = 0,
    /// Too few inliers.
    Degenerate = 1,
    /// Essential matrix with calibrated cameras.
    Calibrated = 2,
    /// Fundamental matrix.
    Uncalibrated = 3,
    /// Homography of a plane.
    Planar = 4,
    /// Homography of a pure rotation.
    Panoramic = 5,
    /// Homography of a plane or of a pure rotation.
    PlanarOrPanoramic = 6,
    /// Inliers without motion between the images: a watermark or a dirty lens.
    Watermark = 7,
    /// Several models with separate inliers.
    Multiple = 8,
}

/// Two-view geometry of an image pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TwoView {
    /// Kind of the geometry.
    pub kind: TwoViewKind,
    /// Fundamental matrix: x₂ᵀ F x₁ = 0, in pixels.
    pub fundamental: Option<Matrix3<f64>>,
    /// Essential matrix: y₂ᵀ E y₁ = 0, for bearings.
    pub essential: Option<Matrix3<f64>>,
    /// Homography: x₂ ~ H x₁, in pixels.
    pub homography: Option<Matrix3<f64>>,
    /// Relative pose with a translation of unit length (zero for a panoramic pair).
    pub cam2_from_cam1: Option<Rigid3>,
    /// Inlier matches.
    pub matches: Vec<Match>,
}

impl TwoView {
    /// Whether the pair is verified.
    pub fn is_verified(&self) -> bool {
        !matches!(
            self.kind,
            TwoViewKind::Undefined | TwoViewKind::Degenerate | TwoViewKind::Watermark
        )
    }
}
