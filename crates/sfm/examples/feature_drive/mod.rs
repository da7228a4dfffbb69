//! Drives of two cameras on synthetic features, and the error of their models.

use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::Reconstruction;
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, RouteKind};

const OBSERVATIONS_AN_IMAGE: usize = 400;
const NOISE_PX: f64 = 0.5;

/// A drive of some moments, or a loop of their length.
pub(crate) fn feature_drive(
    route: RouteKind,
    frames: usize,
    metres_per_frame: f64,
    rate_hz: f64,
    seed: u64,
) -> FeatureScene {
    let length_m = metres_per_frame * frames as f64;
    let options = DriveOptions { seed, length_m, rate_hz, route, ..DriveOptions::default() };
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

/// Root mean square error of the centres after a similarity, in metres.
pub(crate) fn ate_m(model: &Reconstruction, truth: &Reconstruction) -> f64 {
    let poses = |model: &Reconstruction| -> Vec<_> {
        model.images().map(|(_, image)| image.cam_from_world().copied()).collect()
    };
    let truth: Vec<_> = poses(truth).into_iter().flatten().collect();
    let compared = compare_poses(&poses(model), &truth, Alignment::Similarity).expect("a path");
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    Statistics::of(&errors).expect("poses").rmse
}
