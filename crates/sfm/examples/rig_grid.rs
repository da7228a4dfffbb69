//! Effect of `--rig` under each disturbance, on synthetic features: `cargo run --release -p
//! tiepoint-sfm --example rig_grid -- SEEDS FRAMES [FIRST]`.
//!
//! Prints for each cell and mode the trajectory error (ATE in centimetres, mean over the seeds),
//! and for `auto` the errors of clock and calibration (for a flexible mount relative to the mean
//! calibration). A cell is marked bad if the error of `auto` exceeds 1.05 times that of `off` plus
//! two standard deviations of `off`.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::rigs::CalibratedCamera;
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::effects::ClockEffects;
use tiepoint_synth::{Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions};

const RATE_HZ: f64 = 5.0;

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

fn scene(seed: u64, (_, effects, wrong_percent): &Cell, frames: usize) -> Scene {
    let options =
        DriveOptions { seed, rate_hz: RATE_HZ, effects: *effects, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(frames);
    let features = FeatureOptions { seed, observations: 600 * frames, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    let mut blank = scene.without_poses();
    // Some right images swap their times.
    let rights: Vec<ImageId> =
        blank.images().filter(|(_, image)| image.camera.0 == 1).map(|(id, _)| id).collect();
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

/// Result of a drive.
struct Outcome {
    ate_m: f64,
    scale: f64,
    right: Option<CalibratedCamera>,
    /// Error of the held-out tracks in pixels, without and with the rig constraint.
    held_out_px: [f64; 2],
}

fn run(scene: &Scene, seed: u64, rig: RigMode) -> Option<Outcome> {
    let options =
        MapperOptions { refine: RefineIntrinsics::NONE, rig, seed, ..MapperOptions::default() };
    let models = Mapper::new(&scene.graph, &scene.blank).run(&options);
    let MappedModel { reconstruction: model, rig, .. } = models.ok()?.into_iter().next()?;
    let held_out_px = rig.as_ref().map_or([f64::NAN; 2], |rig| [rig.error_off_px, rig.error_px]);
    let right = rig.and_then(|rig| rig.cameras.into_iter().next());
    let found: Vec<_> = model.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let truth: Option<Vec<_>> =
        scene.truth.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let compared = compare_poses(&found, &truth?, Alignment::Similarity)?;
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    Some(Outcome {
        ate_m: Statistics::of(&errors)?.rmse,
        scale: compared.truth_from_model.scale,
        right,
        held_out_px,
    })
}

fn main() {
    let mut arguments = std::env::args()
        .skip(1)
        .map(|word| word.parse::<u64>().expect("SEEDS, FRAMES and FIRST are numbers"));
    let (seeds, frames) = (arguments.next().unwrap_or(3), arguments.next().unwrap_or(45) as usize);
    let first = arguments.next().unwrap_or(1);
    println!(
        "{:24} {:>8} {:>8} {:>8}   of auto, per seed: error of held-out tracks, clock (ms ± sd), \
        turn (°), place (mm)",
        "", "off", "soft", "auto"
    );
    for cell in cells() {
        let mut ates: [Vec<f64>; 3] = Default::default();
        let mut notes = String::new();
        for seed in first..first + seeds {
            let scene = scene(seed, &cell, frames);
            for (ates, rig) in ates.iter_mut().zip([RigMode::Off, RigMode::Soft, RigMode::Auto]) {
                let Some(Outcome { ate_m, scale, right, held_out_px: [off_px, held_px] }) =
                    run(&scene, seed, rig)
                else {
                    continue;
                };
                ates.push(100.0 * ate_m);
                if rig != RigMode::Auto {
                    continue;
                }
                notes += &format!("  {:+.1} %", 100.0 * (held_px / off_px - 1.0));
                let Some(camera) = right else {
                    notes += " off";
                    continue;
                };
                let (true_mount, clock) =
                    (scene.drive.cam_from_rig(1), scene.drive.cameras()[1].clock);
                let pivot_s = camera.sensor_pair.clock.pivot_s;
                let offset_s =
                    camera.sensor_pair.clock.reference_time_s(pivot_s) - clock.time_s(pivot_s);
                let sd_s = camera.covariance.map_or(f64::NAN, |c| c[(6, 6)].sqrt());
                let turn = camera.cam_from_rig.rotation.angle_to(&true_mount.rotation).to_degrees();
                let place =
                    (camera.cam_from_rig.translation * scale - true_mount.translation).norm();
                let (offset_ms, sd_ms, place_mm) = (1e3 * offset_s, 1e3 * sd_s, 1e3 * place);
                notes += &format!(
                    " {:?} {offset_ms:+.2} ± {sd_ms:.2}, {turn:.4}, {place_mm:.1};",
                    camera.sensor_pair.clock_state
                );
            }
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let [off, soft, auto] = [0, 1, 2].map(|k| mean(&ates[k]));
        let sd = mean(&ates[0].iter().map(|ate| (ate - off).powi(2)).collect::<Vec<_>>()).sqrt();
        let verdict = if auto <= 1.05 * off + 2.0 * sd { "" } else { "  BAD" };
        println!("{:24} {off:8.3} {soft:8.3} {auto:8.3} {notes}{verdict}", cell.0);
    }
}
