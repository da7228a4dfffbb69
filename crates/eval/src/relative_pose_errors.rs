//! Relative poses of all pairs of cameras: a measure that needs no alignment, and that one bad
//! camera spoils only for its own pairs. As in COLMAP's benchmark and the Image Matching Challenge
//! (Jin et al. 2021, "Image matching across wide baselines").

use tiepoint_geometry::Rigid3;

/// For each ordered pair of cameras the angular error of the relative pose: the larger of the angle
/// between the rotations and the angle between the directions of translation; infinite where the
/// model lacks one of them.
///
/// Of cameras closer together than `min_baseline` (units of the truth) the direction means nothing,
/// and the rotation alone counts. Poses are `cam_from_world`.
pub fn relative_pose_errors_rad(
    model: &[Option<Rigid3>],
    truth: &[Rigid3],
    min_baseline: f64,
) -> Vec<f64> {
    let count = model.len().min(truth.len());
    let mut errors = Vec::with_capacity(count * count.saturating_sub(1));
    for a in 0..count {
        for b in (0..count).filter(|b| *b != a) {
            let (Some(model_a), Some(model_b)) = (model[a], model[b]) else {
                errors.push(f64::INFINITY);
                continue;
            };
            let found = model_b * model_a.inverse();
            let true_ = truth[b] * truth[a].inverse();
            let rotation = found.rotation.angle_to(&true_.rotation);
            let has_direction = true_.translation.norm() > min_baseline;
            // A model that puts both cameras at one place has no direction either: as wrong as can
            // be.
            let direction = match (has_direction, found.translation.norm() > 0.0) {
                (false, _) => 0.0,
                (true, true) => found.translation.angle(&true_.translation),
                (true, false) => std::f64::consts::PI,
            };
            errors.push(rotation.max(direction));
        }
    }
    errors
}

/// Area under the curve of recall over error, from 0 to `threshold`, as a part of the threshold: 1
/// when all errors are zero, 0 when all are above. Errors and threshold have one unit. The curve is
/// linear between errors and level from the last one to the threshold.
pub fn auc(errors: &[f64], threshold: f64) -> f64 {
    let mut sorted: Vec<f64> = errors.iter().copied().filter(|error| *error <= threshold).collect();
    sorted.sort_by(f64::total_cmp);
    let (mut area, mut last_error, mut last_recall) = (0.0, 0.0, 0.0);
    for (index, error) in sorted.iter().enumerate() {
        let recall = (index + 1) as f64 / errors.len() as f64;
        area += 0.5 * (recall + last_recall) * (error - last_error);
        (last_error, last_recall) = (*error, recall);
    }
    (area + last_recall * (threshold - last_error)) / threshold
}
