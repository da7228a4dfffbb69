//! Effect of `--rig` under each disturbance, on synthetic features: `cargo run --release -p
//! tiepoint-sfm --example rig_grid -- ROUTE RATE FIRST LAST [MODE ...]`.
//!
//! ROUTE is `open` (45 images a camera), `loop` or `split`: a loop whose first right images have
//! no matches to the images around them, only to those that see the place at the end. RATE is in
//! images per second, FIRST and LAST are seeds. Modes are `off`, `soft`, `auto` and `oracle`, by
//! default all but `soft`. The oracle is `rigid` with the true times, `soft` for mounts that swing.
//! Prints a line of JSON for each cell, seed and mode. `bench/rig_modes.py` runs it and pools.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::collections::BTreeSet;

use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::rigs::{CalibratedCamera, RigConstraint};
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::effects::ClockEffects;
use tiepoint_synth::{
    Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions, RouteKind,
};

/// Images a camera of an open route.
const OPEN_FRAMES: usize = 45;
/// Right images that are split off, and how far apart in time images of the two ends are at least
/// (those of `bench/split.py`).
const NUM_SPLIT: usize = 8;
const MIN_APART_S: f64 = 20.0;

/// A cell of the grid: its name, the disturbances, and the percentage of right images with the time
/// of another image.
type Cell = (&'static str, Effects, usize);

fn cells() -> Vec<Cell> {
    let preset = |names: &str| names.parse::<Effects>().expect("known effects");
    let clocks = |offset_s: f64, jitter_s: f64| ClockEffects {
        offset_s,
        drift_ppm: 40.0,
        jitter_s,
        phase: 1.0,
        late_start_s: 0.5,
        drop_fraction: 0.02,
        rate_spread: 0.01,
    };
    let with = |effects: Effects, offset_s: f64, jitter_s: f64| Effects {
        clocks: clocks(offset_s, jitter_s),
        ..effects
    };
    let flex =
        |effects: Effects, degrees: f64| Effects { flex_rad: degrees.to_radians(), ..effects };
    let none = Effects::default();
    vec![
        ("triggered together", none, 0),
        ("triggered, vibration", preset("vibration"), 0),
        ("triggered, 10 % wrong", none, 10),
        ("triggered, 20 % wrong", none, 20),
        ("clocks to 0.3 s", with(none, 0.3, 0.0), 0),
        ("clocks to 1 s", with(none, 1.0, 0.0005), 0),
        ("clocks, jitter 5 ms", with(none, 0.3, 0.005), 0),
        ("clocks, vibration", with(preset("vibration"), 0.3, 0.0005), 0),
        ("clocks, 20 % wrong", with(none, 0.3, 0.0005), 20),
        ("clocks, misaligned", with(preset("misalignment"), 0.3, 0.0005), 0),
        ("flex 0.1°", flex(none, 0.1), 0),
        ("flex 0.5°", flex(none, 0.5), 0),
        ("flex 2°", flex(none, 2.0), 0),
        ("clocks, flex 0.5°", flex(with(none, 0.3, 0.0005), 0.5), 0),
    ]
}

struct Scene {
    drive: Drive,
    graph: CorrespondenceGraph,
    truth: Reconstruction,
    blank: Reconstruction,
}

fn scene(seed: u64, (_, effects, wrong_percent): &Cell, route: &str, rate_hz: f64) -> Scene {
    let kind = if route == "open" { RouteKind::Open } else { RouteKind::Loop };
    let options =
        DriveOptions { seed, rate_hz, route: kind, effects: *effects, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    if route == "open" {
        drive.keep_first(OPEN_FRAMES);
    }
    let frames = drive.cameras()[0].exposures.len();
    let features = FeatureOptions { seed, observations: 600 * frames, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let mut graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    let mut blank = scene.without_poses();
    if route == "split" {
        graph = split(&graph, &blank);
    }
    // Some right images swap their times.
    let rights: Vec<ImageId> = images_of(&blank, 1);
    let wrong = rights.len() * wrong_percent / 100 / 2;
    for k in 0..wrong {
        let (a, b) = (
            rights[k * rights.len() / (2 * wrong)],
            rights[(k + wrong) * rights.len() / (2 * wrong)],
        );
        let times = [a, b].map(|id| blank.image(id).time_s);
        blank.set_time(a, times[1]);
        blank.set_time(b, times[0]);
    }
    Scene { drive, graph, truth: scene.truth().clone(), blank }
}

fn images_of(scene: &Reconstruction, camera: u32) -> Vec<ImageId> {
    scene.images().filter(|(_, image)| image.camera.0 == camera).map(|(id, _)| id).collect()
}

/// Takes the matches between both ends of a loop, but for the first right images. These lose the
/// matches to the images around them.
fn split(graph: &CorrespondenceGraph, blank: &Reconstruction) -> CorrespondenceGraph {
    let off: BTreeSet<ImageId> = images_of(blank, 1).into_iter().take(NUM_SPLIT).collect();
    let time_s = |id: ImageId| blank.image(id).time_s.expect("a drive has times");
    let kept = graph.pairs().iter().filter(|(pair, _)| {
        let (a, b) = (pair.a, pair.b);
        let are_apart = (time_s(a) - time_s(b)).abs() >= MIN_APART_S;
        match (off.contains(&a), off.contains(&b)) {
            (false, false) => !are_apart,
            (true, true) => true,
            _ => are_apart,
        }
    });
    let counts: Vec<usize> = blank.images().map(|(_, image)| image.keypoints.len()).collect();
    CorrespondenceGraph::new(&counts, kept.map(|(pair, two_view)| (*pair, two_view.clone())))
}

/// The scene with the true times of all images.
fn with_true_times(scene: &Scene) -> Reconstruction {
    let mut blank = scene.blank.clone();
    let times: Vec<(ImageId, f64)> = blank
        .images()
        .filter_map(|(id, image)| Some((id, scene.drive.find(&image.name)?.1.time_s)))
        .collect();
    for (id, time_s) in times {
        blank.set_time(id, Some(time_s));
    }
    blank
}

/// Maps a scene; the fields of its line.
fn run(scene: &Scene, cell: &Cell, seed: u64, mode: &str) -> Option<String> {
    let (rig, blank) = match mode {
        "oracle" if cell.1.flex_rad > 0.0 => (RigMode::Soft, with_true_times(scene)),
        "oracle" => (RigMode::Rigid, with_true_times(scene)),
        "off" => (RigMode::Off, scene.blank.clone()),
        "soft" => (RigMode::Soft, scene.blank.clone()),
        _ => (RigMode::Auto, scene.blank.clone()),
    };
    let options =
        MapperOptions { refine: RefineIntrinsics::NONE, rig, seed, ..MapperOptions::default() };
    let models = Mapper::new(&scene.graph, &blank).run(&options);
    let MappedModel { reconstruction: model, rig, .. } = models.ok()?.into_iter().next()?;
    let found: Vec<_> = model.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let truth: Option<Vec<_>> =
        scene.truth.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let compared = compare_poses(&found, &truth?, Alignment::Similarity)?;
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    let mut line = format!(
        "\"ate_cm\": {:.4}, \"registered\": {}, \"images\": {}",
        100.0 * Statistics::of(&errors)?.rmse,
        errors.len(),
        found.len()
    );
    if let Some(rig) = rig {
        let chosen = match rig.constraint {
            None => "off",
            Some(RigConstraint::Soft { .. }) => "soft",
            Some(RigConstraint::Rigid) => "rigid",
        };
        line += &format!(
            ", \"chosen\": \"{chosen}\", \"held_out_px\": [{:.5}, {:.5}]",
            rig.error_off_px, rig.error_px
        );
        line += &rig.cameras.first().map_or(String::new(), |camera| {
            calibration(camera, &scene.drive, compared.truth_from_model.scale)
        });
    }
    Some(line)
}

/// Errors of the calibrated camera; of a flexible mount relative to the mean extrinsics.
fn calibration(camera: &CalibratedCamera, drive: &Drive, scale: f64) -> String {
    let (true_mount, clock) = (drive.cam_from_rig(1), drive.cameras()[1].clock);
    let pivot_s = camera.sensor_pair.clock.pivot_s;
    let offset_s = camera.sensor_pair.clock.reference_time_s(pivot_s) - clock.time_s(pivot_s);
    let sd_s = camera.covariance.map_or(0.0, |c| c[(6, 6)].sqrt());
    let turn = camera.cam_from_rig.rotation.angle_to(&true_mount.rotation).to_degrees();
    let place = (camera.cam_from_rig.translation * scale - true_mount.translation).norm();
    format!(
        ", \"clock\": \"{:?}\", \"offset_ms\": {:.3}, \"offset_sd_ms\": {:.3}, \
         \"turn_deg\": {turn:.5}, \"place_mm\": {:.3}",
        camera.sensor_pair.clock_state,
        1e3 * offset_s,
        1e3 * sd_s,
        1e3 * place
    )
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [route, rate, first, last, modes @ ..] = words.as_slice() else {
        panic!("ROUTE RATE FIRST LAST [MODE ...]")
    };
    let rate_hz: f64 = rate.parse().expect("RATE is a number");
    let [first, last]: [u64; 2] = [first, last].map(|word| word.parse().expect("a seed"));
    let default = ["off", "auto", "oracle"].map(String::from);
    let modes = if modes.is_empty() { &default[..] } else { modes };
    for seed in first..=last {
        for cell in cells() {
            let scene = scene(seed, &cell, route, rate_hz);
            for mode in modes {
                let fields = run(&scene, &cell, seed, mode).unwrap_or_default();
                let comma = if fields.is_empty() { "" } else { ", " };
                println!(
                    "{{\"route\": \"{route}\", \"rate_hz\": {rate_hz}, \"cell\": \"{}\", \
                     \"seed\": {seed}, \"mode\": \"{mode}\"{comma}{fields}}}",
                    cell.0
                );
            }
        }
    }
}
