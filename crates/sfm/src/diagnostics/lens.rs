//! Residuals that a lens model leaves, by the distance from the principal point, and whether the
//! model is one of a lens where the image has observations.

use std::collections::BTreeMap;

use tiepoint_geometry::Intrinsics;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::numeric::median;
use tiepoint_scene::{CameraId, Reconstruction};

/// Rings around the principal point, up to half of the diagonal.
const NUM_RINGS: usize = 10;
/// Fewest observations of a ring, and their smallest share of those of the camera.
const MIN_OBSERVATIONS: usize = 50;
const MIN_SHARE: f64 = 0.01;
/// Quantile of the distances of observations from the principal point up to which the model must be
/// one of a lens.
const OUTER_QUANTILE: f64 = 0.99;

/// What the lens model of a camera leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensResiduals {
    /// The camera.
    pub camera: CameraId,
    /// Root mean square of the median radial residuals of the rings, in pixels. A lens model that
    /// fits leaves noise alone, whose median is 0.
    pub radial_rms_px: f64,
    /// The same relative to half of the diagonal.
    pub relative: f64,
    /// Distance from the principal point of the undistorted image over that of the image, where the
    /// outermost observations are; `None` if the model has no ray there or folds the image.
    pub stretch: Option<f64>,
}

/// The residuals of all cameras with a focal length.
pub fn lens_residuals(model: &Reconstruction) -> Vec<LensResiduals> {
    let mut by_camera: BTreeMap<CameraId, Vec<(f64, f64)>> = BTreeMap::new();
    for (_, track) in model.tracks() {
        for o in &track.observations {
            let image = model.image(o.image);
            let intrinsics = &model.camera(image.camera).intrinsics;
            let Some(pose) = image.cam_from_world() else { continue };
            let Some(projected) = intrinsics.project(&(*pose * track.xyz)) else { continue };
            let pixel = image.keypoints[o.keypoint as usize].pixel;
            let from_centre = pixel - intrinsics.principal_point();
            let radius = from_centre.norm();
            if radius > 0.0 {
                let radial = (pixel - projected).dot(&from_centre) / radius;
                by_camera.entry(image.camera).or_default().push((radius, radial));
            }
        }
    }
    let with_focal = by_camera
        .into_iter()
        .filter(|(id, _)| !model.camera(*id).intrinsics.kind().focal_indices().is_empty());
    let residuals = with_focal.map(|(id, mut observed)| {
        let camera = model.camera(id);
        let half = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height));
        observed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let min = MIN_OBSERVATIONS.max((MIN_SHARE * observed.len() as f64) as usize);
        let (mut squares, mut count) = (0.0, 0);
        for ring in 0..NUM_RINGS {
            let bound = |ring: usize| half * ring as f64 / NUM_RINGS as f64;
            let of_ring = |limit: f64| observed.partition_point(|(radius, _)| *radius < limit);
            let ring = &observed[of_ring(bound(ring))..of_ring(bound(ring + 1))];
            let mut radial: Vec<f64> = ring.iter().map(|(_, radial)| *radial).collect();
            if ring.len() >= min
                && let Some(median) = median(&mut radial)
            {
                squares += median * median * ring.len() as f64;
                count += ring.len();
            }
        }
        let outer = (OUTER_QUANTILE * observed.len().saturating_sub(1) as f64) as usize;
        let radial_rms_px = (squares / count.max(1) as f64).sqrt();
        let stretch = stretch(&camera.intrinsics, observed[outer].0);
        LensResiduals { camera: id, radial_rms_px, relative: radial_rms_px / half, stretch }
    });
    residuals.collect()
}

/// The stretch of a lens at a distance from the principal point, in pixels. A fisheye has no
/// undistorted image; its stretch is 1 if it has rays up to there.
fn stretch(intrinsics: &Intrinsics, radius: f64) -> Option<f64> {
    /// Points between the principal point and the distance.
    const NUM_STEPS: usize = 20;
    let focal_px = intrinsics.mean_focal_px();
    let angle = |radius: f64| {
        let pixel = intrinsics.principal_point() + Vector2::new(radius, 0.0);
        let ray = intrinsics.unproject(&pixel)?;
        Some(ray.xy().norm().atan2(ray.z))
    };
    let mut last = 0.0;
    for step in 1..=NUM_STEPS {
        let next = angle(radius * step as f64 / NUM_STEPS as f64)?;
        if next <= last {
            return None;
        }
        last = next;
    }
    if intrinsics.kind().is_fisheye() { Some(1.0) } else { Some(focal_px * last.tan() / radius) }
}
