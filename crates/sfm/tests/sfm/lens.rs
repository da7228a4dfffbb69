//! The lens of an action camera on a street, as features: viewing direction and aspect ratio.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector2};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{CameraModelKind, Intrinsics, so3};
use tiepoint_scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, IntrinsicsPrior, Observation,
    Reconstruction,
};
use tiepoint_sfm::adjust::{AdjustOptions, RefineIntrinsics, calibration_evidence};
use tiepoint_sfm::{Mapper, MapperOptions, RigMode};
use tiepoint_synth::{
    Drive, DriveCamera, DriveOptions, Effects, FeatureOptions, FeatureScene, LensField,
    MatchOptions, RouteKind,
};

use crate::common::sample;

const FRAMES: usize = 40;
const OBSERVATIONS: usize = 40_000;
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
        let (drive, scene, graph) = street_of(&options, FRAMES, OBSERVATIONS);
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
pub(crate) const LENS_FIELD_PX: f64 = 0.15;

/// A street of 40 moments and its matches.
fn street() -> (FeatureScene, CorrespondenceGraph) {
    street_of_seed(1)
}

fn street_of_seed(seed: u64) -> (FeatureScene, CorrespondenceGraph) {
    let options = DriveOptions { seed, rate_hz: 5.0, ..DriveOptions::default() };
    let (_, scene, graph) = street_of(&options, FRAMES, OBSERVATIONS);
    (scene, graph)
}

/// The first moments of a drive, and their matches.
pub(crate) fn street_of(
    options: &DriveOptions,
    frames: usize,
    observations: usize,
) -> (Drive, FeatureScene, CorrespondenceGraph) {
    let mut drive = Drive::new(options).expect("a street of 200 m");
    drive.keep_first(frames);
    let seed = options.seed;
    let features = FeatureOptions { seed, observations, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    (drive, scene, graph)
}

/// The street without poses, with a lens field, and calibrations whose focal lengths are off by
/// `errors`.
fn calibrated(scene: &FeatureScene, field_px: f64, errors: [f64; 2]) -> Reconstruction {
    let mut blank = scene.without_poses();
    LensField::displace_keypoints(&mut blank, field_px, 1);
    for (id, error) in [CameraId(0), CameraId(1)].into_iter().zip(errors) {
        let camera = blank.camera_mut(id);
        let focal_px = (1.0 + error) * camera.intrinsics.mean_focal_px();
        let (width, height) = (camera.width, camera.height);
        camera.intrinsics = Intrinsics::centred(CameraModelKind::Opencv, focal_px, width, height);
        camera.has_focal_prior = true;
        let prior = IntrinsicsPrior::new(camera.intrinsics, width, height, 1.0);
        blank.intrinsics_priors.insert(id, prior);
    }
    blank
}

#[test]
fn a_drive_corrects_a_calibration_and_keeps_an_exact_one() {
    let (scene, graph) = street();
    for (field_px, error, refine) in [
        (0.0, CALIBRATION_ERROR, RefineIntrinsics::ALL),
        (0.0, 0.0, RefineIntrinsics::ALL),
        (LENS_FIELD_PX, 0.0, RefineIntrinsics::ALL),
        (0.0, CALIBRATION_ERROR, RefineIntrinsics::NONE),
    ] {
        let blank = calibrated(&scene, field_px, [error; 2]);
        let mapper = MapperOptions { refine, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper);
        let mapped = models.expect("the scene is easy").remove(0);
        let model = &mapped.reconstruction;
        assert_eq!(model.num_registered(), 2 * FRAMES);
        let evidence = &mapped.calibration_evidence;
        assert_eq!(evidence.is_empty(), refine == RefineIntrinsics::NONE);
        for (id, camera) in model.cameras() {
            let true_focal_px = scene.truth().camera(id).intrinsics.mean_focal_px();
            let left = camera.intrinsics.mean_focal_px() / true_focal_px - 1.0;
            let told = format!("field {field_px} px, error {error}: {evidence:?}, left {left}");
            let is_refined = refine == RefineIntrinsics::ALL && error > 0.0;
            assert_eq!(camera.intrinsics != blank.camera(id).intrinsics, is_refined, "{told}");
            assert!(left.abs() < if is_refined { MAX_LEFT } else { 1.1 * CALIBRATION_ERROR });
        }
    }
}

#[test]
fn cameras_that_are_merged_by_motion_were_tested_separately() {
    let (scene, graph) = street();
    let blank = calibrated(&scene, LENS_FIELD_PX, [0.0, 2.0 * CALIBRATION_ERROR]);
    let counts: Vec<usize> = blank.images().map(|(_, image)| image.keypoints.len()).collect();
    let camera = |image: ImageId| blank.image(image).camera;
    let own = graph.pairs().iter().filter(|(pair, _)| camera(pair.a) == camera(pair.b));
    let graph = CorrespondenceGraph::new(&counts, own.map(|(pair, view)| (*pair, view.clone())));
    let mapper = MapperOptions { rig: RigMode::Auto, ..MapperOptions::default() };
    let models = Mapper::new(&graph, &blank).run(&mapper).expect("the scene is easy");
    assert_eq!(models.len(), 1, "the cameras move as one rig");
    let model = &models[0].reconstruction;
    let is_kept = |id: CameraId| model.camera(id).intrinsics == blank.camera(id).intrinsics;
    assert_eq!([0, 1].map(CameraId).map(is_kept), [true, false]);
    assert_eq!(model.calibrated, [CameraId(0)].into());
    assert_eq!(models[0].calibration_evidence.len(), 2);
}

/// Points that an image may have without a place in the comparison.
const FEW: usize = 2;

#[test]
fn an_image_with_hardly_any_points_leaves_the_evidence() {
    let (scene, graph) = street();
    let blank = calibrated(&scene, LENS_FIELD_PX, [0.0; 2]);
    let mapper = MapperOptions { keep_calibrations: false, ..MapperOptions::default() };
    let models = Mapper::new(&graph, &blank).run(&mapper);
    let mut model = models.expect("the scene is easy").remove(0).reconstruction;
    let options = AdjustOptions { refine: RefineIntrinsics::ALL, ..AdjustOptions::default() };
    let options = options.with_noise_of(&model);
    let before = calibration_evidence(&model, &options).expect("a model").log_bayes_factor;
    let (id, image, pose) = model.registered().nth(FRAMES / 2).expect("an image");
    let (camera, pose) = (image.camera, *pose);
    let seen = model.tracks().filter(|(_, track)| track.observations.len() > 4);
    let seen = seen.filter_map(|(point, track)| {
        let observation = track.observations.iter().find(|it| it.image == id)?;
        Some((point, model.image(id).keypoints[observation.keypoint as usize]))
    });
    let (points, keypoints): (Vec<_>, Vec<_>) = seen.take(FEW).unzip();
    assert_eq!(points.len(), FEW);
    let image = model.add_image(Image::new("weak", camera, keypoints));
    model.register(image, pose);
    for (keypoint, point) in (0..).zip(points) {
        model.add_observation(point, Observation { image, keypoint });
    }
    let after = calibration_evidence(&model, &options).expect("a model").log_bayes_factor;
    let [before, after] = [before, after].map(|factor| factor.expect("calibrated cameras"));
    assert!((after - before).abs() < 0.1, "{before} {after}");
}

/// Seeds of streets, and their lens fields: what KITTI has, and three times as much.
const FIELDS: [(u64, f64); 4] = [(1, LENS_FIELD_PX), (2, LENS_FIELD_PX), (1, 0.5), (3, 0.5)];
/// Focal lengths are looked for from a fifth above the true ones.
const FOCAL_RATIO: f64 = 1.2;

/// Cameras of which nothing is known.
pub(crate) fn begin_as_simple_radial(blank: &mut Reconstruction) {
    let ids: Vec<CameraId> = blank.cameras().map(|(id, _)| id).collect();
    for id in ids {
        let camera = blank.camera_mut(id);
        let focal_px = FOCAL_RATIO * camera.intrinsics.mean_focal_px();
        let (kind, width, height) = (CameraModelKind::SimpleRadial, camera.width, camera.height);
        camera.intrinsics = Intrinsics::centred(kind, focal_px, width, height);
        camera.has_focal_prior = false;
    }
}

/// Of a normal distribution, 1 of 370 values is beyond three standard deviations. With one of two
/// cameras fitted beside a constant one, the first street has an error of 0.6 px with 0.1 px.
const MAX_DEVIATIONS: f64 = 3.0;
/// A larger standard deviation tells nothing. The last street has 0.06.
const MAX_RELATIVE_SD: f64 = 0.1;

#[test]
fn deviations_of_uncertain_focal_lengths_count_lens_fields() {
    for &(seed, field_px) in sample(&FIELDS) {
        let (scene, graph) = street_of_seed(seed);
        let mut blank = scene.without_poses();
        LensField::displace_keypoints(&mut blank, field_px, seed);
        begin_as_simple_radial(&mut blank);
        let models = Mapper::new(&graph, &blank).run(&MapperOptions::default());
        let mapped = models.expect("the scene is easy").remove(0);
        let model = &mapped.reconstruction;
        assert!(model.calibrated.is_empty(), "no camera has a calibration");
        for (id, camera) in model.cameras() {
            let true_focal_px = scene.truth().camera(id).intrinsics.mean_focal_px();
            let error_px = camera.intrinsics.mean_focal_px() - true_focal_px;
            let sd_px = mapped.intrinsics_sds[&id][0];
            let told = format!("seed {seed}, field {field_px} px: {error_px} +- {sd_px} px");
            assert!(error_px.abs() < MAX_DEVIATIONS * sd_px, "{told}");
            assert!(sd_px < MAX_RELATIVE_SD * true_focal_px, "{told}");
        }
    }
}

/// Seed of a street. Where decentring waits for turns, the focal lengths have errors of −7.7 and
/// −8.1 %, with it −1.6 and −1.7 %.
const DECENTRED_SEED: u64 = 3;
const MAX_FOCAL_ERROR: f64 = 0.04;

#[test]
fn a_street_selects_a_decentred_fisheye_before_it_turns() {
    let seed = DECENTRED_SEED;
    let effects = Effects { has_action_lens: true, ..Effects::default() };
    let route = RouteKind::Open;
    let options = DriveOptions { seed, rate_hz: 5.0, route, effects, ..DriveOptions::default() };
    let (_, scene, graph) = street_of(&options, FRAMES, OBSERVATIONS);
    let mut blank = scene.without_poses();
    begin_as_simple_radial(&mut blank);
    let mapper = MapperOptions { select_camera_models: true, seed, ..MapperOptions::default() };
    let models = Mapper::new(&graph, &blank).run(&mapper);
    let model = models.expect("the scene is easy").remove(0).reconstruction;
    let kinds: Vec<CameraModelKind> =
        model.cameras().map(|(_, camera)| camera.intrinsics.kind()).collect();
    assert!(kinds.contains(&CameraModelKind::ThinPrismFisheye), "{kinds:?}");
    for (id, camera) in model.cameras() {
        let true_focal_px = scene.truth().camera(id).intrinsics.mean_focal_px();
        let error = camera.intrinsics.mean_focal_px() / true_focal_px - 1.0;
        assert!(error.abs() < MAX_FOCAL_ERROR, "{error}");
    }
}

/// Where the right camera's principal point is, in deviations of its prior from the image centre.
const OFF_CENTRE: Vector2<f64> = Vector2::new(1.0, -0.5);
/// The images tell a part of the principal point, so that the rotation is known better than by the
/// prior alone. Observed: 0.3 to 0.44.
const MAX_SD_OF_PRIOR: f64 = 1.0;

#[test]
fn a_principal_point_that_is_held_counts_in_the_rotation_on_the_rig() {
    for &seed in sample(&SEEDS) {
        let options =
            DriveOptions { seed, rate_hz: 5.0, route: RouteKind::Open, ..DriveOptions::default() };
        let (drive, scene, graph) = street_of(&options, FRAMES, OBSERVATIONS);
        let mut blank = scene.without_poses();
        // Focal lengths that are known: uncertain ones are fitted together with principal points.
        let kind = CameraModelKind::SimpleRadial;
        for id in [CameraId(0), CameraId(1)] {
            let camera = blank.camera_mut(id);
            let focal_px = camera.intrinsics.mean_focal_px();
            camera.intrinsics = Intrinsics::centred(kind, focal_px, camera.width, camera.height);
        }
        let refine = RefineIntrinsics { focal: false, ..RefineIntrinsics::ALL };
        let right = *blank.camera(CameraId(1));
        let prior_px = AdjustOptions::default().principal_point_sigma
            * f64::from(right.width.max(right.height));
        let shifted = |(id, image): (ImageId, &Image)| {
            let pixels = image.keypoints.iter().map(|keypoint| keypoint.pixel);
            let shift =
                if image.camera == CameraId(1) { OFF_CENTRE * prior_px } else { Vector2::zeros() };
            (id, pixels.map(|pixel| pixel + shift).collect())
        };
        let shifted: Vec<(ImageId, Vec<Vector2<f64>>)> = blank.images().map(shifted).collect();
        for (image, pixels) in shifted {
            blank.move_keypoints(image, &pixels);
        }
        let rig = RigMode::Auto;
        let mapper = MapperOptions { refine, rig, seed, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper);
        let mapped = models.expect("the scene is easy").remove(0);
        let lens = &mapped.reconstruction.camera(CameraId(1)).intrinsics;
        let centre = Vector2::new(f64::from(right.width), f64::from(right.height)) / 2.0;
        assert_eq!(lens.principal_point(), centre, "no camera turns");
        let camera = mapped.rig.expect("two cameras").cameras.remove(0);
        let turn =
            so3::log(&(camera.cam_from_rig.rotation * drive.cam_from_rig(1).rotation.inverse()));
        let covariance = camera.covariance.expect("all is determined");
        for k in 0..2 {
            let (error, sd) = (turn[k], covariance[(k, k)].sqrt());
            let told = format!("seed {seed}, axis {k}: {error} +- {sd} rad");
            assert!(error.abs() < MAX_DEVIATIONS * sd, "{told}");
            assert!(sd < MAX_SD_OF_PRIOR * prior_px / lens.mean_focal_px(), "{told}");
        }
    }
}
