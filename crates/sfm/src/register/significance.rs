//! How many 2D-3D correspondences must agree with a pose so that chance does not explain them.
//!
//! After Moulon, Monasse & Marlet 2012 (a contrario model estimation, following Moisan & Stival
//! 2004). The background model: all correspondences are wrong and independent. A wrong one has
//! passed the verification of its pair, so it lies near its epipolar line, and one coordinate is
//! left to chance. The probability that it agrees with a pose is therefore that of a distance
//! between point and line, p = 2 t d / a, for a threshold t, the diagonal d and the area a of the
//! image. The number of false alarms of k agreeing correspondences out of n is
//!
//! NFA(n, k) = 4 (n − 3) C(n, k) C(k, 3) pᵏ⁻³
//!
//! with up to four poses from three correspondences. It bounds the expected number of poses that so
//! many correspondences agree with by chance.

use tiepoint_scene::Camera;

/// Maximum number of false alarms: one wrong pose in a thousand images. Half or double changes the
/// required number by at most one.
const MAX_FALSE_ALARMS: f64 = 1e-3;
/// Correspondences that determine a pose, and the number of poses that they may give.
const SAMPLE: usize = 3;
const POSES: f64 = 4.0;

/// The probability that a wrong correspondence agrees with a pose within `max_error_px`.
pub(super) fn chance_of_agreement(camera: &Camera, max_error_px: f64) -> f64 {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    (2.0 * max_error_px * width.hypot(height) / (width * height)).min(1.0)
}

/// Whether chance does not explain that `num_inliers` of `num_candidates` agree with a pose.
pub(super) fn is_significant(num_candidates: usize, num_inliers: usize, chance: f64) -> bool {
    num_inliers > SAMPLE && are_too_few(ln_false_alarms(num_candidates, num_inliers, chance))
}

/// ln of the number of false alarms of `tests` tests, of which each counts events of probability
/// `chance` in `num` trials and one finds `found` or more.
pub(super) fn ln_binomial_false_alarms(tests: usize, num: usize, found: usize, chance: f64) -> f64 {
    let term = |k: usize| {
        (ln_choose(num, k) + k as f64 * chance.ln() + (num - k) as f64 * (1.0 - chance).ln()).exp()
    };
    (tests as f64).ln() + (found..=num).map(term).sum::<f64>().ln()
}

/// Whether so few false alarms mean that it was not chance.
pub(super) fn are_too_few(ln_false_alarms: f64) -> bool {
    ln_false_alarms <= MAX_FALSE_ALARMS.ln()
}

fn ln_false_alarms(num_candidates: usize, num_inliers: usize, chance: f64) -> f64 {
    (POSES * (num_candidates - SAMPLE) as f64).ln()
        + ln_choose(num_candidates, num_inliers)
        + ln_choose(num_inliers, SAMPLE)
        + (num_inliers - SAMPLE) as f64 * chance.ln()
}

/// ln C(n, k).
fn ln_choose(n: usize, k: usize) -> f64 {
    let k = k.min(n - k);
    (0..k).map(|i| ((n - i) as f64 / (k - i) as f64).ln()).sum()
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{
        CameraModelKind, Intrinsics, RansacOptions, Rigid3, Rng, epipolar, estimate,
    };

    use super::*;

    /// The threshold of registration.
    const MAX_ERROR_PX: f64 = 12.0;
    const CAMERA_SIZE: (u32, u32) = (1024, 768);
    const FOCAL_PX: f64 = 800.0;
    /// Draws of wrong correspondences alone: a fifth of a thousand, in which the level lets at most
    /// one be significant.
    const DRAWS: u64 = 200;
    const CANDIDATES: usize = 40;

    fn camera() -> Camera {
        let (width, height) = CAMERA_SIZE;
        let intrinsics =
            Intrinsics::centred(CameraModelKind::SimplePinhole, FOCAL_PX, width, height);
        Camera { intrinsics, width, height, has_focal_prior: true }
    }

    fn required(num_candidates: usize, chance: f64, level: f64) -> Option<usize> {
        (SAMPLE + 1..=num_candidates)
            .find(|&k| ln_false_alarms(num_candidates, k, chance) <= level.ln())
    }

    #[test]
    fn required_numbers_depend_little_on_the_level() {
        let chance = chance_of_agreement(&camera(), MAX_ERROR_PX);
        for num_candidates in [15, 30, 60, 120] {
            let at = |factor| required(num_candidates, chance, factor * MAX_FALSE_ALARMS).unwrap();
            let found = at(1.0);
            assert!(is_significant(num_candidates, found, chance));
            assert!(!is_significant(num_candidates, found - 1, chance));
            assert!(at(0.5) <= found + 1 && at(2.0) + 1 >= found, "{num_candidates}: {found}");
        }
        // Half the threshold leaves half the chance; four correspondences of four prove nothing.
        assert_eq!(2.0 * chance_of_agreement(&camera(), MAX_ERROR_PX / 2.0), chance);
        assert!(!is_significant(4, 4, chance) && !is_significant(0, 0, chance));
        assert!((ln_choose(5, 2).exp() - 10.0).abs() < 1e-9);
    }

    /// Points seen by an image, and keypoints of another one anywhere on their epipolar lines, but
    /// for the first `num_right`.
    fn draw(num_right: usize, seed: u64) -> (Vec<Vector2<f64>>, Vec<Vector3<f64>>) {
        let mut rng = Rng::stream(seed, &[]);
        let intrinsics = camera().intrinsics;
        let pose =
            Rigid3::from_axis_angle(Vector3::new(0.02, -0.1, 0.03), Vector3::new(-1.0, 0.1, -0.5));
        let inverse_k = intrinsics.calibration_matrix().try_inverse().unwrap();
        let fundamental = inverse_k.transpose() * epipolar::essential_from_pose(&pose) * inverse_k;
        let (width, height) = (f64::from(CAMERA_SIZE.0), f64::from(CAMERA_SIZE.1));
        let (mut pixels, mut points) = (Vec::new(), Vec::new());
        while pixels.len() < CANDIDATES {
            let pixel = Vector2::new(width * rng.uniform(), height * rng.uniform());
            let point = intrinsics.unproject(&pixel).unwrap() * (4.0 + 8.0 * rng.uniform());
            let Some(right) = intrinsics.project(&(pose * point)) else { continue };
            let line = fundamental * pixel.push(1.0);
            let x = width * rng.uniform();
            let wrong = Vector2::new(x, -(line.x * x + line.z) / line.y);
            let found = if pixels.len() < num_right { right } else { wrong };
            if camera().contains(&found) {
                pixels.push(found);
                points.push(point);
            }
        }
        (pixels, points)
    }

    fn is_found(num_right: usize, seed: u64) -> bool {
        let (pixels, points) = draw(num_right, seed);
        let camera = camera();
        let ransac = RansacOptions { max_error: MAX_ERROR_PX, seed, ..RansacOptions::default() };
        let report = estimate::absolute_pose(&pixels, &points, &camera.intrinsics, &ransac);
        let chance = chance_of_agreement(&camera, MAX_ERROR_PX);
        report.is_some_and(|report| is_significant(CANDIDATES, report.num_inliers, chance))
    }

    #[test]
    fn wrong_correspondences_on_their_epipolar_lines_are_not_significant() {
        assert_eq!((0..DRAWS).filter(|&seed| is_found(0, seed)).count(), 0);
        // Half of the candidates, fewer than the usual 30, is.
        assert_eq!((0..10).filter(|&seed| is_found(CANDIDATES / 2, seed)).count(), 10);
    }
}
