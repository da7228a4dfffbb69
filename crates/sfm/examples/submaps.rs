//! Sub-maps beside one map: `cargo run --release -p tiepoint-sfm --example submaps -- open 500 200
//! 1,2,3` maps drives of 500 moments of two cameras with these seeds, as one map and in parts of
//! 200 images, and prints the root mean square error of the centres after a similarity, and times.
//! `loop` drives return to their start. `photos` are 500 photos in no order, from above.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

mod feature_drive;

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match,
    Reconstruction, TwoView, TwoViewKind,
};
use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_sfm::submaps::cut;
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions};
use tiepoint_synth::{MatchOptions, RouteKind};

use crate::feature_drive::{ate_m, feature_drive};

const RATE_HZ: f64 = 5.0;
const METRES_PER_FRAME: f64 = 1.2;
const NOISE_PX: f64 = 0.5;
const WINDOW: usize = 6;
/// The focal lengths begin so much too long, and are refined.
const WRONG_FOCAL: f64 = 1.1;
/// Photos from above: their height, the step of their grid, how far they see, and the points.
const HEIGHT_M: f64 = 50.0;
const STEP_M: f64 = 12.0;
const REACH_M: f64 = 50.0;
const POINTS_PER_M2: f64 = 0.2;
const DETECTION: f64 = 0.7;
const SCALE_PX: f32 = 2.0;
/// Fewest common points of a pair.
const MIN_COMMON: usize = 60;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [what, count, size, seeds] = &words[..] else { panic!("what, count, size, seeds") };
    let [count, size] = [count, size].map(|word| word.parse::<usize>().expect("a number"));
    println!("seed       map  images     ATE, m    time, s");
    for seed in seeds.split(',').map(|word| word.parse().expect("seeds")) {
        let (truth, mut blank, graph) = match what.as_str() {
            "photos" => photos(count, seed),
            "loop" => drive(RouteKind::Loop, count, seed),
            _ => drive(RouteKind::Open, count, seed),
        };
        let cameras: Vec<_> = blank.cameras().map(|(id, _)| id).collect();
        for camera in cameras {
            let intrinsics = &mut blank.camera_mut(camera).intrinsics;
            let focal_px = WRONG_FOCAL * intrinsics.mean_focal_px();
            for index in intrinsics.kind().focal_indices() {
                intrinsics.params_mut()[*index] = focal_px;
            }
        }
        let options = MapperOptions { seed, ..MapperOptions::default() };
        let start = Instant::now();
        let one = Mapper::new(&graph, &blank).run(&options).expect("a model");
        show(seed, "one", &one, &truth, start);
        let start = Instant::now();
        let parts = in_parts(&graph, &blank, size, &options);
        show(seed, "parts", &parts, &truth, start);
    }
}

/// The truth, the input of the mapper and the verified pairs.
type Data = (Reconstruction, Reconstruction, CorrespondenceGraph);

fn drive(route: RouteKind, frames: usize, seed: u64) -> Data {
    let scene = feature_drive(route, frames, METRES_PER_FRAME, RATE_HZ, seed);
    let graph = scene.graph(&MatchOptions { window: Some(WINDOW), ..MatchOptions::default() });
    (scene.truth().clone(), scene.without_poses(), graph)
}

/// Photos of hills and houses by three cameras, 50 m above them on a grid with a step of 12 m and
/// some disorder, each turned about the vertical by any angle. Their order is random.
fn photos(count: usize, seed: u64) -> Data {
    let mut rng = Rng::stream(seed, &[]);
    let mut draw = |low: f64, high: f64| low + (high - low) * rng.uniform();
    let side = (count as f64).sqrt().ceil() as usize;
    let side_m = STEP_M * side as f64;
    let num_points = (POINTS_PER_M2 * side_m * side_m) as usize;
    let points: Vec<Vector3<f64>> = (0..num_points)
        .map(|_| {
            let [x, y] = [0, 1].map(|_| draw(0.0, side_m));
            let house_m = draw(-1.0, 1.0).max(0.0) * 10.0;
            Vector3::new(x, y, 8.0 * (x / 40.0).sin() * (y / 55.0).cos() + house_m)
        })
        .collect();
    let mut places: Vec<usize> = (0..count).collect();
    let mut truth = Reconstruction::default();
    for focal_px in [480.0, 520.0, 560.0] {
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, focal_px, 640, 480);
        truth.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
    }
    let mut seen: Vec<Vec<usize>> = Vec::new();
    for index in 0..count {
        let place = places.swap_remove(draw(0.0, places.len() as f64) as usize);
        let jitter_m = Vector3::from_fn(|_, _| draw(-1.5, 1.5));
        let [x, y] = [place % side, place / side].map(|at| STEP_M * (at as f64 + 0.5));
        let eye = Vector3::new(x, y, HEIGHT_M) + jitter_m;
        let [roll, pitch, yaw] = [(PI, 0.1), (0.0, 0.1), (0.0, PI)]
            .map(|(middle, range)| draw(middle - range, middle + range));
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, 0.0)
            * UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
        let cam_from_world = Rigid3::new(rotation, -(rotation * eye));
        let camera = CameraId::from_index(index % 3);
        let intrinsics = truth.camera(camera).intrinsics;
        let (mut keypoints, mut visible) = (Vec::new(), Vec::new());
        for (point, xyz) in points.iter().enumerate() {
            if (xyz - eye).xy().norm() > REACH_M || draw(0.0, 1.0) > DETECTION {
                continue;
            }
            let noise_px = Vector2::from_fn(|_, _| NOISE_PX * 3.0_f64.sqrt() * draw(-1.0, 1.0));
            let Some(pixel) = intrinsics.project(&(cam_from_world * *xyz)) else { continue };
            let pixel = pixel + noise_px;
            if (0.0..640.0).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y) {
                keypoints.push(Keypoint { pixel, scale_px: SCALE_PX });
                visible.push(point);
            }
        }
        let image = truth.add_image(Image::new(format!("{index}.jpg"), camera, keypoints));
        truth.register(image, cam_from_world);
        seen.push(visible);
    }
    let graph = graph_of(&seen);
    let mut blank = truth.clone();
    (0..count).for_each(|index| blank.deregister(ImageId::from_index(index)));
    (truth, blank, graph)
}

/// The pairs of images that see many points in common.
fn graph_of(seen: &[Vec<usize>]) -> CorrespondenceGraph {
    let counts: Vec<usize> = seen.iter().map(Vec::len).collect();
    let mut pairs = Vec::new();
    for (a, of_a) in seen.iter().enumerate() {
        for (b, of_b) in seen.iter().enumerate().skip(a + 1) {
            let at = |(k, point): (usize, &usize)| {
                let other = of_b.binary_search(point).ok()?;
                Some(Match { a: k as u32, b: other as u32 })
            };
            let matches: Vec<Match> = of_a.iter().enumerate().filter_map(at).collect();
            if matches.len() >= MIN_COMMON {
                let pair = ImagePair { a: ImageId::from_index(a), b: ImageId::from_index(b) };
                let kind = TwoViewKind::Calibrated;
                pairs.push((pair, TwoView { kind, matches, ..TwoView::default() }));
            }
        }
    }
    CorrespondenceGraph::new(&counts, pairs)
}

/// Maps parts of the images, which begin with the intrinsics of the first, and assembles them.
fn in_parts(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    size: usize,
    options: &MapperOptions,
) -> Vec<MappedModel> {
    let links: Vec<(ImagePair, usize)> =
        graph.pairs().iter().map(|(pair, view)| (*pair, view.matches.len())).collect();
    let parts = cut(scene, &links, size);
    let map = |images: &BTreeSet<ImageId>, first: Option<&[u8]>| {
        Mapper::new(graph, scene).submap(images, first, options).expect("sound options")
    };
    let first = map(&parts[0], None);
    let others = parts[1..].par_iter().map(|part| map(part, Some(&first))).collect();
    let states = [vec![first.clone()], others].concat();
    Mapper::new(graph, scene).submaps(&states).run(options).expect("a model")
}

fn show(seed: u64, what: &str, models: &[MappedModel], truth: &Reconstruction, start: Instant) {
    let seconds = start.elapsed().as_secs_f64();
    let model = &models[0].reconstruction;
    let ate_m = ate_m(model, truth);
    let models = models.len();
    println!(
        "{seed:4} {what:>6} of {models} {:7} {ate_m:10.4} {seconds:10.1}",
        model.num_registered()
    );
}
