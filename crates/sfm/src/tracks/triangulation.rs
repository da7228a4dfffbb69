//! A point from several sightings, some of which may be wrong.

use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{Intrinsics, Rigid3};
use tiepoint_scene::{Observation, Reconstruction};

/// A keypoint of a posed image.
#[derive(Clone, Copy, Debug)]
pub struct ViewRay<'a> {
    /// The image's pose.
    pub cam_from_world: &'a Rigid3,
    /// The image's camera.
    pub intrinsics: &'a Intrinsics,
    /// Where the point was seen, in pixels.
    pub pixel: Vector2<f64>,
    /// The centre of the camera.
    centre_in_world: Vector3<f64>,
    /// The unit ray through the keypoint.
    ray_in_world: Vector3<f64>,
}

impl<'a> ViewRay<'a> {
    /// `None` where no ray leads through the pixel.
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

    /// The sighting that an observation is; `None` where its image has no pose.
    pub fn of(model: &'a Reconstruction, observation: &Observation) -> Option<Self> {
        let image = model.image(observation.image);
        let pixel = image.keypoints[observation.keypoint as usize].pixel;
        Self::new(image.cam_from_world()?, &model.camera(image.camera).intrinsics, pixel)
    }

    /// Squared distance between keypoint and projection, in pixels²; infinite where the camera does
    /// not see the point.
    fn squared_error(&self, xyz: &Vector3<f64>) -> f64 {
        let projected = self.intrinsics.project(&(*self.cam_from_world * *xyz));
        projected.map_or(f64::INFINITY, |pixel| (pixel - self.pixel).norm_squared())
    }
}

/// A triangulated point.
#[derive(Clone, Debug)]
pub struct Triangulated {
    /// Where.
    pub xyz: Vector3<f64>,
    /// Which sightings agree.
    pub inliers: Vec<usize>,
}

/// Above this many sightings, not every pair is tried but those with the first ones.
const MAX_EXHAUSTIVE: usize = 12;

/// The point that most sightings agree on to `max_error_px`, at least two of them with an angle of
/// `min_angle_rad` between their rays. Hypotheses are the midpoints of pairs; the best is refined
/// on all that agree.
pub fn triangulate(
    sights: &[ViewRay],
    max_error_px: f64,
    min_angle_rad: f64,
) -> Option<Triangulated> {
    let max_squared = max_error_px * max_error_px;
    let max_cosine = min_angle_rad.cos();
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for i in 0..sights.len().min(MAX_EXHAUSTIVE) {
        for j in i + 1..sights.len() {
            if sights[i].ray_in_world.dot(&sights[j].ray_in_world) > max_cosine {
                continue;
            }
            let Some(xyz) = nearest_to_rays([&sights[i], &sights[j]].into_iter()) else { continue };
            let score: f64 = sights.iter().map(|s| s.squared_error(&xyz).min(max_squared)).sum();
            if best.is_none_or(|(least, _)| score < least) {
                best = Some((score, xyz));
            }
        }
    }
    let (score, mut xyz) = best?;
    let inliers_of = |xyz: &Vector3<f64>| {
        (0..sights.len()).filter(|&i| sights[i].squared_error(xyz) < max_squared).collect()
    };
    let mut inliers: Vec<usize> = inliers_of(&xyz);
    if inliers.len() > 2
        && let Some(refined) = nearest_to_rays(inliers.iter().map(|&i| &sights[i]))
        && sights.iter().map(|s| s.squared_error(&refined).min(max_squared)).sum::<f64>() < score
    {
        xyz = refined;
        inliers = inliers_of(&xyz);
    }
    let has_angle = inliers.iter().enumerate().any(|(n, &i)| {
        inliers[..n].iter().any(|&j| angle_cosine(&sights[i], &sights[j], &xyz) <= max_cosine)
    });
    (inliers.len() >= 2 && has_angle).then_some(Triangulated { xyz, inliers })
}

/// Where the poses of now see a point, by all its observations; `None` where their rays do not
/// meet.
pub(crate) fn seen_at(
    model: &Reconstruction,
    observations: &[Observation],
) -> Option<Vector3<f64>> {
    let sights: Vec<ViewRay> = observations.iter().filter_map(|o| ViewRay::of(model, o)).collect();
    nearest_to_rays(sights.iter())
}

/// Cosine of the angle under which two cameras see a point.
fn angle_cosine(a: &ViewRay, b: &ViewRay, xyz: &Vector3<f64>) -> f64 {
    (a.centre_in_world - xyz).normalize().dot(&(b.centre_in_world - xyz).normalize())
}

/// The point nearest to all rays, each weighed by the inverse square of its distance once that is
/// known, so that what is small is the angle and not the length: Σ w (I − d dᵀ)(x − c) = 0, twice.
fn nearest_to_rays<'a>(
    sights: impl Iterator<Item = &'a ViewRay<'a>> + Clone,
) -> Option<Vector3<f64>> {
    let mut xyz: Option<Vector3<f64>> = None;
    for _ in 0..2 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for sight in sights.clone() {
            let weight = xyz.map_or(1.0, |x| 1.0 / (x - sight.centre_in_world).norm_squared());
            let projector = (Matrix3::identity()
                - sight.ray_in_world * sight.ray_in_world.transpose())
                * weight;
            a += projector;
            b += projector * sight.centre_in_world;
        }
        xyz = Some(a.cholesky()?.solve(&b)).filter(|x| x.iter().all(|v| v.is_finite()));
        xyz?;
    }
    xyz
}
