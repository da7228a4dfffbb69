//! Cameras with a clock offset, in the synthetic street as features. Clocks, poses and calibration
//! are known.

use std::ops::Range;

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng, so3};
use tiepoint_scene::{Camera, Image, ImageId, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::rig::Clock;
use tiepoint_sfm::rigs::{
    CalibratedCamera, ClockState, NUMBERED_FRAME_S, RigConstraint, sensor_pairs,
};
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::LensField;
use tiepoint_synth::effects::ClockEffects;
use tiepoint_synth::{Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions};

use crate::common::sample;

/// Clock effects: initial offset, quartz drift, lost frames, and a different rate.
const CLOCKS: ClockEffects = ClockEffects {
    offset_s: 0.3,
    drift_ppm: 40.0,
    jitter_s: 0.0002,
    phase: 1.0,
    late_start_s: 0.5,
    drop_fraction: 0.02,
    rate_spread: 0.01,
};
const FRAMES: usize = 45;

struct Run {
    drive: Drive,
    truth: Reconstruction,
    model: Reconstruction,
    camera: Option<CalibratedCamera>,
}

/// A quarter of a block with a stop and a turn, at 5 images a second.
fn run(seed: u64, clocks: ClockEffects, rig: RigMode, lens_field_px: f64) -> Run {
    let effects = Effects { clocks, ..Effects::default() };
    let options = DriveOptions { seed, rate_hz: 5.0, effects, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(FRAMES);
    let features = FeatureOptions { seed, observations: 30_000, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let matching = MatchOptions { window: Some(6), ..MatchOptions::default() };
    let graph = scene.graph(&matching);
    let mut features = scene.without_poses();
    LensField::displace_keypoints(&mut features, lens_field_px, seed);
    let mapper =
        MapperOptions { refine: RefineIntrinsics::NONE, rig, seed, ..MapperOptions::default() };
    let models = Mapper::new(&graph, &features).run(&mapper);
    let MappedModel { reconstruction: model, rig, .. } =
        models.expect("the scene is easy").remove(0);
    let camera = rig.and_then(|rig| rig.cameras.into_iter().next());
    Run { drive, truth: scene.truth().clone(), model, camera }
}

/// Length of the estimated trajectory relative to the true one, from the first camera's images.
fn scale(run: &Run) -> f64 {
    let length = |scene: &Reconstruction| -> f64 {
        let centres: Vec<_> = run
            .model
            .registered()
            .filter(|(_, image, _)| image.camera.0 == 0)
            .filter_map(|(id, ..)| Some(scene.image(id).cam_from_world()?.origin_in_a()))
            .collect();
        centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    };
    length(&run.model) / length(&run.truth)
}

/// Errors of rotation (radians), translation (metres), offset at the pivot (seconds) and drift, and
/// their standard deviations.
fn errors(run: &Run) -> ([f64; 8], [f64; 8]) {
    let camera = run.camera.as_ref().expect("the right camera was calibrated");
    let (truth, clock) = (run.drive.cam_from_rig(1), run.drive.cameras()[1].clock);
    let scale = scale(run);
    let found = Rigid3::new(camera.cam_from_rig.rotation, camera.cam_from_rig.translation / scale);
    let turn = so3::log(&(found.rotation * truth.rotation.inverse()));
    let shift = found.translation - truth.translation;
    let pivot_s = camera.sensor_pair.clock.pivot_s;
    let offset_s = camera.sensor_pair.clock.reference_time_s(pivot_s) - clock.time_s(pivot_s);
    let drift = camera.sensor_pair.clock.drift - (1.0 / (1.0 + clock.drift) - 1.0);
    let covariance = camera.covariance.expect("all is determined");
    let sd = std::array::from_fn(|k| {
        let sd: f64 = covariance[(k, k)].sqrt();
        if (3..6).contains(&k) { sd / scale } else { sd }
    });
    ([turn.x, turn.y, turn.z, shift.x, shift.y, shift.z, offset_s, drift], sd)
}

/// Required accuracy: half a millisecond, 0.05° and 0.5° of direction.
const MAX_OFFSET_S: f64 = 0.0005;
const MAX_ROTATION_RAD: f64 = 0.05 / 57.3;
const MAX_DIRECTION_RAD: f64 = 0.5 / 57.3;
/// Baseline, in metres.
const BASELINE_M: f64 = 0.5;
/// A seed has six normalised errors. The mean square of six independent numbers lies in the first
/// range with 99 % probability (χ²), and that of three seeds in the second.
const NORMALISED_OF_6: Range<f64> = 0.113..3.09;
const NORMALISED_OF_18: Range<f64> = 0.348..2.06;

#[test]
fn clocks_and_extrinsics_are_estimated_with_consistent_uncertainty() {
    let (mut sum, mut count) = (0.0, 0);
    for &seed in sample(&[1, 2, 3]) {
        let run = run(seed, CLOCKS, RigMode::Auto, 0.0);
        let camera = run.camera.as_ref().expect("the right camera was calibrated");
        assert_eq!(camera.sensor_pair.clock_state, ClockState::Estimated);
        assert!(
            matches!(camera.constraint, RigConstraint::Soft { .. }),
            "images of different instants are not rigid"
        );
        let (error, sd) = errors(&run);
        eprintln!("seed {seed}: errors {error:.6?}\n        deviations {sd:.6?}");
        assert!(error[6].abs() < MAX_OFFSET_S, "seed {seed}: offset {} ± {} s", error[6], sd[6]);
        assert!(
            error[..3].iter().map(|e| e * e).sum::<f64>().sqrt() < MAX_ROTATION_RAD,
            "{error:?}"
        );
        // The error along the baseline is one of length, the error across it one of direction.
        let across = error[4].hypot(error[5]);
        assert!(across < MAX_DIRECTION_RAD * BASELINE_M, "seed {seed}: {error:?} ± {sd:?}");
        // Without the length, whose scale is taken from the truth, and without the drift, which the
        // prior determines.
        for k in [0, 1, 2, 4, 5, 6] {
            sum += (error[k] / sd[k]).powi(2);
            count += 1;
        }
    }
    let normalised = sum / f64::from(count);
    eprintln!("normalised error a degree of freedom: {normalised:.2}");
    let chance = if count == 6 { NORMALISED_OF_6 } else { NORMALISED_OF_18 };
    assert!(chance.contains(&normalised), "{normalised}");
}

/// Root mean squares of a lens field, in pixels: what a calibration leaves (0.1 to 0.2 px along
/// each axis on KITTI).
const LENS_FIELDS_PX: [f64; 2] = [0.28, 0.14];
/// Root mean square of the normalised errors over all seeds; and of one seed, whose five numbers
/// have a mean square in 0.08 to 3.3 with 99 % probability (χ²).
const NORMALISED_RMS: Range<f64> = 0.7..1.4;
const NORMALISED_RMS_OF_5: Range<f64> = 0.29..1.83;

/// Deviations hold although the errors of all images are the same function of the pixel. For
/// independent residuals they would be too small by a factor of three to eight.
#[test]
fn deviations_hold_with_a_lens_field() {
    for &lens_field_px in sample(&LENS_FIELDS_PX) {
        for (name, clocks) in [("clocks", CLOCKS), ("synchronised", ClockEffects::default())] {
            let seeds = sample(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);
            let mut squares = [0.0; 8];
            for &seed in seeds {
                let (error, sd) = errors(&run(seed, clocks, RigMode::Auto, lens_field_px));
                for (square, (error, sd)) in squares.iter_mut().zip(error.iter().zip(sd)) {
                    *square += (error / sd).powi(2) / seeds.len() as f64;
                }
            }
            let each = squares.map(f64::sqrt);
            // Without the length and the drift, as above.
            let extrinsics = ([0, 1, 2, 4, 5].map(|k| squares[k]).iter().sum::<f64>() / 5.0).sqrt();
            eprintln!(
                "{name}, lens field {lens_field_px} px: normalised rms {extrinsics:.2} of the \
                extrinsics, each {each:.2?}"
            );
            let allowed = if seeds.len() == 1 { NORMALISED_RMS_OF_5 } else { NORMALISED_RMS };
            assert!(allowed.contains(&extrinsics), "{extrinsics}");
            if clocks == CLOCKS && seeds.len() > 1 {
                assert!(allowed.contains(&each[6]), "{}", each[6]);
            }
        }
    }
}

/// Lower tolerance of the jitter estimated from some 90 time stamps by the median of their second
/// differences, relative to the truth.
const MIN_RELATIVE_JITTER: f64 = 0.8;
/// Exceeded by chance once in fifteen thousand.
const MAX_DEVIATIONS: f64 = 4.0;

/// The jitter of the time stamps bounds the precision of the offset, however precise the keypoints
/// are.
#[test]
fn no_offset_is_more_precise_than_the_time_stamps() {
    let jitter_s = 0.002;
    let run = run(1, ClockEffects { jitter_s, ..CLOCKS }, RigMode::Auto, 0.0);
    let camera = run.camera.as_ref().expect("the right camera was calibrated");
    let floor_s = 2f64.sqrt() * jitter_s / (camera.num_referenced_images as f64).sqrt();
    let (error, sd) = errors(&run);
    assert!(sd[6] > MIN_RELATIVE_JITTER * floor_s, "{} ± {}, floor {floor_s}", error[6], sd[6]);
    assert!(error[6].abs() < MAX_DEVIATIONS * sd[6], "{} ± {}", error[6], sd[6]);
}

#[test]
fn synchronised_cameras_become_rigid_frames() {
    let run = run(2, ClockEffects::default(), RigMode::Rigid, 0.0);
    let camera = run.camera.as_ref().expect("the right camera was calibrated");
    assert_eq!(
        (camera.sensor_pair.clock_state, camera.sensor_pair.clock.offset_s, camera.constraint),
        (ClockState::Synchronised, 0.0, RigConstraint::Rigid)
    );
    assert_eq!(run.model.frames.len(), FRAMES);
}

/// Two cameras on a rig, half a metre apart, whose images have numbers and no times. Image k of
/// camera c has the pose of the vehicle at `time(c, k)`, with noise, and the number
/// `number(c, k)`; those in `range(c)` have a pose.
fn numbered_model(
    vehicle: &dyn Fn(f64) -> Rigid3,
    time: &dyn Fn(u32, u32) -> f64,
    number: &dyn Fn(u32, u32) -> u32,
    range: &dyn Fn(u32) -> Range<u32>,
) -> Reconstruction {
    let pose = |camera: u32, k: u32| {
        let cam_from_rig =
            Rigid3::new(so3::exp(&Vector3::zeros()), -Vector3::x() * 0.5 * f64::from(camera));
        cam_from_rig * vehicle(time(camera, k))
    };
    let mut model = two_cameras(3, 100, NOISE_M, number, &pose);
    let images: Vec<ImageId> = model.images().map(|(id, _)| id).collect();
    for (at, image) in (0..).zip(images) {
        if !range(at / 100).contains(&(at % 100)) {
            model.deregister(image);
        }
    }
    model
}

/// Two cameras of `num_images` images each, with names `c/NNN.png` from `number(c, k)` and noisy
/// poses. The images of camera 0 come first.
fn two_cameras(
    seed: u64,
    num_images: u32,
    noise_m: f64,
    number: &dyn Fn(u32, u32) -> u32,
    pose: &dyn Fn(u32, u32) -> Rigid3,
) -> Reconstruction {
    let mut rng = Rng::stream(seed, &[]);
    let mut model = Reconstruction::default();
    for camera in 0..2 {
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let id =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        for k in 0..num_images {
            let name = format!("{camera}/{:03}.png", number(camera, k));
            let image = model.add_image(Image::new(name, id, Vec::new()));
            let mut pose = pose(camera, k);
            pose.translation += Vector3::new(rng.normal(), rng.normal(), rng.normal()) * noise_m;
            model.register(image, pose);
        }
    }
    model
}

/// Noise of a pose of a reconstruction.
const NOISE_M: f64 = 0.003;
/// Tolerance of an offset from these poses, in frames.
const MAX_OFFSET_FRAMES: f64 = 0.05;

/// The vehicle weaves and changes its speed, never in the same way twice. A second is a frame.
fn weaving(time_s: f64) -> Rigid3 {
    let turn = Vector3::y() * (0.3 * (0.2 * time_s).sin() + 0.2 * (0.137 * time_s + 1.0).sin());
    let along = 0.8 * time_s + 1.5 * (0.13 * time_s).sin();
    let centre = Vector3::new(2.0 * (0.09 * time_s).sin(), 0.0, along);
    let rotation = so3::exp(&turn);
    Rigid3::new(rotation, -(rotation * centre))
}

#[test]
fn numbered_frames_have_an_offset_in_frames() {
    let all = |_: u32| 0..100;
    let plain = |_: u32, k: u32| k;
    let late = |frames: f64| move |camera: u32, k: u32| f64::from(k) + frames * f64::from(camera);
    let found =
        |frames: f64, number: &dyn Fn(u32, u32) -> u32, range: &dyn Fn(u32) -> Range<u32>| {
            let pair = sensor_pairs(&numbered_model(&weaving, &late(frames), number, range))[0];
            (pair.clock_state, pair.clock.offset_s / NUMBERED_FRAME_S)
        };
    for frames in [0.3, -7.4, 1.1] {
        let (state, offset) = found(frames, &plain, &all);
        assert_eq!(state, ClockState::Estimated, "{frames}");
        assert!((offset - frames).abs() < MAX_OFFSET_FRAMES, "{offset} of {frames}");
    }
    // Numbered from another begin each.
    let (state, offset) = found(0.3, &|camera, k| k + 500 * camera, &all);
    assert_eq!(state, ClockState::Estimated);
    assert!((offset + 500.0 - 0.3).abs() < MAX_OFFSET_FRAMES, "{offset}");
    // Triggered together, and started one after the other.
    let (state, offset) = found(12.0, &plain, &all);
    assert_eq!((state, offset.round()), (ClockState::Synchronised, 12.0));
    assert!((offset - offset.round()).abs() < 1e-9, "{offset}");
    // Every second number counts no frames.
    assert_eq!(found(0.3, &|_, k| 2 * k, &all), (ClockState::Synchronised, 0.0));
}

/// Clocks that were not set may be many seconds apart, though the recordings overlap.
#[test]
fn clocks_are_far_apart_if_the_motion_says_so() {
    let interval_s = 0.1;
    for late_s in [0.13, -3.27, 3.61] {
        let plain = |_: u32, k: u32| k;
        let mut model = numbered_model(
            &weaving,
            &|camera, k| f64::from(k) + late_s / interval_s * f64::from(camera),
            &plain,
            &|_| 0..100,
        );
        let images: Vec<_> = model.images().map(|(id, _)| id).collect();
        for (at, id) in images.into_iter().enumerate() {
            model.set_time(id, Some(interval_s * (at % 100) as f64));
        }
        let found = sensor_pairs(&model)[0].clock.offset_s;
        assert!((found - late_s).abs() < MAX_OFFSET_FRAMES * interval_s, "{found} of {late_s}");
    }
}

/// Also where few images have a pose in both cameras, and where the vehicle moves in the same way
/// all the time, so that any offset gives one relative pose.
#[test]
fn the_same_number_is_the_same_instant_unless_the_motion_contradicts() {
    let together = |vehicle: &dyn Fn(f64) -> Rigid3, range: &dyn Fn(u32) -> Range<u32>| {
        let model = numbered_model(vehicle, &|_, k| f64::from(k), &|_, k| k, range);
        let pair = sensor_pairs(&model)[0];
        assert_eq!((pair.clock_state, pair.clock), (ClockState::Synchronised, Clock::default()));
    };
    let all = |_: u32| 0..100;
    together(&weaving, &all);
    together(&weaving, &|camera| if camera == 0 { 0..60 } else { 45..100 });
    together(&weaving, &|camera| if camera == 0 { 0..40 } else { 60..100 });
    let turntable = |time_s: f64| {
        let rotation = so3::exp(&(Vector3::y() * 0.06 * time_s));
        Rigid3::new(rotation, Vector3::new(0.0, 0.0, 3.0))
    };
    together(&turntable, &all);
    let standing = |_: f64| Rigid3::identity();
    together(&standing, &all);
    // A multi-camera rig that is carried from one place to the next.
    let jumping = |time_s: f64| {
        let mut rng = Rng::stream(5, &[time_s as u64]);
        let mut any = || Vector3::new(rng.normal(), rng.normal(), rng.normal());
        Rigid3::new(so3::exp(&any()), any() * 5.0)
    };
    together(&jumping, &all);
}

/// On a straight road at constant speed, a clock offset is equivalent to a translation of the
/// camera along the road. The offset is unobservable, and the time stamps are used.
#[test]
fn an_unobservable_clock_follows_its_time_stamps() {
    let time_s = |camera: u32, k: u32| 0.2 * f64::from(k) + 0.07 * f64::from(camera);
    let pose = |camera: u32, k: u32| {
        let place = Vector3::new(0.5 * f64::from(camera), 0.0, 8.0 * time_s(camera, k));
        Rigid3::new(so3::exp(&Vector3::zeros()), -place)
    };
    // Noise as in a reconstruction.
    let mut model = two_cameras(1, 40, 0.01, &|_, k| k, &pose);
    let images: Vec<ImageId> = model.images().map(|(id, _)| id).collect();
    for (at, image) in (0..).zip(images) {
        model.set_time(image, Some(time_s(at / 40, at % 40)));
    }
    let found = sensor_pairs(&model);
    assert_eq!(
        (found[0].clock_state, found[0].clock.offset_s),
        (ClockState::Unobservable, 0.0),
        "{found:?}"
    );
    // Right images at the left images' times: synchronised.
    let rights: Vec<_> =
        model.images().filter(|(_, image)| image.camera.0 == 1).map(|(id, _)| id).collect();
    for (k, right) in rights.into_iter().enumerate() {
        model.set_time(right, Some(0.2 * k as f64));
    }
    assert_eq!(sensor_pairs(&model)[0].clock_state, ClockState::Synchronised);
}
