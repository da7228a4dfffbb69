//! How a model is judged: by tracks that took no part in its adjustment.

use tiepoint_scene::{Observation, Reconstruction};

use crate::tracks::seen_at;

/// ConstrainedModel-out observations count up to this error, in pixels.
const MAX_HELD_OUT_ERROR_PX: f64 = 4.0;

/// Observations of the tracks that are held out and can contradict the poses.
pub(super) fn held_out(model: &Reconstruction) -> Vec<Vec<Observation>> {
    model
        .tracks()
        .filter(|(_, track)| track.is_held_out && track.observations.len() >= 3)
        .map(|(_, track)| track.observations.clone())
        .collect()
}

/// Tracks that took no part, and how well a model without any term explains them.
pub(super) struct HeldOutComparison {
    tracks: Vec<Vec<Observation>>,
    pub(super) error_off_px: f64,
}

impl HeldOutComparison {
    pub(super) fn new(tracks: Vec<Vec<Observation>>, off: &Reconstruction) -> Self {
        let mut held_out = Self { tracks, error_off_px: 0.0 };
        held_out.error_off_px = held_out.error_px(off);
        held_out
    }

    /// Root mean square of the truncated errors of the tracks, triangulated anew between the poses
    /// of now: the same observations whatever the model did with them.
    pub(super) fn error_px(&self, model: &Reconstruction) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for observations in &self.tracks {
            let xyz = seen_at(model, observations);
            for observation in observations {
                let error = xyz.and_then(|xyz| model.error_of_px(observation, &xyz));
                sum += error.unwrap_or(f64::INFINITY).min(MAX_HELD_OUT_ERROR_PX).powi(2);
                count += 1;
            }
        }
        (sum / count.max(1) as f64).sqrt()
    }

    /// A difference of errors as a share of the error without any term.
    pub(super) fn share(&self, difference_px: f64) -> f64 {
        difference_px / self.error_off_px
    }

    /// Whether an error is larger than that without any term by more than a share of it.
    pub(super) fn is_worse(&self, error_px: f64, tolerance: f64) -> bool {
        error_px > (1.0 + tolerance) * self.error_off_px
    }
}
