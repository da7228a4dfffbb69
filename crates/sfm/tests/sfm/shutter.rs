//! A rolling-shutter camera in the synthetic street as features.

use std::sync::LazyLock;

use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, RowPoses};
use tiepoint_sfm::rolling_shutter::{Readout, RollingShutter, row_poses};
use tiepoint_sfm::scene::{Camera, Image, Reconstruction};
use tiepoint_sfm::{Failure, Mapper, MapperOptions, OptionalStage};
use tiepoint_synth::{
    Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions, Mount, ViewDirection,
};

use crate::common::ate_m;

/// Readout time in seconds, as of an action camera.
const READOUT_S: f64 = 0.02;
const FRAMES: usize = 30;
/// Baseline, in metres.
const BASELINE_M: f64 = 0.5;

/// Result of a drive.
struct Outcome {
    /// Root mean square error of the centres.
    error_m: f64,
    shutters: Vec<RollingShutter>,
    row_poses: Vec<RowPoses>,
    failures: usize,
}

/// Maps the drive of two cameras without a rig term.
fn run(direction: ViewDirection, readout: Option<Readout>) -> Outcome {
    let effects = Effects { readout_s: READOUT_S, ..Effects::default() };
    let mounts = Mount::stereo(direction, BASELINE_M).to_vec();
    let options =
        DriveOptions { seed: 2, rate_hz: 5.0, effects, mounts, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(FRAMES);
    let features = FeatureOptions { seed: 2, observations: 20_000, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let matching = MatchOptions { window: Some(4), ..MatchOptions::default() };
    let graph = scene.graph(&matching);
    let mapper =
        MapperOptions { refine: RefineIntrinsics::NONE, readout, ..MapperOptions::default() };
    let models = Mapper::new(&graph, &scene.without_poses()).run(&mapper);
    let model = models.expect("the scene is easy").remove(0);
    assert_eq!(model.reconstruction.num_registered(), 2 * FRAMES);
    let is_of_shutter = |failure: &&Failure| failure.stage == OptionalStage::RollingShutter;
    let failures = model.failures.iter().filter(is_of_shutter).count();
    let row_poses = model.row_poses.into_values().collect();
    let error_m = ate_m(&model.reconstruction, scene.truth());
    Outcome { error_m, shutters: model.shutters, row_poses, failures }
}

/// Mapped as with a global shutter; the reference of both tests.
fn without(direction: ViewDirection) -> &'static Outcome {
    static FRONT: LazyLock<Outcome> = LazyLock::new(|| run(ViewDirection::Front, None));
    static RIGHT: LazyLock<Outcome> = LazyLock::new(|| run(ViewDirection::Right, None));
    if direction == ViewDirection::Front { &FRONT } else { &RIGHT }
}

/// In seconds. In that time the vehicle leaves the street, and no keypoint stays visible.
const ABSURD_READOUT_S: f64 = 10.0;

#[test]
fn an_absurd_readout_leaves_the_model_unchanged() {
    let without = without(ViewDirection::Front);
    assert_eq!(without.failures, 0);
    let absurd = run(ViewDirection::Front, Some(Readout::Known(ABSURD_READOUT_S)));
    assert_eq!(absurd.failures, 1);
    assert_eq!(absurd.error_m, without.error_m);
}

/// Maximum standard deviation of a readout time in seconds, a twentieth of it, and maximum error in
/// standard deviations.
const MAX_READOUT_SD_S: f64 = 0.001;
const MAX_DEVIATIONS: f64 = 3.0;
/// The correction removes most of the error that the rolling shutter causes.
const MAX_RELATIVE_ERROR: f64 = 0.5;

#[test]
fn a_rolling_shutter_is_estimated_and_corrected() {
    for direction in [ViewDirection::Front, ViewDirection::Right] {
        let uncorrected = without(direction);
        assert_eq!(uncorrected.shutters, []);
        assert_eq!(uncorrected.row_poses, []);
        let known = run(direction, Some(Readout::Known(READOUT_S)));
        let found = run(direction, Some(Readout::Estimated));
        eprintln!(
            "{direction:?}: {:.4} m uncorrected, {:.4} known, {:.4} found: {:?}",
            uncorrected.error_m, known.error_m, found.error_m, found.shutters
        );
        for outcome in [&known, &found] {
            assert!(
                outcome.error_m < MAX_RELATIVE_ERROR * uncorrected.error_m,
                "{} m, {} without",
                outcome.error_m,
                uncorrected.error_m
            );
        }
        assert_eq!(found.shutters.len(), 2);
        // The ends of each camera's trajectory lack neighbours.
        assert!(found.row_poses.len() >= 2 * (FRAMES - 4), "{}", found.row_poses.len());
        for shutter in found.shutters {
            let sd_s = shutter.readout_sd_s.expect("it was estimated");
            assert!(sd_s < MAX_READOUT_SD_S, "{shutter:?}");
            assert!((shutter.readout_s - READOUT_S).abs() < MAX_DEVIATIONS * sd_s, "{shutter:?}");
        }
    }
}

/// Errors of the row poses from true poses and readout, relative to the middle row.
const MAX_ROW_ERROR_M: f64 = 0.002;
const MAX_ROW_ERROR_DEG: f64 = 0.02;

#[test]
fn rows_of_true_poses_are_at_their_true_poses() {
    let effects = Effects { readout_s: READOUT_S, ..Effects::default() };
    let drive = Drive::new(&DriveOptions { effects, ..DriveOptions::default() });
    let drive = drive.expect("a street of 200 m");
    let mut model = Reconstruction::default();
    let mut true_times = Vec::new();
    for (index, camera) in drive.cameras().iter().enumerate() {
        let (width, height) = (camera.width, camera.height);
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 400.0, width, height);
        let id = model.add_camera(Camera { intrinsics, width, height, has_focal_prior: true });
        for exposure in &camera.exposures {
            let image = model.add_image(Image::new(exposure.name.clone(), id, Vec::new()));
            model.set_time(image, Some(exposure.stamp_s));
            model.register(image, drive.cam_from_world(index, exposure.time_s));
            true_times.push((index, exposure.time_s));
        }
    }
    let shutter = |(camera, _)| RollingShutter { camera, readout_s: READOUT_S, readout_sd_s: None };
    let shutters: Vec<RollingShutter> = model.cameras().map(shutter).collect();
    let rows = row_poses(&model, &shutters);
    assert!(rows.len() + 4 * drive.cameras().len() >= model.num_images(), "{}", rows.len());
    let (mut worst_m, mut worst_deg, mut moved_m) = (0.0f64, 0.0f64, 0.0f64);
    let last_s = true_times.iter().fold(0.0f64, |last, (_, time_s)| last.max(*time_s));
    for (id, rows) in rows {
        // The true path does not go on before the first image and after the last one.
        if true_times[id.index()].1 < READOUT_S || true_times[id.index()].1 > last_s - READOUT_S {
            continue;
        }
        let middle = model.image(id).cam_from_world().expect("all have poses");
        let (camera, time_s) = true_times[id.index()];
        for y_px in [0.5, rows.height_px - 0.5] {
            let found = rows.cam_from_world(middle, y_px);
            let truth = drive.row_pose(camera, time_s, y_px).world_from_cam;
            let error = found * truth;
            worst_m = worst_m.max(error.translation.norm());
            worst_deg = worst_deg.max(error.rotation.angle().to_degrees());
            moved_m = moved_m.max((truth.translation - middle.origin_in_a()).norm());
        }
    }
    eprintln!("rows: {worst_m:.5} m and {worst_deg:.5} degrees, of {moved_m:.3} m");
    assert!(worst_m < MAX_ROW_ERROR_M && worst_deg < MAX_ROW_ERROR_DEG, "{worst_m} {worst_deg}");
    assert!(moved_m > 10.0 * MAX_ROW_ERROR_M, "the camera moves during the readout");
}
