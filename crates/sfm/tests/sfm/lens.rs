//! The lens of an action camera on a street, as features: viewing direction and aspect ratio.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector2};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{Camera, CameraId, IntrinsicsPrior};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::{Mapper, MapperOptions};
use tiepoint_synth::{
    Drive, DriveCamera, DriveOptions, Effects, FeatureOptions, FeatureScene, LensField,
    MatchOptions,
};

use crate::common::sample;

const FRAMES: usize = 40;
/// Grid points along each side of the image for comparing lenses.
const GRID: u32 = 20;

/// The rotation between a lens and the true one.
fn turn(camera: &Camera, truth: &DriveCamera) -> UnitQuaternion<f64> {
    let (mut found, mut true_rays) = (Vec::new(), Vec::new());
    for (column, row) in (0..GRID).flat_map(|column| (0..GRID).map(move |row| (column, row))) {
        let coordinate = |k: u32| (f64::from(k) + 0.5) / f64::from(GRID);
        let pixel = Vector2::new(
            coordinate(column) * f64::from(camera.width),
            coordinate(row) * f64::from(camera.height),
        );
        let rays = (camera.intrinsics.unproject(&pixel), truth.lens.unproject(&pixel));
        if let (Some(ray), Some(true_ray)) = rays {
            // Both ends, so that the alignment is a pure rotation.
            found.extend([ray, -ray]);
            true_rays.extend([true_ray, -true_ray]);
        }
    }
    umeyama(&found, &true_rays, false).expect("rays all over the image").rotation
}

/// Seeds. Without constant prism parameters the extrinsics rotated by 0.197° and 0.114°, with them
/// by 0.015° and 0.009°.
const SEEDS: [u64; 2] = [1, 3];
const MAX_TURN_DEG: f64 = 0.05;
/// Without the prior on it, the ratio of focal lengths had errors of 0.0015 and 0.0024.
const MAX_RATIO_ERROR: f64 = 1e-5;

#[test]
fn a_street_rotates_no_camera_and_keeps_pixels_square() {
    for &seed in sample(&SEEDS) {
        let effects = Effects { has_action_lens: true, ..Effects::default() };
        let options = DriveOptions { seed, rate_hz: 5.0, effects, ..DriveOptions::default() };
        let mut drive = Drive::new(&options).expect("a street of 200 m");
        drive.keep_first(FRAMES);
        let features = FeatureOptions { seed, observations: 40_000, ..FeatureOptions::default() };
        let scene = FeatureScene::new(&drive, &features).expect("sound options");
        let graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
        let mut blank = scene.without_poses();
        let ids: Vec<CameraId> = blank.cameras().map(|(id, _)| id).collect();
        for id in &ids {
            let camera = blank.camera_mut(*id);
            let (kind, focal_px) =
                (CameraModelKind::ThinPrismFisheye, camera.intrinsics.mean_focal_px());
            camera.intrinsics = Intrinsics::centred(kind, focal_px, camera.width, camera.height);
            camera.has_focal_prior = true;
        }
        let mapper = MapperOptions { seed, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper);
        let model = models.expect("the scene is easy").remove(0).reconstruction;
        assert_eq!(model.num_registered(), 2 * FRAMES);
        let turns: Vec<_> = ids
            .iter()
            .zip(drive.cameras())
            .map(|(id, truth)| turn(model.camera(*id), truth))
            .collect();
        let apart_deg = turns[0].angle_to(&turns[1]).to_degrees();
        assert!(apart_deg < MAX_TURN_DEG, "seed {seed}: {apart_deg}°");
        for (_, camera) in model.cameras() {
            let params = camera.intrinsics.params();
            let error = (params[1] / params[0] - 1.0).abs();
            assert!(error < MAX_RATIO_ERROR, "seed {seed}: {error}");
        }
    }
}

/// Relative error of a calibrated focal length, four times the deviation of the calibration. The
/// images correct 0.75 of it.
const CALIBRATION_ERROR: f64 = 0.01;
const MAX_LEFT: f64 = 0.5 * CALIBRATION_ERROR;
/// What KITTI's rectified images have.
const LENS_FIELD_PX: f64 = 0.15;

#[test]
fn a_drive_corrects_a_calibration_and_keeps_an_exact_one() {
    let options = DriveOptions { seed: 1, rate_hz: 5.0, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(FRAMES);
    let features = FeatureOptions { seed: 1, observations: 40_000, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    for (field_px, error, refine) in [
        (0.0, CALIBRATION_ERROR, RefineIntrinsics::ALL),
        (0.0, 0.0, RefineIntrinsics::ALL),
        (LENS_FIELD_PX, 0.0, RefineIntrinsics::ALL),
        (0.0, CALIBRATION_ERROR, RefineIntrinsics::NONE),
    ] {
        let mut blank = scene.without_poses();
        LensField::displace_keypoints(&mut blank, field_px, 1);
        let ids: Vec<CameraId> = blank.cameras().map(|(id, _)| id).collect();
        let mut true_focal_px = 0.0;
        for &id in &ids {
            let camera = blank.camera_mut(id);
            true_focal_px = camera.intrinsics.mean_focal_px();
            let focal_px = (1.0 + error) * true_focal_px;
            let (width, height) = (camera.width, camera.height);
            camera.intrinsics =
                Intrinsics::centred(CameraModelKind::Opencv, focal_px, width, height);
            camera.has_focal_prior = true;
            let prior = IntrinsicsPrior::new(camera.intrinsics, width, height, 1.0);
            blank.intrinsics_priors.insert(id, prior);
        }
        let mapper = MapperOptions { refine, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper);
        let mapped = models.expect("the scene is easy").remove(0);
        let model = &mapped.reconstruction;
        assert_eq!(model.num_registered(), 2 * FRAMES);
        let evidence = mapped.calibration_evidence;
        assert_eq!(evidence.is_some(), refine == RefineIntrinsics::ALL);
        for id in ids {
            let found = model.camera(id).intrinsics;
            let left = found.mean_focal_px() / true_focal_px - 1.0;
            let told = format!("field {field_px} px, error {error}: {evidence:?}, left {left}");
            let is_refined = refine == RefineIntrinsics::ALL && error > 0.0;
            assert_eq!(found != blank.camera(id).intrinsics, is_refined, "{told}");
            assert!(left.abs() < if is_refined { MAX_LEFT } else { 1.1 * CALIBRATION_ERROR });
        }
    }
}
