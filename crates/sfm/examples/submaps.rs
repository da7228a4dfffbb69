//! Sub-maps beside one map: `cargo run --release -p tiepoint-sfm --example submaps -- open 500 200
//! 1,2,3` maps drives of 500 moments of two cameras with these seeds, as one map and in parts of
//! 200 images, and prints the root mean square error of the centres after a similarity, and times.
//! `loop` drives return to their start.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::collections::BTreeSet;
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};
use tiepoint_sfm::submaps::cut;
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, RouteKind};

const RATE_HZ: f64 = 5.0;
const METRES_PER_FRAME: f64 = 1.2;
const OBSERVATIONS_AN_IMAGE: usize = 400;
const NOISE_PX: f64 = 0.5;
const WINDOW: usize = 6;
/// The focal lengths begin so much too long, and are refined.
const WRONG_FOCAL: f64 = 1.1;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [route, frames, size, seeds] = &words[..] else { panic!("route, frames, size, seeds") };
    let route = if route == "loop" { RouteKind::Loop } else { RouteKind::Open };
    let [frames, size] = [frames, size].map(|word| word.parse::<usize>().expect("a number"));
    println!("seed       map  images     ATE, m    time, s");
    for seed in seeds.split(',').map(|word| word.parse().expect("seeds")) {
        let scene = drive(route, frames, seed);
        let graph = scene.graph(&MatchOptions { window: Some(WINDOW), ..MatchOptions::default() });
        let mut blank = scene.without_poses();
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
        show(seed, "one", &one, scene.truth(), start);
        let start = Instant::now();
        let parts = in_parts(&graph, &blank, size, &options);
        show(seed, "parts", &parts, scene.truth(), start);
    }
}

fn drive(route: RouteKind, frames: usize, seed: u64) -> FeatureScene {
    let length_m = METRES_PER_FRAME * frames as f64;
    let options =
        DriveOptions { seed, length_m, rate_hz: RATE_HZ, route, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street");
    if matches!(route, RouteKind::Open) {
        drive.keep_first(frames);
    }
    let images: usize = drive.cameras().iter().map(|camera| camera.exposures.len()).sum();
    let features = FeatureOptions {
        seed,
        observations: OBSERVATIONS_AN_IMAGE * images,
        noise_px: NOISE_PX,
        ..FeatureOptions::default()
    };
    FeatureScene::new(&drive, &features).expect("sound options")
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
    let poses = |model: &Reconstruction| -> Vec<_> {
        model.images().map(|(_, image)| image.cam_from_world().copied()).collect()
    };
    let model = &models[0].reconstruction;
    let truth: Vec<_> = poses(truth).into_iter().flatten().collect();
    let compared = compare_poses(&poses(model), &truth, Alignment::Similarity).expect("a path");
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    let ate_m = Statistics::of(&errors).expect("poses").rmse;
    let models = models.len();
    println!(
        "{seed:4} {what:>6} of {models} {:7} {ate_m:10.4} {seconds:10.1}",
        model.num_registered()
    );
}
