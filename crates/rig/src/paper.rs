//! The weights of Huang, Elhashash & Qin 2022, exactly as published.
//!
//! While mapping, every link (i, i + 1) of consecutive complete pairs has the weight λ N_p/N_t (Eq.
//! 2). In the final adjustment each pair has its own λ_i, 250 or 500 (Eq. 4), and a link takes the
//! larger one of its two pairs. The paper leaves two points open, which are chosen here: p_avg is
//! the arithmetic mean of the p_i, each in the axis-angle branch nearest to the first, and it is
//! constant during the final adjustment. A bad pair gets the larger weight, which is the opposite
//! of a robust loss.
//!
//! λ has a unit: λ = 500 is a standard deviation of 1/√500 = 0.045 model units and 2.6°. In metres
//! it depends on the scale of the model; [`Sigmas`] has both.

use tiepoint_geometry::nalgebra::SVector;

use crate::RelativePose;

/// λ while mapping, and of bad pairs in the final adjustment.
pub const LAMBDA: f64 = 500.0;
/// λ_i of good pairs in the final adjustment.
pub const LAMBDA_GOOD: f64 = 250.0;
/// A pair is bad if an element of p_i differs from that of p_avg by more than this many times the
/// element of p_avg.
pub const MAX_RELATIVE_DEVIATION: f64 = 5.0;

/// λ N_p/N_t of Eq. (2), where `num_reconstructed` of `num_pairs` pairs have both poses.
pub fn growing_weight(num_reconstructed: usize, num_pairs: usize) -> f64 {
    LAMBDA * num_reconstructed as f64 / num_pairs.max(1) as f64
}

/// p_avg: the mean over all reconstructed pairs; `None` if there are none.
pub fn average(poses: &[RelativePose]) -> Option<RelativePose> {
    let first = poses.first()?;
    let sum: SVector<f64, 6> = poses.iter().map(|p| p.nearest_to(first).to_vector()).sum();
    let mean = sum / poses.len() as f64;
    Some(RelativePose {
        translation: mean.fixed_rows::<3>(0).into_owned(),
        axis_angle: mean.fixed_rows::<3>(3).into_owned(),
    })
}

/// Whether Eq. (4) classifies a pair as incorrectly estimated, by any of the six elements.
pub fn is_bad(pose: &RelativePose, average: &RelativePose) -> bool {
    let (p, avg) = (pose.nearest_to(average).to_vector(), average.to_vector());
    p.iter().zip(&avg).any(|(p, avg)| (p - avg).abs() > MAX_RELATIVE_DEVIATION * avg.abs())
}

/// λ_i of Eq. (4).
pub fn final_weight(pose: &RelativePose, average: &RelativePose) -> f64 {
    if is_bad(pose, average) { LAMBDA } else { LAMBDA_GOOD }
}

/// The weight of each link between consecutive pairs in the final adjustment: the larger one of its
/// two pairs. One fewer than `poses`.
pub fn final_link_weights(poses: &[RelativePose]) -> Vec<f64> {
    let Some(average) = average(poses) else { return Vec::new() };
    let weights: Vec<f64> = poses.iter().map(|p| final_weight(p, &average)).collect();
    weights.windows(2).map(|w| w[0].max(w[1])).collect()
}

/// A weight as standard deviations of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Standard deviation of each element of the translation, in model units.
    pub translation: f64,
    /// Standard deviation of each element of the rotation, in radians.
    pub rotation_rad: f64,
}

/// Standard deviations 1/√w of a least-squares weight w, when reprojection errors are in pixels
/// with unit weight.
pub fn sigmas(weight: f64) -> Sigmas {
    let sigma = 1.0 / weight.sqrt();
    Sigmas { translation: sigma, rotation_rad: sigma }
}
