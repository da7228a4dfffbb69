//! Visible-point recall: the share of the points that an image ought to see that it does see.

use std::collections::BTreeSet;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, PointId, Reconstruction};

use super::options::RegisterOptions;

/// Views of a point whose directions differ by less than 10° and whose distances differ by less
/// than a quarter match well (Mikolajczyk & Schmid 2005).
const MAX_VIEW_ANGLE_RAD: f64 = 0.175;
pub(super) const MAX_DISTANCE_RATIO: f64 = 1.25;

/// Points that an image ought to observe, and those of them that it observes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Recall {
    num_expected: usize,
    pub(super) num_found: usize,
}

impl Recall {
    /// Adds the points of `visible` that an image with a pose ought to observe.
    pub(super) fn add(
        &mut self,
        model: &Reconstruction,
        image: ImageId,
        cam_from_world: &Rigid3,
        visible: &[PointId],
        is_found: impl Fn(PointId) -> bool,
    ) {
        for &point in visible {
            if is_expected(model, image, cam_from_world, point) {
                self.num_expected += 1;
                self.num_found += usize::from(is_found(point));
            }
        }
    }

    /// The share; `None` with too few expected points, which tell nothing.
    pub(super) fn share(self, options: &RegisterOptions) -> Option<f64> {
        let is_informative = self.num_expected >= options.min_num_inliers.max(1);
        is_informative.then(|| self.num_found as f64 / self.num_expected as f64)
    }

    /// That of a registered image.
    pub(super) fn of_registered(
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
    ) -> Self {
        let mut recall = Self::default();
        if let Some(pose) = model.image(image).cam_from_world() {
            let observed: BTreeSet<PointId> =
                model.image(image).points().iter().flatten().copied().collect();
            let visible = visible_to_neighbours(graph, model, image);
            recall.add(model, image, pose, &visible, |point| observed.contains(&point));
        }
        recall
    }
}

/// Whether an image with this pose should observe a point: the point projects into the image, and
/// some other image observes it from a similar direction and distance.
fn is_expected(
    model: &Reconstruction,
    image: ImageId,
    cam_from_world: &Rigid3,
    point: PointId,
) -> bool {
    let Some(track) = model.track(point) else { return false };
    let camera = model.camera_of(image);
    let is_inside = camera
        .intrinsics
        .project(&(*cam_from_world * track.xyz))
        .is_some_and(|pixel| camera.contains(&pixel));
    let ray = track.xyz - cam_from_world.origin_in_a();
    let is_similar_view = |observation: &Observation| {
        let pose = model.image(observation.image).cam_from_world();
        pose.filter(|_| observation.image != image).is_some_and(|pose| {
            let other_ray = track.xyz - pose.origin_in_a();
            are_similar_views(&ray, &other_ray, MAX_VIEW_ANGLE_RAD, MAX_DISTANCE_RATIO)
        })
    };
    is_inside && track.observations.iter().any(is_similar_view)
}

/// Whether two images look at a point from similar directions and distances; the rays are from
/// their centres to the point.
pub(super) fn are_similar_views(
    ray: &Vector3<f64>,
    other: &Vector3<f64>,
    max_angle_rad: f64,
    max_distance_ratio: f64,
) -> bool {
    let ratio = ray.norm() / other.norm();
    ray.angle(other) < max_angle_rad && ratio.max(1.0 / ratio) < max_distance_ratio
}

/// The points that the neighbours of an image in the graph observe, in order of their ids.
pub(super) fn visible_to_neighbours(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
) -> Vec<PointId> {
    let neighbours = graph.neighbours(image).iter();
    let mut points: Vec<PointId> =
        neighbours.flat_map(|&other| model.image(other).points()).flatten().copied().collect();
    points.sort_unstable();
    points.dedup();
    points
}
