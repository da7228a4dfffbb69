//! Judging a model from outside: a share of the tracks takes no part in adjustment, and how well
//! the adjusted poses explain them cannot be flattered by over-fitting.

use tiepoint_geometry::Rng;
use tiepoint_scene::{PointId, Reconstruction};

/// Marks about `share` (0 to 1) of the tracks as held out, and no others. Which ones depends on the
/// seed and on the track's first observation, so that a track keeps its role when others come and
/// go. Returns how many.
pub fn hold_out_tracks(model: &mut Reconstruction, share: f64, seed: u64) -> usize {
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    let mut count = 0;
    for point in points {
        let Some(track) = model.track_mut(point) else { continue };
        let first = track.observations.iter().min();
        track.is_held_out = first.is_some_and(|o| {
            Rng::stream(seed, &[u64::from(o.image.0), u64::from(o.keypoint)]).uniform() < share
        });
        count += usize::from(track.is_held_out);
    }
    count
}

/// Root mean square distance between keypoint and projection over the held-out tracks with at least
/// three observations (two rays nearly always meet somewhere), in pixels; `None` where there are
/// none.
pub fn held_out_rms_px(model: &Reconstruction) -> Option<f64> {
    /// Fewest observations of a track that can contradict the poses.
    const MIN_OBSERVATIONS: usize = 3;
    let (mut sum, mut count) = (0.0, 0usize);
    for (_, track) in
        model.tracks().filter(|(_, t)| t.is_held_out && t.observations.len() >= MIN_OBSERVATIONS)
    {
        for error in track.observations.iter().filter_map(|o| model.error_of_px(o, &track.xyz)) {
            sum += error * error;
            count += 1;
        }
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}
