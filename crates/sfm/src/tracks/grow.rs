//! Creation, continuation, completion and merging of tracks. Each function can be called at any
//! time, leaves a consistent model, and returns the number of changed observations.
//!
//! After Schönberger & Frahm 2016, sections 4.3 and 4.4.

use std::collections::{BTreeSet, VecDeque};

use tiepoint_adjust::view_ray;
use tiepoint_geometry::OptionError;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::triangulate::{ViewRay, triangulate};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, PointId, Reconstruction, Track};

/// Thresholds of track creation.
#[derive(Clone, Copy, Debug)]
pub struct TrackOptions {
    /// Maximum reprojection error for creating or continuing a track, in pixels.
    pub max_create_error_px: f64,
    /// Maximum reprojection error for completing and merging tracks, in pixels. These run on
    /// adjusted poses.
    pub max_merge_error_px: f64,
    /// Minimum triangulation angle of a new point, in radians.
    pub min_angle_rad: f64,
    /// Whether two keypoints that match only each other become a point. Such points are numerous,
    /// uncertain, and no third image can contradict them. A model of two images needs them.
    pub two_view: bool,
    /// Maximum number of correspondences between a track and an observation that completes it.
    pub max_transitivity: usize,
}

impl TrackOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        let Self { max_create_error_px, max_merge_error_px, min_angle_rad, .. } = *self;
        OptionError::check_positive("tracks.max_create_error_px", max_create_error_px)?;
        OptionError::check_positive("tracks.max_merge_error_px", max_merge_error_px)?;
        OptionError::check_angle("tracks.min_angle_rad", min_angle_rad)
    }
}

impl Default for TrackOptions {
    fn default() -> Self {
        Self {
            max_create_error_px: 12.0,
            max_merge_error_px: 4.0,
            min_angle_rad: 1.5_f64.to_radians(),
            two_view: false,
            max_transitivity: 5,
        }
    }
}

/// Continues tracks with the keypoints of a registered image, and triangulates new points from its
/// correspondences. Returns the number of added observations.
pub fn triangulate_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    options: &TrackOptions,
) -> usize {
    let mut added = 0;
    for keypoint in 0..model.image(image).keypoints.len() as u32 {
        let observation = Observation { image, keypoint };
        if !options.two_view && graph.is_two_view(observation) {
            continue;
        }
        let targets: Vec<Observation> = graph
            .correspondences(observation)
            .iter()
            .copied()
            .filter(|t| model.image(t.image).cam_from_world().is_some())
            .collect();
        if targets.is_empty() {
            continue;
        }
        if model.image(image).point_of(keypoint).is_none() {
            added += usize::from(continue_track(
                model,
                observation,
                &targets,
                options.max_create_error_px,
            ));
        }
        let mut free: Vec<Observation> = std::iter::once(observation)
            .chain(targets)
            .filter(|o| model.image(o.image).point_of(o.keypoint).is_none())
            .collect();
        // If a keypoint was matched to two scene points, the remaining observations may give
        // another point.
        while free.len() >= 2 {
            let Some((xyz, members)) = create_point(model, &free, options) else { break };
            added += members.len();
            free.retain(|o| !members.contains(o));
            model.add_track(Track::new(xyz, members));
        }
    }
    added
}

/// Adds a keypoint to the best-fitting point of its correspondences.
fn continue_track(
    model: &mut Reconstruction,
    observation: Observation,
    targets: &[Observation],
    max_error_px: f64,
) -> bool {
    let candidates: BTreeSet<PointId> =
        targets.iter().filter_map(|t| model.image(t.image).point_of(t.keypoint)).collect();
    let errors = candidates.into_iter().filter_map(|point| {
        let error = model.observation_error_px(&observation, &model.track(point)?.xyz)?;
        (error <= max_error_px).then_some((error, point))
    });
    match errors.min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((_, point)) => {
            model.add_observation(point, observation);
            true
        }
        None => false,
    }
}

/// Triangulates a new point from keypoints without points. Returns it with its inliers.
fn create_point(
    model: &Reconstruction,
    free: &[Observation],
    options: &TrackOptions,
) -> Option<(Vector3<f64>, Vec<Observation>)> {
    let (members, rays): (Vec<Observation>, Vec<ViewRay>) =
        free.iter().filter_map(|o| Some((*o, view_ray(model, o)?))).unzip();
    let found = triangulate(&rays, options.max_create_error_px, options.min_angle_rad)?;
    Some((found.xyz, found.inliers.into_iter().map(|index| members[index]).collect()))
}

/// Calls [`triangulate_image`] on every registered image, since poses have changed after an
/// adjustment. Returns the number of added observations.
pub fn retriangulate(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    options: &TrackOptions,
) -> usize {
    // Between adjusted poses, observations above the merge threshold would be filtered again.
    let options = &TrackOptions { max_create_error_px: options.max_merge_error_px, ..*options };
    let images: Vec<ImageId> = model.registered().map(|(id, ..)| id).collect();
    images.into_iter().map(|image| triangulate_image(graph, model, image, options)).sum()
}

/// Updates all tracks after an adjustment: runs [`retriangulate`], [`complete_tracks`] and
/// [`merge_tracks`] on the whole model.
pub(crate) fn update_tracks(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    options: &TrackOptions,
) {
    retriangulate(graph, model, options);
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    complete_tracks(graph, model, &points, options);
    merge_tracks(graph, model, &points, options);
}

/// Adds keypoints without points to the tracks of `points` if correspondences connect them and they
/// fit. Returns the number of added observations.
pub fn complete_tracks(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    points: &[PointId],
    options: &TrackOptions,
) -> usize {
    let mut added = 0;
    for &point in points {
        let Some(track) = model.track(point) else { continue };
        let xyz = track.xyz;
        let mut queue: VecDeque<(Observation, usize)> =
            track.observations.iter().map(|o| (*o, 0)).collect();
        let mut visited: BTreeSet<Observation> = track.observations.iter().copied().collect();
        while let Some((observation, distance)) = queue.pop_front() {
            if distance == options.max_transitivity {
                continue;
            }
            for &next in graph.correspondences(observation) {
                if model.image(next.image).point_of(next.keypoint).is_none()
                    && model
                        .observation_error_px(&next, &xyz)
                        .is_some_and(|e| e <= options.max_merge_error_px)
                    && visited.insert(next)
                {
                    model.add_observation(point, next);
                    queue.push_back((next, distance + 1));
                    added += 1;
                }
            }
        }
    }
    added
}

/// Merges points that a correspondence connects if all observations fit the merged point. Returns
/// the number of observations in merged tracks.
pub fn merge_tracks(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    points: &[PointId],
    options: &TrackOptions,
) -> usize {
    let mut merged_observations = 0;
    for &first in points {
        let mut point = first;
        let mut refused = BTreeSet::new();
        while let Some((other, xyz)) =
            mergeable(graph, model, point, &mut refused, options.max_merge_error_px)
        {
            match model.merge_tracks(point, other, xyz) {
                Some(merged) => point = merged,
                None => break,
            }
            merged_observations += model.track(point).map_or(0, |track| track.observations.len());
        }
    }
    merged_observations
}

/// Mean of two points, weighted by their numbers of observations.
pub(crate) fn mean_position(one: &Track, other: &Track) -> Vector3<f64> {
    let (n, m) = (one.observations.len() as f64, other.observations.len() as f64);
    (one.xyz * n + other.xyz * m) / (n + m)
}

/// Returns a point that can be merged with `point`, and the merged position.
fn mergeable(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    point: PointId,
    refused: &mut BTreeSet<PointId>,
    max_error_px: f64,
) -> Option<(PointId, Vector3<f64>)> {
    let track = model.track(point)?;
    for observation in &track.observations {
        for next in graph.correspondences(*observation) {
            let Some(other) = model.image(next.image).point_of(next.keypoint) else { continue };
            if other == point || !refused.insert(other) {
                continue;
            }
            let Some(other_track) = model.track(other) else { continue };
            let xyz = mean_position(track, other_track);
            let fits = |o: &Observation| {
                model.observation_error_px(o, &xyz).is_some_and(|e| e <= max_error_px)
            };
            if track.observations.iter().chain(&other_track.observations).all(fits) {
                return Some((other, xyz));
            }
        }
    }
    None
}
