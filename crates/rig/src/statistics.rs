//! Statistics of the relative pose over time, which measure how constant it is.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::so3;

use crate::RelativePose;

/// Statistics of relative poses over time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePoseStatistics {
    /// Number of pairs.
    pub count: usize,
    /// Median distance between the two cameras, in model units.
    pub median_baseline: f64,
    /// Mean distance, in model units.
    pub mean_baseline: f64,
    /// Standard deviation of the distance, in model units.
    pub sd_baseline: f64,
    /// Root mean square distance of the translations from their mean, in model units.
    pub rms_translation: f64,
    /// Root mean square angle of the rotations from their mean, in radians.
    pub rms_rotation_rad: f64,
    /// Mean distance in the second half of the drive over that in the first half: 1 without scale
    /// drift.
    pub second_over_first_half: f64,
}

/// Statistics of the relative poses in order of time; `None` for fewer than two.
pub fn relative_pose_statistics(poses: &[RelativePose]) -> Option<RelativePoseStatistics> {
    if poses.len() < 2 {
        return None;
    }
    let count = poses.len();
    let baselines: Vec<f64> = poses.iter().map(|p| p.translation.norm()).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let mean_baseline = mean(&baselines);
    let variance =
        baselines.iter().map(|b| (b - mean_baseline).powi(2)).sum::<f64>() / count as f64;
    let centre: Vector3<f64> =
        poses.iter().map(|p| p.translation).sum::<Vector3<f64>>() / count as f64;
    let rms_translation =
        (poses.iter().map(|p| (p.translation - centre).norm_squared()).sum::<f64>() / count as f64)
            .sqrt();
    // Deviations are small except for wrong pairs, so the tangent space of the middle pair is
    // sufficient for the mean.
    let reference = so3::exp(&poses[count / 2].axis_angle);
    let tangents: Vec<Vector3<f64>> =
        poses.iter().map(|p| so3::log(&(reference.inverse() * so3::exp(&p.axis_angle)))).collect();
    let middle: Vector3<f64> = tangents.iter().sum::<Vector3<f64>>() / count as f64;
    let rms_rotation_rad =
        (tangents.iter().map(|t| (t - middle).norm_squared()).sum::<f64>() / count as f64).sqrt();
    Some(RelativePoseStatistics {
        count,
        median_baseline: median(&mut baselines.clone()).unwrap_or(f64::NAN),
        mean_baseline,
        sd_baseline: variance.sqrt(),
        rms_translation,
        rms_rotation_rad,
        second_over_first_half: mean(&baselines[count / 2..]) / mean(&baselines[..count / 2]),
    })
}
