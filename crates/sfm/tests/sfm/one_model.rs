//! A walk along a facade whose two halves are connected by few matches, by few common images, or by
//! a like object at two places.

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Reconstruction,
};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions};

use crate::common::{ate_m, sample};

const SEEDS: [u64; 3] = [0, 1, 2];
const FRAMES: usize = 18;
/// The first image of the second half.
pub(crate) const HALF: usize = 9;
/// In metres: distance between frames, and distance to the facade.
const STEP: f64 = 0.6;
const DISTANCE: f64 = 5.0;
/// Maximum distance of matched frames.
const WINDOW: usize = 4;
/// Points of the facade, of which an image sees a quarter.
const POINTS: usize = 1600;
/// Points that connect the halves: fewer than an image usually needs (30), and more than chance
/// explains (20 of 24, [`tiepoint_sfm::register`]).
const FEW: usize = 24;
/// Standard deviation of the keypoints, in pixels.
const NOISE_PX: f64 = 0.3;
/// In metres: three times the largest error of the three seeds, 6.5 mm. A scale of the second half
/// that is wrong by a tenth gives decimetres, as the halves are 5 m long.
const MAX_ATE_M: f64 = 0.02;

pub(crate) struct Walk {
    pub(crate) truth: Reconstruction,
    pub(crate) graph: CorrespondenceGraph,
}

/// A walk along points; `matches(a, b, point)` says whether the keypoints of a point match between
/// frames a < b, and as which point b sees what a sees.
fn walk(
    seed: u64,
    points: &[Vector3<f64>],
    matches: impl Fn(usize, usize, usize) -> Option<usize>,
) -> Walk {
    let mut rng = Rng::stream(seed, &[1]);
    let intrinsics =
        Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 200.0, 150.0]).expect("sound");
    let mut truth = Reconstruction::default();
    let camera =
        truth.add_camera(Camera { intrinsics, width: 400, height: 300, has_focal_prior: true });
    let mut seen: Vec<Vec<Option<u32>>> = Vec::new();
    for frame in 0..FRAMES {
        let x = STEP * frame as f64;
        // Steps off the line, so that centres are not on one.
        let centre = Vector3::new(x, 0.3 * (frame % 3) as f64, 0.4 * (frame % 2) as f64);
        let mut keypoints = Vec::new();
        let place = |point: &Vector3<f64>| {
            let pixel = intrinsics.project(&(point - centre))?;
            let noise = Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
            if !(0.0..400.0).contains(&pixel.x) || !(0.0..300.0).contains(&pixel.y) {
                return None;
            }
            keypoints.push(Keypoint { pixel: pixel + noise, scale_px: 1.0 });
            Some(keypoints.len() as u32 - 1)
        };
        seen.push(points.iter().map(place).collect());
        let image = truth.add_image(Image::new(format!("{frame:02}.jpg"), camera, keypoints));
        truth.register(image, Rigid3 { translation: -centre, ..Rigid3::identity() });
    }
    let view = |frame: usize| ImageObservations::new(&truth, ImageId(frame as u32));
    let pairs = (0..FRAMES).flat_map(|a| (a + 1..FRAMES).map(move |b| (a, b)));
    let two_views = pairs.filter_map(|(a, b)| {
        let of = |point: usize| {
            let there = matches(a, b, point)?;
            Some(Match { a: seen[a][point]?, b: seen[b][there]? })
        };
        let found: Vec<Match> = (0..points.len()).filter_map(of).collect();
        let two_view = verify_pair(view(a), view(b), &found, &VerifyOptions::default(), seed);
        Some((ImagePair::new(ImageId(a as u32), ImageId(b as u32))?, two_view))
    });
    let two_views: Vec<_> = two_views.collect();
    let counts: Vec<usize> = truth.images().map(|(_, image)| image.keypoints.len()).collect();
    let graph = CorrespondenceGraph::new(&counts, two_views);
    Walk { truth, graph }
}

fn facade(seed: u64) -> Vec<Vector3<f64>> {
    let mut rng = Rng::stream(seed, &[0]);
    let length = STEP * FRAMES as f64 + 5.0;
    let mut draw = || {
        let [x, y, z] = [0; 3].map(|_| rng.uniform());
        Vector3::new(length * x - 2.5, 4.0 * y - 2.0, DISTANCE + 2.0 * z - 1.0)
    };
    (0..POINTS).map(|_| draw()).collect()
}

fn models(walk: &Walk, seed: u64) -> Vec<MappedModel> {
    let options =
        MapperOptions { refine: RefineIntrinsics::NONE, seed, ..MapperOptions::default() };
    Mapper::new(&walk.graph, &walk.truth).run(&options).expect("a walk")
}

fn sizes(models: &[MappedModel]) -> Vec<usize> {
    models.iter().map(|model| model.reconstruction.num_registered()).collect()
}

fn is_near(a: usize, b: usize) -> bool {
    b - a <= WINDOW
}

fn are_of_one_half(a: usize, b: usize) -> bool {
    (a < HALF) == (b < HALF)
}

/// Points about the middle, the only ones that match between the halves.
#[test]
fn few_significant_points_connect_two_halves() {
    for &seed in sample(&SEEDS) {
        let points = facade(seed);
        let middle = Vector3::new(STEP * (HALF as f64 - 0.5), 0.3, DISTANCE);
        let mut nearest: Vec<usize> = (0..POINTS).collect();
        nearest.sort_by(|a, b| {
            let distance = |point: &usize| (points[*point] - middle).norm();
            distance(a).total_cmp(&distance(b))
        });
        let few = &nearest[..FEW];
        let walk = walk(seed, &points, |a, b, point| {
            let matches = is_near(a, b) && (are_of_one_half(a, b) || few.contains(&point));
            matches.then_some(point)
        });
        let found = models(&walk, seed);
        assert_eq!(sizes(&found), [FRAMES], "seed {seed}");
        let error_m = ate_m(&found[0].reconstruction, &walk.truth);
        assert!(error_m < MAX_ATE_M, "seed {seed}: {error_m} m");
    }
}

/// As many points of an object that stands in both halves: the first half's object matches the
/// second one's. All else there is different, and the images say so.
#[test]
fn a_like_object_at_two_places_connects_nothing() {
    for &seed in sample(&SEEDS) {
        let mut points = facade(seed);
        let apart = Vector3::new(STEP * HALF as f64, 0.0, 0.0);
        let mut rng = Rng::stream(seed, &[2]);
        let first = points.len();
        for _ in 0..FEW {
            let [x, y, z] = [0; 3].map(|_| rng.uniform());
            let point = Vector3::new(STEP * 4.0 + x - 0.5, 2.0 * y - 1.0, DISTANCE - z);
            points.extend([point, point + apart]);
        }
        let is_of_object = |point: usize| point >= first;
        let walk = walk(seed, &points, |a, b, point| {
            if are_of_one_half(a, b) {
                return is_near(a, b).then_some(point);
            }
            // The second half sees the second object where the first half sees the first one.
            let matches = is_of_object(point) && (point - first).is_multiple_of(2);
            matches.then_some(point + 1)
        });
        let is_between = |pair: &&ImagePair| !are_of_one_half(pair.a.index(), pair.b.index());
        assert!(walk.graph.pairs().keys().filter(is_between).count() > 1, "pairs are verified");
        assert_eq!(sizes(&models(&walk, seed)), [HALF, HALF], "seed {seed}");
    }
}

/// A walk around a corner: the points before it match in the first half, those behind it in the
/// second one. Only images of `common`, the last of the first half, match on both sides, with the
/// second half behind the corner.
pub(crate) fn corner(seed: u64, common: std::ops::Range<usize>) -> Walk {
    let points = facade(seed);
    let corner = STEP * (common.start + common.end - 1) as f64 / 2.0;
    walk(seed, &points, |a, b, point| {
        let is_behind = points[point].x > corner;
        let matches = match (a < HALF, b < HALF) {
            (true, true) => !is_behind,
            (true, false) => is_behind && common.contains(&a),
            (false, _) => is_behind,
        };
        (is_near(a, b) && matches).then_some(point)
    })
}

#[test]
fn models_with_two_common_images_are_joined_and_with_one_they_stay_apart() {
    for &seed in sample(&SEEDS) {
        let walk = corner(seed, HALF - 2..HALF);
        let found = models(&walk, seed);
        assert_eq!(sizes(&found), [FRAMES], "seed {seed}");
        let error_m = ate_m(&found[0].reconstruction, &walk.truth);
        assert!(error_m < MAX_ATE_M, "seed {seed}: {error_m} m");
        // One image without common points says nothing of the scale.
        let apart = sizes(&models(&corner(seed, HALF - 1..HALF), seed));
        assert_eq!((apart.len(), apart.iter().sum()), (2, FRAMES), "seed {seed}");
    }
}
