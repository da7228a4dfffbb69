//! A camera that looks ahead and one that looks back without common points, in the synthetic street
//! as features.

use std::ops::ControlFlow;

use tiepoint_geometry::{Rigid3, so3};
use tiepoint_scene::CorrespondenceGraph;
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::rigs::{CalibratedCamera, ClockState};
use tiepoint_sfm::{Event, MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::effects::ClockEffects;
use tiepoint_synth::{
    Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions, Mount, ViewDirection,
};

/// Baseline, in metres.
const BASELINE_M: f64 = 0.5;
const FRAMES: usize = 60;
/// Initial offset and a different rate.
const CLOCKS: ClockEffects = ClockEffects {
    offset_s: 0.3,
    drift_ppm: 0.0,
    jitter_s: 0.0,
    phase: 1.0,
    late_start_s: 0.0,
    drop_fraction: 0.0,
    rate_spread: 0.01,
};

struct Run {
    drive: Drive,
    models: usize,
    camera: Option<CalibratedCamera>,
    was_joined: bool,
    /// Metres per unit of the model, from the first camera's trajectory.
    metres: f64,
}

/// Half a block with a turn and a stop.
fn run(rig: RigMode) -> Run {
    let [ahead, _] = Mount::stereo(ViewDirection::Front, BASELINE_M);
    let [_, back] = Mount::stereo(ViewDirection::Rear, BASELINE_M);
    let effects = Effects { clocks: CLOCKS, ..Effects::default() };
    let mounts = vec![ahead, back];
    let mut drive = Drive::new(&DriveOptions {
        seed: 3,
        rate_hz: 4.0,
        effects,
        mounts,
        ..DriveOptions::default()
    })
    .expect("a street of 200 m");
    drive.keep_first(FRAMES);
    let features = FeatureOptions { seed: 3, observations: 40_000, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let camera = |image| scene.truth().image(image).camera;
    let two_views: Vec<_> = scene
        .matches(&MatchOptions { window: Some(5), ..MatchOptions::default() })
        .into_iter()
        .filter(|found| camera(found.pair.a) == camera(found.pair.b))
        .map(|found| (found.pair, found.two_view))
        .collect();
    let counts: Vec<usize> =
        scene.truth().images().map(|(_, image)| image.keypoints.len()).collect();
    let graph = CorrespondenceGraph::new(&counts, two_views);
    let mapper = MapperOptions { refine: RefineIntrinsics::NONE, rig, ..MapperOptions::default() };
    let mut was_joined = false;
    let mut watch = |event: &Event| {
        was_joined |= matches!(event, Event::Merged { .. });
        ControlFlow::Continue(())
    };
    let blank = scene.without_poses();
    let models = Mapper::new(&graph, &blank).watch(&mut watch).run(&mapper);
    let models = models.expect("the scene is easy");
    let MappedModel { reconstruction, rig, .. } = &models[0];
    let camera = rig.as_ref().and_then(|rig| rig.cameras.first().cloned());
    let path = |scene: &tiepoint_scene::Reconstruction| {
        let of_first = reconstruction.registered().filter(|(_, image, _)| image.camera.0 == 0);
        let centres: Vec<_> = of_first
            .filter_map(|(id, ..)| Some(scene.image(id).cam_from_world()?.origin_in_a()))
            .collect();
        centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>()
    };
    let metres = path(scene.truth()) / path(reconstruction);
    Run { drive, models: models.len(), camera, was_joined, metres }
}

/// The models are connected only by their motion. The tolerance is six times that of cameras with
/// common points.
const MAX_ROTATION_RAD: f64 = 0.3 / 57.3;
const MAX_OFFSET_S: f64 = 0.005;
/// Tolerance of the camera centre along the road and across it, in metres. On a flat road the
/// vertical coordinate is unobservable and stays at its true value, zero.
const MAX_POSITION_ERROR_M: f64 = 0.1;
const MAX_HEIGHT_M: f64 = 0.01;

#[test]
fn cameras_without_common_points_are_merged_into_one_model() {
    let run = run(RigMode::Auto);
    assert!(run.was_joined);
    assert_eq!(run.models, 1);
    let camera = run.camera.expect("it is calibrated");
    assert_eq!(camera.sensor_pair.clock_state, ClockState::Estimated);
    let (truth, clock) = (run.drive.cam_from_rig(1), run.drive.cameras()[1].clock);
    let Rigid3 { rotation, translation } = camera.cam_from_rig;
    let turn_rad = so3::log(&(rotation * truth.rotation.inverse())).norm();
    // In the first camera's frame: right, down, ahead.
    let found = -(rotation.inverse() * translation) * run.metres;
    let expected = truth.origin_in_a();
    let error = found - expected;
    let pivot_s = camera.sensor_pair.clock.pivot_s;
    let offset_s = camera.sensor_pair.clock.reference_time_s(pivot_s) - clock.time_s(pivot_s);
    eprintln!(
        "rotation {turn_rad:.5} rad, position {error:.3?} m, clock {offset_s:.5} s, {camera:?}"
    );
    assert!(turn_rad < MAX_ROTATION_RAD, "{turn_rad} rad");
    assert!(error.x.hypot(error.z) < MAX_POSITION_ERROR_M, "{error:?}");
    let blind = camera.sensor_pair.unobservable_direction.expect("the road is flat");
    assert!(blind.y.abs() > 0.9, "{blind:?}");
    assert!((found - blind * found.dot(&blind)).norm() > found.norm() - MAX_HEIGHT_M, "{found:?}");
    assert!(offset_s.abs() < MAX_OFFSET_S, "{offset_s} s");
}

#[test]
fn without_a_rig_term_the_models_stay_separate() {
    let run = run(RigMode::Off);
    assert!(!run.was_joined);
    assert_eq!(run.models, 2);
}
