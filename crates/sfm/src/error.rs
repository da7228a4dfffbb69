/// Why a mapping or an adjustment could not be done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No two images overlap enough to begin with.
    #[error(
        "no image pair can start a model: {verified} verified pairs, the best has {best_inliers} \
        matches that triangulate \
         (at least {required} are needed); take photos that overlap more and are taken from \
         different places"
    )]
    NoInitialPair {
        /// How many verified pairs there are.
        verified: usize,
        /// Triangulated matches of the best of them.
        best_inliers: usize,
        /// How many are asked for.
        required: usize,
    },
    /// Fewer than two images with a pose and a common point.
    #[error(
        "nothing to adjust: {images} posed images, {points} points, {observations} observations"
    )]
    NothingToAdjust {
        /// Images with a pose.
        images: usize,
        /// Points.
        points: usize,
        /// Observations.
        observations: usize,
    },
    /// What was taken off the keypoints cannot have been done to them.
    #[error("only {after} of {before} images keep observations")]
    ImagesLost {
        /// Images with a pose before,
        before: usize,
        /// and after.
        after: usize,
    },
    /// Making the matches of torn pairs one point costs more matches elsewhere.
    #[error(
        "a loop of {pairs} pairs of images was not closed: their matches contradict the others'"
    )]
    LoopNotClosed {
        /// Pairs of images.
        pairs: usize,
    },
    /// Terms compose the pose of an image twice, or of another image than they said.
    #[error(
        "the terms of an adjustment compose the pose of an image twice, or of an image that they \
        did not name"
    )]
    ComposedPoses,
    /// A term of the caller's own cannot join an adjustment.
    #[error(transparent)]
    Term(Box<dyn std::error::Error + Send + Sync>),
    /// The optimiser refused the problem.
    #[error(transparent)]
    Adjustment(#[from] tiepoint_ba::Error),
    /// The caller's callback asked to stop.
    #[error("stopped on request")]
    Cancelled,
}
