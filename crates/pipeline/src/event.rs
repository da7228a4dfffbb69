use std::ops::ControlFlow;

use serde::Serialize;

use crate::{Error, Stage};

/// Progress events of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event<'a> {
    /// A stage begins or resumes.
    StageBegan {
        /// The stage.
        stage: Stage,
        /// Its number of steps: images to extract, pairs to match, images to register, or steps of
        /// [`DenseStep`] for each image.
        total: usize,
        /// Number of steps that an earlier run completed.
        done: usize,
    },
    /// An earlier run completed this stage with the same input and options.
    StageKept {
        /// The stage.
        stage: Stage,
    },
    /// The soundtracks of two recordings gave the offset of their starts.
    AudioOffset {
        /// The first recording.
        reference: &'a str,
        /// The other recording.
        recording: &'a str,
        /// Start of the other recording minus start of the first, in seconds.
        after_s: f64,
    },
    /// A camera recorded with electronic stabilisation.
    Stabilised {
        /// The recording.
        recording: &'a str,
    },
    /// A frame of a video was selected and written into the workspace.
    FrameSelected {
        /// Name of the image.
        image: &'a str,
        /// Number of frames of this recording that were read so far.
        read: usize,
    },
    /// Something about the input that decides what the result is worth.
    Noted {
        /// A sentence: what, where, what to do.
        what: &'a str,
    },
    /// A photo cannot be used and is skipped.
    ImageSkipped {
        /// Its name.
        image: &'a str,
        /// The reason, as a sentence.
        reason: &'a str,
    },
    /// The intrinsics of a camera are known from a file.
    CameraCalibrated {
        /// The first photo of the camera.
        image: &'a str,
        /// The file, and the name of the camera in it, as `FILE#CAMERA`.
        calibration: &'a str,
    },
    /// The EXIF focal length of a camera is impossible and is ignored.
    FocalIgnored {
        /// The first photo of the camera.
        image: &'a str,
        /// The focal length in EXIF, in pixels.
        focal_px: f64,
    },
    /// The features of an image are in the database.
    ImageDone {
        /// Its name.
        image: &'a str,
        /// Number of keypoints.
        keypoints: usize,
    },
    /// The pairs to match were chosen.
    PairsChosen {
        /// The selection in the words of the command line; for `auto` what it chose.
        selection: &'a str,
        /// Number of pairs that are matched in this run.
        pairs: usize,
        /// Expected time of matching them, in seconds, from a sample of them.
        expected_s: f64,
    },
    /// A pair is matched and verified.
    PairDone {
        /// The first image.
        image1: &'a str,
        /// The second image.
        image2: &'a str,
        /// Number of descriptor matches.
        matches: usize,
        /// Number of inliers of the two-view geometry; 0 without one.
        inliers: usize,
    },
    /// A model was initialised from two images.
    ModelInitialised {
        /// The first image.
        image1: &'a str,
        /// The second image.
        image2: &'a str,
        /// Number of triangulated points.
        points: usize,
    },
    /// A map goes on from a model.
    ModelExtended {
        /// Number of images of the model.
        images: usize,
        /// Number of those that the workspace lacks. They stay in the map.
        absent: usize,
        /// Number of those with other keypoints in the workspace. Their points are triangulated
        /// anew.
        other_keypoints: usize,
        /// Number of points that were taken.
        points: usize,
    },
    /// An image was registered.
    ImageRegistered {
        /// Its name.
        image: &'a str,
        /// Number of registered images of the model.
        registered: usize,
        /// Number of points of the model.
        points: usize,
    },
    /// A photo was compared with a model.
    ImageLocalized {
        /// Its name.
        image: &'a str,
        /// Number of keypoints that observe a point; 0 without a pose.
        inliers: usize,
    },
    /// An image was undistorted.
    ImageUndistorted {
        /// Its name.
        image: &'a str,
        /// Number of undistorted images.
        done: usize,
        /// Number of images to undistort.
        total: usize,
    },
    /// A loop was closed.
    LoopClosed {
        /// Number of image pairs that drift had separated.
        pairs: usize,
    },
    /// Global bundle adjustment finished.
    ModelAdjusted {
        /// Number of registered images.
        images: usize,
        /// Number of observations.
        observations: usize,
        /// Final cost ½ Σ ρ.
        cost: f64,
        /// Number of steps.
        iterations: usize,
    },
    /// [`adjust`](crate::models::adjust) attempted a step.
    AdjustmentStep {
        /// Number of the step, from 1.
        step: usize,
        /// Cost ½ Σ ρ after the step.
        cost: f64,
    },
    /// A step of dense reconstruction is complete for an image.
    DenseDone {
        /// The step.
        step: DenseStep,
        /// Name of the image.
        image: &'a str,
    },
    /// The points stay grey, because the photos cannot be read any more.
    ColorsMissing {
        /// The reason, as a sentence.
        reason: &'a str,
    },
    /// A stage is complete on disk.
    StageDone {
        /// The stage.
        stage: Stage,
        /// Wall time in this run.
        seconds: f64,
    },
}

/// Steps of dense reconstruction, each for all images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DenseStep {
    /// Undistorts the image.
    Undistort,
    /// Estimates planes at half resolution.
    Planes,
    /// Refines them to a depth map.
    Depths,
}

/// Callback for every event, in order and on the calling thread. `Break` stops the run.
pub type Watch<'a> = &'a mut dyn FnMut(&Event) -> ControlFlow<()>;

/// Passes an event to the callback.
///
/// # Errors
///
/// [`Error::Cancelled`] if the callback returns `Break`.
pub fn emit(watch: Watch, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
