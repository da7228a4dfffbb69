//! Positions with a clock of their own: the clock offset and the lever arm.

use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng, Sim3};
use tiepoint_scene::{Camera, Image, Reconstruction};
use tiepoint_sfm::positions::{TimedPosition, TrackMisfit, align, align_track};

const ANY: std::ops::Range<f64> = f64::NEG_INFINITY..f64::INFINITY;
const OFFSET_S: f64 = 1234.7;
/// To the right of the camera, above and behind it.
const ARM_M: Vector3<f64> = Vector3::new(0.9, -1.1, -1.6);
const SIGMA_M: f64 = 2.0;

/// A motion in the plane: heading and speed at a time.
type Motion = fn(f64) -> (f64, f64);

/// Turns of some 45° and speeds from 4 m/s to 12 m/s.
fn town(time_s: f64) -> (f64, f64) {
    let heading = 0.8 * (0.11 * time_s).sin() + 1.3 * (0.037 * time_s).sin();
    (heading, 8.0 + 4.0 * (0.23 * time_s).sin())
}

/// The camera along a motion, ten times a second: times and `world_from_cam`.
fn drive(motion: Motion, seconds: usize) -> Vec<(f64, Rigid3)> {
    const STEPS: usize = 100;
    let mut place = Vector3::new(0.0, 0.0, 1.5);
    let mut poses = Vec::new();
    for step in 0..=STEPS * seconds {
        let time_s = step as f64 / STEPS as f64;
        let (heading, speed) = motion(time_s);
        let forward = Vector3::new(heading.cos(), heading.sin(), 0.0);
        if step % (STEPS / 10) == 0 {
            let right = Vector3::new(heading.sin(), -heading.cos(), 0.0);
            let axes = Matrix3::from_columns(&[right, -Vector3::z(), forward]);
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
            poses.push((time_s, Rigid3::new(rotation, place)));
        }
        place += forward * speed / STEPS as f64;
    }
    poses
}

/// A model of the images from `from` on, five in a second, in another frame and unit.
fn model(poses: &[(f64, Rigid3)], from: usize, count: usize) -> Reconstruction {
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
    let camera = model.add_camera(camera);
    for (index, (time_s, pose)) in poses[from..].iter().step_by(2).take(count).enumerate() {
        let image = model.add_image(Image::new(format!("{index}.png"), camera, Vec::new()));
        model.set_time(image, Some(*time_s));
        model.register(image, pose.inverse());
    }
    model.transform(&Sim3 {
        scale: 0.05,
        rotation: UnitQuaternion::from_euler_angles(1.0, -0.5, 2.5),
        translation: Vector3::new(3.0, 1.0, -7.0),
    });
    model
}

/// One position in a second with noise, of which one in twenty is wrong by far.
fn track(poses: &[(f64, Rigid3)], seed: u64) -> Vec<TimedPosition> {
    let mut rng = Rng::stream(seed, &[]);
    let mut fix = |(index, (time_s, pose)): (usize, &(f64, Rigid3))| {
        let mut xyz = *pose * ARM_M + Vector3::from_fn(|_, _| SIGMA_M * rng.normal());
        if index % 20 == 7 {
            xyz += Vector3::new(50.0 * rng.normal(), 50.0 * rng.normal(), 0.0);
        }
        let time_s = time_s + OFFSET_S;
        TimedPosition { time_s, xyz, has_height: true, sigmas_m: None }
    };
    poses.iter().step_by(10).enumerate().map(&mut fix).collect()
}

#[test]
fn offset_and_arm_are_found_with_their_deviations() {
    let poses = drive(town, 300);
    let model = model(&poses, 0, 1500);
    let (mut offsets, mut arms) = (Vec::new(), Vec::new());
    const SEEDS: u64 = 12;
    for seed in 0..SEEDS {
        let found = align_track(&model, &track(&poses, seed), ANY, 0).unwrap();
        assert!(found.offset_sd_s < 0.15, "{seed}: {}", found.offset_sd_s);
        offsets.push((found.offset_s - OFFSET_S) / found.offset_sd_s);
        // The road is level: nothing tells of the height of the antenna above the camera, which
        // has the deviation of the assumption.
        assert!(found.arm_m.y.abs() < 0.05, "{seed}: {}", found.arm_m);
        assert!((0.9..1.1).contains(&found.arm_sds_m.y), "{seed}: {}", found.arm_sds_m);
        assert!(found.arm_sds_m.x < 0.5 && found.arm_sds_m.z < 0.8, "{}", found.arm_sds_m);
        let errors = (found.arm_m - ARM_M).component_div(&found.arm_sds_m);
        arms.extend([errors.x, errors.z]);
        // With one position in a second, in the image of that time, whose centre it is of.
        let similarity = align(&model, &found.positions, false, 0).unwrap().term_from_model;
        for ((_, _, pose), (_, truth)) in model.registered().zip(poses.iter().step_by(2)) {
            // But for the height. Seven parameters of 285 positions of 2 m are known to 0.3 m in
            // the middle, and at the ends to twice that; three deviations.
            let here = similarity * pose.origin_in_a() - truth.translation;
            assert!(here.xy().norm() < 1.8, "{seed}: {here}");
        }
    }
    // The mean square of 12 (24) standard normal variables is below 2.5 (2.1) in all but one of a
    // thousand cases, and above 0.2 (0.4): quantiles of χ².
    let mean_square =
        |list: &[f64]| list.iter().map(|value| value * value).sum::<f64>() / list.len() as f64;
    let [offset, arm] = [mean_square(&offsets), mean_square(&arms)];
    assert!((0.2..2.75).contains(&offset), "{offset}: {offsets:?}");
    assert!((0.35..2.15).contains(&arm), "{arm}: {arms:?}");
}

#[test]
fn positions_of_another_stretch_of_the_track_do_no_harm() {
    // The pictures are of the second minute of ten.
    let poses = drive(town, 600);
    let found = align_track(&model(&poses, 600, 300), &track(&poses, 3), ANY, 0).unwrap();
    assert!((found.offset_s - OFFSET_S).abs() < 4.0 * found.offset_sd_s, "{}", found.offset_s);
    // Those in the minute count.
    assert!((55..=60).contains(&found.positions.len()), "{}", found.positions.len());
}

#[test]
fn what_the_drive_does_not_determine_is_refused() {
    let refused = |motion: Motion, from: usize, offsets_s: std::ops::Range<f64>| {
        let poses = drive(motion, 240);
        align_track(&model(&poses, from, 600), &track(&poses, 1), offsets_s, 0).unwrap_err()
    };
    let straight = refused(|_| (0.3, 10.0), 0, ANY);
    assert!(matches!(straight, TrackMisfit::NoOffset { sd_s } if sd_s > 0.5), "{straight:?}");
    assert!(straight.to_string().contains("turns and changes of speed"));
    // Two rounds of the same speeds, of which the pictures have one.
    let rounds: Motion = |time_s| {
        let round = std::f64::consts::TAU / 120.0;
        (round * time_s, 8.0 + 3.0 * (round * time_s).sin())
    };
    let twice = refused(rounds, 0, ANY);
    assert!(matches!(twice, TrackMisfit::TwoOffsets(_)), "{twice:?}");
    // The clocks are known to agree within a minute.
    let other = refused(town, 0, -60.0..60.0);
    assert!(matches!(other, TrackMisfit::NoOverlap { .. }), "{other:?}");
    let poses = drive(town, 60);
    let mut blank = model(&poses, 0, 300);
    let ids: Vec<_> = blank.registered().map(|(id, ..)| id).collect();
    ids.into_iter().for_each(|id| blank.set_time(id, None));
    assert_eq!(align_track(&blank, &track(&poses, 1), ANY, 0), Err(TrackMisfit::NoTimes));
    let few = &track(&poses, 1)[..3];
    let misfit = align_track(&model(&poses, 0, 300), few, ANY, 0).unwrap_err();
    assert_eq!(misfit, TrackMisfit::TooFew { during: 3 });
}
