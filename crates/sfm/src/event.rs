use std::ops::ControlFlow;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::Spread;
use tiepoint_scene::ImageId;

use crate::Error;
use crate::adjust::MountingCovariance;
use crate::companion::Companion;
use crate::mounting::Hold;
use crate::shutter::RollingShutter;

/// What the mapper tells while it works.
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
    /// Two images of one moment that neither agree with the mounting of their cameras in the model nor by their own matches.
    BadPair {
        /// Of the first camera.
        left: ImageId,
        /// Of the other one.
        right: ImageId,
    },
    /// What was to be made of the model failed; it is as it was.
    Failed {
        /// What.
        finish: Finish,
        /// Why, as a sentence.
        why: String,
    },
    /// What the shutter of a camera does, where that was asked for.
    Shutter(RollingShutter),
    /// Images that had no matches with their partners and stood elsewhere were brought back to where their mounting has them.
    SplitClosed {
        /// How many images.
        num_images: usize,
        /// Pairs that matched when they were matched again.
        num_pairs: usize,
    },
    /// The calibration of a camera that is held to the first one.
    MountedCamera(Box<MountedCamera>),
    /// Models of cameras that see nothing in common were joined, since they move as one. Their cameras were held to a mounting: what was told of
    /// mountings before counts no longer, and what follows is of the whole.
    Joined {
        /// Images with a pose in the whole.
        num_images: usize,
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

/// What is made of a model that is finished otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// What a rolling shutter did is taken off the keypoints.
    Straightened,
    /// Cameras are held to each other.
    Held,
}

/// What came out for a camera that rides with the first one.
#[derive(Clone, Debug, PartialEq)]
pub struct MountedCamera {
    /// Which cameras, and the other one's clock.
    pub companion: Companion,
    /// The calibration, in units of the model.
    pub right_from_left: Rigid3,
    /// Of calibration and clock; `None` where something is not determined. Along [`Companion::blind`] the camera is where it was believed to be, and
    /// that is known to a unit.
    pub covariance: Option<MountingCovariance>,
    /// How firmly it is held.
    pub hold: Hold,
    /// Moments at which the two could be compared.
    pub num_moments: usize,
    /// Of the relative poses at the moments that are held.
    pub spread: Option<Spread>,
}

/// Tells an event; an error where the answer is to stop.
pub(crate) fn tell(watch: &mut dyn FnMut(&Event) -> ControlFlow<()>, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
