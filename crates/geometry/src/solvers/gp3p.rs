//! Absolute pose of a generalised camera from three rays (Nistér & Stewénius 2007, "A minimal
//! solution to the generalised 3-point pose problem", JMIV 27).
//!
//! The rays pass through pᵢ with unit directions bᵢ. With depths dᵢ, wᵢⱼ = pᵢ − pⱼ, mᵢⱼ = bᵢ·bⱼ and
//! aᵢⱼ = |Xᵢ − Xⱼ|², the distances of the points give three quadrics
//!
//! dᵢ² + dⱼ² − 2 mᵢⱼ dᵢdⱼ + 2 (wᵢⱼ·bᵢ) dᵢ − 2 (wᵢⱼ·bⱼ) dⱼ + |wᵢⱼ|² − aᵢⱼ = 0.
//!
//! Over x = d₀, those of the sides 01 and 02 are d₁² + B₁d₁ + C₁ = 0 and d₂² + B₂d₂ + C₂ = 0. They
//! remove the squares from that of the side 12, which becomes P d₁ + Q d₂ + S d₁d₂ + T = 0. Its d₂
//! in the quadratic of d₂, reduced by the quadratic of d₁, is U d₁ + V = 0. This d₁ in its own
//! quadratic gives V² − B₁UV + C₁U² = 0, of degree eight in x. The depths are then refined by
//! Newton's method on the three quadrics.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::p3p::p3p;
use super::sturm::real_roots;
use crate::Rigid3;

/// Maximum number of solutions.
const MAX_SOLUTIONS: usize = 8;
/// Number of Newton steps on the depths.
const REFINEMENT_STEPS: usize = 3;
/// Maximum residual of a quadric after refinement, relative to its terms. Newton's method reaches
/// rounding errors from a root of the polynomial; a larger residual belongs to no solution.
const MAX_RESIDUAL: f64 = 1e-9;

/// The poses `rig_from_world` that take `points_in_world[i]` to the ray through `origins_in_rig[i]`
/// in the unit direction `rays_in_rig[i]`, with positive depths along the rays.
///
/// If the rays meet in one point, the solutions are those of [`p3p`].
pub fn gp3p(
    origins_in_rig: &[Vector3<f64>; 3],
    rays_in_rig: &[Vector3<f64>; 3],
    points_in_world: &[Vector3<f64>; 3],
) -> ArrayVec<Rigid3, MAX_SOLUTIONS> {
    let origin = origins_in_rig[0];
    if origins_in_rig[1] == origin && origins_in_rig[2] == origin {
        let central = p3p(rays_in_rig, points_in_world).into_iter();
        return central
            .map(|pose| Rigid3 { translation: pose.translation + origin, ..pose })
            .collect();
    }
    let x = points_in_world;
    let edges =
        Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], (x[1] - x[0]).cross(&(x[2] - x[0]))]);
    let Some(inverse_edges) = edges.try_inverse() else { return ArrayVec::new() };
    // The longest side is the unit of length.
    let sides = [(0, 1), (0, 2), (1, 2)].map(|(i, j): (usize, usize)| (x[i] - x[j]).norm());
    let unit = sides[0].max(sides[1]).max(sides[2]);
    let p = origins_in_rig.map(|p| (p - origin) / unit);
    let quadrics = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| {
        let squared_side = ((x[i] - x[j]) / unit).norm_squared();
        Quadric::new(&(p[i] - p[j]), &rays_in_rig[i], &rays_in_rig[j], squared_side)
    });
    let elimination = Elimination::new(&quadrics);
    let mut poses = ArrayVec::new();
    for d0 in real_roots(&elimination.polynomial()) {
        let Some(depths) = elimination.depths(d0) else { continue };
        let Some(depths) = refine_depths(depths, &quadrics) else { continue };
        if depths.min() <= 0.0 || poses.is_full() {
            continue;
        }
        let y: [Vector3<f64>; 3] =
            std::array::from_fn(|i| origins_in_rig[i] + rays_in_rig[i] * (depths[i] * unit));
        let (e1, e2) = (y[1] - y[0], y[2] - y[0]);
        let matrix = Matrix3::from_columns(&[e1, e2, e1.cross(&e2)]) * inverse_edges;
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        poses.push(Rigid3 { rotation, translation: y[0] - rotation * x[0] });
    }
    poses
}

/// dᵢ² + dⱼ² − 2 m dᵢdⱼ + a dᵢ + b dⱼ + c = 0.
struct Quadric {
    m: f64,
    a: f64,
    b: f64,
    c: f64,
}

impl Quadric {
    fn new(w: &Vector3<f64>, ray_i: &Vector3<f64>, ray_j: &Vector3<f64>, squared: f64) -> Self {
        Self {
            m: ray_i.dot(ray_j),
            a: 2.0 * w.dot(ray_i),
            b: -2.0 * w.dot(ray_j),
            c: w.norm_squared() - squared,
        }
    }

    fn value(&self, di: f64, dj: f64) -> f64 {
        di * di + dj * dj - 2.0 * self.m * di * dj + self.a * di + self.b * dj + self.c
    }

    /// Sum of the magnitudes of the terms.
    fn magnitude(&self, di: f64, dj: f64) -> f64 {
        di * di
            + dj * dj
            + (2.0 * self.m * di * dj).abs()
            + (self.a * di).abs()
            + (self.b * dj).abs()
            + self.c.abs()
    }

    /// Derivatives by dᵢ and dⱼ.
    fn gradient(&self, di: f64, dj: f64) -> [f64; 2] {
        [2.0 * (di - self.m * dj) + self.a, 2.0 * (dj - self.m * di) + self.b]
    }

    /// B and C of dⱼ² + B dⱼ + C, as polynomials in dᵢ.
    fn over_first(&self) -> ([f64; 2], [f64; 3]) {
        ([self.b, -2.0 * self.m], [self.c, self.a, 1.0])
    }
}

/// The polynomials in d₀ of the elimination, with ascending coefficients.
struct Elimination {
    b1: [f64; 2],
    c1: [f64; 3],
    p: [f64; 2],
    q: [f64; 2],
    s: f64,
    t: [f64; 3],
    u: [f64; 4],
    v: [f64; 5],
}

impl Elimination {
    fn new([side01, side02, side12]: &[Quadric; 3]) -> Self {
        let ((b1, c1), (b2, c2)) = (side01.over_first(), side02.over_first());
        let p = [side12.a - b1[0], -b1[1]];
        let q = [side12.b - b2[0], -b2[1]];
        let s = -2.0 * side12.m;
        let t = [side12.c - c1[0] - c2[0], -c1[1] - c2[1], -c1[2] - c2[2]];
        // (P d₁ + T)² − B₂ (P d₁ + T)(Q + S d₁) + C₂ (Q + S d₁)² = k₂d₁² + k₁d₁ + k₀.
        let (pq, st, pt) = (product::<3>(&p, &q), t.map(|t| s * t), product::<4>(&p, &t));
        let k2: [f64; 3] = sum(
            sum(product::<3>(&p, &p), product::<3>(&b2, &p).map(|c| -s * c)),
            c2.map(|c| s * s * c),
        );
        let b2_terms: [f64; 4] = product(&b2, &sum(pq, st));
        let c2_terms: [f64; 4] = product(&c2, &q).map(|c| 2.0 * s * c);
        let k1 = sum(sum(pt.map(|c| 2.0 * c), b2_terms.map(|c| -c)), c2_terms);
        let tq: [f64; 4] = product(&t, &q);
        let k0: [f64; 5] = sum(
            sum(product(&t, &t), product::<5>(&b2, &tq).map(|c| -c)),
            product(&c2, &product::<3>(&q, &q)),
        );
        let u = sum(k1, product::<4>(&k2, &b1).map(|c| -c));
        let v = sum(k0, product::<5>(&k2, &c1).map(|c| -c));
        Self { b1, c1, p, q, s, t, u, v }
    }

    /// V² − B₁UV + C₁U², times x² + 1, which has no real root, for the degree of the root finder.
    fn polynomial(&self) -> [f64; 11] {
        let Self { b1, c1, u, v, .. } = self;
        let uv: [f64; 8] = product(u, v);
        let eight: [f64; 9] = sum(
            sum(product(v, v), product::<9>(b1, &uv).map(|c| -c)),
            product(c1, &product::<7>(u, u)),
        );
        product(&eight, &[1.0, 0.0, 1.0])
    }

    /// All depths from the first; `None` where they are not determined.
    fn depths(&self, d0: f64) -> Option<Vector3<f64>> {
        let d1 = -value(&self.v, d0) / value(&self.u, d0);
        let d2 =
            -(value(&self.p, d0) * d1 + value(&self.t, d0)) / (value(&self.q, d0) + self.s * d1);
        (d1.is_finite() && d2.is_finite()).then(|| Vector3::new(d0, d1, d2))
    }
}

/// The product of two polynomials, which has N coefficients.
fn product<const N: usize>(one: &[f64], other: &[f64]) -> [f64; N] {
    let mut product = [0.0; N];
    for (i, a) in one.iter().enumerate() {
        for (j, b) in other.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    product
}

fn sum<const N: usize>(one: [f64; N], other: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| one[i] + other[i])
}

fn value(polynomial: &[f64], x: f64) -> f64 {
    polynomial.iter().rev().fold(0.0, |value, c| value * x + c)
}

/// Refines the depths by Newton's method on the quadrics; `None` if they are no solution.
fn refine_depths(
    mut d: Vector3<f64>,
    [side01, side02, side12]: &[Quadric; 3],
) -> Option<Vector3<f64>> {
    for _ in 0..REFINEMENT_STEPS {
        let error = Vector3::new(
            side01.value(d[0], d[1]),
            side02.value(d[0], d[2]),
            side12.value(d[1], d[2]),
        );
        // The Jacobian has the rows (p, q, 0), (r, 0, s), (0, t, u).
        let [p, q] = side01.gradient(d[0], d[1]);
        let [r, s] = side02.gradient(d[0], d[2]);
        let [t, u] = side12.gradient(d[1], d[2]);
        let determinant = -(p * s * t + q * r * u);
        let step = Vector3::new(
            -s * t * error[0] - q * u * error[1] + q * s * error[2],
            -r * u * error[0] + p * u * error[1] - p * s * error[2],
            r * t * error[0] - p * t * error[1] - q * r * error[2],
        ) / determinant;
        if !step.iter().all(|v| v.is_finite()) {
            break;
        }
        d -= step;
    }
    let is_zero = |side: &Quadric, i: usize, j: usize| {
        side.value(d[i], d[j]).abs() <= MAX_RESIDUAL * side.magnitude(d[i], d[j])
    };
    (is_zero(side01, 0, 1) && is_zero(side02, 0, 2) && is_zero(side12, 1, 2)).then_some(d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    /// Largest distance between solutions of both solvers: rounding errors of conditioned problems.
    const TOLERANCE: f64 = 1e-6;
    const PROBLEMS: usize = 500;

    /// Rays of one camera of a rig, whose centre is not the origin of the rig, and rays that meet
    /// nearly: both have all solutions of the camera.
    #[test]
    fn rays_that_meet_in_one_point_have_the_solutions_of_a_camera() {
        let (mut missed, mut solutions) = (0, 0);
        for problem in 0..PROBLEMS {
            let mut rng = Rng::stream(3, &[problem as u64]);
            let mut vector = |size: f64| {
                let [x, y, z] = [0; 3].map(|_| 2.0 * rng.uniform() - 1.0);
                Vector3::new(x, y, z) * size
            };
            let cam_from_world = Rigid3::from_axis_angle(vector(1.0), vector(2.0));
            let points_in_cam = [0; 3].map(|_| vector(2.0) + Vector3::new(0.0, 0.0, 5.0));
            let rays = points_in_cam.map(|point| point.normalize());
            let points = points_in_cam.map(|point| cam_from_world.inverse() * point);
            let centre = vector(1.0);
            let of_camera = p3p(&rays, &points);
            let near = [0; 3].map(|_| centre + vector(1e-9));
            for origins in [[centre; 3], near] {
                let found = gp3p(&origins, &rays, &points);
                for pose in &of_camera {
                    let distance = |other: &Rigid3| {
                        pose.rotation.angle_to(&other.rotation)
                            + (pose.translation + centre - other.translation).norm()
                    };
                    let nearest = found.iter().map(distance).fold(f64::INFINITY, f64::min);
                    solutions += 1;
                    missed += usize::from(nearest > TOLERANCE);
                }
            }
        }
        // Of nearly double solutions some are missed.
        assert!(100 * missed <= solutions, "{missed} of {solutions} missed");
    }

    #[test]
    fn a_degenerate_sample_has_no_solution() {
        let rays = [Vector3::z(); 3];
        let origins = [0.0, 1.0, 2.0].map(|x| Vector3::new(x, 0.0, 0.0));
        let collinear = [0.0, 1.0, 2.0].map(|x| Vector3::new(x, 0.0, 5.0));
        assert!(gp3p(&origins, &rays, &collinear).is_empty());
        let same = [Vector3::new(0.0, 0.0, 5.0); 3];
        assert!(gp3p(&origins, &rays, &same).is_empty());
    }
}
