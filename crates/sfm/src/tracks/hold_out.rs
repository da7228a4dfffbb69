//! Held-out tracks: a fraction of the tracks takes no part in adjustment, so that their error is
//! not reduced by over-fitting.

use tiepoint_geometry::Rng;
use tiepoint_scene::{PointId, Reconstruction};

/// Marks a fraction `fraction` (0 to 1) of the tracks as held out and unmarks all others. The
/// choice depends on the seed and on the track's first observation, so that it is stable when other
/// observations change. Returns the number of held-out tracks.
pub fn hold_out_tracks(model: &mut Reconstruction, fraction: f64, seed: u64) -> usize {
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    let mut count = 0;
    for point in points {
        let Some(track) = model.track_mut(point) else { continue };
        let first = track.observations.iter().min();
        track.is_held_out = first.is_some_and(|o| {
            Rng::stream(seed, &[u64::from(o.image.0), u64::from(o.keypoint)]).uniform() < fraction
        });
        count += usize::from(track.is_held_out);
    }
    count
}

/// Root mean square reprojection error of the held-out tracks with at least three observations, in
/// pixels; `None` if there are none. Two rays nearly always intersect approximately.
pub fn held_out_rms_px(model: &Reconstruction) -> Option<f64> {
    /// Minimum number of observations with which a track can contradict the poses.
    const MIN_OBSERVATIONS: usize = 3;
    let (mut sum, mut count) = (0.0, 0usize);
    for (_, track) in
        model.tracks().filter(|(_, t)| t.is_held_out && t.observations.len() >= MIN_OBSERVATIONS)
    {
        for error in
            track.observations.iter().filter_map(|o| model.observation_error_px(o, &track.xyz))
        {
            sum += error * error;
            count += 1;
        }
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}
