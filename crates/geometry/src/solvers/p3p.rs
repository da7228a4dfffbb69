//! Absolute pose from three rays (Ding, Yang, Larsson, Olsson, Åström 2023, "Revisiting the P3P
//! problem", CVPR).
//!
//! With unit rays bᵢ, depths dᵢ and aᵢⱼ = |Xᵢ − Xⱼ|², the law of cosines gives dᵢ² + dⱼ² − 2 mᵢⱼ
//! dᵢdⱼ = aᵢⱼ, mᵢⱼ = bᵢ·bⱼ. Two ratios of these are conics in (d₀ : d₁ : d₂):
//!
//! - C₁: d₀² + d₁² − 2 m₀₁ d₀d₁ = α (d₁² + d₂² − 2 m₁₂ d₁d₂), α = a₀₁/a₁₂,
//! - C₂: d₀² + d₂² − 2 m₀₂ d₀d₂ = β (d₁² + d₂² − 2 m₁₂ d₁d₂), β = a₀₂/a₁₂.
//!
//! A real root s of the cubic det(C₁ + s C₂) = 0 gives a pair of lines through the common points of
//! both; on each line a quadratic gives at most two. Depths are then refined by Newton's method on
//! the three laws of cosines.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::polynomial::{cubic_root, quadratic_roots};
use crate::{Rigid3, so3};

/// Number of Newton steps on the depths.
const REFINEMENT_STEPS: usize = 2;

/// The poses `cam_from_world` that project `points_in_world[i]` to the unit ray `rays_in_cam[i]`,
/// with positive depths along the rays.
pub fn p3p(
    rays_in_cam: &[Vector3<f64>; 3],
    points_in_world: &[Vector3<f64>; 3],
) -> ArrayVec<Rigid3, 4> {
    let squared = |i: usize, j: usize| (points_in_world[i] - points_in_world[j]).norm_squared();
    // The longest side divides the others: order the points so that it is the side 12.
    let sides = [squared(1, 2), squared(0, 2), squared(0, 1)];
    let first = (0..3).fold(0, |best, i| if sides[i] > sides[best] { i } else { best });
    let order = [first, (first + 1) % 3, (first + 2) % 3];
    let b = order.map(|i| rays_in_cam[i]);
    let x = order.map(|i| points_in_world[i]);
    let (a12, a02, a01) = (sides[order[0]], sides[order[1]], sides[order[2]]);
    let (m01, m02, m12) = (b[0].dot(&b[1]), b[0].dot(&b[2]), b[1].dot(&b[2]));
    let (alpha, beta) = (a01 / a12, a02 / a12);

    let edges =
        Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], (x[1] - x[0]).cross(&(x[2] - x[0]))]);
    let Some(inverse_edges) = edges.try_inverse() else { return ArrayVec::new() };

    let c1 = Matrix3::new(1.0, -m01, 0.0, -m01, 1.0 - alpha, alpha * m12, 0.0, alpha * m12, -alpha);
    let c2 = Matrix3::new(1.0, 0.0, -m02, 0.0, -beta, beta * m12, -m02, beta * m12, 1.0 - beta);
    let mut poses = ArrayVec::new();
    let Some((conic, degenerate)) = degenerate_conic(&c1, &c2) else { return poses };
    for line in split_into_lines(&degenerate).into_iter().flatten() {
        for [d0, d1, d2] in intersect(&line, &conic) {
            // The longest side gives the scale of the depths.
            let scale = (a12 / (d1 * d1 + d2 * d2 - 2.0 * m12 * d1 * d2)).sqrt();
            let sign = if d0 + d1 + d2 < 0.0 { -scale } else { scale };
            let depths = Vector3::new(d0, d1, d2) * sign;
            if !(depths.min() > 0.0 && depths.max().is_finite()) || poses.is_full() {
                continue;
            }
            let depths = refine_depths(depths, [m01, m02, m12], [a01, a02, a12]);
            let y = [b[0] * depths[0], b[1] * depths[1], b[2] * depths[2]];
            let (e1, e2) = (y[1] - y[0], y[2] - y[0]);
            let matrix = Matrix3::from_columns(&[e1, e2, e1.cross(&e2)]) * inverse_edges;
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
            poses.push(Rigid3 { rotation, translation: y[0] - rotation * x[0] });
        }
    }
    poses
}

/// One of the two conics, and the degenerate conic (a pair of lines) through the intersections of
/// both. The returned conic does not contain the lines.
fn degenerate_conic(c1: &Matrix3<f64>, c2: &Matrix3<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let (a1, a2) = (adjugate(c1), adjugate(c2));
    // det(c1 + s c2) = det c1 + s tr(adj(c1) c2) + s² tr(adj(c2) c1) + s³ det c2
    let d0 = a1.row(0).transpose().dot(&c1.column(0));
    let d1 = a1.component_mul(c2).sum();
    let d2 = a2.component_mul(c1).sum();
    let d3 = a2.row(0).transpose().dot(&c2.column(0));
    // Solve for s or for 1/s, whichever has the larger leading coefficient.
    if d3.abs() >= d0.abs() {
        let s = cubic_root([d0 / d3, d1 / d3, d2 / d3]);
        let conic = if s.abs() < 1.0 { c2 } else { c1 };
        s.is_finite().then(|| (*conic, c1 + c2 * s))
    } else {
        let s = cubic_root([d3 / d0, d2 / d0, d1 / d0]);
        let conic = if s.abs() < 1.0 { c1 } else { c2 };
        s.is_finite().then(|| (*conic, c1 * s + c2))
    }
}

/// The transposed matrix of cofactors of a symmetric matrix.
fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c, d, e, f] = [m.m11, m.m12, m.m13, m.m22, m.m23, m.m33];
    let (xx, xy, xz) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let (yy, yz, zz) = (a * f - c * c, b * c - a * e, a * d - b * b);
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// The two lines of a conic of rank two (Richter-Gebert 2011, "Perspectives on projective
/// geometry", chapter 11); `None` if they are not real.
fn split_into_lines(conic: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
    // The adjugate of p qᵀ + q pᵀ is −(p × q)(p × q)ᵀ. Adding the cross-product matrix of p × q
    // gives 2 p qᵀ or its transpose.
    let adjugate = adjugate(conic);
    let diagonal = adjugate.diagonal();
    let i = diagonal.imin();
    if diagonal[i] > 0.0 {
        return None;
    }
    let cross: Vector3<f64> = if diagonal[i] < 0.0 {
        adjugate.column(i) / -(-diagonal[i]).sqrt()
    } else {
        Vector3::zeros()
    };
    let product = conic + so3::hat(&cross);
    let (row, column) = product.abs().iamax_full();
    Some([product.column(column).into_owned(), product.row(row).transpose()])
}

/// The intersections of a line and a conic, in homogeneous coordinates.
fn intersect(line: &Vector3<f64>, conic: &Matrix3<f64>) -> ArrayVec<[f64; 3], 2> {
    // Points of the line are τu + w, with the coordinate of the line's largest entry eliminated.
    let i = line.iamax();
    let (j, k) = ((i + 1) % 3, (i + 2) % 3);
    let (mut u, mut w) = (Vector3::zeros(), Vector3::zeros());
    (u[j], w[k]) = (1.0, 1.0);
    (u[i], w[i]) = (-line[j] / line[i], -line[k] / line[i]);
    let (cu, cw) = (conic * u, conic * w);
    let taus = quadratic_roots(w.dot(&cw), 2.0 * u.dot(&cw), u.dot(&cu));
    taus.into_iter().flatten().map(|tau| (u * tau + w).into()).collect()
}

/// Refines the depths by Newton's method on the laws of cosines, with the cosines m and the squared
/// side lengths a of the sides 01, 02, 12.
fn refine_depths(
    mut d: Vector3<f64>,
    [m01, m02, m12]: [f64; 3],
    [a01, a02, a12]: [f64; 3],
) -> Vector3<f64> {
    for _ in 0..REFINEMENT_STEPS {
        let error = Vector3::new(
            d[0] * d[0] + d[1] * d[1] - 2.0 * m01 * d[0] * d[1] - a01,
            d[0] * d[0] + d[2] * d[2] - 2.0 * m02 * d[0] * d[2] - a02,
            d[1] * d[1] + d[2] * d[2] - 2.0 * m12 * d[1] * d[2] - a12,
        );
        // Half the Jacobian has the rows (p, q, 0), (r, 0, s), (0, t, u).
        let (p, q) = (d[0] - m01 * d[1], d[1] - m01 * d[0]);
        let (r, s) = (d[0] - m02 * d[2], d[2] - m02 * d[0]);
        let (t, u) = (d[1] - m12 * d[2], d[2] - m12 * d[1]);
        let determinant = -(p * s * t + q * r * u);
        let step = Vector3::new(
            -s * t * error[0] - q * u * error[1] + q * s * error[2],
            -r * u * error[0] + p * u * error[1] - p * s * error[2],
            r * t * error[0] - p * t * error[1] - q * r * error[2],
        ) * (0.5 / determinant);
        if !step.iter().all(|v| v.is_finite()) {
            break;
        }
        d -= step;
    }
    d
}
