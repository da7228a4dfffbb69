use std::ops::ControlFlow;

use tiepoint_scene::ImageId;

use crate::Error;

/// Progress event of the mapper. Results are in [`crate::MappedModel`].
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A model was initialised from an image pair.
    Initialised {
        /// The image at the origin.
        image1: ImageId,
        /// The second image.
        image2: ImageId,
        /// Number of triangulated points.
        num_points: usize,
    },
    /// An image was registered.
    Registered {
        /// The image.
        image: ImageId,
        /// Registered images of this model.
        num_registered: usize,
        /// Images that are in no earlier model.
        num_images: usize,
        /// Points of this model.
        num_points: usize,
    },
    /// A loop was closed: image pairs separated by drift have common points again.
    LoopClosed {
        /// Number of these pairs.
        num_pairs: usize,
    },
    /// A global bundle adjustment ended.
    Adjusted {
        /// Registered images of this model.
        num_images: usize,
        /// Observations of this model.
        num_observations: usize,
        /// Final cost ½ Σ ρ.
        cost: f64,
        /// Number of iterations.
        iterations: usize,
    },
    /// A model held two places that look alike as one. The images of the smaller one left it.
    Divided {
        /// Images that stay.
        num_images: usize,
        /// Images that left, and may give another model.
        num_others: usize,
    },
    /// A stage failed. The model is as it was before the stage.
    Failed(Failure),
    /// Two models were merged: growth from one of them reached the other, or their cameras move as
    /// one rig.
    Merged {
        /// Registered images of the merged model.
        num_images: usize,
    },
}

/// A stage that failed and was undone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The stage.
    pub stage: OptionalStage,
    /// The reason, as a sentence.
    pub reason: String,
}

/// A stage that may fail without failing the mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionalStage {
    /// Rolling-shutter correction of the keypoints.
    RollingShutter,
    /// Estimation of the rig and constraint of the cameras.
    Rig,
}

/// Receives every event of the mapper. A `Break` stops the run.
pub(crate) type Watch<'a> = dyn FnMut(&Event) -> ControlFlow<()> + 'a;

/// Sends an event.
///
/// # Errors
///
/// [`Error::Cancelled`] if the receiver asks to stop.
pub(crate) fn notify(watch: &mut Watch, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
