//! Points from rays.

use nalgebra::{Matrix3, Vector3};

use crate::{Rigid3, epipolar::essential_from_pose};

/// The point, in camera 1, of two rays (of any length): the least correction of their angles that
/// makes them meet (Lee and Civera 2019, "Closed-form optimal two-view triangulation based on
/// angular errors", L2 cost to first order, in the iterated form of Lindstrom 2010). `None` where
/// they are parallel or meet behind a camera.
pub fn triangulate_two_view(
    ray1: &Vector3<f64>,
    ray2: &Vector3<f64>,
    cam2_from_cam1: &Rigid3,
) -> Option<Vector3<f64>> {
    let essential = essential_from_pose(cam2_from_cam1);
    let (mut y1, mut y2) = (ray1.normalize(), ray2.normalize());
    // Newton on y₂ᵀEy₁ = 0 with steps along the gradient on the two spheres; the second step is at
    // rounding level already.
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

/// The world point of the rays (of any length, in their cameras) of two or more cameras: Σ over
/// rays of the squared distance
/// |(I − yyᵀ)(RX + t)|² divided by the squared depth of an earlier solution, so that in the
/// end it is the angles that count.
/// `None` where the rays are parallel, or the point is behind a camera.
pub fn triangulate(
    cams_from_world: &[Rigid3],
    rays_in_cam: &[Vector3<f64>],
) -> Option<Vector3<f64>> {
    let mut point = None;
    for _ in 0..REWEIGHTINGS {
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for (cam_from_world, ray) in cams_from_world.iter().zip(rays_in_cam) {
            let world_from_cam = cam_from_world.rotation.inverse();
            let ray_in_world = world_from_cam * ray.normalize();
            let centre = cam_from_world.origin_in_a();
            let weight =
                point.map_or(1.0, |point: Vector3<f64>| 1.0 / (point - centre).norm_squared());
            let projector =
                (Matrix3::identity() - ray_in_world * ray_in_world.transpose()) * weight;
            normal += projector;
            right += projector * centre;
        }
        let solution = normal.cholesky()?.solve(&right);
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

/// Solutions of [`triangulate`]: each brings the depths, which only weigh, nearer.
const REWEIGHTINGS: usize = 3;

/// The angle, in radians, between the rays from two camera centres to a point.
pub fn triangulation_angle(
    centre1: &Vector3<f64>,
    centre2: &Vector3<f64>,
    point: &Vector3<f64>,
) -> f64 {
    let (a, b) = (centre1 - point, centre2 - point);
    a.cross(&b).norm().atan2(a.dot(&b))
}
