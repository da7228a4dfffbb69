//! Assembly of points and observations to a reconstruction with ground truth.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{ImageId, ImagePair, Keypoint, Match, Observation, Reconstruction, Track};

use super::options::FeatureOptions;
use super::visibility::{KeypointObservation, SceneImages, sample_scale_px};
use crate::Drive;
use crate::error::{Error, require};

/// Rounds of the pilot sample, which estimates the number of observations of a point.
const PILOT_ROUNDS: usize = 12;
/// Most keypoints that a visually aliased pair copies, and the smallest distance between its
/// images, in metres.
const WRONG_PAIR_MATCHES: usize = 80;
const WRONG_PAIR_DISTANCE_M: f64 = 25.0;

/// A visually aliased pair: its matches, and the wrong relative pose that they support.
#[derive(Clone, Debug)]
pub(super) struct WrongPair {
    pub(super) pair: ImagePair,
    pub(super) matches: Vec<Match>,
    pub(super) cam2_from_cam1: Rigid3,
}

/// A feature-level scene with ground truth.
#[derive(Clone, Debug)]
pub struct FeatureScene {
    truth: Reconstruction,
    pub(super) wrong_pairs: Vec<WrongPair>,
    pub(super) seed: u64,
}

/// A point: its position in the world, and the number of its consecutive observations.
type Point = (Vector3<f64>, usize);

impl FeatureScene {
    /// Simulates the features of the images of a drive. Images are those of [`Drive::truth`], in
    /// that order.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if an option is out of its range.
    pub fn new(drive: &Drive, options: &FeatureOptions) -> Result<Self, Error> {
        require(
            (0.0..=1.0).contains(&options.detection),
            "detection",
            options.detection,
            "0 to 1",
        )?;
        require(
            (0.0..=50.0).contains(&options.noise_px),
            "noise_px",
            options.noise_px,
            "0 to 50 px",
        )?;
        require(
            (1.0..=200.0).contains(&options.max_range_m),
            "max_range_m",
            options.max_range_m,
            "1 to 200 m",
        )?;
        let angle = options.max_view_angle_rad;
        require((0.0..=1.5).contains(&angle), "max_view_angle_rad", angle, "0 to 1.5")?;
        let posed = drive.truth();
        let images = SceneImages::new(drive, options.max_range_m);
        let (mut points, mut observations) = sample(&images, options, 0..PILOT_ROUNDS);
        let per_round = observations.len().max(1) as f64 / PILOT_ROUNDS as f64;
        let rounds = (options.observations as f64 / per_round).round() as usize;
        let (more, more_observations) =
            sample(&images, options, PILOT_ROUNDS..rounds.max(PILOT_ROUNDS));
        points.extend(more);
        observations.extend(more_observations);
        Ok(assemble(&posed, &points, &observations, options))
    }

    /// The ground truth: keypoints, poses, points and tracks. The intrinsics are exact only for the
    /// ideal lens, and the poses hold for every row only with a global shutter.
    pub fn truth(&self) -> &Reconstruction {
        &self.truth
    }

    /// The input of a mapper: cameras, and images with times and keypoints, without poses and
    /// points.
    pub fn without_poses(&self) -> Reconstruction {
        let mut blank = Reconstruction::default();
        for (_, camera) in self.truth.cameras() {
            blank.add_camera(*camera);
        }
        for (_, image) in self.truth.images() {
            let copy = tiepoint_scene::Image::new(
                image.name.clone(),
                image.camera,
                image.keypoints.to_vec(),
            );
            let id = blank.add_image(copy);
            blank.set_time(id, image.time_s);
        }
        blank
    }
}

/// Samples the points of some rounds; in each round every image contributes the surface point of
/// one pixel.
fn sample(
    images: &SceneImages,
    options: &FeatureOptions,
    rounds: std::ops::Range<usize>,
) -> (Vec<Point>, Vec<KeypointObservation>) {
    let found: Vec<(Vec<Point>, Vec<KeypointObservation>)> = (0..images.len())
        .into_par_iter()
        .map(|image| {
            let (mut points, mut observations) = (Vec::new(), Vec::new());
            for round in rounds.clone() {
                let mut rng = Rng::stream(options.seed, &[30, image as u64, round as u64]);
                let first = observations.len();
                if let Some(xyz) = images.sample_point(image, options, &mut rng, &mut observations)
                    && observations.len() >= first + 2
                {
                    points.push((xyz, observations.len() - first));
                } else {
                    observations.truncate(first);
                }
            }
            (points, observations)
        })
        .collect();
    let mut all = (Vec::new(), Vec::new());
    for (points, observations) in found {
        all.0.extend(points);
        all.1.extend(observations);
    }
    all
}

fn assemble(
    posed: &Reconstruction,
    points: &[Point],
    observations: &[KeypointObservation],
    options: &FeatureOptions,
) -> FeatureScene {
    let count = posed.images().count();
    let mut keypoints: Vec<Vec<Keypoint>> = vec![Vec::new(); count];
    let mut tracks = Vec::with_capacity(points.len());
    let mut rest = observations;
    for &(xyz, length) in points {
        let (mine, others) = rest.split_at(length);
        rest = others;
        let observe = |observation: &KeypointObservation| {
            let of_image = &mut keypoints[observation.image as usize];
            of_image.push(observation.keypoint);
            Observation { image: ImageId(observation.image), keypoint: of_image.len() as u32 - 1 }
        };
        tracks.push(Track::new(xyz, mine.iter().map(observe).collect()));
    }
    for (index, (_, image)) in posed.images().enumerate() {
        let mut rng = Rng::stream(options.seed, &[31, index as u64]);
        let camera = posed.camera(image.camera);
        for _ in 0..options.clutter {
            let pixel = Vector2::new(
                f64::from(camera.width) * rng.uniform(),
                f64::from(camera.height) * rng.uniform(),
            );
            keypoints[index].push(Keypoint { pixel, scale_px: sample_scale_px(&mut rng) as f32 });
        }
    }
    let wrong_pairs = wrong_pairs(posed, &tracks, &mut keypoints, options);
    let mut truth = Reconstruction::default();
    for (_, camera) in posed.cameras() {
        truth.add_camera(*camera);
    }
    for ((_, image), keypoints) in posed.images().zip(keypoints) {
        let id = truth.add_image(tiepoint_scene::Image::new(
            image.name.clone(),
            image.camera,
            keypoints,
        ));
        truth.set_time(id, image.time_s);
        truth.register(id, *image.cam_from_world().expect("the true model has every pose"));
    }
    for track in tracks {
        truth.add_track(track);
    }
    FeatureScene { truth, wrong_pairs, seed: options.seed }
}

/// Makes visually aliased pairs: copies keypoints of the neighbour of an image into a distant
/// image, so that the image and the distant one agree on a wrong geometry.
fn wrong_pairs(
    posed: &Reconstruction,
    tracks: &[Track],
    keypoints: &mut [Vec<Keypoint>],
    options: &FeatureOptions,
) -> Vec<WrongPair> {
    let mut rng = Rng::stream(options.seed, &[32]);
    let poses: Vec<Rigid3> = posed.registered().map(|(_, _, pose)| *pose).collect();
    let mut pairs = Vec::new();
    // Some draws have no neighbour with enough common points, or no distant image.
    for _ in 0..20 * options.wrong_pairs {
        if pairs.len() == options.wrong_pairs {
            break;
        }
        let (image, distant_image) = (rng.below(poses.len()), rng.below(poses.len()));
        let neighbour = image + 1;
        let is_same_camera = |other: usize| {
            let camera = |index: usize| posed.image(ImageId::from_index(index)).camera;
            camera(image) == camera(other)
        };
        let distance_m = (poses[image].origin_in_a() - poses[distant_image].origin_in_a()).norm();
        if neighbour >= poses.len()
            || !is_same_camera(neighbour)
            || distance_m < WRONG_PAIR_DISTANCE_M
        {
            continue;
        }
        let Some(pair) =
            ImagePair::new(ImageId::from_index(image), ImageId::from_index(distant_image))
        else {
            continue;
        };
        let in_image = |track: &Track, index: usize| {
            track.observations.iter().find(|o| o.image.index() == index).map(|o| o.keypoint)
        };
        let common: Vec<(u32, u32)> = tracks
            .iter()
            .filter_map(|track| Some((in_image(track, image)?, in_image(track, neighbour)?)))
            .take(WRONG_PAIR_MATCHES)
            .collect();
        if common.len() < WRONG_PAIR_MATCHES / 2 {
            continue;
        }
        let is_first = pair.a.index() == image;
        let mut matches = Vec::new();
        for (mine, theirs) in common {
            let copy = keypoints[neighbour][theirs as usize];
            keypoints[distant_image].push(copy);
            let copied = keypoints[distant_image].len() as u32 - 1;
            matches.push(if is_first {
                Match { a: mine, b: copied }
            } else {
                Match { a: copied, b: mine }
            });
        }
        let neighbour_from_image = poses[neighbour] * poses[image].inverse();
        let cam2_from_cam1 =
            if is_first { neighbour_from_image } else { neighbour_from_image.inverse() };
        pairs.push(WrongPair { pair, matches, cam2_from_cam1 });
    }
    pairs
}
