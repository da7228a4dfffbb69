//! Why images have no pose in a model, and which images nearly connect two models.

use std::cmp::Reverse;

use rayon::prelude::*;
use tiepoint_geometry::{RansacOptions, Rigid3, Rng, estimate};
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};

use crate::register::{RegisterOptions, Timelines, candidates};

/// Why an image has no pose in a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnregisteredReason {
    /// No pair with the image is verified.
    NoPair,
    /// The image has verified pairs, but none with an image that has a pose in a model, or in the
    /// first one if the image itself has a pose in another.
    NoPairWithModel {
        /// Number of verified pairs.
        pairs: usize,
    },
    /// Fewer keypoints match points of the model than a pose needs.
    FewPoints {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number that a pose needs.
        required: usize,
    },
    /// Too few 2D-3D correspondences agree on a pose.
    FewInliers {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
        /// Number that a pose needs.
        required: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose, but too few did while the model grew.
    Late {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose, which most verified matches with images of the
    /// model contradict.
    Contradiction {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose that the camera cannot have reached from the
    /// images before and after.
    OutOfReach {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
}

/// An image without a pose in the first model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnregisteredImage {
    /// The image.
    pub image: ImageId,
    /// Index of the model that it has a pose in.
    pub posed_in: Option<usize>,
    /// Index of the model that the reason is about: the first, or, for an image without any pose,
    /// that of the image with which it has the most verified matches.
    pub model: usize,
    /// Why it has no pose there.
    pub reason: UnregisteredReason,
    /// The image of that model with the most verified matches, and their number.
    pub nearest: Option<(ImageId, usize)>,
}

/// The images with keypoints that have no pose in the first of the finished models, and why.
pub fn unregistered_images(
    graph: &CorrespondenceGraph,
    models: &[&Reconstruction],
    options: &RegisterOptions,
    seed: u64,
) -> Vec<UnregisteredImage> {
    let Some(first) = models.first() else { return Vec::new() };
    let images = first.images().take(graph.num_images());
    let out: Vec<ImageId> = images
        .filter(|(_, image)| !image.keypoints.is_empty() && image.cam_from_world().is_none())
        .map(|(id, _)| id)
        .collect();
    let timelines: Vec<Timelines> =
        models.iter().map(|model| Timelines::new(graph, model)).collect();
    let describe = |image: ImageId| {
        let posed_in = models.iter().position(|model| has_pose(model, image));
        let wanted = if posed_in.is_some() { &models[..1] } else { models };
        let nearest_in = |(index, model): (usize, &&Reconstruction)| {
            let posed = graph.neighbours(image).iter().filter(|other| has_pose(model, **other));
            let matches = |other: &ImageId| {
                let view = ImagePair::new(image, *other).and_then(|pair| graph.pairs().get(&pair));
                (*other, view.map_or(0, |view| view.matches.len()))
            };
            let most = posed.map(matches).max_by_key(|(other, count)| (*count, Reverse(*other)))?;
            Some((index, most))
        };
        let nearest = wanted.iter().enumerate().filter_map(nearest_in);
        let nearest = nearest.max_by_key(|(index, (_, count))| (*count, Reverse(*index)));
        let (model, nearest) = nearest.map_or((0, None), |(model, most)| (model, Some(most)));
        let reason = match (graph.neighbours(image).len(), nearest) {
            (0, _) => UnregisteredReason::NoPair,
            (pairs, None) => UnregisteredReason::NoPairWithModel { pairs },
            _ => reason_of_pose(graph, models[model], &timelines[model], image, options, seed),
        };
        UnregisteredImage { image, posed_in, model, reason, nearest }
    };
    out.into_par_iter().map(describe).collect()
}

/// Why an image with matches to the model has no pose: resection against the finished model.
fn reason_of_pose(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    timelines: &Timelines,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
) -> UnregisteredReason {
    let (mut pixels, mut points) = (Vec::new(), Vec::new());
    for (observation, point) in candidates(graph, model, image) {
        if let Some(track) = model.track(point) {
            pixels.push(model.image(image).keypoints[observation.keypoint as usize].pixel);
            points.push(track.xyz);
        }
    }
    let correspondences = points.len();
    let of_all = (options.min_inlier_ratio * correspondences as f64).ceil() as usize;
    let required = options.min_num_inliers.max(of_all);
    if correspondences < required {
        return UnregisteredReason::FewPoints { correspondences, required };
    }
    let ransac = RansacOptions {
        max_error: options.max_error_px,
        seed: Rng::stream(seed, &[u64::from(image.0)]).next_u64(),
        ..RansacOptions::default()
    };
    let intrinsics = &model.camera_of(image).intrinsics;
    match estimate::absolute_pose(&pixels, &points, intrinsics, &ransac) {
        Some(report) if report.num_inliers >= required => {
            let inliers = report.num_inliers;
            let motion = timelines.expected_motion(model, image);
            if motion.is_some_and(|motion| motion.contradicts(&report.model)) {
                UnregisteredReason::OutOfReach { correspondences, inliers }
            } else if agrees(graph, model, image, &report.model, options.max_error_px) {
                UnregisteredReason::Late { correspondences, inliers }
            } else {
                UnregisteredReason::Contradiction { correspondences, inliers }
            }
        }
        report => {
            let inliers = report.map_or(0, |report| report.num_inliers);
            UnregisteredReason::FewInliers { correspondences, inliers, required }
        }
    }
}

/// Whether most verified matches of an image with images of the model agree with a pose of it: the
/// angle between ray and epipolar plane, in pixels of the image.
fn agrees(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
    cam_from_world: &Rigid3,
    max_error_px: f64,
) -> bool {
    let ray = |image: ImageId, keypoint: u32| {
        let pixel = model.image(image).keypoints[keypoint as usize].pixel;
        model.camera_of(image).intrinsics.unproject(&pixel)
    };
    let max_sine = max_error_px / model.camera_of(image).intrinsics.mean_focal_px();
    let (mut all, mut agreeing) = (0, 0);
    for &other in graph.neighbours(image) {
        let Some(other_from_world) = model.image(other).cam_from_world() else { continue };
        let from_other = *cam_from_world * other_from_world.inverse();
        let Some(pair) = ImagePair::new(image, other) else { continue };
        for m in graph.pairs().get(&pair).into_iter().flat_map(|view| &view.matches) {
            let (keypoint, there) = if pair.a == image { (m.a, m.b) } else { (m.b, m.a) };
            let (Some(here), Some(there)) = (ray(image, keypoint), ray(other, there)) else {
                continue;
            };
            let normal = from_other.translation.cross(&(from_other.rotation * there));
            all += 1;
            let is_near = here.dot(&normal).abs() <= max_sine * here.norm() * normal.norm();
            agreeing += usize::from(is_near);
        }
    }
    2 * agreeing >= all
}

/// The verified pair of an image of `model` and one of `other` with the most matches, and their
/// number. Images that both have connect nothing here.
pub fn nearest_pair(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    other: &Reconstruction,
) -> Option<([ImageId; 2], usize)> {
    let only = |image: ImageId, of: &Reconstruction, not: &Reconstruction| {
        has_pose(of, image) && !has_pose(not, image)
    };
    let across = |pair: &ImagePair| {
        let images = [[pair.a, pair.b], [pair.b, pair.a]];
        images.into_iter().find(|[a, b]| only(*a, model, other) && only(*b, other, model))
    };
    let pairs = graph.pairs().iter();
    let found = pairs.filter_map(|(pair, view)| Some((across(pair)?, view.matches.len())));
    found.max_by_key(|(images, count)| (*count, Reverse(*images)))
}

fn has_pose(model: &Reconstruction, image: ImageId) -> bool {
    image.index() < model.num_images() && model.image(image).cam_from_world().is_some()
}
