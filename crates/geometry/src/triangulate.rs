//! Triangulation of points from rays.

use nalgebra::{Matrix3, Vector3};

use crate::{Rigid3, epipolar::essential_from_pose};

/// Triangulates the point, in camera 1, of two corresponding rays of any length. The rays are
/// corrected by the smallest angles that make them intersect (Lee and Civera 2019, "Closed-form
/// optimal two-view triangulation based on angular errors", L2 cost to first order, in the iterated
/// form of Lindstrom 2010). `None` if the rays are parallel or intersect behind a camera.
pub fn triangulate_two_view(
    ray1: &Vector3<f64>,
    ray2: &Vector3<f64>,
    cam2_from_cam1: &Rigid3,
) -> Option<Vector3<f64>> {
    let essential = essential_from_pose(cam2_from_cam1);
    let (mut y1, mut y2) = (ray1.normalize(), ray2.normalize());
    // Newton's method on y₂ᵀEy₁ = 0 along the gradient on the two unit spheres. The second step is
    // already at the level of rounding.
    for _ in 0..3 {
        let (g1, g2) = (essential.tr_mul(&y2), essential * y1);
        let error = y2.dot(&g2);
        let (g1, g2) = (g1 - y1 * y1.dot(&g1), g2 - y2 * y2.dot(&g2));
        let length2 = g1.norm_squared() + g2.norm_squared();
        if length2 > 0.0 {
            let step = error / length2;
            (y1, y2) = ((y1 - g1 * step).normalize(), (y2 - g2 * step).normalize());
        }
    }
    // λ₁ R y₁ + t = λ₂ y₂.
    let rotated = cam2_from_cam1.rotation * y1;
    let t = &cam2_from_cam1.translation;
    let normal = rotated.cross(&y2);
    let (depth1, depth2) = (y2.cross(t).dot(&normal), rotated.cross(t).dot(&normal));
    let point = y1 * (depth1 / normal.norm_squared());
    (depth1 > 0.0 && depth2 > 0.0 && point.iter().all(|v| v.is_finite())).then_some(point)
}

/// Triangulates the world point of the rays of two or more cameras. `rays_in_cam[i]`, of any
/// length, is in the frame of camera `i`.
///
/// Minimises the sum over the rays of |(I − yyᵀ)(RX + t)|² / |RX₀ + t|², where X₀ is the solution
/// of the previous iteration. The weights make the cost approximate the sum of squared angles.
/// `None` if the rays are parallel or the point is behind a camera.
pub fn triangulate(
    cams_from_world: &[Rigid3],
    rays_in_cam: &[Vector3<f64>],
) -> Option<Vector3<f64>> {
    let mut point = None;
    for _ in 0..NUM_REWEIGHTINGS {
        let mut normal = Matrix3::zeros();
        let mut rhs = Vector3::zeros();
        for (cam_from_world, ray) in cams_from_world.iter().zip(rays_in_cam) {
            let world_from_cam = cam_from_world.rotation.inverse();
            let ray_in_world = world_from_cam * ray.normalize();
            let centre = cam_from_world.origin_in_a();
            let weight =
                point.map_or(1.0, |point: Vector3<f64>| 1.0 / (point - centre).norm_squared());
            let projector =
                (Matrix3::identity() - ray_in_world * ray_in_world.transpose()) * weight;
            normal += projector;
            rhs += projector * centre;
        }
        let solution = normal.cholesky()?.solve(&rhs);
        if !solution.iter().all(|v| v.is_finite()) {
            return None;
        }
        point = Some(solution);
    }
    let point = point?;
    let in_front =
        |(cam_from_world, ray): (&Rigid3, &Vector3<f64>)| (*cam_from_world * point).dot(ray) > 0.0;
    cams_from_world.iter().zip(rays_in_cam).all(in_front).then_some(point)
}

/// Iterations of reweighted least squares in [`triangulate`].
const NUM_REWEIGHTINGS: usize = 3;

/// The angle at a point, in radians, between the rays to two camera centres. All arguments are in
/// the same frame.
pub fn triangulation_angle(
    centre1: &Vector3<f64>,
    centre2: &Vector3<f64>,
    point: &Vector3<f64>,
) -> f64 {
    let (a, b) = (centre1 - point, centre2 - point);
    a.cross(&b).norm().atan2(a.dot(&b))
}
