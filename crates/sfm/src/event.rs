use std::ops::ControlFlow;

use tiepoint_scene::ImageId;

use crate::Error;
use crate::mounting::Hold;

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
    /// Two images of one moment that neither agree with the mounting of their cameras in the model nor by their own matches.
    BadPair {
        /// Of the first camera.
        left: ImageId,
        /// Of the other one.
        right: ImageId,
    },
    /// A finished model was held to the mountings of its cameras.
    Mounted {
        /// How firmly in the end; `None` where it would have explained held-out tracks worse.
        hold: Option<Hold>,
        /// Moments that take part.
        num_pairs: usize,
        /// Error of the held-out tracks without any mounting, in pixels.
        error_off_px: f64,
        /// The same as it is now.
        error_px: f64,
    },
}

/// Tells an event; an error where the answer is to stop.
pub(crate) fn tell(watch: &mut dyn FnMut(&Event) -> ControlFlow<()>, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
