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
    /// Root mean square of the median radial residuals of the rings, in pixels, without what the
    /// parameters of an estimated lens can absorb. A lens model that fits leaves noise alone, whose
    /// median is 0.
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
        let mut rings = Vec::new();
        for ring in 0..NUM_RINGS {
            let bound = |ring: usize| half * ring as f64 / NUM_RINGS as f64;
            let of_ring = |limit: f64| observed.partition_point(|(radius, _)| *radius < limit);
            let ring = &observed[of_ring(bound(ring))..of_ring(bound(ring + 1))];
            let mut radial: Vec<f64> = ring.iter().map(|(_, radial)| *radial).collect();
            if ring.len() >= min
                && let Some(median) = median(&mut radial)
            {
                let radius = ring[ring.len() / 2].0 / half;
                rings.push(Ring { radius, median, count: ring.len() as f64 });
            }
        }
        let is_estimated =
            !model.calibrated.contains(&id) && !model.intrinsics_priors.contains_key(&id);
        let kind = camera.intrinsics.kind();
        let num_linear = kind.focal_indices().len() + kind.principal_point_indices().len();
        let powers: &[i32] = match (is_estimated, kind.num_params() > num_linear) {
            (false, _) => &[],
            (true, false) => &[1],
            (true, true) => &[1, 3],
        };
        let outer = (OUTER_QUANTILE * observed.len().saturating_sub(1) as f64) as usize;
        let radial_rms_px = rms_of(&mut rings, powers);
        let stretch = stretch(&camera.intrinsics, observed[outer].0);
        LensResiduals { camera: id, radial_rms_px, relative: radial_rms_px / half, stretch }
    });
    residuals.collect()
}

/// The observations of a camera at about one distance from the principal point.
struct Ring {
    /// Median distance over half of the diagonal.
    radius: f64,
    /// Median radial residual, in pixels.
    median: f64,
    count: f64,
}

/// Root mean square of the medians without their components in these powers of the radius. Focal
/// length (1) and first distortion (3) were fitted, so that a lens leaves none of them: they come
/// from what constrains poses, as a second camera on the rig. They are half of the residuals of
/// KITTI 04, and a hundredth of those of fisheyes.
fn rms_of(rings: &mut [Ring], powers: &[i32]) -> f64 {
    if rings.len() <= powers.len() {
        return 0.0;
    }
    let dot = |rings: &[Ring], a: &[f64], b: &[f64]| -> f64 {
        rings.iter().zip(a).zip(b).map(|((ring, a), b)| ring.count * a * b).sum()
    };
    // Gram-Schmidt.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for &power in powers {
        let mut next: Vec<f64> = rings.iter().map(|ring| ring.radius.powi(power)).collect();
        for known in &basis {
            let share = dot(rings, &next, known) / dot(rings, known, known);
            next.iter_mut().zip(known).for_each(|(next, known)| *next -= share * known);
        }
        let medians: Vec<f64> = rings.iter().map(|ring| ring.median).collect();
        let share = dot(rings, &medians, &next) / dot(rings, &next, &next);
        rings.iter_mut().zip(&next).for_each(|(ring, next)| ring.median -= share * next);
        basis.push(next);
    }
    let squares: f64 = rings.iter().map(|ring| ring.count * ring.median.powi(2)).sum();
    (squares / rings.iter().map(|ring| ring.count).sum::<f64>()).sqrt()
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
