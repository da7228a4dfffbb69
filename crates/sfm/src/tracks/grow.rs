//! Creation, continuation, completion and merging of tracks. Each function can be called at any
//! time, leaves a consistent model, and returns the number of changed observations.
//!
//! Changes happen one after another, because each decides what the next ones find. Between
//! adjustments few tracks change. Which ones may is found in parallel before: no change of another
//! one adds to what a track that cannot change has to choose from.
//!
//! After Schönberger & Frahm 2016, sections 4.3 and 4.4.

use std::collections::{BTreeSet, VecDeque};

use rayon::prelude::*;
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
    // A table of all keypoints would cost more than one image.
    triangulate_images(graph, model, &[image], &has_no_point, options)
}

/// [`triangulate_image`] for several images. `is_free` is [`has_no_point`] or a table of it.
fn triangulate_images(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    images: &[ImageId],
    is_free: &IsFree<'_>,
    options: &TrackOptions,
) -> usize {
    let is_free = |of: &Observation| is_free(model, of);
    let open = images.par_iter().flat_map_iter(|&image| {
        let keypoints = 0..model.image(image).keypoints.len() as u32;
        let observations = keypoints.map(move |keypoint| Observation { image, keypoint });
        observations.filter(|of| {
            // It has no point and a correspondence, or two of its correspondences have no point.
            let mut targets = graph.correspondences(*of).iter();
            let is_open = match is_free(of) {
                true => targets.any(|target| is_registered(model, target.image)),
                false => targets.filter(|target| is_free(target)).nth(1).is_some(),
            };
            is_open && (options.two_view || !graph.is_two_view(*of))
        })
    });
    let open: Vec<Observation> = open.collect();
    open.into_iter().map(|of| triangulate_keypoint(graph, model, of, options)).sum()
}

fn is_registered(model: &Reconstruction, image: ImageId) -> bool {
    model.image(image).cam_from_world().is_some()
}

fn is_free(model: &Reconstruction, of: &Observation) -> bool {
    model.image(of.image).point_of(of.keypoint).is_none()
}

/// Whether a keypoint of a registered image has no point.
type IsFree<'a> = dyn Fn(&Reconstruction, &Observation) -> bool + Sync + 'a;

fn has_no_point(model: &Reconstruction, of: &Observation) -> bool {
    is_registered(model, of.image) && is_free(model, of)
}

/// [`has_no_point`] of all keypoints, in one table that caches hold.
struct FreeKeypoints {
    /// Where those of each image begin.
    first: Vec<usize>,
    is_free: Vec<bool>,
}

impl FreeKeypoints {
    fn new(model: &Reconstruction) -> Self {
        let (mut first, mut is_free) = (Vec::new(), Vec::new());
        for (_, image) in model.images() {
            first.push(is_free.len());
            let is_registered = image.cam_from_world().is_some();
            is_free.extend(image.points().iter().map(|point| is_registered && point.is_none()));
        }
        Self { first, is_free }
    }

    fn has(&self, of: &Observation) -> bool {
        self.is_free[self.first[of.image.index()] + of.keypoint as usize]
    }
}

/// Continues a track with a keypoint, or triangulates points from its correspondences. Returns the
/// number of added observations.
fn triangulate_keypoint(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    observation: Observation,
    options: &TrackOptions,
) -> usize {
    let targets = graph.correspondences(observation).iter().copied();
    let targets: Vec<Observation> = targets.filter(|t| is_registered(model, t.image)).collect();
    let mut added = 0;
    if is_free(model, &observation) {
        let max_error_px = options.max_create_error_px;
        added += usize::from(continue_track(model, observation, &targets, max_error_px));
    }
    let mut free: Vec<Observation> =
        std::iter::once(observation).chain(targets).filter(|o| is_free(model, o)).collect();
    // If a keypoint was matched to two scene points, the remaining observations may give another
    // point.
    while free.len() >= 2 {
        let Some((xyz, members)) = create_point(model, &free, options) else { break };
        added += members.len();
        free.retain(|o| !members.contains(o));
        model.add_track(Track::new(xyz, members));
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
    let free = FreeKeypoints::new(model);
    triangulate_images(graph, model, &images, &|_, of| free.has(of), options)
}

/// An adjustment before an update of the tracks ends when a step lowers the cost by less than this
/// fraction. It is the change between rounds of the mapper that counts as none. An update changes
/// the cost by 5e-3 to 8e-3 (the street of `tiepoint demo`), so that smaller steps are lost. Of
/// 1e-4, 3e-4 and 5e-4 the first needs a third more steps there; the final costs differ by 4e-4 and
/// the position errors by 0.4 %. Larger values were not tried.
pub(crate) const TOLERANCE_BEFORE_TRACK_UPDATE: f64 = 5e-4;

/// Updates all tracks after an adjustment: runs [`retriangulate`], [`complete_tracks`] and
/// [`merge_tracks`] on the whole model.
pub(crate) fn update_tracks(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    options: &TrackOptions,
) {
    retriangulate(graph, model, options);
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    let free = FreeKeypoints::new(model);
    complete(graph, model, &points, &|_, of| free.has(of), options);
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
    complete(graph, model, points, &has_no_point, options)
}

/// [`complete_tracks`]. `is_free` is [`has_no_point`] or a table of it.
fn complete(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    points: &[PointId],
    is_free: &IsFree<'_>,
    options: &TrackOptions,
) -> usize {
    let may_grow = |point: &&PointId| {
        model.track(**point).is_some_and(|track| {
            let mut next = track.observations.iter().flat_map(|o| graph.correspondences(*o));
            next.any(|next| is_free(model, next) && completes(model, next, &track.xyz, options))
        })
    };
    let open: Vec<PointId> = points.par_iter().filter(may_grow).copied().collect();
    open.into_iter().map(|point| complete_track(graph, model, point, options)).sum()
}

/// Whether a keypoint has no point and fits one.
fn completes(
    model: &Reconstruction,
    next: &Observation,
    xyz: &Vector3<f64>,
    options: &TrackOptions,
) -> bool {
    let fits = |error_px| error_px <= options.max_merge_error_px;
    is_free(model, next) && model.observation_error_px(next, xyz).is_some_and(fits)
}

fn complete_track(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    point: PointId,
    options: &TrackOptions,
) -> usize {
    let Some(track) = model.track(point) else { return 0 };
    let (xyz, mut added) = (track.xyz, 0);
    let mut queue: VecDeque<(Observation, usize)> =
        track.observations.iter().map(|o| (*o, 0)).collect();
    while let Some((observation, distance)) = queue.pop_front() {
        if distance == options.max_transitivity {
            continue;
        }
        for &next in graph.correspondences(observation) {
            if completes(model, &next, &xyz, options) {
                model.add_observation(point, next);
                queue.push_back((next, distance + 1));
                added += 1;
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
    let may_merge = |point: &&PointId| {
        model.track(**point).is_some_and(|track| {
            let mut next = track.observations.iter().flat_map(|o| graph.correspondences(*o));
            let point_of = |o: &Observation| model.image(o.image).point_of(o.keypoint);
            next.any(|next| point_of(next).is_some_and(|other| other != **point))
        })
    };
    let open: Vec<PointId> = points.par_iter().filter(may_merge).copied().collect();
    open.into_iter().map(|point| merge_track(graph, model, point, options)).sum()
}

fn merge_track(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    mut point: PointId,
    options: &TrackOptions,
) -> usize {
    let (mut merged_observations, mut refused) = (0, BTreeSet::new());
    while let Some((other, xyz)) =
        mergeable(graph, model, point, &mut refused, options.max_merge_error_px)
    {
        match model.merge_tracks(point, other, xyz) {
            Some(merged) => point = merged,
            None => break,
        }
        merged_observations += model.track(point).map_or(0, |track| track.observations.len());
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

#[cfg(test)]
mod tests {
    use tiepoint_geometry::Rng;
    use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions};

    use super::*;

    const MOMENTS: usize = 8;
    const SEEDS: u64 = 3;

    /// A model with the true poses. Of its tracks a third is missing, a third is cut in two, and
    /// all points are off by a centimetre or so.
    fn broken_model(scene: &FeatureScene, rng: &mut Rng) -> Reconstruction {
        let truth = scene.truth();
        let mut model = scene.without_poses();
        // One image has no pose.
        for (image, _, pose) in truth.registered().skip(1) {
            model.register(image, *pose);
        }
        for (index, (_, track)) in truth.tracks().enumerate() {
            let xyz = track.xyz.map(|value| value + 0.01 * rng.normal());
            let is_posed = |of: &&Observation| is_registered(&model, of.image);
            let observations: Vec<Observation> =
                track.observations.iter().filter(is_posed).copied().collect();
            let parts = match index % 3 {
                0 => Vec::new(),
                1 if observations.len() >= 4 => {
                    let (one, other) = observations.split_at(observations.len() / 2);
                    vec![one.to_vec(), other.to_vec()]
                }
                // One of the observations is missing.
                _ if observations.len() >= 3 => vec![observations[1..].to_vec()],
                _ => vec![observations],
            };
            for observations in parts.into_iter().filter(|part| part.len() >= 2) {
                model.add_track(Track::new(xyz, observations));
            }
        }
        model
    }

    /// The slow twin tries all keypoints and points one after another.
    #[test]
    fn only_tracks_that_change_are_left_to_change() {
        let drive = DriveOptions { rate_hz: 4.0, ..DriveOptions::default() };
        let mut drive = Drive::new(&drive).unwrap();
        drive.keep_first(MOMENTS);
        for seed in 0..SEEDS {
            let observations = 2 * MOMENTS * 200;
            let features = FeatureOptions { seed, observations, ..FeatureOptions::default() };
            let scene = FeatureScene::new(&drive, &features).unwrap();
            let graph = scene.graph(&MatchOptions::default());
            let (options, mut slow) =
                (TrackOptions::default(), broken_model(&scene, &mut Rng::stream(seed, &[])));
            let mut model = slow.clone();
            let images: Vec<ImageId> = slow.registered().map(|(id, ..)| id).collect();

            let mut count = 0;
            for image in &images {
                for keypoint in 0..slow.image(*image).keypoints.len() as u32 {
                    let of = Observation { image: *image, keypoint };
                    if !graph.is_two_view(of) {
                        count += triangulate_keypoint(&graph, &mut slow, of, &options);
                    }
                }
            }
            let free = FreeKeypoints::new(&model);
            let mut direct = model.clone();
            let table: &IsFree<'_> = &|_, of| free.has(of);
            assert_eq!(triangulate_images(&graph, &mut model, &images, table, &options), count);
            let same = triangulate_images(&graph, &mut direct, &images, &has_no_point, &options);
            assert!(same == count && direct == model);
            assert!(count > 0 && model == slow);

            let points: Vec<PointId> = slow.tracks().map(|(point, _)| point).collect();
            let completed = points.iter().map(|p| complete_track(&graph, &mut slow, *p, &options));
            let count: usize = completed.sum();
            let free = FreeKeypoints::new(&model);
            assert_eq!(complete_tracks(&graph, &mut direct, &points, &options), count);
            let table: &IsFree<'_> = &|_, of| free.has(of);
            assert_eq!(complete(&graph, &mut model, &points, table, &options), count);
            assert!(direct == model);
            assert!(count > 0 && model == slow);

            let merged = points.iter().map(|p| merge_track(&graph, &mut slow, *p, &options));
            let count: usize = merged.sum();
            assert_eq!(merge_tracks(&graph, &mut model, &points, &options), count);
            assert!(count > 0 && model == slow);
        }
    }
}
