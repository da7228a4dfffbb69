//! Robust triangulation of a point from several views.

use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{Intrinsics, Rigid3};
use tiepoint_scene::{Observation, Reconstruction};

/// A keypoint of a registered image as a ray.
#[derive(Clone, Copy, Debug)]
pub struct ViewRay<'a> {
    /// Pose of the image.
    pub cam_from_world: &'a Rigid3,
    /// Intrinsics of the image's camera.
    pub intrinsics: &'a Intrinsics,
    /// Position of the keypoint, in pixels.
    pub pixel: Vector2<f64>,
    /// Camera centre.
    centre_in_world: Vector3<f64>,
    /// Unit ray through the keypoint.
    ray_in_world: Vector3<f64>,
}

impl<'a> ViewRay<'a> {
    /// Returns `None` if the pixel has no ray.
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

    /// The ray of an observation; `None` if its image is not registered.
    pub fn of(model: &'a Reconstruction, observation: &Observation) -> Option<Self> {
        let image = model.image(observation.image);
        let pixel = image.keypoints[observation.keypoint as usize].pixel;
        Self::new(image.cam_from_world()?, &model.camera(image.camera).intrinsics, pixel)
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

/// Triangulates a point from all observations with the current poses; `None` if the rays do not
/// determine it.
pub(crate) fn triangulate_observations(
    model: &Reconstruction,
    observations: &[Observation],
) -> Option<Vector3<f64>> {
    let rays: Vec<ViewRay> = observations.iter().filter_map(|o| ViewRay::of(model, o)).collect();
    nearest_to_rays(rays.iter())
}

/// Cosine of the triangulation angle.
fn angle_cosine(a: &ViewRay, b: &ViewRay, xyz: &Vector3<f64>) -> f64 {
    (a.centre_in_world - xyz).normalize().dot(&(b.centre_in_world - xyz).normalize())
}

/// The point with the least squared distances from all rays, each weighted by the inverse square of
/// its length in a second iteration, so that angles are minimised: Σ w (I − d dᵀ)(x − c) = 0.
fn nearest_to_rays<'a>(
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
