/// Error of a bundle adjustment.
#[derive(Debug, thiserror::Error)]
pub enum Error {
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
    /// An option is out of its range.
    #[error(transparent)]
    Option(#[from] tiepoint_geometry::OptionError),
    /// Error of the optimiser.
    #[error(transparent)]
    Optimiser(#[from] tiepoint_ba::Error),
}
