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
    /// The registered images of a model that is to be extended have no common point.
    #[error(
        "the {images} images with a pose have no matches with each other that triangulate to a \
        point: match them with each other and with the new images"
    )]
    NothingToExtend {
        /// Images with a pose.
        images: usize,
    },
    /// Both known rigs and an existing model give the scale.
    #[error(
        "known rigs and an existing model both give the scale: map with the rigs alone, or go on \
        from the model without them"
    )]
    RigsOfExistingModel,
    /// Sub-maps are to be assembled where something else gives the frame.
    #[error(
        "sub-maps are assembled by their common images: map known rigs, an existing model and \
        the rig constraint of the paper as one map"
    )]
    SubmapsWithFrame,
    /// The states are none of [`crate::Mapper::submap`] with this scene.
    #[error("the sub-maps are those of other images or cameras: map them again")]
    OtherSubmaps,
    /// An option is out of its range.
    #[error(transparent)]
    Option(#[from] tiepoint_geometry::OptionError),
    /// No image of a model is in the scene.
    #[error(
        "none of its {images} images is among the images of the workspace: images are compared \
        by name, and the model has {in_model:?} where the workspace has {in_scene:?}"
    )]
    NoCommonImage {
        /// Images of the model.
        images: usize,
        /// The name of one.
        in_model: String,
        /// The name of an image of the scene.
        in_scene: String,
    },
    /// An image has another size in a model.
    #[error(
        "its image {image} has {}x{} pixels, and that of the workspace {}x{}: use photos of one \
        size, turned as their EXIF orientation says", in_model[0], in_model[1], in_scene[0],
        in_scene[1]
    )]
    OtherSize {
        /// The name of the image.
        image: String,
        /// Width and height in the model, in pixels.
        in_model: [u32; 2],
        /// Width and height in the scene, in pixels.
        in_scene: [u32; 2],
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
    /// Error of a bundle adjustment.
    #[error(transparent)]
    Adjustment(#[from] tiepoint_adjust::Error),
    /// Error of the optimiser outside of bundle adjustment, such as that of a pose graph.
    #[error(transparent)]
    Optimiser(#[from] tiepoint_ba::Error),
    /// The callback asked to stop.
    #[error("stopped on request")]
    Cancelled,
}
