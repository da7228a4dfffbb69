//! Evaluation on a rendered drive: the true model has no error, and added errors are measured.
#![allow(clippy::unwrap_used)]

#[path = "common/true_model.rs"]
mod true_model;

use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::geometry::{Rigid3, Sim3};
use tiepoint_pipeline::eval::{Alignment, TrueObservation, find_alignment};
use tiepoint_pipeline::evaluation::{evaluate_cloud, evaluate_rig, evaluate_surface};
use tiepoint_pipeline::sfm::rigs::NUMBERED_FRAME_S;
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Reconstruction};
use tiepoint_pipeline::workspace::{RigCamera, RigClock, RigClockState, RigFile};
use tiepoint_synth::{Drive, DriveOptions, LidarOptions, reference_cloud};

use true_model::{TOLERANCE_M, drive, truth_with_points};

fn true_observation(drive: &Drive, image: &Image, pixel: &Vector2<f64>) -> TrueObservation {
    let (camera, exposure) = drive.find(&image.name).unwrap();
    let surface = drive.surface_at(camera, exposure.time_s, pixel);
    TrueObservation {
        camera_in_world: drive
            .row_pose(camera, exposure.time_s, pixel.y)
            .world_from_cam
            .translation,
        surface_in_world: surface
            .filter(|surface| !surface.is_moving)
            .map(|surface| surface.point_in_world),
    }
}

#[test]
fn true_model_has_no_surface_error_and_a_shift_is_measured() {
    for effects in ["none", "lens+rolling-shutter+traffic"] {
        let drive = drive(effects);
        let mut model = truth_with_points(&drive);
        let truth_from_model = Sim3 { scale: 2.0, ..Sim3::identity() };
        model.transform(&truth_from_model.inverse());
        let evaluate = |model: &Reconstruction| {
            evaluate_surface(model, &truth_from_model, |i, p| true_observation(&drive, i, p))
                .unwrap()
        };
        let exact = evaluate(&model);
        assert!(exact.points > 500 && exact.not_on_a_surface == 0, "{effects}: {exact:?}");
        assert!(exact.distance.max < TOLERANCE_M, "{effects}: {:?}", exact.distance);
        assert!(exact.floor.unwrap().max < 1e3 * TOLERANCE_M, "{effects}: {:?}", exact.floor);
        // All points half a metre further east; the cameras stay.
        let points: Vec<_> = model.tracks().map(|(id, _)| id).collect();
        for id in points {
            model.track_mut(id).unwrap().xyz.x += 0.25;
        }
        let shifted = evaluate(&model);
        assert!(
            (shifted.distance.median - 0.5).abs() < TOLERANCE_M,
            "{effects}: {:?}",
            shifted.distance
        );
        assert!((shifted.near.unwrap().mean - 0.5).abs() < TOLERANCE_M);
        assert!(shifted.distance.std < TOLERANCE_M);
        assert_eq!(shifted.floor, exact.floor);
        assert_eq!(shifted.errors.len(), shifted.points);
    }
}

#[test]
fn relative_pose_of_the_true_rig_is_constant_and_drift_is_measured() {
    let drive = drive("none");
    let mut model = drive.truth();
    let rigs = evaluate_rig(&model, None, 1.0);
    let rig = &rigs[0];
    assert_eq!((rigs.len(), rig.frames), (1, 30));
    assert_eq!(rig.cameras, ["left", "right"]);
    assert!((rig.baseline.mean - 0.5).abs() < TOLERANCE_M, "{rig:?}");
    assert!(
        rig.baseline.std < TOLERANCE_M
            && rig.translation_rms < TOLERANCE_M
            && rig.rotation_rms_deg < 1e-6
    );
    // The right camera drifts to its right by 1 cm per image; lengths are scaled by 2.
    let right: Vec<(ImageId, Rigid3)> = model
        .registered()
        .filter(|(_, i, _)| i.name.starts_with("right"))
        .map(|(id, _, pose)| (id, *pose))
        .collect();
    for (k, (id, mut pose)) in right.into_iter().enumerate() {
        pose.translation.x -= 0.01 * k as f64;
        model.register(id, pose);
    }
    let rig = &evaluate_rig(&model, None, 2.0)[0];
    assert!((rig.translation_drift - 2.0 * 0.29).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline_drift - 0.29 / (0.5 + 0.145)).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline.max - 2.0 * 0.79).abs() < TOLERANCE_M, "{rig:?}");
    assert_eq!(rig.times_s.len(), rig.series.centres.len());
}

/// The right camera exposes between the left ones, and its clock differs. What is left at the times
/// of the clock is the jitter of the stamps of both cameras, 0.5 ms each: 4 mm were measured.
/// Images nearest in time are up to half an interval apart, in which the car drives decimetres.
#[test]
fn relative_pose_is_constant_at_the_times_of_the_clock() {
    let drive = drive("clocks");
    let mut model = drive.truth();
    let stamps: Vec<(ImageId, f64)> = model
        .images()
        .map(|(id, image)| (id, drive.find(&image.name).unwrap().1.stamp_s))
        .collect();
    stamps.into_iter().for_each(|(id, stamp_s)| model.set_time(id, Some(stamp_s)));
    let [left, right] = [0, 1].map(|camera| drive.cameras()[camera].clock);
    // Stamps of the left camera at the times of stamps 0 and 1 of the right one.
    let [at_0, at_1] = [0.0, 1.0].map(|stamp_s| left.stamp_s(right.time_s(stamp_s)));
    let camera = RigCamera {
        name: "right".to_owned(),
        clock: RigClock {
            state: RigClockState::Estimated,
            offset_s: at_0,
            drift_ppm: 1e6 * (at_1 - at_0 - 1.0),
            ..RigClock::default()
        },
        ..RigCamera::default()
    };
    let rig =
        RigFile { reference: "left".to_owned(), cameras: vec![camera], bad_pairs: Vec::new() };
    let nearest = &evaluate_rig(&model, None, 1.0)[0];
    let at_clock = &evaluate_rig(&model, Some(&rig), 1.0)[0];
    assert!(at_clock.has_clock && !nearest.has_clock);
    assert!(at_clock.frames > 20, "{}", at_clock.frames);
    assert!((at_clock.baseline.mean - 0.5).abs() < 1e-3, "{:?}", at_clock.baseline);
    assert!(at_clock.translation_rms < 0.01, "{}", at_clock.translation_rms);
    assert!(nearest.translation_rms > 0.05, "{}", nearest.translation_rms);
    // Without times, the numbers of the frames are compared.
    let left_first = model.images().find(|(_, image)| image.name.starts_with("left"));
    let right_first = model.images().find(|(_, image)| image.name.starts_with("right"));
    let stamp_s = |found: Option<(ImageId, &Image)>| found.unwrap().1.time_s.unwrap();
    let first_s = left.stamp_s(right.time_s(stamp_s(right_first)));
    let frames = (first_s - stamp_s(left_first)) * DriveOptions::default().rate_hz;
    let images: Vec<ImageId> = model.images().map(|(id, _)| id).collect();
    let mut numbered = model.clone();
    images.into_iter().for_each(|id| numbered.set_time(id, None));
    let mut by_number = rig.clone();
    by_number.cameras[0].clock = RigClock {
        state: RigClockState::Estimated,
        offset_s: frames * NUMBERED_FRAME_S,
        assumed_frame_s: Some(NUMBERED_FRAME_S),
        ..RigClock::default()
    };
    let found = &evaluate_rig(&numbered, Some(&by_number), 1.0)[0];
    assert!(found.has_clock && !found.has_times);
    assert!(found.translation_rms < 0.5 * nearest.translation_rms, "{found:?}");
    // They are told as numbers.
    let steps = found.times_s.windows(2).map(|two| two[1] - two[0]);
    assert!(steps.clone().count() > 20 && steps.clone().all(|step| step > 0.9), "{found:?}");
    // What the rig says to contradict is left out.
    let bad = model.registered().map(|(_, image, _)| image.name.clone());
    let bad = bad.filter(|name| name.starts_with("right")).nth(10).unwrap();
    let rig = RigFile { bad_pairs: vec![[String::new(), bad]], ..rig };
    assert_eq!(evaluate_rig(&model, Some(&rig), 1.0)[0].frames, at_clock.frames - 1);
}

/// A camera that is held upright for some photos is two cameras of one stream, and no rig. Without
/// times, images are paired by the numbers in their names, and that is said.
#[test]
fn cameras_of_one_stream_are_no_rig() {
    let mut model = drive("none").truth();
    let images: Vec<ImageId> = model.images().map(|(id, _)| id).collect();
    for id in images.iter().copied() {
        model.set_time(id, None);
    }
    let rigs = evaluate_rig(&model, None, 1.0);
    assert_eq!((rigs.len(), rigs[0].has_times), (1, false));
    for id in images {
        model.set_stream(id, "phone".into());
    }
    assert_eq!(evaluate_rig(&model, None, 1.0).len(), 0);
}

#[test]
fn icp_aligns_a_moved_cloud_to_its_scan() {
    let drive = drive("none");
    let scanner = LidarOptions {
        every_turns: 10,
        azimuth_step_rad: 1f64.to_radians(),
        ..LidarOptions::default()
    };
    let scan = reference_cloud(&drive, &scanner).unwrap();
    let cloud: Vec<Vector3<f64>> = scan.iter().step_by(3).copied().collect();
    let moved = Sim3 {
        scale: 0.25,
        rotation: tiepoint_pipeline::eval::geometry::so3::exp(&Vector3::new(0.02, -0.01, 0.03)),
        translation: Vector3::new(0.3, -0.2, 0.1),
    };
    let cloud: Vec<_> = cloud.iter().map(|point| moved * *point).collect();
    // An approximate alignment, as the camera poses would give it.
    let start = Sim3 { scale: 4.0, ..Sim3::identity() };
    let found = evaluate_cloud(&cloud, &scan, &start, Alignment::Rigid).unwrap();
    assert!(found.cloud.distance.max < 1e-6, "{found:?}");
    assert!((found.cloud.scale - 4.0).abs() < 1e-9);
    let unaligned = evaluate_cloud(&cloud, &scan, &start, Alignment::None).unwrap();
    assert!(unaligned.cloud.distance.mean > 0.05, "{unaligned:?}");
    // The cloud has every third point of the scan.
    assert!(
        found.reference_distance.mean > 0.0
            && found.reference_distance.mean < unaligned.cloud.distance.mean * 10.0
    );
    assert!(evaluate_cloud(&[], &scan, &start, Alignment::Rigid).is_none());
}

#[test]
fn coarse_alignment_needs_no_initial_guess() {
    let drive = drive("none");
    let scanner = LidarOptions {
        every_turns: 10,
        azimuth_step_rad: 1f64.to_radians(),
        ..LidarOptions::default()
    };
    let scan = reference_cloud(&drive, &scanner).unwrap();
    // Another scan of the same drive, moved by a similarity, with outliers.
    let other = LidarOptions { azimuth_step_rad: 1.3f64.to_radians(), seed: 1, ..scanner };
    let moved = Sim3 {
        scale: 0.03,
        rotation: tiepoint_pipeline::eval::geometry::so3::exp(&Vector3::new(0.5, -2.0, 1.0)),
        translation: Vector3::new(30.0, -20.0, 10.0),
    };
    let mut cloud: Vec<_> =
        reference_cloud(&drive, &other).unwrap().iter().map(|p| moved * *p).collect();
    cloud.extend((0..20).map(|k| Vector3::new(1000.0, f64::from(k), 0.0)));
    let start = find_alignment(&cloud, &scan).unwrap();
    let found = evaluate_cloud(&cloud, &scan, &start, Alignment::Similarity).unwrap();
    // At 10 m the points of a scan are half a metre apart, with noise of 1.5 cm: ICP changes the
    // scale by some 1e-3.
    assert!((found.cloud.scale * moved.scale - 1.0).abs() < 0.01, "{found:?}");
    assert!(found.cloud.distance.median < 0.3, "{found:?}");
    let line: Vec<_> = (0..50).map(|k| Vector3::new(f64::from(k), 0.0, 0.0)).collect();
    assert!(find_alignment(&line, &line).is_none());
    assert!(find_alignment(&[], &scan).is_none());
}
