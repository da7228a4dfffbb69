//! Absolute pose of an image from its 2D-3D correspondences.
//!
//! With repeated texture, wrong correspondences may outnumber the correct ones and agree on a wrong
//! pose: windows of a facade look alike from positions that differ by their spacing. Missing
//! correspondences reveal such a pose (Zach, Irschara & Bischof 2008), because an image there would
//! observe nearly all points that its neighbours observe. The visible-point recall measures this.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{RansacOptions, Rigid3, estimate};
use tiepoint_scene::{Camera, CorrespondenceGraph, ImageId, Observation, PointId, Reconstruction};

/// A second pose is considered if it has at least this fraction of the first pose's inliers. It is
/// selected if its recall is larger by the factor `MIN_ADVANTAGE`, or larger at all if only the
/// second pose is plausible. On the streets used for tuning, correct poses had at least 1.28 times
/// the recall of wrong ones.
const MIN_SECOND_INLIERS: f64 = 0.5;
const MIN_ADVANTAGE: f64 = 1.25;
/// Views of a point whose directions differ by less than 10° and whose distances differ by less
/// than a quarter match well (Mikolajczyk & Schmid 2005).
const MAX_VIEW_ANGLE_RAD: f64 = 0.175;
const MAX_DISTANCE_RATIO: f64 = 1.25;

/// Thresholds of registration.
#[derive(Clone, Copy, Debug)]
pub struct RegisterOptions {
    /// Maximum reprojection error of an inlier, in pixels.
    pub max_error_px: f64,
    /// Minimum number of inliers.
    pub min_num_inliers: usize,
    /// Minimum fraction of inliers.
    pub min_inlier_ratio: f64,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { max_error_px: 12.0, min_num_inliers: 30, min_inlier_ratio: 0.25 }
    }
}

/// Estimates and sets the pose of `image`, and adds its inliers to the tracks. Returns the number
/// of inliers; `None` without changes if there are too few.
pub fn register_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
) -> Option<usize> {
    let placement = estimate_placement(graph, model, image, options, seed, &|_| true)?;
    placement.apply(model);
    Some(placement.inliers.len())
}

/// An estimated pose of an image.
pub(crate) struct Placement {
    pub(crate) image: ImageId,
    pub(super) cam_from_world: Rigid3,
    /// Inliers: keypoints and their points.
    pub(super) inliers: Vec<(u32, PointId)>,
    /// Number of expected points that the inliers contain.
    num_found: usize,
    /// Visible-point recall: `num_found` relative to the number of expected points.
    pub(crate) recall: f64,
    /// Whether the caller's check accepts the pose.
    pub(crate) is_plausible: bool,
}

impl Placement {
    pub(crate) fn apply(&self, model: &mut Reconstruction) {
        model.register(self.image, self.cam_from_world);
        for &(keypoint, point) in &self.inliers {
            model.add_observation(point, Observation { image: self.image, keypoint });
        }
    }
}

/// Estimates the pose of an image; `None` with too few inliers. A pose that `is_plausible` rejects
/// is returned only if no other is found.
pub(crate) fn estimate_placement(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
    is_plausible: &dyn Fn(&Rigid3) -> bool,
) -> Option<Placement> {
    let candidates = candidates(graph, model, image);
    let neighbours = graph.neighbours(image).iter();
    let mut visible_to_neighbours: Vec<PointId> =
        neighbours.flat_map(|&other| model.image(other).points()).flatten().copied().collect();
    visible_to_neighbours.sort_unstable();
    visible_to_neighbours.dedup();
    let ransac =
        RansacOptions { max_error: options.max_error_px, seed, ..RansacOptions::default() };
    let camera = model.camera_of(image);
    let estimate_from = |candidates: &[(u32, PointId)], min_inliers: usize| {
        if candidates.len() < min_inliers {
            return None;
        }
        let pixels: Vec<Vector2<f64>> = candidates
            .iter()
            .map(|(keypoint, _)| model.image(image).keypoints[*keypoint as usize].pixel)
            .collect();
        let points: Vec<Vector3<f64>> = candidates
            .iter()
            .filter_map(|(_, point)| model.track(*point))
            .map(|track| track.xyz)
            .collect();
        let report = estimate::absolute_pose(&pixels, &points, &camera.intrinsics, &ransac)?;
        let inliers = candidates.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier);
        let inliers: Vec<(u32, PointId)> = inliers.map(|(candidate, _)| *candidate).collect();
        let found_points: BTreeSet<PointId> = inliers.iter().map(|(_, point)| *point).collect();
        let expected: Vec<&PointId> = visible_to_neighbours
            .iter()
            .filter(|point| is_expected(model, camera, &report.model, **point))
            .collect();
        let num_found = expected.iter().filter(|point| found_points.contains(point)).count();
        // With few expected points the recall is not informative.
        let is_informative = expected.len() >= options.min_num_inliers.max(1);
        let placement = Placement {
            image,
            cam_from_world: report.model,
            inliers,
            num_found,
            recall: if is_informative { num_found as f64 / expected.len() as f64 } else { 1.0 },
            is_plausible: is_plausible(&report.model),
        };
        (placement.inliers.len() >= min_inliers).then_some(placement)
    };
    let best = estimate_from(&candidates, options.min_num_inliers)?;
    if (best.inliers.len() as f64) < options.min_inlier_ratio * candidates.len() as f64 {
        return None;
    }
    // The outliers of the best pose may support another pose.
    let is_seen: BTreeSet<&(u32, PointId)> = best.inliers.iter().collect();
    let others: Vec<(u32, PointId)> =
        candidates.iter().filter(|candidate| !is_seen.contains(candidate)).copied().collect();
    // Against an implausible pose, the second pose only needs the usual fraction of inliers.
    let min_inliers = if best.is_plausible {
        MIN_SECOND_INLIERS * best.inliers.len() as f64
    } else {
        options.min_inlier_ratio * others.len() as f64
    };
    let second = estimate_from(&others, options.min_num_inliers.max(min_inliers.ceil() as usize))
        .filter(|second| {
            let advantage =
                if second.is_plausible && !best.is_plausible { 1.0 } else { MIN_ADVANTAGE };
            (second.is_plausible || !best.is_plausible)
                && second.num_found >= options.min_num_inliers
                && second.recall > advantage * best.recall
        });
    Some(second.unwrap_or(best))
}

/// Whether an image with this pose should observe a point: the point projects into the image, and
/// some image observes it from a similar direction and distance.
fn is_expected(
    model: &Reconstruction,
    camera: &Camera,
    cam_from_world: &Rigid3,
    point: PointId,
) -> bool {
    let Some(track) = model.track(point) else { return false };
    let is_inside = camera
        .intrinsics
        .project(&(*cam_from_world * track.xyz))
        .is_some_and(|pixel| camera.contains(&pixel));
    let ray = track.xyz - cam_from_world.origin_in_a();
    let is_similar_view = |observation: &Observation| {
        model.image(observation.image).cam_from_world().is_some_and(|pose| {
            let other_ray = track.xyz - pose.origin_in_a();
            let ratio = ray.norm() / other_ray.norm();
            ray.angle(&other_ray) < MAX_VIEW_ANGLE_RAD
                && ratio.max(1.0 / ratio) < MAX_DISTANCE_RATIO
        })
    };
    is_inside && track.observations.iter().any(is_similar_view)
}

/// Returns keypoints with the points of their correspondences. A keypoint may have several points.
pub(super) fn candidates(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
) -> Vec<(u32, PointId)> {
    let mut candidates = Vec::new();
    for keypoint in 0..model.image(image).keypoints.len() as u32 {
        let points: BTreeSet<PointId> = graph
            .correspondences(Observation { image, keypoint })
            .iter()
            .filter_map(|t| model.image(t.image).point_of(t.keypoint))
            .filter(|point| model.track(*point).is_some())
            .collect();
        candidates.extend(points.into_iter().map(|point| (keypoint, point)));
    }
    candidates
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
    use tiepoint_scene::{
        Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Observation,
        Reconstruction, Track, TwoView, TwoViewKind,
    };

    use super::{RegisterOptions, register_image};

    /// Number of points and of matched points at the true place, and at the place that looks alike.
    const TRUE_PLACE: (usize, usize) = (150, 60);
    const SIMILAR_PLACE: (usize, usize) = (600, 80);
    /// Distance between the two places, and tolerance of the pose without noise, in metres.
    const DISTANCE_M: f64 = 100.0;
    const TOLERANCE_M: f64 = 1e-3;

    /// Two similar walls, each observed by one image, and a third image with keypoints of both.
    #[test]
    fn a_pose_with_low_recall_loses_against_one_with_fewer_inliers() {
        let intrinsics =
            Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 320.0, 240.0]).unwrap();
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let centres =
            [Vector3::zeros(), Vector3::new(DISTANCE_M, 0.0, 0.0), Vector3::new(0.3, 0.0, 0.1)];
        let poses = centres.map(|centre| Rigid3 { translation: -centre, ..Rigid3::identity() });
        let mut rng = Rng::stream(5, &[]);
        let mut keypoints: [Vec<Keypoint>; 3] = Default::default();
        let mut walls: Vec<(Vector3<f64>, usize)> = Vec::new();
        let mut matches: [Vec<Match>; 2] = Default::default();
        let see = |pose: &Rigid3, point: &Vector3<f64>| -> Option<Vector2<f64>> {
            let pixel = intrinsics.project(&(*pose * *point))?;
            (pixel.x > 0.0 && pixel.x < 640.0 && pixel.y > 0.0 && pixel.y < 480.0).then_some(pixel)
        };
        for (place, (num_points, num_matched)) in
            [TRUE_PLACE, SIMILAR_PLACE].into_iter().enumerate()
        {
            while keypoints[place].len() < num_points {
                let [x, y, z] = [0; 3].map(|_| rng.uniform());
                let offset = Vector3::new(6.0 * x - 3.0, 4.0 * y - 2.0, 5.0 + 4.0 * z);
                let (point, as_if) = (centres[place] + offset, offset);
                let (Some(pixel), Some(pixel_of_third)) =
                    (see(&poses[place], &point), see(&poses[2], &as_if))
                else {
                    continue;
                };
                walls.push((point, place));
                if keypoints[place].len() < num_matched {
                    let (a, b) = (keypoints[place].len() as u32, keypoints[2].len() as u32);
                    matches[place].push(Match { a, b });
                    keypoints[2].push(Keypoint { pixel: pixel_of_third, scale_px: 1.0 });
                }
                keypoints[place].push(Keypoint { pixel, scale_px: 1.0 });
            }
        }
        let counts: Vec<usize> = keypoints.iter().map(Vec::len).collect();
        let images: Vec<ImageId> = keypoints
            .into_iter()
            .enumerate()
            .map(|(index, keypoints)| {
                model.add_image(Image::new(index.to_string(), camera, keypoints))
            })
            .collect();
        for place in 0..2 {
            model.register(images[place], poses[place]);
        }
        let mut num_seen = [0; 2];
        for (xyz, place) in walls {
            let observation = Observation { image: images[place], keypoint: num_seen[place] };
            num_seen[place] += 1;
            model.add_track(Track::new(xyz, vec![observation]));
        }
        let two_views = matches.into_iter().enumerate().filter_map(|(place, matches)| {
            Some((
                ImagePair::new(images[place], images[2])?,
                TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() },
            ))
        });
        let graph = CorrespondenceGraph::new(&counts, two_views);
        let num_inliers =
            register_image(&graph, &mut model, images[2], &RegisterOptions::default(), 1).unwrap();
        assert_eq!(num_inliers, TRUE_PLACE.1);
        let found = model.image(images[2]).cam_from_world().unwrap().origin_in_a();
        assert!((found - centres[2]).norm() < TOLERANCE_M, "{found}");
    }
}
