//! Relative-pose errors of all pairs of images, and their AUC, as in COLMAP's benchmark and the
//! Image Matching Challenge (Jin et al. 2021, "Image matching across wide baselines"). The measure
//! needs no alignment, and a wrong pose affects only its own pairs.

use tiepoint_geometry::Rigid3;

/// Angular error of the relative pose of each ordered pair of images: the larger of the angle
/// between the rotations and the angle between the directions of translation, in radians. Infinite
/// if the model lacks one of the poses.
///
/// Poses are `cam_from_world`. For true centres closer than `min_baseline` (units of the ground
/// truth) only the rotation counts, because the direction is undefined.
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
            // Coincident estimated centres have no direction: the largest error.
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

/// Area under the recall curve from 0 to `threshold`, over the threshold: 1 if all errors are zero,
/// 0 if all exceed the threshold. Errors and threshold have the same unit. The curve is linear
/// between errors and constant from the last error to the threshold.
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
