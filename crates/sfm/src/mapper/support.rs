use tiepoint_scene::Reconstruction;

/// Errors from this size on do not support a hypothesis, in pixels.
const MAX_SUPPORT_ERROR_PX: f64 = 2.0;

/// Support of a model: the sum over observations of 1 − (error / threshold)², at least 0. Also
/// returns the sum relative to the number of observations.
pub(super) fn support(model: &Reconstruction) -> (f64, f64) {
    let errors = model
        .tracks()
        .flat_map(|(_, t)| t.observations.iter().map(|o| model.observation_error_px(o, &t.xyz)));
    let sum: f64 = errors
        .flatten()
        .map(|error_px| (1.0 - (error_px / MAX_SUPPORT_ERROR_PX).powi(2)).max(0.0))
        .sum();
    (sum, sum / model.num_observations().max(1) as f64)
}
