use tiepoint_scene::ImageId;

/// What the mapper tells while it works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A model was begun.
    Initialised {
        /// The image at the origin.
        image1: ImageId,
        /// The other one.
        image2: ImageId,
        /// Points triangulated from the two.
        num_points: usize,
    },
    /// One more image has a pose.
    Registered {
        /// Which.
        image: ImageId,
        /// Images with a pose in this model.
        num_registered: usize,
        /// Images that could have one.
        num_images: usize,
        /// Points in this model.
        num_points: usize,
    },
    /// Everything was adjusted.
    Adjusted {
        /// Images with a pose in this model.
        num_images: usize,
        /// Observations in this model.
        num_observations: usize,
        /// ½ Σ ρ at the end.
        cost: f64,
        /// Steps taken.
        iterations: usize,
    },
}
