//! Mapping time over the number of images: `cargo run --release -p tiepoint-sfm --example
//! long_drive -- 250 500 1000`.
//!
//! For each number of frames, a drive of two cameras is mapped from keypoints and verified matches
//! with `--rig off` and with `soft`.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::time::Instant;

use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::{Mapper, MapperOptions, RigMode};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, RouteKind};

const RATE_HZ: f64 = 10.0;
const METRES_PER_FRAME: f64 = 0.6;
const MIN_LENGTH_M: f64 = 160.0;
const OBSERVATIONS_AN_IMAGE: usize = 1500;
/// Keypoints without a match, which are the majority.
const CLUTTER: usize = 3000;
const WINDOW: usize = 10;

fn main() {
    println!(
        "{:>8} {:>14} {:>10} {:>10} {:>12}",
        "images", "observations", "off, s", "soft, s", "ms an image"
    );
    for frames in
        std::env::args().skip(1).map(|word| word.parse::<usize>().expect("numbers of frames"))
    {
        let length_m = (METRES_PER_FRAME * frames as f64).max(MIN_LENGTH_M);
        let route = RouteKind::Open;
        let options = DriveOptions { length_m, rate_hz: RATE_HZ, route, ..DriveOptions::default() };
        let mut drive = Drive::new(&options).expect("a street");
        drive.keep_first(frames);
        let observations = 2 * OBSERVATIONS_AN_IMAGE * frames;
        let features =
            FeatureOptions { observations, clutter: CLUTTER, ..FeatureOptions::default() };
        let scene = FeatureScene::new(&drive, &features).expect("sound options");
        let graph = scene.graph(&MatchOptions { window: Some(WINDOW), ..MatchOptions::default() });
        let blank = scene.without_poses();
        let mut observations = 0;
        let seconds = [RigMode::Off, RigMode::Soft].map(|rig| {
            let options =
                MapperOptions { refine: RefineIntrinsics::NONE, rig, ..MapperOptions::default() };
            let start = Instant::now();
            let models = Mapper::new(&graph, &blank).run(&options);
            let seconds = start.elapsed().as_secs_f64();
            observations = models.map_or(0, |models| models[0].reconstruction.num_observations());
            seconds
        });
        let (images, [off, soft]) = (graph.num_images(), seconds);
        println!(
            "{images:8} {observations:14} {off:10.1} {soft:10.1} {:12.1}",
            1e3 * off / images as f64
        );
    }
}
