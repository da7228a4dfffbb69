//! The measures of a drive: nothing is wrong with the truth, and what is made wrong is measured.
#![allow(clippy::unwrap_used)]

use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::geometry::{Rigid3, Sim3};
use tiepoint_pipeline::eval::{Alignment, Sighting};
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Keypoint, Observation, Reconstruction, Track};
use tiepoint_pipeline::{evaluate_cloud, evaluate_rig, evaluate_surface};
use tiepoint_synth::{Drive, DriveOptions, LidarOptions, reference_cloud};

/// Through lens and shutter and back, at distances up to 100 m.
const TOLERANCE_M: f64 = 1e-5;

fn drive(effects: &str) -> Drive {
    let options =
        DriveOptions { effects: effects.parse().unwrap(), length_m: 160.0, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).unwrap();
    drive.keep_first(30);
    drive
}

fn sighting(drive: &Drive, image: &Image, pixel: &Vector2<f64>) -> Sighting {
    let (camera, exposure) = drive.find(&image.name).unwrap();
    let surface = drive.surface_at(camera, exposure.time_s, pixel);
    Sighting {
        camera_in_world: drive.row_pose(camera, exposure.time_s, pixel.y).world_from_cam.translation,
        surface_in_world: surface.filter(|surface| !surface.is_moving).map(|surface| surface.point_in_world),
    }
}

/// The true model with points: those that a grid of pixels of the left camera sees, where the right camera sees them as well.
fn truth_with_points(drive: &Drive) -> Reconstruction {
    let bare = drive.truth();
    let mut keypoints: Vec<Vec<Keypoint>> = bare.images().map(|_| Vec::new()).collect();
    let mut tracks = Vec::new();
    let frames = drive.cameras()[0].exposures.len().min(drive.cameras()[1].exposures.len());
    for frame in 0..frames {
        for cell in 0..80u32 {
            let pixel = Vector2::new(f64::from(cell % 10) * 60.0 + 40.0, f64::from(cell / 10) * 50.0 + 60.0);
            let times = [0, 1].map(|camera| drive.cameras()[camera].exposures[frame].time_s);
            let Some(seen) = drive.surface_at(0, times[0], &pixel).filter(|seen| !seen.is_moving) else {
                continue;
            };
            let Some(other) = drive.project(1, times[1], &seen.point_in_world) else { continue };
            let is_same = drive
                .surface_at(1, times[1], &other)
                .is_some_and(|back| (back.point_in_world - seen.point_in_world).norm() < TOLERANCE_M);
            if !is_same {
                continue;
            }
            let images = [frame, drive.cameras()[0].exposures.len() + frame];
            let observe = |(image, pixel): (usize, Vector2<f64>)| {
                keypoints[image].push(Keypoint { pixel, scale_px: 1.0 });
                let keypoint = keypoints[image].len() as u32 - 1;
                Observation { image: ImageId(image as u32), keypoint }
            };
            let observations = images.into_iter().zip([pixel, other]).map(observe).collect();
            tracks.push((seen.point_in_world, observations));
        }
    }
    let mut model = Reconstruction::default();
    for (_, camera) in bare.cameras() {
        model.add_camera(*camera);
    }
    for ((_, image), keypoints) in bare.images().zip(keypoints) {
        let id = model.add_image(Image::new(image.name.clone(), image.camera, keypoints));
        model.set_time(id, image.time_s);
        model.register(id, *image.cam_from_world().unwrap());
    }
    for (xyz, observations) in tracks {
        model.add_track(Track::new(xyz, observations));
    }
    model.validate().unwrap();
    model
}

#[test]
fn the_truth_has_no_error_and_a_shift_is_measured() {
    for effects in ["none", "lens+rolling-shutter+traffic"] {
        let drive = drive(effects);
        let mut model = truth_with_points(&drive);
        let truth_from_model = Sim3 { scale: 2.0, ..Sim3::identity() };
        model.transform(&truth_from_model.inverse());
        let evaluate = |model: &Reconstruction| {
            evaluate_surface(model, &truth_from_model, |i, p| sighting(&drive, i, p)).unwrap()
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
        assert!((shifted.distance.median - 0.5).abs() < TOLERANCE_M, "{effects}: {:?}", shifted.distance);
        assert!((shifted.near.unwrap().mean - 0.5).abs() < TOLERANCE_M);
        assert!(shifted.distance.std < TOLERANCE_M);
        assert_eq!(shifted.floor, exact.floor);
        assert_eq!(shifted.errors.len(), shifted.points);
    }
}

#[test]
fn the_true_rig_is_rigid_and_a_drifting_one_is_not() {
    let drive = drive("none");
    let mut model = drive.truth();
    let rigs = evaluate_rig(&model, 1.0);
    let rig = &rigs[0];
    assert_eq!((rigs.len(), rig.moments), (1, 30));
    assert_eq!(rig.cameras, ["left", "right"]);
    assert!((rig.baseline.mean - 0.5).abs() < TOLERANCE_M, "{rig:?}");
    assert!(
        rig.baseline.std < TOLERANCE_M && rig.translation_rms < TOLERANCE_M && rig.rotation_rms_deg < 1e-6
    );
    // The right camera moves off to its right by 1 cm an image; in units of half a metre.
    let right: Vec<(ImageId, Rigid3)> = model
        .registered()
        .filter(|(_, i, _)| i.name.starts_with("right"))
        .map(|(id, _, pose)| (id, *pose))
        .collect();
    for (k, (id, mut pose)) in right.into_iter().enumerate() {
        pose.translation.x -= 0.01 * k as f64;
        model.register(id, pose);
    }
    let rig = &evaluate_rig(&model, 2.0)[0];
    assert!((rig.translation_drift - 2.0 * 0.29).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline_drift - 0.29 / (0.5 + 0.145)).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline.max - 2.0 * 0.79).abs() < TOLERANCE_M, "{rig:?}");
    assert_eq!(rig.times_s.len(), rig.series.centres.len());
}

#[test]
fn a_moved_cloud_is_put_back_onto_its_scan() {
    let drive = drive("none");
    let scanner =
        LidarOptions { every_turns: 10, azimuth_step_rad: 1f64.to_radians(), ..LidarOptions::default() };
    let scan = reference_cloud(&drive, &scanner).unwrap();
    let cloud: Vec<Vector3<f64>> = scan.iter().step_by(3).copied().collect();
    let moved = Sim3 {
        scale: 0.25,
        rotation: tiepoint_pipeline::eval::geometry::so3::exp(&Vector3::new(0.02, -0.01, 0.03)),
        translation: Vector3::new(0.3, -0.2, 0.1),
    };
    let cloud: Vec<_> = cloud.iter().map(|point| moved * *point).collect();
    // From roughly where it belongs, as cameras would give it.
    let start = Sim3 { scale: 4.0, ..Sim3::identity() };
    let found = evaluate_cloud(&cloud, &scan, &start, Alignment::Rigid).unwrap();
    assert!(found.distance.max < 1e-6, "{found:?}");
    assert!((found.scale - 4.0).abs() < 1e-9);
    let unaligned = evaluate_cloud(&cloud, &scan, &start, Alignment::None).unwrap();
    assert!(unaligned.distance.mean > 0.05, "{unaligned:?}");
    // Every third point is there, so the nearest to any is near.
    assert!(
        found.reference_distance.mean > 0.0 && found.reference_distance.mean < unaligned.distance.mean * 10.0
    );
    assert!(evaluate_cloud(&[], &scan, &start, Alignment::Rigid).is_none());
}
