//! Model comparison by the reprojection error of tracks that are held out of the adjustment.

use tiepoint_adjust::triangulate_observations;
use tiepoint_scene::{Observation, Reconstruction};

/// Truncation of the reprojection errors of held-out observations, in pixels.
const MAX_HELD_OUT_ERROR_PX: f64 = 4.0;

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
    pub(super) error_off_px: f64,
}

impl HeldOutComparison {
    pub(super) fn new(tracks: Vec<Vec<Observation>>, off: &Reconstruction) -> Self {
        let mut comparison = Self { tracks, error_off_px: 0.0 };
        comparison.error_off_px = comparison.error_px(off);
        comparison
    }

    /// Root mean square of the truncated reprojection errors in pixels. The tracks are triangulated
    /// from the model's poses, so that all models are compared on the same observations.
    pub(super) fn error_px(&self, model: &Reconstruction) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for observations in &self.tracks {
            let xyz = triangulate_observations(model, observations);
            for observation in observations {
                let error = xyz.and_then(|xyz| model.observation_error_px(observation, &xyz));
                sum += error.unwrap_or(f64::INFINITY).min(MAX_HELD_OUT_ERROR_PX).powi(2);
                count += 1;
            }
        }
        (sum / count.max(1) as f64).sqrt()
    }

    /// A difference of errors relative to the error without a constraint.
    pub(super) fn relative(&self, difference_px: f64) -> f64 {
        difference_px / self.error_off_px
    }

    /// Whether an error exceeds the error without a constraint by more than the relative tolerance.
    pub(super) fn is_worse(&self, error_px: f64, tolerance: f64) -> bool {
        error_px > (1.0 + tolerance) * self.error_off_px
    }
}
