//! Exponential, logarithm and left Jacobian of SE(3). Tangent vectors are (ω, v), rotation first.
//!
//! Exp(ω, v) = (Exp ω, J_l(ω) v). The left Jacobian is 𝒥 = [[J, 0], [Q, J]] with Exp(ξ + δ) ≈ Exp(𝒥
//! δ) Exp(ξ), where Q is Eq. (102) of Barfoot & Furgale 2014, "Associating uncertainty with
//! three-dimensional poses".

use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use tiepoint_geometry::{Rigid3, so3};

pub(crate) type Twist = SVector<f64, 6>;
pub(crate) type Matrix6 = SMatrix<f64, 6, 6>;

/// Below this angle the coefficients are computed by series; three terms leave less than 1e-13.
const SMALL_ANGLE: f64 = 0.05;

fn split(twist: &Twist) -> (Vector3<f64>, Vector3<f64>) {
    (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned())
}

pub(crate) fn exp(twist: &Twist) -> Rigid3 {
    let (w, v) = split(twist);
    Rigid3::new(so3::exp(&w), so3::left_jacobian(&w) * v)
}

pub(crate) fn log(motion: &Rigid3) -> Twist {
    let w = so3::log(&motion.rotation);
    let v = so3::left_jacobian_inverse(&w) * motion.translation;
    Twist::new(w.x, w.y, w.z, v.x, v.y, v.z)
}

/// A fraction of a motion: Exp(fraction · Log(motion)).
pub fn scaled_motion(motion: &Rigid3, fraction: f64) -> Rigid3 {
    exp(&(log(motion) * fraction))
}

/// The left Jacobian 𝒥.
pub(crate) fn left_jacobian(twist: &Twist) -> Matrix6 {
    let (w, v) = split(twist);
    let j = so3::left_jacobian(&w);
    blocks(&j, &q(&w, &v), &j)
}

/// Its inverse 𝒥⁻¹.
pub(crate) fn left_jacobian_inverse(twist: &Twist) -> Matrix6 {
    let (w, v) = split(twist);
    let inverse = so3::left_jacobian_inverse(&w);
    blocks(&inverse, &-(inverse * q(&w, &v) * inverse), &inverse)
}

/// A lower triangular matrix of 3 × 3 blocks.
fn blocks(a: &Matrix3<f64>, below: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix6 {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(a);
    matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(below);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(b);
    matrix
}

fn q(w: &Vector3<f64>, v: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let angle = angle2.sqrt();
    // (θ − sin θ)/θ³, (1 − θ²/2 − cos θ)/θ⁴, (θ − sin θ − θ³/6)/θ⁵.
    let (a, b, c) = if angle < SMALL_ANGLE {
        (
            1.0 / 6.0 - angle2 / 120.0 + angle2 * angle2 / 5040.0,
            -1.0 / 24.0 + angle2 / 720.0 - angle2 * angle2 / 40320.0,
            -1.0 / 120.0 + angle2 / 5040.0 - angle2 * angle2 / 362_880.0,
        )
    } else {
        let (sin, cos) = angle.sin_cos();
        (
            (angle - sin) / (angle2 * angle),
            (1.0 - angle2 / 2.0 - cos) / (angle2 * angle2),
            (angle - sin - angle2 * angle / 6.0) / (angle2 * angle2 * angle),
        )
    };
    let (w, v) = (so3::hat(w), so3::hat(v));
    let (wv, vw) = (w * v, v * w);
    let wvw = wv * w;
    v * 0.5 + (wv + vw + wvw) * a
        - (w * wv + vw * w - wvw * 3.0) * b
        - (wvw * w + w * wvw) * (0.5 * (b - 3.0 * c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    /// Rounding of numbers up to ten, through the quotients of the coefficients.
    const TOLERANCE: f64 = 1e-9;
    const STEP: f64 = 1e-5;

    fn twist(angle: f64, seed: u64) -> Twist {
        let mut rng = Rng::stream(seed, &[1]);
        let mut vector = || Vector3::new(rng.normal(), rng.normal(), rng.normal());
        let (w, v) = (vector().normalize() * angle, vector());
        Twist::new(w.x, w.y, w.z, v.x, v.y, v.z)
    }

    proptest! {
        #[test]
        fn the_logarithm_undoes_the_exponential(angle in 0.0..3.1, seed: u64) {
            let xi = twist(angle, seed);
            prop_assert!((log(&exp(&xi)) - xi).norm() < TOLERANCE);
        }

        #[test]
        fn the_left_jacobian_is_the_derivative(
            angle in prop_oneof![0.0..3.0, 0.049..0.051, 0.0..1e-6],
            seed: u64,
        ) {
            let xi = twist(angle, seed);
            let mut numeric = Matrix6::zeros();
            for column in 0..6 {
                let moved = |step: f64| {
                    let mut moved = xi;
                    moved[column] += step;
                    log(&(exp(&moved) * exp(&xi).inverse()))
                };
                numeric.set_column(column, &((moved(STEP) - moved(-STEP)) / (2.0 * STEP)));
            }
            // Central differences: errors of step² and of rounding / step.
            prop_assert!((numeric - left_jacobian(&xi)).amax() < 1e-8);
            prop_assert!(
                (left_jacobian(&xi) * left_jacobian_inverse(&xi) - Matrix6::identity()).amax()
                    < TOLERANCE
            );
        }

        #[test]
        fn the_adjoint_moves_a_motion_to_the_other_side(angle in 0.0..3.0, seed: u64) {
            let (a, xi) = (exp(&twist(angle, seed)), twist(0.3, seed ^ 1));
            let (left, right) = (a * exp(&xi), exp(&(a.adjoint() * xi)) * a);
            prop_assert!((left.translation - right.translation).norm() < TOLERANCE);
            prop_assert!(left.rotation.angle_to(&right.rotation) < 1e-7);
        }
    }
}
