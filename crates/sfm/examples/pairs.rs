//! Accuracy by the choice of pairs: `cargo run --release -p tiepoint-sfm --example pairs --
//! open 250 1,2,3 sequential:20 sequential:24+thin` maps drives of 250 moments of two cameras with
//! these seeds from the pairs of each selection, and prints their number, the root mean square
//! error of the centres after a similarity, and the time. `loop` drives return to their start.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

mod feature_drive;

use std::collections::BTreeMap;
use std::time::Instant;

use tiepoint_scene::CorrespondenceGraph;
use tiepoint_sfm::matching::{PairSelection, Sequence};
use tiepoint_sfm::{Mapper, MapperOptions};
use tiepoint_synth::{FeatureScene, MatchOptions, RouteKind};

use crate::feature_drive::{ate_m, feature_drive};

/// The paper's drive.
const RATE_HZ: f64 = 10.0;
const METRES_PER_FRAME: f64 = 0.9;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [route, frames, seeds, selections @ ..] = &words[..] else {
        panic!("route, frames, seeds, selections")
    };
    let route = if route == "loop" { RouteKind::Loop } else { RouteKind::Open };
    let frames = frames.parse().expect("a number");
    println!("seed           selection   pairs  images     ATE, m    time, s");
    for seed in seeds.split(',').map(|word| word.parse().expect("seeds")) {
        let scene = feature_drive(route, frames, METRES_PER_FRAME, RATE_HZ, seed);
        for selection in selections {
            map(&scene, selection, seed);
        }
    }
}

fn map(scene: &FeatureScene, selection: &str, seed: u64) {
    let mut images: BTreeMap<&str, (Vec<u32>, Vec<f64>)> = BTreeMap::new();
    for (id, image) in scene.truth().images() {
        let (ids, times_s) = images.entry(&image.stream).or_default();
        ids.push(id.0);
        times_s.push(image.time_s.expect("a drive has times"));
    }
    let cameras: Vec<Sequence> = images
        .into_values()
        .map(|(ids, times_s)| Sequence::with_times(ids, times_s).expect("in order"))
        .collect();
    let chosen = selection.parse::<PairSelection>().expect("a selection").pairs(&cameras);
    let mut found = scene.matches(&MatchOptions::default());
    found.retain(|found| chosen.binary_search(&(found.pair.a.0, found.pair.b.0)).is_ok());
    let counts: Vec<usize> =
        scene.truth().images().map(|(_, image)| image.keypoints.len()).collect();
    let found = found.into_iter().map(|found| (found.pair, found.two_view));
    let graph = CorrespondenceGraph::new(&counts, found);
    let options = MapperOptions { seed, ..MapperOptions::default() };
    let start = Instant::now();
    let models = Mapper::new(&graph, &scene.without_poses()).run(&options).expect("a model");
    let seconds = start.elapsed().as_secs_f64();
    let model = &models[0].reconstruction;
    let ate_m = ate_m(model, scene.truth());
    let (pairs, images) = (graph.pairs().len(), model.num_registered());
    println!("{seed:4} {selection:>19} {pairs:7} {images:7} {ate_m:10.4} {seconds:10.1}");
}
