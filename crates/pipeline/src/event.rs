use std::ops::ControlFlow;

use serde::Serialize;

use crate::{Error, Stage};

/// What a run tells while it works.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event<'a> {
    /// A stage begins, or goes on after an interruption.
    StageBegan {
        /// Which.
        stage: Stage,
        /// How many steps it has: images, pairs, images.
        total: usize,
        /// How many of them an earlier run did.
        done: usize,
    },
    /// An earlier run finished this stage with the same input and options.
    StageKept {
        /// Which.
        stage: Stage,
    },
    /// What two recordings have both heard tells when one of them began.
    SoundHeard {
        /// The first recording.
        reference: &'a str,
        /// The other one.
        recording: &'a str,
        /// By how many seconds it began later.
        after_s: f64,
    },
    /// A camera has stabilised its pictures electronically.
    Stabilised {
        /// The recording.
        recording: &'a str,
    },
    /// A frame of a video was put into the workspace.
    FrameKept {
        /// Its name.
        image: &'a str,
        /// Frames of this camera that were read so far.
        read: usize,
    },
    /// A photo cannot be used; the others are.
    ImageSkipped {
        /// Its name.
        image: &'a str,
        /// Why, as a sentence.
        why: &'a str,
    },
    /// The features of an image are in the database.
    ImageDone {
        /// Its name.
        image: &'a str,
        /// How many keypoints it has.
        keypoints: usize,
    },
    /// A pair is matched and verified.
    PairDone {
        /// One image.
        image1: &'a str,
        /// The other one.
        image2: &'a str,
        /// Matches of descriptors.
        matches: usize,
        /// Those that agree with a two-view geometry; 0 where there is none.
        inliers: usize,
    },
    /// A model begins with two images.
    ModelBegan {
        /// One image.
        image1: &'a str,
        /// The other one.
        image2: &'a str,
        /// Points that they see together.
        points: usize,
    },
    /// An image has a pose.
    ImageRegistered {
        /// Its name.
        image: &'a str,
        /// Images with a pose in this model.
        registered: usize,
        /// Points in this model.
        points: usize,
    },
    /// A loop that drift had left open is closed.
    LoopClosed {
        /// Pairs of images that it had torn apart.
        pairs: usize,
    },
    /// The whole model was adjusted.
    ModelAdjusted {
        /// Images with a pose.
        images: usize,
        /// Observations.
        observations: usize,
        /// ½ Σ ρ at the end.
        cost: f64,
        /// Steps taken.
        iterations: usize,
    },
    /// An adjustment that was asked for by itself tried a step.
    AdjustmentStep {
        /// From 1.
        step: usize,
        /// ½ Σ ρ after it.
        cost: f64,
    },
    /// The points have no colours, since the photos could not be read again.
    PointsGrey {
        /// Why, as a sentence.
        why: &'a str,
    },
    /// A stage is complete on disk.
    StageDone {
        /// Which.
        stage: Stage,
        /// Wall time of this run's part.
        seconds: f64,
    },
}

/// Gets every event, in order, on the calling thread; what it returns stops the run.
pub type Watch<'a> = &'a mut dyn FnMut(&Event) -> ControlFlow<()>;

/// Tells an event.
///
/// # Errors
///
/// [`Error::Cancelled`] where the run is to stop.
pub(crate) fn tell(watch: Watch, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
