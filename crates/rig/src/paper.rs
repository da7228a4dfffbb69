//! The weights of Huang, Elhashash & Qin 2022, to the letter.
//!
//! While mapping, every link (i, i + 1) of consecutive complete pairs weighs λ N_p/N_t (Eq. 2). In
//! the last adjustment each pair has its own λ_i, 250 or 500 (Eq. 4), and a link takes the larger
//! of its two pairs'. What the paper leaves open is stated here: p_avg is the arithmetic mean of
//! the p_i (each in the axis-angle branch nearest to the first) and is frozen during the last
//! adjustment. A bad pair is pulled harder, which is the reverse of a robust loss.
//!
//! λ has a unit: λ = 500 is a standard deviation of 1/√500 = 0.045 model units and 2.6°. What that
//! means in metres depends on the size of the model; [`Sigmas`] says it.

use tiepoint_geometry::nalgebra::SVector;

use crate::RelativePose;

/// λ while mapping, and of bad pairs in the last adjustment.
pub const LAMBDA: f64 = 500.0;
/// λ_i of good pairs in the last adjustment.
pub const LAMBDA_GOOD: f64 = 250.0;
/// A pair is bad when an element of p_i differs from that of p_avg by more than this many times the
/// latter's size.
pub const MAX_RELATIVE_DEVIATION: f64 = 5.0;

/// λ N_p/N_t of Eq. (2): `num_reconstructed` of `num_pairs` pairs have both poses.
pub fn growing_weight(num_reconstructed: usize, num_pairs: usize) -> f64 {
    LAMBDA * num_reconstructed as f64 / num_pairs.max(1) as f64
}

/// p_avg: the mean over all reconstructed pairs; `None` without any.
pub fn average(poses: &[RelativePose]) -> Option<RelativePose> {
    let first = poses.first()?;
    let sum: SVector<f64, 6> = poses.iter().map(|p| p.nearest_to(first).to_vector()).sum();
    let mean = sum / poses.len() as f64;
    Some(RelativePose {
        translation: mean.fixed_rows::<3>(0).into_owned(),
        axis_angle: mean.fixed_rows::<3>(3).into_owned(),
    })
}

/// Whether Eq. (4) takes a pair for incorrectly estimated: any of the six elements.
pub fn is_bad(pose: &RelativePose, average: &RelativePose) -> bool {
    let (p, avg) = (pose.nearest_to(average).to_vector(), average.to_vector());
    p.iter().zip(&avg).any(|(p, avg)| (p - avg).abs() > MAX_RELATIVE_DEVIATION * avg.abs())
}

/// λ_i of Eq. (4).
pub fn final_weight(pose: &RelativePose, average: &RelativePose) -> f64 {
    if is_bad(pose, average) { LAMBDA } else { LAMBDA_GOOD }
}

/// The weight of each link between consecutive pairs in the last adjustment: the larger of its two
/// pairs'.
pub fn final_link_weights(poses: &[RelativePose]) -> Vec<f64> {
    let Some(average) = average(poses) else { return Vec::new() };
    let weights: Vec<f64> = poses.iter().map(|p| final_weight(p, &average)).collect();
    weights.windows(2).map(|w| w[0].max(w[1])).collect()
}

/// What a weight means as standard deviations of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Of each element of the translation, in model units.
    pub translation: f64,
    /// Of each element of the rotation, in radians.
    pub rotation_rad: f64,
}

/// A least-squares weight w is a standard deviation of 1/√w, in units of pixels of weighted
/// reprojection error.
pub fn sigmas(weight: f64) -> Sigmas {
    let sigma = 1.0 / weight.sqrt();
    Sigmas { translation: sigma, rotation_rad: sigma }
}
