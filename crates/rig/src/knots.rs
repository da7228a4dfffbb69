//! Interpolation of a trajectory: a cubic on SE(3) through four poses at any times.
//!
//! With the poses P_k = `cam_from_world` at times t_k and the Lagrange polynomials ℓ_k of those
//! times, P(t) = Exp(Σ ℓ_k(t) η_k) P_1 with η_k = Log(P_k P_1⁻¹): the Lagrange cubic in the tangent
//! space at the second pose. It passes through all four poses. A motion of constant twist (along a
//! line or a circle) is reproduced exactly, because then η_k = (t_k − t_1) ξ and Σ ℓ_k(t) (t_k −
//! t_1) = t − t_1.
//!
//! The tangents ε = (δ, τ) of CONVENTIONS.md are, to first order, perturbations P ← Exp(ε) P. With
//! ζ = Σ ℓ_k η_k, the derivatives are dη_k = 𝒥⁻¹(η_k) ε_k − 𝒥⁻¹(−η_k) ε_1, dP(t) = 𝒥(ζ) Σ ℓ_k dη_k
//! + Ad(Exp ζ) ε_1, and dP/dt = 𝒥(ζ) Σ ℓ_k' η_k.

use tiepoint_geometry::Rigid3;

use crate::se3::{self, Matrix6, Twist};

/// Four poses (`cam_from_world`) with their times, ascending, and the cubic through them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knots<'a> {
    /// The poses.
    pub poses: [&'a Rigid3; 4],
    /// Their times in seconds, all different.
    pub times_s: [f64; 4],
}

/// A pose with its derivatives with respect to the tangents (rotation, translation) of the four
/// knots and to time.
pub(crate) struct LinearPose {
    pub(crate) pose: Rigid3,
    pub(crate) d_knots: [Matrix6; 4],
    pub(crate) d_time: Twist,
}

/// The knot of the tangent space.
const BASE: usize = 1;

impl Knots<'_> {
    /// The interpolated pose at a time, which should be between those of the knots.
    pub fn at(&self, time_s: f64) -> Rigid3 {
        let weights = self.weights(time_s).0;
        let twists = self.twists();
        let zeta: Twist = (0..4).map(|k| twists[k] * weights[k]).sum();
        se3::exp(&zeta) * *self.poses[BASE]
    }

    pub(crate) fn linearize(&self, time_s: f64) -> LinearPose {
        let (weights, slopes) = self.weights(time_s);
        let twists = self.twists();
        let zeta: Twist = (0..4).map(|k| twists[k] * weights[k]).sum();
        let slope: Twist = (0..4).map(|k| twists[k] * slopes[k]).sum();
        let motion = se3::exp(&zeta);
        let pose = motion * *self.poses[BASE];
        let jacobian = se3::left_jacobian(&zeta);
        let mut d_base = motion.adjoint();
        let mut d_knots = [Matrix6::zeros(); 4];
        for k in (0..4).filter(|&k| k != BASE) {
            d_knots[k] = jacobian * se3::left_jacobian_inverse(&twists[k]) * weights[k];
            d_base -= jacobian * se3::left_jacobian_inverse(&-twists[k]) * weights[k];
        }
        d_knots[BASE] = d_base;
        LinearPose { pose, d_knots, d_time: jacobian * slope }
    }

    /// η_k.
    fn twists(&self) -> [Twist; 4] {
        let world_from_base = self.poses[BASE].inverse();
        std::array::from_fn(|k| match k {
            BASE => Twist::zeros(),
            _ => se3::log(&(*self.poses[k] * world_from_base)),
        })
    }

    /// ℓ_k and ℓ_k' at a time.
    fn weights(&self, time_s: f64) -> ([f64; 4], [f64; 4]) {
        let t = &self.times_s;
        let (mut weights, mut slopes) = ([1.0; 4], [0.0; 4]);
        for k in 0..4 {
            for other in (0..4).filter(|&other| other != k) {
                // Product rule, one Lagrange factor at a time.
                let (factor, slope) =
                    ((time_s - t[other]) / (t[k] - t[other]), 1.0 / (t[k] - t[other]));
                slopes[k] = slopes[k] * factor + weights[k] * slope;
                weights[k] *= factor;
            }
        }
        (weights, slopes)
    }
}
