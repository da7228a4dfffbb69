//! A camera whose rows are exposed one after the other, on the street of the synthetic world seen as features.

mod common;

use std::ops::ControlFlow;

use tiepoint_sfm::{Event, MapperOptions, Readout, RefineIntrinsics, RollingShutter, map};
use tiepoint_synth::{
    Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions, Mount, Mounting,
};

use common::ate_m;

/// Time from the first row to the last one: an action camera's.
const READOUT_S: f64 = 0.02;
const FRAMES: usize = 30;
/// Distance of the cameras, in metres.
const BASELINE_M: f64 = 0.5;

/// The drive of two cameras, mapped without a rig term: root mean square error of their centres in metres, and the shutters found.
fn run(mounting: Mounting, readout: Option<Readout>) -> (f64, Vec<RollingShutter>) {
    let effects = Effects { readout_s: READOUT_S, ..Effects::default() };
    let mounts = Mount::stereo(mounting, BASELINE_M).to_vec();
    let options = DriveOptions { seed: 2, rate_hz: 5.0, effects, mounts, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(FRAMES);
    let features = FeatureOptions { seed: 2, observations: 20_000, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let matching = MatchOptions { window: Some(4), ..MatchOptions::default() };
    let graph = scene.graph(&matching);
    let mapper = MapperOptions { refine: RefineIntrinsics::NONE, readout, ..MapperOptions::default() };
    let mut shutters = Vec::new();
    let models = map(&graph, &scene.without_poses(), &mut |_| Vec::new(), &mapper, &mut |event| {
        if let Event::Shutter(shutter) = event {
            shutters.push(*shutter);
        }
        ControlFlow::Continue(())
    });
    let model = models.expect("the scene is easy").remove(0);
    assert_eq!(model.num_registered(), 2 * FRAMES);
    (ate_m(&model, scene.truth()), shutters)
}

/// A readout is known to this, in seconds: a twentieth of it; and off by no more than so many standard deviations.
const MAX_READOUT_SD_S: f64 = 0.001;
const MAX_DEVIATIONS: f64 = 3.0;
/// Knowing the shutter takes away most of what not knowing it costs.
const MAX_SHARE: f64 = 0.5;

#[test]
fn a_rolling_shutter_is_found_and_taken_off_the_keypoints() {
    for mounting in [Mounting::Front, Mounting::Right] {
        let (error_off_m, none) = run(mounting, None);
        assert_eq!(none, []);
        let (error_known_m, _) = run(mounting, Some(Readout::Known(READOUT_S)));
        let (error_m, shutters) = run(mounting, Some(Readout::Estimated));
        eprintln!(
            "{mounting:?}: {error_off_m:.4} m off, {error_known_m:.4} known, {error_m:.4} found: {shutters:?}"
        );
        assert!(error_known_m < MAX_SHARE * error_off_m, "{error_known_m} m, {error_off_m} without");
        assert!(error_m < MAX_SHARE * error_off_m, "{error_m} m, {error_off_m} without");
        assert_eq!(shutters.len(), 2);
        for shutter in shutters {
            let sd_s = shutter.readout_sd_s.expect("it was estimated");
            assert!(sd_s < MAX_READOUT_SD_S, "{shutter:?}");
            assert!((shutter.readout_s - READOUT_S).abs() < MAX_DEVIATIONS * sd_s, "{shutter:?}");
        }
    }
}
