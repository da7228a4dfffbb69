/// Error of a mapping or an adjustment.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No image pair has enough matches that triangulate.
    #[error(
        "no image pair can start a model: {verified} verified pairs, the best has {best_inliers} \
        matches that triangulate \
         (at least {required} are needed); take photos that overlap more and are taken from \
         different places"
    )]
    NoInitialPair {
        /// Number of verified pairs.
        verified: usize,
        /// Triangulated matches of the best pair.
        best_inliers: usize,
        /// Required number.
        required: usize,
    },
    /// Fewer than two registered images have a common point.
    #[error(
        "nothing to adjust: {images} posed images, {points} points, {observations} observations"
    )]
    NothingToAdjust {
        /// Registered images.
        images: usize,
        /// Points.
        points: usize,
        /// Observations.
        observations: usize,
    },
    /// The rolling-shutter correction left too few images with observations.
    #[error("only {after} of {before} images keep observations")]
    ImagesLost {
        /// Registered images before the correction.
        before: usize,
        /// Registered images after the correction.
        after: usize,
    },
    /// The known extrinsics of a rig have no use.
    #[error(
        "no frame has two images whose relative pose agrees with the known extrinsics to 20 \
        degrees, so that images were registered one by one"
    )]
    NoKnownFrame,
    /// Closing a loop removed more matches elsewhere than it added.
    #[error(
        "a loop of {pairs} pairs of images was not closed: their matches contradict the others'"
    )]
    LoopNotClosed {
        /// Image pairs of the loop.
        pairs: usize,
    },
    /// The terms compose the pose of an image twice, or of an image that no
    /// [`crate::Term::composed_images`] named.
    #[error(
        "the terms of an adjustment compose the pose of an image twice, or of an image that they \
        did not name"
    )]
    ComposedPoses,
    /// Error of a caller's own term.
    #[error(transparent)]
    Term(Box<dyn std::error::Error + Send + Sync>),
    /// Error of the optimiser.
    #[error(transparent)]
    Adjustment(#[from] tiepoint_ba::Error),
    /// The callback asked to stop.
    #[error("stopped on request")]
    Cancelled,
}
