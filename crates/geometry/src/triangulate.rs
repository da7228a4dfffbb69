//! Triangulation of points from rays.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::{Intrinsics, Rigid3, epipolar::essential_from_pose};

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

/// A pixel of a camera of known pose, as a ray.
#[derive(Clone, Copy, Debug)]
pub struct ViewRay<'a> {
    cam_from_world: &'a Rigid3,
    intrinsics: &'a Intrinsics,
    pixel: Vector2<f64>,
    /// Camera centre.
    centre_in_world: Vector3<f64>,
    /// Unit ray through the pixel.
    ray_in_world: Vector3<f64>,
}

impl<'a> ViewRay<'a> {
    /// The ray of a pixel of the camera with this pose. Returns `None` if the pixel has no ray.
    pub fn new(
        cam_from_world: &'a Rigid3,
        intrinsics: &'a Intrinsics,
        pixel: Vector2<f64>,
    ) -> Option<Self> {
        let ray_in_world = cam_from_world.rotation.inverse() * intrinsics.unproject(&pixel)?;
        Some(Self {
            cam_from_world,
            intrinsics,
            pixel,
            centre_in_world: cam_from_world.origin_in_a(),
            ray_in_world,
        })
    }

    /// Squared reprojection error in pixels²; infinite if the point does not project.
    fn squared_error(&self, xyz: &Vector3<f64>) -> f64 {
        let point_in_cam = *self.cam_from_world * *xyz;
        self.intrinsics.squared_error_px2(&point_in_cam, &self.pixel).unwrap_or(f64::INFINITY)
    }
}

/// A triangulated point.
#[derive(Clone, Debug)]
pub struct Triangulated {
    /// Position in the world frame.
    pub xyz: Vector3<f64>,
    /// Indices of the inlier rays.
    pub inliers: Vec<usize>,
}

/// Up to this number of rays all pairs are hypotheses; above it, only pairs with one of the first
/// rays.
const MAX_EXHAUSTIVE: usize = 12;

/// Triangulates a point with the smallest truncated squared reprojection error (MSAC, threshold
/// `max_error_px`). Hypotheses are the midpoints of pairs of rays; the best is refined on its
/// inliers. Returns `None` with fewer than two inliers, or with a triangulation angle below
/// `min_angle_rad`.
pub fn triangulate(
    rays: &[ViewRay],
    max_error_px: f64,
    min_angle_rad: f64,
) -> Option<Triangulated> {
    let max_squared = max_error_px * max_error_px;
    let max_cosine = min_angle_rad.cos();
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for i in 0..rays.len().min(MAX_EXHAUSTIVE) {
        for j in i + 1..rays.len() {
            if rays[i].ray_in_world.dot(&rays[j].ray_in_world) > max_cosine {
                continue;
            }
            let Some(xyz) = nearest_to_rays([&rays[i], &rays[j]].into_iter()) else { continue };
            let score: f64 = rays.iter().map(|s| s.squared_error(&xyz).min(max_squared)).sum();
            if best.is_none_or(|(least, _)| score < least) {
                best = Some((score, xyz));
            }
        }
    }
    let (score, mut xyz) = best?;
    let inliers_of = |xyz: &Vector3<f64>| {
        (0..rays.len()).filter(|&i| rays[i].squared_error(xyz) < max_squared).collect()
    };
    let mut inliers: Vec<usize> = inliers_of(&xyz);
    if inliers.len() > 2
        && let Some(refined) = nearest_to_rays(inliers.iter().map(|&i| &rays[i]))
        && rays.iter().map(|s| s.squared_error(&refined).min(max_squared)).sum::<f64>() < score
    {
        xyz = refined;
        inliers = inliers_of(&xyz);
    }
    let has_angle = inliers.iter().enumerate().any(|(n, &i)| {
        inliers[..n].iter().any(|&j| angle_cosine(&rays[i], &rays[j], &xyz) <= max_cosine)
    });
    (inliers.len() >= 2 && has_angle).then_some(Triangulated { xyz, inliers })
}

/// Cosine of the triangulation angle.
fn angle_cosine(a: &ViewRay, b: &ViewRay, xyz: &Vector3<f64>) -> f64 {
    (a.centre_in_world - xyz).normalize().dot(&(b.centre_in_world - xyz).normalize())
}

/// The point with the least squared distances from all rays, each weighted by the inverse square of
/// its length in a second iteration, so that angles are minimised: Σ w (I − d dᵀ)(x − c) = 0.
/// `None` if the rays do not determine it. The point may be behind a camera; [`triangulate`] checks
/// that.
pub fn nearest_to_rays<'a>(
    rays: impl Iterator<Item = &'a ViewRay<'a>> + Clone,
) -> Option<Vector3<f64>> {
    let mut xyz: Option<Vector3<f64>> = None;
    for _ in 0..2 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for ray in rays.clone() {
            let weight = xyz.map_or(1.0, |x| 1.0 / (x - ray.centre_in_world).norm_squared());
            let projector =
                (Matrix3::identity() - ray.ray_in_world * ray.ray_in_world.transpose()) * weight;
            a += projector;
            b += projector * ray.centre_in_world;
        }
        xyz = Some(a.cholesky()?.solve(&b)).filter(|x| x.iter().all(|v| v.is_finite()));
        xyz?;
    }
    xyz
}

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
