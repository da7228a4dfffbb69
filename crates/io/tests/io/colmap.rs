//! COLMAP models: round trips, and errors of invalid files.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_io::Error;
use tiepoint_io::colmap::{Format, read_model, write_model};
use tiepoint_scene::{
    Camera, Frame, Image, Keypoint, Observation, Reconstruction, Rig, RigId, RigSensor, Track,
};

use crate::common::{RigKind, random_model};

const FORMATS: [Format; 2] = [Format::Binary, Format::Text];
/// Poses of images in frames are products of two transforms: a few roundings of numbers of size 10.
const POSE_TOLERANCE: f64 = 1e-12;

fn round_trip(model: &Reconstruction, format: Format) -> Reconstruction {
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), model, format).unwrap();
    read_model(dir.path()).unwrap()
}

#[test]
fn a_model_of_one_camera_of_any_kind_is_read_as_written() {
    for kind in CameraModelKind::ALL {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(*kind, 500.0, 640, 320);
        model.add_camera(Camera { intrinsics, width: 640, height: 320, has_focal_prior: false });
        for format in FORMATS {
            assert_eq!(round_trip(&model, format), model, "{kind:?} {format:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 32,
        failure_persistence: None,
        ..Default::default()
    })]

    /// Equal to the last bit: all numbers are f64 in both formats, and text has the digits that
    /// identify them.
    #[test]
    fn model_is_read_as_written(seed: u64, together: bool) {
        let rig_kind = if together { RigKind::SeveralCameras } else { RigKind::SingleCameras };
        let model = random_model(seed, rig_kind);
        for format in FORMATS {
            let read = round_trip(&model, format);
            // A frame of a single camera is dropped by the reader.
            prop_assert_eq!(&read, &model);
        }
    }

    /// A truncated binary file is refused without a panic.
    #[test]
    fn truncated_binary_is_refused(seed: u64, file in 0..5usize, cut in 0.0..1.0) {
        let dir = tempfile::tempdir().unwrap();
        let model = random_model(seed, RigKind::SeveralCameras);
        write_model(dir.path(), &model, Format::Binary).unwrap();
        let path = dir
            .path()
            .join(["cameras", "rigs", "frames", "images", "points3D"][file])
            .with_extension("bin");
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..(bytes.len() as f64 * cut) as usize]).unwrap();
        match read_model(dir.path()) {
            Err(Error::Bytes { path: named, .. }) => prop_assert_eq!(named, path),
            other => prop_assert!(false, "{:?}", other),
        }
    }

    /// Damaged files give a valid model or an error.
    #[test]
    fn damaged_files_never_panic(
        seed: u64,
        file in 0..5usize,
        place in 0.0..1.0,
        damage: [u8; 8],
        text: bool,
    ) {
        let dir = tempfile::tempdir().unwrap();
        let (format, suffix) = if text { (Format::Text, "txt") } else { (Format::Binary, "bin") };
        write_model(dir.path(), &random_model(seed, RigKind::SeveralCameras), format).unwrap();
        let path = dir
            .path()
            .join(["cameras", "rigs", "frames", "images", "points3D"][file])
            .with_extension(suffix);
        let mut bytes = fs::read(&path).unwrap();
        let start = (bytes.len() as f64 * place) as usize;
        for (byte, new) in bytes[start..].iter_mut().zip(damage) {
            *byte = if text { 32 + new % 96 } else { new };
        }
        fs::write(&path, &bytes).unwrap();
        if let Ok(model) = read_model(dir.path()) {
            prop_assert!(model.validate().is_ok());
        }
    }
}

fn camera() -> Camera {
    let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
    Camera { intrinsics, width: 640, height: 480, has_focal_prior: true }
}

fn keypoint() -> Keypoint {
    Keypoint { pixel: Vector2::new(1.5, 2.5), scale_px: 3.0 }
}

/// Two registered images and one without a pose between them; a point between deleted ones.
fn model_with_gaps() -> Reconstruction {
    let mut model = Reconstruction::default();
    let camera = model.add_camera(camera());
    let ids = ["a.png", "b.png", "c.png"]
        .map(|name| model.add_image(Image::new(name, camera, vec![keypoint(); 2])));
    model.register(ids[0], Rigid3::identity());
    model.register(ids[2], Rigid3::from_axis_angle(Vector3::x(), Vector3::y()));
    let track = |keypoint| {
        Track::new(
            Vector3::z(),
            vec![Observation { image: ids[0], keypoint }, Observation { image: ids[2], keypoint }],
        )
    };
    let gone = model.add_track(track(0));
    model.add_track(track(1));
    model.delete_track(gone);
    model
}

#[test]
fn only_registered_images_are_written_and_ids_stay() {
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), &model_with_gaps(), Format::Text).unwrap();
    let images = fs::read_to_string(dir.path().join("images.txt")).unwrap();
    assert!(
        images.contains("\n1 ") && !images.contains("b.png") && images.contains("\n3 "),
        "{images}"
    );
    let points = fs::read_to_string(dir.path().join("points3D.txt")).unwrap();
    assert!(points.contains("\n2 0 0 1 128 128 128 "), "{points}");
    let frames = fs::read_to_string(dir.path().join("frames.txt")).unwrap();
    assert!(frames.contains("\n3 1 ") && frames.ends_with(" 1 CAMERA 1 3\n"), "{frames}");

    let read = read_model(dir.path()).unwrap();
    let names: Vec<_> = read.images().map(|(_, image)| image.name.as_str()).collect();
    assert_eq!(names, ["a.png", "c.png"]);
    assert_eq!((read.num_tracks(), read.num_observations()), (1, 2));
    assert!(read.rigs.is_empty() && read.frames.is_empty());
}

#[test]
fn ids_of_a_model_that_was_read_stay() {
    // Of a workspace of ten cameras of which COLMAP's mapper kept the seventh.
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
    let files = [
        ("cameras.txt", "7 PINHOLE 640 480 500 500 320 240\n"),
        ("images.txt", "4 1 0 0 0 0 0 0 7 a.png\n1 2 90\n9 1 0 0 0 1 0 0 7 b.png\n1 2 90\n"),
        ("points3D.txt", "90 0 0 1 1 2 3 0.5 4 0 9 0\n"),
    ];
    for (name, content) in files {
        fs::write(dir.path().join(name), content).unwrap();
    }
    let model = read_model(dir.path()).unwrap();
    for format in FORMATS {
        assert_eq!(round_trip(&model, format), model);
    }
    write_model(dir.path(), &model, Format::Text).unwrap();
    for (name, content) in [
        ("cameras.txt", "\n7 PINHOLE"),
        ("images.txt", " 7 b.png\n1 2 90\n"),
        ("points3D.txt", "\n90 0 0 1 1 2 3 "),
        ("frames.txt", "\n9 7 1 0 0 0 1 0 0 1 CAMERA 7 9\n"),
        ("rigs.txt", "\n7 1 CAMERA 7\n"),
    ] {
        assert!(text(name).contains(content), "{content} in {}", text(name));
    }
    // What is added has the ids after the largest one, as long as there are such ids.
    let mut added = model.clone();
    let camera = added.add_camera(camera());
    let image = added.add_image(Image::new("c.png", camera, Vec::new()));
    added.register(image, Rigid3::identity());
    write_model(dir.path(), &added, Format::Text).unwrap();
    assert!(text("images.txt").contains("\n10 1 0 0 0 0 0 0 8 c.png\n"), "{}", text("images.txt"));
    let cameras = "4294967295 PINHOLE 640 480 500 500 320 240\n";
    fs::write(dir.path().join("cameras.txt"), cameras).unwrap();
    fs::write(dir.path().join("images.txt"), "").unwrap();
    fs::write(dir.path().join("points3D.txt"), "").unwrap();
    for name in ["rigs.txt", "frames.txt"] {
        fs::remove_file(dir.path().join(name)).unwrap();
    }
    let invalid = read_model(dir.path()).unwrap();
    let error = write_model(dir.path(), &invalid, Format::Text).unwrap_err().to_string();
    assert!(error.contains("ids of the cameras are too large"), "{error}");
}

#[test]
fn two_images_of_one_name_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = Reconstruction::default();
    let camera = model.add_camera(camera());
    for name in ["a.jpg", "b.jpg"] {
        let id = model.add_image(Image::new(name, camera, vec![]));
        model.register(id, Rigid3::identity());
    }
    write_model(dir.path(), &model, Format::Text).unwrap();
    let images = dir.path().join("images.txt");
    let text = fs::read_to_string(&images).unwrap();
    fs::write(&images, text.replace("b.jpg", "a.jpg")).unwrap();
    let error = read_model(dir.path()).unwrap_err().to_string();
    assert!(error.contains("two of its images have the name a.jpg"), "{error}");
}

#[test]
fn image_outside_the_frames_of_its_rig_gets_a_frame_of_that_rig() {
    let mut model = Reconstruction::default();
    let (left, right) = (model.add_camera(camera()), model.add_camera(camera()));
    let cam_from_rig = Rigid3::from_axis_angle(Vector3::y(), Vector3::x());
    model.rigs.push(Rig {
        sensors: vec![
            RigSensor { camera: left, cam_from_rig: Some(Rigid3::identity()) },
            RigSensor { camera: right, cam_from_rig: Some(cam_from_rig) },
        ],
    });
    let [a, b, lone] = [("a", left), ("b", right), ("lone", right)]
        .map(|(name, camera)| model.add_image(Image::new(name, camera, vec![])));
    model.register(a, Rigid3::identity());
    model.register(b, cam_from_rig);
    let elsewhere = Rigid3::from_axis_angle(Vector3::z(), Vector3::z());
    model.register(lone, elsewhere);
    model.frames.push(Frame {
        rig: RigId(0),
        rig_from_world: Rigid3::identity(),
        images: vec![a, b],
    });
    for format in FORMATS {
        let read = round_trip(&model, format);
        assert_eq!(read.rigs, model.rigs);
        assert_eq!(read.frames.len(), 2);
        assert_eq!(read.frames[1].images, [lone]);
        let given = cam_from_rig * read.frames[1].rig_from_world;
        assert!((given.translation - elsewhere.translation).norm() < POSE_TOLERANCE);
        // acos near 1 loses half of the digits.
        assert!(given.rotation.angle_to(&elsewhere.rotation) < 1e-7);
    }

    // A pose that no frame can give cannot be written for COLMAP.
    model.frames[0].rig_from_world = elsewhere;
    let error =
        write_model(tempfile::tempdir().unwrap().path(), &model, Format::Binary).unwrap_err();
    assert!(error.to_string().contains("not the one that its frame and rig give it"), "{error}");
}

#[test]
fn image_of_a_sensor_without_pose_keeps_its_pose_and_is_in_no_frame() {
    let dir = tempfile::tempdir().unwrap();
    let model = random_model(1, RigKind::SeveralCameras);
    write_model(dir.path(), &model, Format::Text).unwrap();
    let others: String =
        (2..=model.rigs[0].sensors.len()).map(|id| format!(" CAMERA {id} 0")).collect();
    let rig = format!("1 {} CAMERA 1{others}", model.rigs[0].sensors.len());
    let path = dir.path().join("rigs.txt");
    let lines = fs::read_to_string(&path).unwrap();
    let lines = lines.lines().map(|line| if line.starts_with("1 ") { &rig } else { line });
    fs::write(&path, lines.collect::<Vec<_>>().join("\n")).unwrap();
    let read = read_model(dir.path()).unwrap();
    let poses =
        |model: &Reconstruction| model.registered().map(|(.., pose)| *pose).collect::<Vec<_>>();
    assert_eq!(poses(&read), poses(&model));
    // One camera remains, which is not a rig.
    assert_eq!((read.rigs.len(), read.frames.len()), (0, 0));
    // The model can be written again.
    assert_eq!(poses(&round_trip(&read, Format::Text)), poses(&model));
}

/// The mapper of COLMAP makes such tracks.
#[test]
fn a_track_may_hold_two_keypoints_of_an_image() {
    let mut model = model_with_gaps();
    let (point, _) = model.tracks().next().unwrap();
    model.add_observation(point, Observation { image: tiepoint_scene::ImageId(0), keypoint: 0 });
    for format in FORMATS {
        let read = round_trip(&model, format);
        assert_eq!(
            read.tracks().map(|(_, track)| track.observations.len()).collect::<Vec<_>>(),
            [3]
        );
    }
}

fn with_files(files: &[(&str, &str)]) -> Result<Reconstruction, Error> {
    let dir = tempfile::tempdir().unwrap();
    write_model(dir.path(), &model_with_gaps(), Format::Text).unwrap();
    for (name, content) in files {
        fs::write(dir.path().join(name), content).unwrap();
    }
    read_model(dir.path())
}

#[test]
fn errors_name_the_violation() {
    let points = "1 0 0 1 9 9 9 0.5 1 0 2 0\n";
    for (files, expected) in [
        (vec![("cameras.txt", "1 NO_SUCH 640 480 1")], "line 1: unknown camera model `NO_SUCH`"),
        (
            vec![("cameras.txt", "\n1 PINHOLE 640 480 500 500 320")],
            "line 2: camera model PINHOLE takes 4",
        ),
        (vec![("cameras.txt", "1 PINHOLE 640 480 NaN 500 320 240")], "a parameter is NaN"),
        (vec![("cameras.txt", "")], "image a.png names camera 1, which does not exist"),
        (
            vec![("images.txt", "1 0 0 0 0 0 0 0 1 a.png\n\n")],
            "a quaternion of norm 0 is no rotation",
        ),
        (vec![("images.txt", "1 1 0 0 0 0 0 0 1\n\n")], "line 1: the image has no name"),
        (vec![("points3D.txt", points)], "names another point"),
        (vec![("points3D.txt", "2 0 0 1 9 9 9 0.5 1 7\n")], "which has 2 keypoints"),
        (vec![("points3D.txt", "2 0 0 1 9 9 9 0.5 1 1\n")], "whose track does not hold it"),
        (vec![("points3D.txt", "1 0 0 1 256 0 0 0.5\n")], "red is `256`, not a number in range"),
        (vec![("rigs.txt", "1 1 IMU 1\n")], "is no camera, which is not supported"),
        (vec![("rigs.txt", "1 1 CAMERA 1\n2 1 CAMERA 1\n")], "camera 1 is on two rigs"),
        (vec![("frames.txt", "1 9 1 0 0 0 0 0 0 0\n")], "frame 1 names rig 9"),
        (
            vec![("frames.txt", "1 1 1 0 0 0 0 0 0 4294967295\n")],
            "ends where a sensor's kind should be",
        ),
    ] {
        let error = with_files(&files).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error} for {files:?}");
    }
}

#[test]
fn poses_of_frames_override_poses_of_images() {
    // COLMAP 4.2.1 ignores the poses of images.txt where there are frames.
    let frames = "1 1 1 0 0 0 5 0 0 1 CAMERA 1 1\n3 1 1 0 0 0 6 0 0 1 CAMERA 1 3\n";
    let model = with_files(&[("frames.txt", frames)]).unwrap();
    let x: Vec<_> = model.registered().map(|(.., pose)| pose.translation.x).collect();
    assert_eq!(x, [5.0, 6.0]);
}

#[test]
fn models_without_rigs_are_read_and_empty_folders_refused() {
    let dir = tempfile::tempdir().unwrap();
    let error = read_model(dir.path()).unwrap_err().to_string();
    assert!(error.contains("holds no COLMAP model"), "{error}");
    assert!(matches!(read_model(&dir.path().join("absent")), Err(Error::Io { .. })));
    for (format, suffix) in [(Format::Binary, "bin"), (Format::Text, "txt")] {
        let dir = dir.path().join(suffix);
        write_model(&dir, &model_with_gaps(), format).unwrap();
        let with = read_model(&dir).unwrap();
        for name in ["rigs", "frames"] {
            fs::remove_file(dir.join(name).with_extension(suffix)).unwrap();
        }
        assert_eq!(read_model(&dir).unwrap(), with);
    }
}

#[test]
fn failed_write_leaves_no_files() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = model_with_gaps();
    let camera = tiepoint_scene::CameraId(0);
    let id = model.add_image(Image::new("two\nlines.png", camera, vec![]));
    model.register(id, Rigid3::identity());
    assert!(write_model(dir.path(), &model, Format::Text).is_err());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    assert!(write_model(Path::new("/proc/nowhere"), &model, Format::Binary).is_err());
}
