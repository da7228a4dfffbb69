use std::ops::ControlFlow;

use tiepoint_scene::ImageId;

use crate::Error;

/// What the mapper tells while it works. Results are in [`crate::MappedModel`].
#[derive(Clone, Debug, PartialEq)]
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
    /// Pairs of images that were torn apart by drift are together again.
    LoopClosed {
        /// How many.
        num_pairs: usize,
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
    /// A stage failed; the model is as it was before.
    Failed(Failure),
    /// Models of cameras that see nothing in common were joined, since they move as one.
    Joined {
        /// Images with a pose in the whole.
        num_images: usize,
    },
}

/// A stage that was undone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Which.
    pub stage: OptionalStage,
    /// Why, as a sentence.
    pub why: String,
}

/// A stage without which a model is finished, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionalStage {
    /// What a rolling shutter did is taken off the keypoints.
    RollingShutter,
    /// Cameras are held to each other.
    Rig,
}

/// Gets every event of the mapper; what it returns stops the run.
pub(crate) type Watch<'a> = dyn FnMut(&Event) -> ControlFlow<()> + 'a;

/// Tells an event; an error where the answer is to stop.
pub(crate) fn tell(watch: &mut Watch, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
