//! Which images are expected to observe which points.
//!
//! An image is expected to observe a point if another image does so from a similar direction and
//! distance, if it has keypoints where the point would be, and if it sees nothing nearer there.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use tiepoint_scene::{CorrespondenceGraph, ImageId, PointId, Reconstruction};

use crate::register::recall::{are_similar_views, visible_to_neighbours};
use crate::register::square_cells::square_cell;

/// Largest angle between two views of a point (7°), and largest ratio of their distances: less than
/// those at which [`crate::register::recall`] expects a point to be found, so that more of what
/// hides a point from one view hides it from the other. Chosen on twins-apart, seed 11
/// (docs/benchmarks/photos.md), without half and double.
const MAX_ANGLE_RAD: f64 = 0.122_15;
const MAX_DISTANCE_RATIO: f64 = 1.2;
/// A point is hidden if the points that the image observes in its cell are nearer than this share
/// of its depth in the median. Not varied.
const HIDDEN_DEPTH: f64 = 0.9;
/// Images that are remembered for an expectation, evenly among all that observe the point from
/// there.
pub(super) const MAX_WITNESSES: usize = 4;

/// An image and a point that it is expected to observe.
pub(super) struct Expected {
    pub(super) image: usize,
    pub(super) track: usize,
    /// Whether it observes the point.
    pub(super) is_found: bool,
    /// Images that observe the point from a similar place. The last one fills the rest.
    pub(super) witnesses: [usize; MAX_WITNESSES],
}

/// All expectations of a model.
pub(super) struct Expectations {
    /// The registered images. All indices of images are into this list.
    pub(super) images: Vec<ImageId>,
    /// The images that observe each point that is expected anywhere, in order.
    pub(super) observers: Vec<Vec<usize>>,
    /// By image, cell and track.
    pub(super) expected: Vec<Expected>,
    /// The expectations in each cell of each image.
    pub(super) cells: Vec<Range<usize>>,
}

/// An expectation of one image, before tracks have indices: its cell, the point, whether it is
/// found, and the witnesses.
type Found = ((i64, i64), PointId, bool, [usize; MAX_WITNESSES]);

impl Expectations {
    pub(super) fn new(graph: &CorrespondenceGraph, model: &Reconstruction) -> Self {
        let images: Vec<ImageId> = model.registered().map(|(id, ..)| id).collect();
        let index: BTreeMap<ImageId, usize> =
            images.iter().enumerate().map(|(k, id)| (*id, k)).collect();
        let expected = |image: &ImageId| expected_of(graph, model, &index, *image);
        let found: Vec<Vec<Found>> = images.par_iter().map(expected).collect();
        let mut points: Vec<PointId> = found.iter().flatten().map(|it| it.1).collect();
        points.sort_unstable();
        points.dedup();
        let observers = points.iter().map(|point| {
            let observations = model.track(*point).map_or(&[][..], |track| &track.observations);
            let mut observers: Vec<usize> =
                observations.iter().filter_map(|it| index.get(&it.image).copied()).collect();
            observers.sort_unstable();
            observers.dedup();
            observers
        });
        let observers = observers.collect();
        let (mut expected, mut cells) = (Vec::new(), Vec::new());
        for (image, found) in found.iter().enumerate() {
            for in_cell in found.chunk_by(|a, b| a.0 == b.0) {
                let begin = expected.len();
                expected.extend(in_cell.iter().filter_map(|(_, point, is_found, witnesses)| {
                    let track = points.binary_search(point).ok()?;
                    Some(Expected { image, track, is_found: *is_found, witnesses: *witnesses })
                }));
                cells.push(begin..expected.len());
            }
        }
        Self { images, observers, expected, cells }
    }

    /// The share of the expectations that are met; `None` if there are none.
    pub(super) fn rate(&self) -> Option<f64> {
        let num_found = self.expected.iter().filter(|it| it.is_found).count();
        (!self.expected.is_empty()).then(|| num_found as f64 / self.expected.len() as f64)
    }
}

/// What an image is expected to observe, by cell and point.
fn expected_of(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    index: &BTreeMap<ImageId, usize>,
    image: ImageId,
) -> Vec<Found> {
    let (camera, observed) = (model.camera_of(image), model.image(image));
    let Some(pose) = observed.cam_from_world() else { return Vec::new() };
    // By cell, the depths of the points that the image observes; empty if it has other keypoints.
    let mut depths: BTreeMap<(i64, i64), Vec<f64>> = BTreeMap::new();
    for (keypoint, point) in observed.keypoints.iter().zip(observed.points()) {
        let depths = depths.entry(square_cell(camera, &keypoint.pixel)).or_default();
        depths.extend(point.and_then(|it| model.track(it)).map(|it| (*pose * it.xyz).z));
    }
    depths.values_mut().for_each(|depths| depths.sort_by(f64::total_cmp));
    let mut expected: Vec<Found> = Vec::new();
    for point in visible_to_neighbours(graph, model, image) {
        let Some(track) = model.track(point) else { continue };
        let seen = *pose * track.xyz;
        let pixel = camera.intrinsics.project(&seen).filter(|pixel| camera.contains(pixel));
        let Some(pixel) = pixel else { continue };
        let cell = square_cell(camera, &pixel);
        let Some(depths) = depths.get(&cell) else { continue };
        let is_hidden = |depth: &f64| *depth < HIDDEN_DEPTH * seen.z;
        if depths.get(depths.len() / 2).is_some_and(is_hidden) {
            continue;
        }
        let ray = track.xyz - pose.origin_in_a();
        let is_witness = |other: &ImageId| {
            let pose = model.image(*other).cam_from_world();
            pose.filter(|_| *other != image).is_some_and(|pose| {
                let other_ray = track.xyz - pose.origin_in_a();
                are_similar_views(&ray, &other_ray, MAX_ANGLE_RAD, MAX_DISTANCE_RATIO)
            })
        };
        let observers = track.observations.iter().map(|it| it.image);
        let mut near: Vec<usize> =
            observers.filter(is_witness).filter_map(|it| index.get(&it).copied()).collect();
        near.sort_unstable();
        near.dedup();
        let Some(last) = near.last().copied() else { continue };
        let step = near.len().div_ceil(MAX_WITNESSES);
        let mut witnesses = [last; MAX_WITNESSES];
        witnesses.iter_mut().zip(near.iter().step_by(step)).for_each(|(to, it)| *to = *it);
        let is_found = track.observations.iter().any(|it| it.image == image);
        expected.push((cell, point, is_found, witnesses));
    }
    expected.sort_by_key(|it| (it.0, it.1));
    expected
}
