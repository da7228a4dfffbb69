//! Matches between the images of a scene, correct and wrong, with the two-view geometries that a
//! geometric verification would find.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Intrinsics, Rigid3, Rng, so3};
use tiepoint_scene::{
    CorrespondenceGraph, ImageId, ImagePair, Match, Observation, Reconstruction, TwoView,
    TwoViewKind,
};

use super::scene::FeatureScene;

/// Baselines shorter than this, in metres, are pure rotations.
const MIN_BASELINE_M: f64 = 1e-3;

/// Options of the matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchOptions {
    /// Fewest common points of a pair.
    pub min_common: usize,
    /// Largest difference of the indices of a pair in the sequences of their cameras. Pairs that
    /// are more than ten windows apart are matched, too: the ends of a loop. `None` matches all
    /// pairs.
    pub window: Option<usize>,
    /// Fraction of the common points that are matched.
    pub recall: f64,
    /// Fraction of the unverified matches that are wrong.
    pub outlier_ratio: f64,
    /// Largest Sampson error of a wrong match that passes the verification, in pixels.
    pub max_error_px: f64,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self { min_common: 20, window: None, recall: 0.8, outlier_ratio: 0.2, max_error_px: 4.0 }
    }
}

/// The matches of a pair of images.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMatches {
    /// The pair.
    pub pair: ImagePair,
    /// All matches, correct and wrong.
    pub matches: Vec<Match>,
    /// The true two-view geometry with its inlier matches; for a visually aliased pair, the wrong
    /// geometry that its matches support.
    pub two_view: TwoView,
}

impl FeatureScene {
    /// The verified matches, the input of a mapper together with [`FeatureScene::without_poses`].
    pub fn graph(&self, options: &MatchOptions) -> CorrespondenceGraph {
        let counts: Vec<usize> =
            self.truth().images().map(|(_, image)| image.keypoints.len()).collect();
        let found = self.matches(options).into_iter();
        CorrespondenceGraph::new(&counts, found.map(|found| (found.pair, found.two_view)))
    }

    /// Matches every pair of images with enough points in common, sorted by pair.
    pub fn matches(&self, options: &MatchOptions) -> Vec<PairMatches> {
        let truth = self.truth();
        let sequence_index = sequence_indices(truth);
        let count = sequence_index.len();
        let is_in_window = |a: usize, b: usize| {
            // Pairs more than ten windows apart are the ends of a loop; pairs between are left out.
            options.window.is_none_or(|window| {
                let difference = sequence_index[a].abs_diff(sequence_index[b]);
                difference <= window || difference > 10 * window
            })
        };
        let of_image = |a: usize| {
            let image = truth.image(ImageId::from_index(a));
            let mut common: Vec<(u32, Match)> = Vec::new();
            for (keypoint, point) in image.points().iter().enumerate() {
                let Some(track) = point.and_then(|point| truth.track(point)) else { continue };
                for &Observation { image, keypoint: other } in &track.observations {
                    if image.index() > a && is_in_window(a, image.index()) {
                        common.push((image.0, Match { a: keypoint as u32, b: other }));
                    }
                }
            }
            common.sort();
            let pairs = common.chunk_by(|one, other| one.0 == other.0);
            let pairs = pairs.filter(|common| common.len() >= options.min_common);
            pairs.map(|common| self.true_pair(a, common, options)).collect::<Vec<_>>()
        };
        let found: Vec<Vec<PairMatches>> = (0..count).into_par_iter().map(of_image).collect();
        let mut found: Vec<PairMatches> = found.into_iter().flatten().collect();
        for wrong in &self.wrong_pairs {
            let mut two_view = two_view_geometry(truth, wrong.pair, &wrong.cam2_from_cam1);
            two_view.matches.clone_from(&wrong.matches);
            let made = PairMatches { pair: wrong.pair, matches: wrong.matches.clone(), two_view };
            match found.binary_search_by_key(&wrong.pair, |known| known.pair) {
                // The wrong matches outnumber the few common points of this pair.
                Ok(at) => found[at] = made,
                Err(at) => found.insert(at, made),
            }
        }
        found
    }

    /// The visually aliased pairs.
    pub fn wrong_pairs(&self) -> impl Iterator<Item = ImagePair> {
        self.wrong_pairs.iter().map(|wrong| wrong.pair)
    }

    fn true_pair(&self, a: usize, common: &[(u32, Match)], options: &MatchOptions) -> PairMatches {
        let truth = self.truth();
        let b = common[0].0 as usize;
        let pair = ImagePair { a: ImageId::from_index(a), b: ImageId::from_index(b) };
        let mut rng = Rng::stream(self.seed, &[33, a as u64, b as u64]);
        let (one, other) = (truth.image(pair.a), truth.image(pair.b));
        let pose = |image: ImageId| {
            *truth.image(image).cam_from_world().expect("the truth has every pose")
        };
        let mut two_view = two_view_geometry(truth, pair, &(pose(pair.b) * pose(pair.a).inverse()));
        let mut matches: Vec<Match> =
            common.iter().filter(|_| rng.uniform() < options.recall).map(|(_, m)| *m).collect();
        two_view.matches.clone_from(&matches);
        let share = options.outlier_ratio.clamp(0.0, 0.99);
        let wrong = (matches.len() as f64 * share / (1.0 - share)).round() as usize;
        // Each keypoint has at most one match: wrong ones use unmatched keypoints.
        let left_over = |count: usize, taken: &dyn Fn(&Match) -> u32| {
            let mut is_taken = vec![false; count];
            matches.iter().for_each(|m| is_taken[taken(m) as usize] = true);
            (0..count as u32).filter(|&k| !is_taken[k as usize]).collect::<Vec<u32>>()
        };
        let mut left_a = left_over(one.keypoints.len(), &|m| m.a);
        let mut left_b = left_over(other.keypoints.len(), &|m| m.b);
        for _ in 0..wrong.min(left_a.len()).min(left_b.len()) {
            let a = left_a.swap_remove(rng.below(left_a.len()));
            let b = left_b.swap_remove(rng.below(left_b.len()));
            let m = Match { a, b };
            if common.binary_search_by_key(&m, |(_, m)| *m).is_ok() {
                continue;
            }
            matches.push(m);
            let (x1, x2) = (one.keypoints[m.a as usize].pixel, other.keypoints[m.b as usize].pixel);
            if error_px(&two_view, x1.push(1.0), x2.push(1.0)) < options.max_error_px {
                two_view.matches.push(m);
            }
        }
        matches.sort();
        two_view.matches.sort();
        PairMatches { pair, matches, two_view }
    }
}

/// The index of each image in the sequence of its camera.
fn sequence_indices(truth: &Reconstruction) -> Vec<usize> {
    let mut next = vec![0; truth.cameras().count()];
    let mut sequence_index = |camera: usize| {
        next[camera] += 1;
        next[camera] - 1
    };
    truth.images().map(|(_, image)| sequence_index(image.camera.index())).collect()
}

/// The two-view geometry of a known relative pose, without matches.
fn two_view_geometry(truth: &Reconstruction, pair: ImagePair, cam2_from_cam1: &Rigid3) -> TwoView {
    let calibration = |image: ImageId| {
        let intrinsics: &Intrinsics = &truth.camera_of(image).intrinsics;
        let (focal, centre) = (intrinsics.mean_focal_px(), intrinsics.principal_point());
        Matrix3::new(focal, 0.0, centre.x, 0.0, focal, centre.y, 0.0, 0.0, 1.0)
    };
    let invert = |k: Matrix3<f64>| k.try_inverse().expect("a focal length is positive");
    let rotation = cam2_from_cam1.rotation.to_rotation_matrix().into_inner();
    let baseline = cam2_from_cam1.translation.norm();
    if baseline < MIN_BASELINE_M {
        return TwoView {
            kind: TwoViewKind::Panoramic,
            homography: Some(calibration(pair.b) * rotation * invert(calibration(pair.a))),
            cam2_from_cam1: Some(Rigid3::new(cam2_from_cam1.rotation, Vector3::zeros())),
            ..TwoView::default()
        };
    }
    let direction = cam2_from_cam1.translation / baseline;
    let essential = so3::hat(&direction) * rotation;
    let fundamental =
        invert(calibration(pair.b)).transpose() * essential * invert(calibration(pair.a));
    TwoView {
        kind: TwoViewKind::Calibrated,
        fundamental: Some(fundamental),
        essential: Some(essential),
        cam2_from_cam1: Some(Rigid3::new(cam2_from_cam1.rotation, direction)),
        ..TwoView::default()
    }
}

/// Sampson error in pixels, or the transfer error of the homography.
fn error_px(two_view: &TwoView, x1: Vector3<f64>, x2: Vector3<f64>) -> f64 {
    if let Some(f) = &two_view.fundamental {
        let (line2, line1) = (f * x1, f.transpose() * x2);
        let residual = x2.dot(&line2);
        return residual.abs() / (line1.xy().norm_squared() + line2.xy().norm_squared()).sqrt();
    }
    two_view.homography.map_or(f64::INFINITY, |h| {
        let there = h * x1;
        (there.xy() / there.z - x2.xy()).norm()
    })
}
