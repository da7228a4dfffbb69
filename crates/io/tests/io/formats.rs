//! Trajectories, ground truth, PLY and BAL: round trips, and files of other programs.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_io::bal::{Bal, BalCamera, BalError, BalObservation};
use tiepoint_io::ply::{self, Vertex};
use tiepoint_io::trajectory::{
    TimedPose, read_euroc, read_kitti, read_tum, write_euroc, write_kitti, write_tum,
};
use tiepoint_io::{
    calibration, colmap, control_points, gpx, kitti, position_priors, positions, rig_calibration,
    similarity, strecha, timestamps,
};

use crate::common::{RigKind, pose, random_model, vector};
use crate::skipped;

/// Poses are inverted by the writer and the reader: roundings of numbers of size 30.
const POSE_TOLERANCE: f64 = 1e-12;
/// arccos near 1 loses half of the digits of small angles.
const ANGLE_TOLERANCE_RAD: f64 = 1e-7;

fn close(a: &Rigid3, b: &Rigid3) -> bool {
    (a.translation - b.translation).norm() < POSE_TOLERANCE
        && a.rotation.angle_to(&b.rotation) < ANGLE_TOLERANCE_RAD
}

fn in_file<T>(content: impl AsRef<[u8]>, read: impl FnOnce(&Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file");
    fs::write(&path, content).unwrap();
    read(&path)
}

fn round_trip<T>(write: impl FnOnce(&Path), read: impl FnOnce(&Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file");
    write(&path);
    read(&path)
}

fn random_bal(rng: &mut Rng) -> Bal {
    let cameras: Vec<_> = (0..1 + rng.below(4))
        .map(|_| BalCamera {
            axis_angle_rad: vector(rng, 0.8),
            translation: vector(rng, 3.0),
            focal_px: 300.0 + 100.0 * rng.uniform(),
            k1: 0.01 * rng.normal(),
            k2: 0.001 * rng.normal(),
        })
        .collect();
    let points: Vec<_> = (0..rng.below(20)).map(|_| vector(rng, 5.0)).collect();
    let mut observations = Vec::new();
    for point in 0..points.len() as u32 {
        for camera in 0..cameras.len() as u32 {
            if rng.uniform() < 0.7 {
                let pixel = Vector2::new(rng.normal(), rng.normal()) * 100.0;
                observations.push(BalObservation { camera, point, pixel });
            }
        }
    }
    Bal { cameras, points, observations }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 32,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn trajectories_are_read_as_written(seed: u64, count in 0..10usize) {
        let mut rng = Rng::stream(seed, &[]);
        let poses: Vec<TimedPose> = (0..count)
            .map(|k| TimedPose {
                time_s: 1.4e9 + k as f64 + rng.uniform(),
                cam_from_world: pose(&mut rng),
            })
            .collect();
        let tum =
            round_trip(|path| write_tum(path, &poses).unwrap(), |path| read_tum(path).unwrap());
        let euroc =
            round_trip(|path| write_euroc(path, &poses).unwrap(), |path| read_euroc(path).unwrap());
        let bare: Vec<Rigid3> = poses.iter().map(|pose| pose.cam_from_world).collect();
        let kitti =
            round_trip(|path| write_kitti(path, &bare).unwrap(), |path| read_kitti(path).unwrap());
        prop_assert_eq!((tum.len(), euroc.len(), kitti.len()), (count, count, count));
        for k in 0..count {
            prop_assert!(tum[k].time_s == poses[k].time_s && euroc[k].time_s == poses[k].time_s);
            for read in [&tum[k].cam_from_world, &euroc[k].cam_from_world, &kitti[k]] {
                prop_assert!(close(read, &bare[k]), "{:?} {:?}", read, bare[k]);
            }
        }
    }

    /// Single precision on disk.
    #[test]
    fn ply_is_read_as_written(seed: u64, count in 0..20usize) {
        let mut rng = Rng::stream(seed, &[]);
        let vertices: Vec<Vertex> = (0..count)
            .map(|k| Vertex {
                xyz: vector(&mut rng, 5.0).map(|v| f64::from(v as f32)),
                color: [k as u8, 255, 0],
            })
            .collect();
        let read = round_trip(
            |path| ply::write(path, &vertices).unwrap(),
            |path| ply::read(path).unwrap(),
        );
        prop_assert_eq!(read, vertices);
    }

    #[test]
    fn bal_is_read_as_written(seed: u64) {
        let bal = random_bal(&mut Rng::stream(seed, &[]));
        prop_assert_eq!(
            &round_trip(|path| bal.write(path).unwrap(), |path| Bal::read(path).unwrap()),
            &bal
        );
    }

    /// Projections by the formula of the format and by our cameras are equal, also after a
    /// conversion back.
    #[test]
    fn bal_and_reconstruction_are_one_problem(seed: u64) {
        let bal = random_bal(&mut Rng::stream(seed, &[]));
        let model = bal.to_reconstruction().unwrap();
        prop_assert!(model.validate().is_ok());
        prop_assert_eq!(model.num_observations(), bal.observations.len());
        for observation in &bal.observations {
            let camera = &bal.cameras[observation.camera as usize];
            let point = &bal.points[observation.point as usize];
            let residual = (camera.project(point).unwrap() - observation.pixel).norm();
            let image = tiepoint_scene::ImageId(observation.camera);
            let track = model.track(tiepoint_scene::PointId(observation.point)).unwrap();
            let ours = track.observations.iter().find(|o| o.image == image).unwrap();
            // Our cameras do not image points behind them.
            if let Some(error) = model.observation_error_px(ours, point) {
                prop_assert!(
                    (error - residual).abs() < 1e-9 * (1.0 + residual),
                    "{} {}",
                    error,
                    residual
                );
            }
        }
        let back = Bal::from_reconstruction(&model).unwrap();
        prop_assert_eq!(back.points, bal.points);
        for (a, b) in back.cameras.iter().zip(&bal.cameras) {
            prop_assert!(
                (a.axis_angle_rad - b.axis_angle_rad).norm() < POSE_TOLERANCE
                    || b.axis_angle_rad.norm() > 3.0
            );
            prop_assert_eq!(
                (a.translation, a.focal_px, a.k1, a.k2),
                (b.translation, b.focal_px, b.k1, b.k2)
            );
        }
        for (a, b) in back.observations.iter().zip(&bal.observations) {
            prop_assert!(
                (a.camera, a.point) == (b.camera, b.point)
                    && (a.pixel - b.pixel).norm() < POSE_TOLERANCE * 100.0
            );
        }
    }

    /// Damaged and truncated files give values or an error.
    #[test]
    fn damaged_files_never_panic(
        seed: u64,
        which in 0..6usize,
        place in 0.0..1.0,
        damage: [u8; 6],
        cut: bool,
    ) {
        let mut rng = Rng::stream(seed, &[]);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        let poses = [TimedPose { time_s: 1.5, cam_from_world: pose(&mut rng) }; 3];
        match which {
            0 => write_tum(&path, &poses).unwrap(),
            1 => write_euroc(&path, &poses).unwrap(),
            2 => write_kitti(&path, &poses.map(|pose| pose.cam_from_world)).unwrap(),
            3 => ply::write(&path, &[Vertex { xyz: vector(&mut rng, 1.0), color: [1, 2, 3] }; 4])
                .unwrap(),
            4 => fs::write(&path, ASCII_PLY).unwrap(),
            _ => random_bal(&mut rng).write(&path).unwrap(),
        }
        let mut bytes = fs::read(&path).unwrap();
        let start = (bytes.len() as f64 * place) as usize;
        if cut {
            bytes.truncate(start);
        } else {
            bytes[start..].iter_mut().zip(damage).for_each(|(byte, new)| *byte = new);
        }
        fs::write(&path, bytes).unwrap();
        match which {
            0 => drop(read_tum(&path)),
            1 => drop(read_euroc(&path)),
            2 => drop(read_kitti(&path)),
            3 | 4 => drop(ply::read(&path)),
            _ => drop(Bal::read(&path).map(|bal| bal.to_reconstruction())),
        }
    }
}

const ASCII_PLY: &str = "ply\r\nformat ascii 1.0\r\ncomment made by hand\nelement face \
2\nproperty list uchar int vertex_indices\n\
    element vertex 3\nproperty double z\nproperty float nx\nproperty float y\nproperty float x\n\
    property uint8 blue\nproperty uint8 green\nproperty uint8 red\nend_header\n\
    3 0 1 2\n2 0 1\n1.5 0 2 -3e2 1 2 3\n 4 5 6 7 8 9 10\nnan 0 0 0 0 0 0\n";

#[test]
fn ply_files_of_other_programs_are_read() {
    let vertices = in_file(ASCII_PLY, |path| ply::read(path).unwrap());
    let expected = [
        Vertex { xyz: Vector3::new(-300.0, 2.0, 1.5), color: [3, 2, 1] },
        Vertex { xyz: Vector3::new(7.0, 6.0, 4.0), color: [10, 9, 8] },
    ];
    assert_eq!(vertices, expected);

    let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float \
    x\nproperty int16 y\nproperty double z\n\
        property float red\nproperty list uint8 ushort tail\nend_header\n"
        .to_vec();
    big.extend(1.5f32.to_be_bytes());
    big.extend((-2i16).to_be_bytes());
    big.extend(3.25f64.to_be_bytes());
    big.extend(0.5f32.to_be_bytes());
    big.extend([2, 0, 1, 0, 2]);
    let vertices = in_file(&big, |path| ply::read(path).unwrap());
    assert_eq!(vertices, [Vertex { xyz: Vector3::new(1.5, -2.0, 3.25), color: [128, 128, 128] }]);

    let header = "ply\nformat ascii 1.0\nelement vertex";
    for (content, expected) in [
        (String::new(), "the file ends within a line"),
        ("no\n".to_owned(), "is no PLY file"),
        (format!("{header} 1\nproperty float x\nend_header\n1\n"), "a vertex has no property `y`"),
        (format!("{header} -1\nend_header\n"), "the header says `element vertex -1`"),
        (format!("{header} 1\nproperty float128 x\n"), "the header says `property float128 x`"),
        (
            "ply\nelement vertex 0\nproperty float x\nproperty float y\nproperty float \
            z\nend_header\n"
                .to_owned(),
            "names no format",
        ),
        (
            format!(
                "{header} 4000000000000\nproperty float x\nproperty float y\nproperty float \
                z\nend_header\n1 2 3\n"
            ),
            "4000000000000 × vertex are announced, but 6 bytes follow",
        ),
    ] {
        let error = in_file(&content, |path| ply::read(path).unwrap_err().to_string());
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn ply_of_points_and_camera_centres() {
    let model = random_model(3, RigKind::SeveralCameras);
    assert_eq!(ply::points(&model).len(), model.num_tracks());
    let centres = ply::camera_centres(&model);
    assert_eq!(centres.len(), model.num_registered());
    let (_, image, pose) = model.registered().next().unwrap();
    assert_eq!(centres[0].xyz, pose.origin_in_a(), "{}", image.name);
}

#[test]
fn trajectory_formats_agree_on_conventions() {
    // A camera at (1, 2, 3) that looks along +x: its z axis is the x axis of the world, its x axis
    // is −y of the world.
    let rows = "0 0 1 1 -1 0 0 2 0 -1 0 3\n";
    let pose = in_file(rows, |path| read_kitti(path).unwrap()[0]);
    assert!((pose.origin_in_a() - Vector3::new(1.0, 2.0, 3.0)).norm() < POSE_TOLERANCE);
    assert!(
        (pose * Vector3::new(6.0, 2.0, 3.0) - Vector3::new(0.0, 0.0, 5.0)).norm() < POSE_TOLERANCE
    );
    // The same pose in the two other formats: the quaternion of the matrix is (w, x, y, z) = (1,
    // −1, 1, −1) / 2.
    let tum =
        in_file("# comment\n1.5 1 2 3 -0.5 0.5 -0.5 0.5\n", |path| read_tum(path).unwrap()[0]);
    let euroc = in_file("#timestamp\n1500000000, 1,2,3, 0.5,-0.5,0.5,-0.5, 9,9\n", |path| {
        read_euroc(path).unwrap()[0]
    });
    for other in [tum, euroc] {
        assert_eq!(other.time_s, 1.5);
        assert!(close(&other.cam_from_world, &pose));
    }
    for (content, expected) in [
        ("1 2 3 0 0 0 1", "line 1: ends where the quaternion should be"),
        ("\n1 1 2 3 0 0 0 0", "line 2: a quaternion of norm 0 is no rotation"),
        // Rotation first.
        ("\n1 0 0 0 1 1 2 3", "line 2: a quaternion of norm 3.87"),
        ("1 1 2 inf 0 0 0 1", "line 1: the position is inf"),
        ("1 1 2 3 0 0 0 1 5", "line 1: `5` follows"),
    ] {
        let error = in_file(content, |path| read_tum(path).unwrap_err().to_string());
        assert!(error.contains(expected), "{error}");
    }
    let error =
        in_file("2 0 0 0 0 1 0 0 0 0 1 0", |path| read_kitti(path).unwrap_err().to_string());
    assert!(error.contains("the matrix is no rotation"), "{error}");
}

#[test]
fn bal_errors_name_the_violation() {
    for (content, expected) in [
        ("", "line 1: the file ends where the numbers of cameras"),
        ("1 1 1\n0 1 2 3\n", "line 2: camera 0 sees point 1, but there are 1 cameras and 1 points"),
        ("1 0 0\n1 2 3 4 5 6 7 8", "line 3: the file ends where a camera's focal length"),
        ("1 0 18446744073709551615\n", "the file ends where an observation should be"),
    ] {
        let error = in_file(content, |path| Bal::read(path).unwrap_err().to_string());
        assert!(error.contains(expected), "{error}");
    }
    let mut model = Bal {
        cameras: vec![BalCamera { focal_px: 1.0, ..Default::default() }],
        ..Default::default()
    }
    .to_reconstruction()
    .unwrap();
    let camera = tiepoint_scene::CameraId(0);
    model.camera_mut(camera).intrinsics =
        Intrinsics::new(CameraModelKind::Pinhole, &[1.0, 2.0, 0.0, 0.0]).unwrap();
    assert_eq!(
        Bal::from_reconstruction(&model),
        Err(BalError::NotRadial { camera, model: "PINHOLE" })
    );
}

#[test]
fn strecha_cameras_look_at_the_scene() {
    let Some(data) = skipped::data() else { return };
    let cameras = strecha::read(&data.join("fountain-P11/cameras")).unwrap();
    assert_eq!(cameras.len(), 11);
    assert_eq!(
        (cameras[0].name.as_str(), cameras[0].width, cameras[0].height),
        ("0000.jpg", 3072, 2048)
    );
    let first = cameras[0].cam_from_world;
    assert!((first.origin_in_a() - Vector3::new(-7.28137, -7.57667, 0.204446)).norm() < 1e-12);
    assert_eq!(
        cameras[0].calibration,
        Matrix3::new(2759.48, 0.0, 1520.69, 0.0, 2764.16, 1006.81, 0.0, 0.0, 1.0)
    );
    // All cameras look at the fountain: the point nearest to their optical axes is in front of each
    // of them, within 15 m.
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for camera in &cameras {
        let axis = camera.cam_from_world.rotation.inverse() * Vector3::z();
        let across = Matrix3::identity() - axis * axis.transpose();
        a += across;
        b += across * camera.cam_from_world.origin_in_a();
    }
    let fountain = a.try_inverse().unwrap() * b;
    for camera in &cameras {
        let depth = (camera.cam_from_world * fountain).z;
        assert!((1.0..15.0).contains(&depth), "{} sees the fountain at {depth} m", camera.name);
    }
    assert!(
        strecha::read(&data.join("fountain-P11"))
            .unwrap_err()
            .to_string()
            .contains("holds no .camera files")
    );
}

#[test]
fn kitti_calibration_of_a_stereo_pair() {
    let Some(data) = skipped::data() else { return };
    let calibration = kitti::read_calibration(&data.join("kitti04/calib.txt")).unwrap();
    assert_eq!(
        calibration.cameras.iter().map(|camera| camera.number).collect::<Vec<_>>(),
        [0, 1, 2, 3]
    );
    assert_eq!(
        calibration.cameras[0].intrinsics.params(),
        [707.0912, 707.0912, 602.3873, 183.6104]
    );
    assert_eq!(calibration.cameras[0].cam_from_cam0, Rigid3::identity());
    // The baseline of the grey cameras of KITTI: 0.54 m to the right.
    let right = calibration.cameras[1].cam_from_cam0.origin_in_a();
    assert!((right - Vector3::new(0.537, 0.0, 0.0)).norm() < 1e-3, "{right}");
    // The x axis of the scanner points forward, as our z axis.
    let ahead = calibration.cam0_from_velodyne.unwrap().rotation * Vector3::x();
    assert!((ahead - Vector3::z()).norm() < 0.02, "{ahead}");
    let poses = read_kitti(&data.join("kitti04/poses.txt")).unwrap();
    assert_eq!(poses.len(), 51);
    let travelled = (poses[50].origin_in_a() - poses[0].origin_in_a()).norm();
    assert!((travelled - 69.1).abs() < 0.5, "{travelled}"); // SOURCE.md: 69.1 m
    assert!(
        ply::read(&data.join("kitti04/lidar_reference_voxel10cm.ply")).unwrap().len() > 1_000_000
    );
}

#[test]
fn trajectories_of_other_programs_are_read() {
    let Some(data) = skipped::data() else { return };
    let dir = data.join("trajectories");
    assert_eq!(read_kitti(&dir.join("KITTI_00_gt.txt")).unwrap().len(), 4541);
    assert!(read_tum(&dir.join("freiburg1_xyz-groundtruth.txt")).unwrap().len() > 1000);
    let truth = read_euroc(&dir.join("V102_groundtruth.csv")).unwrap();
    assert!(truth.len() > 1000 && (truth[0].time_s - 1_403_715_524.907_143).abs() < 1e-5);
}

/// BAL problems: the mean squared residual of the published initial values, computed with the
/// formula of the format and with our cameras.
#[test]
fn published_bal_problems_are_read() {
    let Some(data) = skipped::data() else { return };
    let bal = Bal::read(&data.join("bal/problem-21-11315-pre.txt")).unwrap();
    assert_eq!((bal.cameras.len(), bal.points.len(), bal.observations.len()), (21, 11315, 36455));
    let model = bal.to_reconstruction().unwrap();
    model.validate().unwrap();
    let cost: f64 = bal
        .observations
        .iter()
        .map(|o| {
            (bal.cameras[o.camera as usize].project(&bal.points[o.point as usize]).unwrap()
                - o.pixel)
                .norm_squared()
        })
        .sum();
    let ours: f64 = model
        .tracks()
        .flat_map(|(_, track)| {
            track.observations.iter().map(|o| model.observation_error_px(o, &track.xyz))
        })
        .map(|error| error.unwrap_or(f64::NAN).powi(2))
        .sum();
    assert!((ours / cost - 1.0).abs() < 1e-9, "{ours} {cost}");
}

#[test]
fn bal_numbers_after_the_last_point_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bal.txt");
    let good = "1 1 1\n0 0 1 2\n0 0 0 0 0 0 500 0 0\n0 0 -5";
    for (behind, says) in [
        ("", None),
        ("\n \n", None),
        (" 7.5\n", Some("line 4: `7.5` follows the last of 1 points")),
        ("\n\n1 2 3\n", Some("line 6: `1 2 3` follows the last of 1 points")),
    ] {
        std::fs::write(&path, good.to_owned() + behind).unwrap();
        let found = Bal::read(&path).err().map(|error| error.to_string());
        match (says, &found) {
            (None, None) => {}
            (Some(says), Some(found)) => assert!(found.contains(says), "{found}"),
            _ => panic!("{behind:?} {found:?}"),
        }
    }
}

/// A sparse file is as long as it announces, and takes no room on the disk.
#[cfg(target_os = "linux")]
#[test]
fn sparse_files_of_more_than_memory_are_refused() {
    // More than the address space of a process.
    const VERTICES: u64 = 1 << 44;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("huge.ply");
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {VERTICES}\nproperty uchar \
         x\nproperty uchar y\nproperty uchar z\nend_header\n"
    );
    std::fs::write(&path, &header).unwrap();
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    // File systems have limits of their own.
    if file.set_len(header.len() as u64 + 3 * VERTICES).is_ok() {
        let error = ply::read(&path).unwrap_err().to_string();
        assert!(error.contains("more than memory holds"), "{error}");
    }
}

#[test]
fn clouds_in_utm_coordinates_keep_their_millimetres() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("utm.ply");
    // Origins, and whether single precision holds a cloud of 100 m there.
    for (origin, is_single) in
        [([0.0; 3], true), ([300.0; 3], true), ([500_000.0, 5.4e6, 300.0], false)]
    {
        let vertices: Vec<Vertex> = (0..100)
            .map(|i| Vertex {
                xyz: Vector3::from(origin) + Vector3::new(f64::from(i), 0.001 * f64::from(i), 1.0),
                color: [1, 2, 3],
            })
            .collect();
        ply::write(&path, &vertices).unwrap();
        let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
        assert_eq!(text.contains("property float x"), is_single, "{origin:?}");
        for (read, written) in ply::read(&path).unwrap().iter().zip(&vertices) {
            assert!((read.xyz - written.xyz).amax() < 1e-4, "{origin:?}: {read:?}");
        }
    }
    ply::write(&path, &[]).unwrap();
    assert!(ply::read(&path).unwrap().is_empty());
}

/// Reads a file or the only file of a folder; the result as text.
type Reader = fn(&Path) -> String;

/// Every reader of text: the name of a file, its content, and the reader of the folder of it.
fn text_readers() -> Vec<(&'static str, &'static str, Reader)> {
    fn shown<T: std::fmt::Debug>(result: tiepoint_io::Result<T>) -> String {
        match result {
            Ok(value) => format!("{value:?}"),
            Err(error) => format!("error: {error}"),
        }
    }
    const CAMERA: &str = "1 0 0\n0 1 0\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 2 3\n640 480\n";
    vec![
        ("positions.txt", "1.jpg 1 2 3\n2.jpg 4 5 6\n", |p| shown(positions::read(p))),
        ("places.csv", "image,lat,lon,alt\n1.jpg,48.1,11.5,519\n", |p| {
            shown(position_priors::read(p))
        }),
        ("track.csv", "seconds,lat,lon,alt\n0.5,48.1,11.5,519\n", |p| {
            shown(position_priors::read_track(p))
        }),
        (
            "track.gpx",
            "<gpx><trkpt lat=\"1\" lon=\"2\"><time>2024-02-29T12:34:56Z</time></trkpt></gpx>",
            |p| shown(gpx::read(p)),
        ),
        ("times.csv", "image,seconds\n1.jpg,0.5\n", |p| shown(timestamps::read(p))),
        ("gcp_list.txt", "EPSG:32632\n691603 5334780 519 7 8 1.jpg a\n", |p| {
            shown(control_points::read(p))
        }),
        ("gcp.csv", "point,x,y,z,image,px,py\np,1,2,3,a.jpg,4,5\n", |p| {
            shown(control_points::read(p))
        }),
        ("tum.txt", "0.5 1 2 3 0 0 0 1\n", |p| shown(read_tum(p))),
        ("kitti.txt", "1 0 0 1 0 1 0 2 0 0 1 3\n", |p| shown(read_kitti(p))),
        ("euroc.csv", "5,1,2,3,1,0,0,0\n", |p| shown(read_euroc(p))),
        ("sim.txt", "2 1 0 0 0 1 2 3\n", |p| shown(similarity::read(p))),
        ("bal.txt", "1 0 0\n0 0 0 0 0 0 1 0 0\n", |p| shown(Bal::read(p))),
        ("0.jpg.camera", CAMERA, |p| shown(strecha::read(p.parent().unwrap()))),
        ("calib.txt", "P0: 700 0 600 0 0 700 180 0 0 0 1 0\n", |p| shown(calibration::read(p))),
        ("cameras.txt", "1 PINHOLE 640 480 500 500 320 240\n", |p| shown(calibration::read(p))),
        (
            "opencv.yml",
            "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n\
             camera_matrix: [500, 0, 320, 0, 500, 240, 0, 0, 1]\n",
            |p| shown(calibration::read(p)),
        ),
        (
            "camchain.yaml",
            "cam0:\n  camera_model: pinhole\n  intrinsics: [500, 500, 320, 240]\n  \
             resolution: [640, 480]\n",
            |p| shown(rig_calibration::read(p)),
        ),
        (
            "rig_config.json",
            r#"[{"cameras": [{"image_prefix": "a/", "ref_sensor": true}]}]"#,
            |p| shown(rig_calibration::read(p)),
        ),
    ]
}

#[test]
fn position_priors_have_optional_altitudes_and_deviations() {
    use tiepoint_scene::{Place, Position};
    let read = |text: &str| in_file(text, position_priors::read);
    let text = "image, Lat,lon,alt,sigma_h,sigma_v\n# a comment\na, b.jpg,-48.5,11.25,519,2,3.5\n\n\
                c.jpg, 1e-3 ,181,,,\n";
    let found = read(text).unwrap();
    let geodetic = |latitude_deg, longitude_deg, altitude_m, sigmas: [Option<f64>; 2]| Position {
        place: Place::Geodetic { latitude_deg, longitude_deg, altitude_m },
        sigma_horizontal_m: sigmas[0],
        sigma_vertical_m: sigmas[1],
    };
    assert_eq!(found["a, b.jpg"], geodetic(-48.5, 11.25, Some(519.0), [Some(2.0), Some(3.5)]));
    assert_eq!(found["c.jpg"], geodetic(0.001, 181.0, None, [None; 2]));
    let found = read("image,x,y,z,sigma\na.jpg,691000.25,-2,3,0.02\n").unwrap();
    let place = Place::Cartesian(Vector3::new(691000.25, -2.0, 3.0));
    let sigma = Some(0.02);
    assert_eq!(
        found["a.jpg"],
        Position { place, sigma_horizontal_m: sigma, sigma_vertical_m: sigma }
    );

    let track = |text: &str| in_file(text, position_priors::read_track);
    let found = track("seconds,lat,lon,alt\n7,-48.5,11.25,519\n-0.5,1,2,\n").unwrap();
    assert_eq!(found.times_s(), [-0.5, 7.0]);
    assert_eq!(found.positions()[1], geodetic(-48.5, 11.25, Some(519.0), [None; 2]));
    for (text, part) in [
        ("seconds,lat,lon,alt\n", "has no position"),
        ("seconds,lat,lon,alt\ninf,1,2,3\n", "the time is `inf`, not a number of seconds"),
        ("seconds,lat,lon,alt\n7,5,48,1,11,5,519\n", "decimals follow a point"),
        ("seconds,lat,lon,alt\n7,-90.1,1,2\n", "the latitude -90.1 is not from -90 to 90"),
        ("image,lat,lon,alt\na,1,2,3\n", "must be `seconds,lat,lon,alt` or `seconds,x,y,z`"),
    ] {
        let found = track(text).unwrap_err().to_string();
        assert!(found.contains(part), "{found}");
    }

    let header = "image,lat,lon,alt\n";
    for (text, parts) in [
        (String::new(), ["the header is ``", "`image,lat,lon,alt` or `image,x,y,z`"]),
        ("a.jpg 1 2 3\n".to_owned(), ["line 1", "`a.jpg 1 2 3`"]),
        ("image;lat;lon;alt\n".to_owned(), ["`image;lat;lon;alt`", "separated by commas"]),
        ("image,lon,lat,alt\n".to_owned(), ["the header is `image,lon,lat,alt`", "must be"]),
        (header.to_owned(), ["has no position", "file"]),
        (format!("{header}a.jpg,1,2\n"), ["line 2", "not a name and 3 numbers between commas"]),
        (format!("{header}a.jpg,48,1,11,5,519,2\n"), ["decimals follow a point", "not a comma"]),
        (format!("{header}a.jpg,48.1,nan,5\n"), ["the longitude of a.jpg is `nan`", "no number"]),
        (format!("{header}a.jpg,,2,5\n"), ["the latitude of a.jpg is ``", "no number"]),
        (
            format!("{header}a.jpg,139.7,35.7,5\n"),
            [
                "the latitude 139.7 is not from -90 to 90 for a.jpg",
                "latitude comes before longitude",
            ],
        ),
        (format!("{header}a.jpg,1,2,3\na.jpg,1,2,3\n"), ["line 3", "a.jpg is listed twice"]),
        ("image,x,y,z,sigma\na.jpg,1,2,3,0\n".to_owned(), ["the standard deviation 0", "above 0"]),
    ] {
        let message = read(&text).unwrap_err().to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "{text:?}: {message}");
    }
}

#[test]
fn control_points_have_marks_in_images() {
    use tiepoint_scene::Place;
    let read = |text: &str| in_file(text, control_points::read);
    let marks = "691603.031991 5334780.030903 519 10.5 20 a.jpg north\n\
                 691603.031991 5334780.030903 519 30 40 b.jpg north\n\
                 1 2 3 5 6 a.jpg CHK-one\n";
    for header in ["EPSG:32632", "WGS84 UTM 32N", "+proj=utm +zone=32 +ellps=WGS84 +units=m"] {
        let found = read(&format!("{header}\n{marks}")).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].name.as_str(), found[0].is_check), ("north", false));
        assert!(found[1].is_check);
        let expected = [("a.jpg", 10.5, 20.0), ("b.jpg", 30.0, 40.0)];
        let expected = expected.map(|(name, x, y)| (name.to_owned(), Vector2::new(x, y)));
        assert_eq!(found[0].marks, expected);
        // Of PROJ; a micrometre is 1e-11 degrees.
        let Place::Geodetic { latitude_deg, longitude_deg, altitude_m } = found[0].place else {
            panic!("{found:?}")
        };
        assert!((latitude_deg - 48.1374).abs() < 1e-10 && (longitude_deg - 11.5755).abs() < 1e-10);
        assert_eq!(altitude_m, Some(519.0));
    }
    // Without names, marks of one position are of one point; longitude comes first.
    let found = read("EPSG:4326\n11.5 48.1 5 1 2 a.jpg\n11.5 48.1 5 3 4 b.jpg\n").unwrap();
    assert_eq!((found.len(), found[0].name.as_str(), found[0].marks.len()), (1, "1", 2));
    let place = Place::Geodetic { latitude_deg: 48.1, longitude_deg: 11.5, altitude_m: Some(5.0) };
    assert_eq!(found[0].place, place);
    let found = read("local\n1 2 3 4 5 a.jpg\n").unwrap();
    assert_eq!(found[0].place, Place::Cartesian(Vector3::new(1.0, 2.0, 3.0)));
    assert_eq!((found[0].sigmas_m, found[0].mark_sigma_px), (None, None));
    // CSV: columns in any order, deviations that may be empty.
    let header = "point,lat,lon,alt,image,px,py,sigma_h,sigma_v,sigma_px";
    let found = read(&format!(
        "{header}\nn, 48.1, 11.5, 5, a b.jpg, 1, 2, 0.02, 0.05, 1.5\n\
         n,48.1,11.5,5,b.jpg,3,4,0.02,0.05,1.5\nCHK-1,48.1,11.5,6,b.jpg,5,6,,,\n"
    ));
    let found = found.unwrap();
    assert_eq!((found.len(), found[0].name.as_str(), found[0].place), (2, "n", place));
    assert_eq!((found[0].sigmas_m, found[0].mark_sigma_px), (Some([0.02, 0.05]), Some(1.5)));
    assert_eq!((found[1].sigmas_m, found[1].mark_sigma_px), (None, None));
    let marks = [("a b.jpg", 1.0, 2.0), ("b.jpg", 3.0, 4.0)];
    assert_eq!(found[0].marks, marks.map(|(name, x, y)| (name.to_owned(), Vector2::new(x, y))));
    assert!(found[1].is_check && !found[0].is_check);
    let found = read("image,px,py,point,x,y,z,sigma\na.jpg,4,5,p,1,2,3,0.1\n").unwrap();
    assert_eq!(found[0].place, Place::Cartesian(Vector3::new(1.0, 2.0, 3.0)));
    assert_eq!(found[0].sigmas_m, Some([0.1; 2]));
    for (text, part) in [
        ("", "the frame is ``"),
        ("EPSG:2056\n1 2 3 4 5 a.jpg\n", "the frame is `EPSG:2056` and must be EPSG:4326"),
        ("+proj=utm +zone=32 +ellps=bessel\n", "must be EPSG:4326"),
        ("EPSG:32661\n", "must be EPSG:4326"),
        ("local\n", "has no mark"),
        ("local\n1 2 3 4 a.jpg\n", "line 2: a coordinate of the pixel is `a.jpg`"),
        ("local\n1 2 3 4 5\n", "ends where the image should be"),
        ("local\n1,5 2 3 4 5 a.jpg\n", "`1,5`"),
        ("local\n1 2 3 4 5 a.jpg p\n1 2 4 4 5 b.jpg p\n", "p has another position above"),
        ("local\n1 2 3 4 5 a.jpg p\n1 2 3 4 5 a.jpg p\n", "p is marked twice in a.jpg"),
        ("EPSG:4326\n48 111 3 4 5 a.jpg\n", "the latitude 111 is not from -90 to 90"),
        ("local\n1 2 NaN 4 5 a.jpg\n", "a coordinate of the point is NaN"),
        (
            "point,x,y,image,px,py\n",
            "line 1: the header `point,x,y,image,px,py` lacks the column z",
        ),
        ("point,x,y,z,z,image,px,py\n", "the column `z` is in the header twice"),
        ("point,x,y,z,image,px,py,colour\n", "the column `colour` is none of control points"),
        ("point,x,y,z,image,px,py,sigma_h\n", "are sigma, or sigma_h and sigma_v"),
        ("point,x,y,z,image,px,py\n", "has no mark"),
        ("point,x,y,z,image,px,py\np,1,5,2,3,a.jpg,4,5\n", "8 fields and the header 7: decimals"),
        ("point,x,y,z,image,px,py\np,1,2,inf,a.jpg,4,5\n", "the column z is `inf`, no number"),
        ("point,x,y,z,image,px,py\n,1,2,3,a.jpg,4,5\n", "the column point is empty"),
        ("point,lat,lon,alt,image,px,py\np,111,48,3,a.jpg,4,5\n", "the latitude 111 is not"),
        ("point,x,y,z,image,px,py,sigma\np,1,2,3,a.jpg,4,5,0\n", "sigma is 0, not above 0"),
        (
            "point,x,y,z,image,px,py,sigma\np,1,2,3,a.jpg,4,5,1\np,1,2,3,b.jpg,4,5,2\n",
            "the point p has other standard deviations above",
        ),
    ] {
        let message = read(text).unwrap_err().to_string();
        assert!(message.contains(part), "{text:?}: {message}");
    }
}

#[test]
fn text_may_begin_with_a_byte_order_mark_and_is_not_utf_16() {
    for (name, content, read) in text_readers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        let of_bytes = |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            read(&path)
        };
        let plain = of_bytes(content.as_bytes());
        assert!(!plain.starts_with("error"), "{name}: {plain}");
        assert_eq!(of_bytes(&[b"\xEF\xBB\xBF", content.as_bytes()].concat()), plain, "{name}");
        let wide = |bytes_of: fn(u16) -> [u8; 2], mark: &str| -> Vec<u8> {
            let text = mark.to_owned() + content;
            text.encode_utf16().flat_map(bytes_of).collect()
        };
        for utf_16 in [
            wide(u16::to_le_bytes, "\u{feff}"),
            wide(u16::to_be_bytes, "\u{feff}"),
            wide(u16::to_le_bytes, ""),
            wide(u16::to_be_bytes, ""),
        ] {
            let error = of_bytes(&utf_16);
            assert!(error.contains("is UTF-16 text") && error.contains("UTF-8"), "{name}: {error}");
            assert!(error.contains(name), "{name}: {error}");
        }
    }
}

#[test]
fn text_models_may_begin_with_byte_order_marks() {
    let dir = tempfile::tempdir().unwrap();
    let model = random_model(3, RigKind::SingleCameras);
    colmap::write_model(dir.path(), &model, colmap::Format::Text).unwrap();
    let before = colmap::read_model(dir.path()).unwrap();
    for entry in fs::read_dir(dir.path()).unwrap() {
        let path = entry.unwrap().path();
        let content = fs::read(&path).unwrap();
        fs::write(&path, [b"\xEF\xBB\xBF", &content[..]].concat()).unwrap();
    }
    assert_eq!(colmap::read_model(dir.path()).unwrap(), before);
}
