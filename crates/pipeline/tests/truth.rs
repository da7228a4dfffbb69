//! Evaluation on a rendered drive: the true model has no error, and added errors are measured.
#![allow(clippy::unwrap_used)]

use tiepoint_pipeline::eval::find_alignment;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::geometry::{Rigid3, Sim3};
use tiepoint_pipeline::eval::{Alignment, TrueObservation};
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Keypoint, Observation, Reconstruction, Track};
use tiepoint_pipeline::{
    CameraError, ReportModel, ReportSection, Table, evaluate_cloud, evaluate_rig, evaluate_surface,
    report_html,
};
use tiepoint_synth::{Drive, DriveOptions, LidarOptions, reference_cloud};

/// Rounding of projection and ray casting at distances up to 100 m.
const TOLERANCE_M: f64 = 1e-5;

fn drive(effects: &str) -> Drive {
    let options = DriveOptions {
        effects: effects.parse().unwrap(),
        length_m: 160.0,
        ..DriveOptions::default()
    };
    let mut drive = Drive::new(&options).unwrap();
    drive.keep_first(30);
    drive
}

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

/// The true model with the surface points at a grid of pixels of the left camera that the right
/// camera sees as well.
fn truth_with_points(drive: &Drive) -> Reconstruction {
    let bare = drive.truth();
    let mut keypoints: Vec<Vec<Keypoint>> = bare.images().map(|_| Vec::new()).collect();
    let mut tracks = Vec::new();
    let frames = drive.cameras()[0].exposures.len().min(drive.cameras()[1].exposures.len());
    for frame in 0..frames {
        for cell in 0..80u32 {
            let pixel = Vector2::new(
                f64::from(cell % 10) * 60.0 + 40.0,
                f64::from(cell / 10) * 50.0 + 60.0,
            );
            let times = [0, 1].map(|camera| drive.cameras()[camera].exposures[frame].time_s);
            let Some(seen) = drive.surface_at(0, times[0], &pixel).filter(|seen| !seen.is_moving)
            else {
                continue;
            };
            let Some(other) = drive.project(1, times[1], &seen.point_in_world) else { continue };
            let is_same = drive.surface_at(1, times[1], &other).is_some_and(|back| {
                (back.point_in_world - seen.point_in_world).norm() < TOLERANCE_M
            });
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
    let rigs = evaluate_rig(&model, 1.0);
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
    let rig = &evaluate_rig(&model, 2.0)[0];
    assert!((rig.translation_drift - 2.0 * 0.29).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline_drift - 0.29 / (0.5 + 0.145)).abs() < TOLERANCE_M, "{rig:?}");
    assert!((rig.baseline.max - 2.0 * 0.79).abs() < TOLERANCE_M, "{rig:?}");
    assert_eq!(rig.times_s.len(), rig.series.centres.len());
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

#[test]
fn report_shows_models_side_by_side_and_escapes_names() {
    let drive = drive("none");
    let model = truth_with_points(&drive);
    // All centres are 1 m off horizontally and 2 m too low.
    let error = Vector3::new(0.6, 0.8, -2.0);
    let errors = model.registered().map(|(_, image, pose)| CameraError {
        camera: image.camera.index(),
        estimated_centre: pose.origin_in_a() + error,
        true_centre: pose.origin_in_a(),
    });
    let camera_errors: Vec<CameraError> = errors.collect();
    let report_model = ReportModel {
        name: "off",
        model: &model,
        world_from_model: Some(Sim3::identity()),
        report: None,
        camera_errors: &camera_errors,
        cloud_errors: &[],
        dense: None,
        photos: None,
    };
    let other = ReportModel { name: "</script>paper", ..report_model };
    let rows = vec![("ATE".to_owned(), vec!["1 m".to_owned(), "2 m".to_owned()])];
    let table = Table::of_columns(&["off".to_owned(), "paper".to_owned()], rows);
    let section = ReportSection {
        heading: "open",
        note: "a note",
        tables: &[table],
        models: &[report_model, other],
    };
    let page = report_html("a drive", &[section], vec![("rig.json", "{}".to_owned())]);
    assert_eq!(page.matches("</script>").count(), 2, "the template's own");
    let data = page.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["files"][0], serde_json::json!(["rig.json", "{}"]));
    let data = &data["sections"][0];
    assert_eq!([&data["heading"], &data["note"]], ["open", "a note"]);
    assert_eq!(data["tables"][0]["rows"][0], serde_json::json!(["ATE", ["1 m", "2 m"]]));
    let trajectory = &data["models"][0]["trajectory"];
    let series = |name: &str| -> Vec<f64> {
        trajectory[name].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    assert_eq!(series("truth").len(), 3 * 30, "of the first camera");
    // Up is the mean up direction of the cameras: the pitch of the vehicle changes it by 1 %.
    assert!(series("horizontal").iter().all(|m| (m - 1.0).abs() < 0.02), "{trajectory}");
    assert!(series("vertical").iter().all(|m| (m + 2.0).abs() < 0.02), "{trajectory}");
    assert!(series("path_length").windows(2).all(|pair| pair[0] < pair[1]), "{trajectory}");
    assert_eq!(data["models"][1]["name"], "</script>paper");
    for shown in data["models"].as_array().unwrap() {
        assert_eq!(shown["points_shown"], shown["num_points"]);
        // Four characters of base64 are three bytes; a position has six bytes.
        let count = shown["num_points"].as_u64().unwrap() as usize;
        assert_eq!(shown["points"].as_str().unwrap().len(), (6 * count).div_ceil(3) * 4);
        assert_eq!(shown["cameras"][0]["corners"].as_array().unwrap().len(), 15 * 30);
        assert_eq!(shown["errors"]["counts"][0], 2 * count, "the truth has no reprojection error");
        assert_eq!(shown["track_lengths"]["counts"][0], count);
        let baselines = shown["rigs"][0]["baselines"].as_array().unwrap();
        assert!(baselines.iter().all(|b| (b.as_f64().unwrap() - 0.5).abs() < TOLERANCE_M));
    }
    // Every point is common to the two images of one frame.
    let matrix = &data["models"][0]["covisibility"];
    assert_eq!(matrix["side"], 60);
    let total: u64 = matrix["counts"].as_array().unwrap().iter().map(|c| c.as_u64().unwrap()).sum();
    assert_eq!(total, 2 * model.num_tracks() as u64);
}
