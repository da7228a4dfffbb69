//! Model comparison by the reprojection error of tracks that are held out of the adjustment.

use std::collections::BTreeMap;

use tiepoint_adjust::triangulate_observations;
use tiepoint_scene::{CameraId, ImageId, Observation, Reconstruction};

use crate::timeline::images_of_cameras;

/// Truncation of the reprojection errors of held-out observations, in pixels.
const MAX_HELD_OUT_ERROR_PX: f64 = 4.0;
/// An increase of the error counts if it exceeds this many of its standard deviations: the
/// one-standard-error rule of cross-validation (Breiman, Friedman, Olshen & Stone 1984, section
/// 3.4.3). On KITTI 01 and 04, three windows of KITTI 01 and three rendered drives, half takes one
/// drive as `soft` in place of `rigid`, with the same error; double takes a window that turns as
/// rigid, for 1.89 cm in place of 0.54, and a rigid drive as `rigid`.
const STANDARD_ERRORS: f64 = 1.0;
/// Parts of the drive whose errors count as independent of each other in the standard deviation of
/// a change. They are longer than tracks as long as a drive has some hundred images. The usual
/// number of a jackknife. On the sets of [`STANDARD_ERRORS`], half takes one more of the rendered
/// drives as `rigid` and double one more as `soft`; no error changes by more than 0.02 cm.
const BLOCKS: usize = 20;

/// Returns the observations of the held-out tracks with at least three observations. Tracks of two
/// rarely contradict the poses.
pub(super) fn held_out_observations(model: &Reconstruction) -> Vec<Vec<Observation>> {
    model
        .tracks()
        .filter(|(_, track)| track.is_held_out && track.observations.len() >= 3)
        .map(|(_, track)| track.observations.clone())
        .collect()
}

/// The held-out tracks, and their error in the model without a rig constraint.
pub(super) struct HeldOutComparison {
    tracks: Vec<Vec<Observation>>,
    /// Errors of each track without a rig constraint.
    off: Vec<ErrorSum>,
    pub(super) error_off_px: f64,
}

/// Change of the error of held-out tracks by a rig constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutChange {
    /// Error with the constraint over that without, less 1.
    pub relative: f64,
    /// Its standard deviation: a jackknife over parts of the drive.
    pub sd: f64,
}

/// Sum of squared errors in pixels, and their number.
#[derive(Clone, Copy, Default)]
struct ErrorSum {
    sum: f64,
    count: usize,
}

impl ErrorSum {
    fn of(squares: impl Iterator<Item = f64>) -> Self {
        squares.fold(Self::default(), |all, square| all.plus(&Self { sum: square, count: 1 }))
    }

    fn plus(self, other: &Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count }
    }

    fn rms(self) -> f64 {
        (self.sum / self.count.max(1) as f64).sqrt()
    }
}

impl HeldOutComparison {
    pub(super) fn new(tracks: Vec<Vec<Observation>>, off: &Reconstruction) -> Self {
        let mut comparison = Self { tracks, off: Vec::new(), error_off_px: 0.0 };
        comparison.error_off_px = comparison.error_px(off);
        comparison.off = comparison.errors(off);
        comparison
    }

    /// The comparison on the tracks that one of the cameras sees.
    pub(super) fn of_cameras(&self, cameras: [CameraId; 2], off: &Reconstruction) -> Self {
        let is_seen = |track: &&Vec<Observation>| {
            track.iter().any(|seen| cameras.contains(&off.image(seen.image).camera))
        };
        Self::new(self.tracks.iter().filter(is_seen).cloned().collect(), off)
    }

    /// Root mean square of the truncated reprojection errors in pixels. The tracks are triangulated
    /// from the model's poses, so that all models are compared on the same observations.
    pub(super) fn error_px(&self, model: &Reconstruction) -> f64 {
        ErrorSum::of(self.tracks.iter().flat_map(|track| squared_errors(model, track))).rms()
    }

    /// The change of the error by the constraint of `model`; `None` if the tracks are in fewer than
    /// two parts of the drive.
    pub(super) fn change(&self, model: &Reconstruction) -> Option<HeldOutChange> {
        self.change_between(&self.off, model)
    }

    /// Whether the error of `model` is above that of `than` by more than [`STANDARD_ERRORS`].
    pub(super) fn is_significantly_worse(
        &self,
        model: &Reconstruction,
        than: &Reconstruction,
    ) -> bool {
        let increase = self.change_between(&self.errors(than), model);
        increase.is_some_and(|increase| increase.relative > STANDARD_ERRORS * increase.sd)
    }

    /// Errors of each track.
    fn errors(&self, model: &Reconstruction) -> Vec<ErrorSum> {
        self.tracks.iter().map(|track| ErrorSum::of(squared_errors(model, track))).collect()
    }

    /// The change of the error from `before`, the errors of each track, to `model`.
    fn change_between(&self, before: &[ErrorSum], model: &Reconstruction) -> Option<HeldOutChange> {
        let places = places(model);
        let mut blocks: BTreeMap<usize, [ErrorSum; 2]> = BTreeMap::new();
        for ((track, before), after) in self.tracks.iter().zip(before).zip(self.errors(model)) {
            let sum: f64 = track.iter().map(|seen| places[&seen.image]).sum();
            let block = (sum / track.len() as f64 * BLOCKS as f64) as usize;
            let sums = blocks.entry(block).or_default();
            *sums = [sums[0].plus(before), sums[1].plus(&after)];
        }
        let change_without = |left_out: Option<usize>| {
            let kept = || blocks.iter().filter(|(block, _)| Some(**block) != left_out);
            let [before, after] = [0, 1].map(|of| {
                kept().fold(ErrorSum::default(), |all, (_, sums)| all.plus(&sums[of])).rms()
            });
            after / before - 1.0
        };
        let count = blocks.len() as f64;
        let each: Vec<f64> = blocks.keys().map(|block| change_without(Some(*block))).collect();
        let mean = each.iter().sum::<f64>() / count;
        let scatter: f64 = each.iter().map(|one| (one - mean).powi(2)).sum();
        let sd = ((count - 1.0) / count * scatter).sqrt();
        (blocks.len() > 1 && sd.is_finite())
            .then(|| HeldOutChange { relative: change_without(None), sd })
    }

    /// Whether an error exceeds the error without a constraint by more than the relative tolerance.
    pub(super) fn is_worse(&self, error_px: f64, tolerance: f64) -> bool {
        error_px > (1.0 + tolerance) * self.error_off_px
    }
}

/// The squared truncated errors of a track that is triangulated from the poses of `model`.
fn squared_errors<'a>(
    model: &'a Reconstruction,
    track: &'a [Observation],
) -> impl Iterator<Item = f64> + 'a {
    let xyz = triangulate_observations(model, track);
    track.iter().map(move |observation| {
        let error = xyz.and_then(|xyz| model.observation_error_px(observation, &xyz));
        error.unwrap_or(f64::INFINITY).min(MAX_HELD_OUT_ERROR_PX).powi(2)
    })
}

/// The place of each image in the sequence of its camera, from 0 to less than 1.
fn places(model: &Reconstruction) -> BTreeMap<ImageId, f64> {
    let mut places = BTreeMap::new();
    for images in images_of_cameras(model).into_values() {
        let count = images.len() as f64;
        places.extend(images.into_iter().enumerate().map(|(rank, id)| (id, rank as f64 / count)));
    }
    places
}
