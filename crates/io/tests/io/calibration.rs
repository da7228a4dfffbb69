//! Calibrations: each format, its pixel centre, and damaged files.

use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_io::calibration::{self, CameraCalibration};

fn read(name: &str, text: impl AsRef<[u8]>) -> Result<Vec<CameraCalibration>, String> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    calibration::read(&path).map_err(|error| error.to_string())
}

fn intrinsics(model: CameraModelKind, params: &[f64]) -> Intrinsics {
    Intrinsics::new(model, params).unwrap()
}

const COLMAP: &str = "# Camera list\n3 PINHOLE 640 480 500 510 320.5 240\n7 SIMPLE_RADIAL 640 480 \
                      500 320 240 -0.1\n";

#[test]
fn colmap_has_our_pixel_centre() {
    let found = read("cameras.txt", COLMAP).unwrap();
    assert_eq!(found[0].name, "3");
    assert_eq!(found[0].size, Some([640, 480]));
    let pinhole = intrinsics(CameraModelKind::Pinhole, &[500.0, 510.0, 320.5, 240.0]);
    assert_eq!(found[0].intrinsics, pinhole);
    assert_eq!((found[1].name.as_str(), found.len()), ("7", 2));
}

const OPENCV: &str = "%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3e+02, 0., 3.4e+02, 0.,
       5.2e+02, 2.4e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.3, 0.1, 0.001,
       -0.002, 0. ]
";

#[test]
fn opencv_has_its_first_pixel_at_zero() {
    let found = read("a.yml", OPENCV).unwrap();
    let expected = intrinsics(
        CameraModelKind::Opencv,
        &[530.0, 520.0, 340.5, 240.5, -0.3, 0.1, 0.001, -0.002],
    );
    let expected = CameraCalibration {
        name: "camera".to_owned(),
        topic: None,
        size: Some([640, 480]),
        intrinsics: expected,
    };
    assert_eq!(found, [expected]);
    // As ROS writes it.
    let ros = "image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [530, 0, 340, 0, 520, 240, 0, 0, 1]
distortion_model: equidistant
distortion_coefficients:
  rows: 1
  cols: 4
  data: [0.1, 0, 0, 0.2]
";
    let fisheye = intrinsics(
        CameraModelKind::OpencvFisheye,
        &[530.0, 520.0, 340.5, 240.5, 0.1, 0.0, 0.0, 0.2],
    );
    assert_eq!(read("ros.yaml", ros).unwrap()[0].intrinsics, fisheye);
    // Nested lists, no distortion.
    let plain = "K: [[530, 0, 340], [0, 520, 240], [0, 0, 1]]\n";
    let pinhole = intrinsics(CameraModelKind::Pinhole, &[530.0, 520.0, 340.5, 240.5]);
    assert_eq!(read("k.yaml", plain).unwrap()[0].intrinsics, pinhole);
    let stereo = "M1: [9, 0, 5, 0, 9, 5, 0, 0, 1]\nD1: [0.5]\nM2: [8, 0, 5, 0, 8, 5, 0, 0, 1]\nD2: \
                  []\n";
    let found = read("stereo.yml", stereo).unwrap();
    assert_eq!((found[0].name.as_str(), found[1].name.as_str()), ("M1", "M2"));
    assert_eq!(found[0].intrinsics.kind(), CameraModelKind::Opencv);
    assert_eq!(found[1].intrinsics, intrinsics(CameraModelKind::Pinhole, &[8.0, 8.0, 5.5, 5.5]));
}

#[test]
fn a_third_radial_coefficient_needs_the_full_model() {
    let found = read("a.yml", OPENCV.replace("-0.002, 0. ]", "-0.002, 0.2 ]"));
    match CameraModelKind::from_name("FULL_OPENCV") {
        Ok(kind) => assert_eq!(found.unwrap()[0].intrinsics.kind(), kind),
        Err(_) => assert!(found.unwrap_err().contains("FULL_OPENCV")),
    }
}

/// A camera matrix, then further keys.
fn with_matrix(further: &str) -> String {
    format!("camera_matrix: [[530, 0, 340], [0, 520, 240], [0, 0, 1]]\n{further}")
}

#[test]
fn distortion_and_size_of_opencv_have_several_names() {
    let distorted = intrinsics(
        CameraModelKind::Opencv,
        &[530.0, 520.0, 340.5, 240.5, -0.3, 0.1, 0.001, -0.002],
    );
    let coefficients = "[-0.3, 0.1, 0.001, -0.002]";
    for key in ["dist_coefs", "distortion_coeffs", "distortion_parameters", "D", "dist"] {
        let found = read("a.yml", with_matrix(&format!("{key}: {coefficients}\n"))).unwrap();
        assert_eq!(found[0].intrinsics, distorted, "{key}");
    }
    for further in ["image_size: [640, 480]\n", "width: 640\nheight: 480\n"] {
        assert_eq!(read("a.yml", with_matrix(further)).unwrap()[0].size, Some([640, 480]));
    }
    for flag in ["1", "true", "True"] {
        let text = with_matrix(&format!("fisheye_model: {flag}\nD: [0.1]\n"));
        let kind = read("a.yml", text).unwrap()[0].intrinsics.kind();
        assert_eq!(kind, CameraModelKind::OpencvFisheye, "{flag}");
    }
    let named = read("a.yml", with_matrix("camera_name: left\n")).unwrap();
    assert_eq!(named[0].topic.as_deref(), Some("left"));
    let stereo = "M1: [9, 0, 5, 0, 9, 5, 0, 0, 1]\nimage_size1: [10, 10]\nM2: [8, 0, 5, 0, 8, \
                  5, 0, 0, 1]\nimage_size2: [12, 12]\n";
    let found = read("stereo.yml", stereo).unwrap();
    assert_eq!((found[0].size, found[1].size), (Some([10, 10]), Some([12, 12])));
}

#[test]
fn messages_of_ros_have_a_size_and_an_end() {
    let ros2 = "header:\n  frame_id: left\nheight: 480\nwidth: 640\ndistortion_model: \
                plumb_bob\nd:\n- -0.3\n- 0.1\n- 0.001\n- -0.002\n- 0.0\nk:\n- 530.0\n- 0.0\n- \
                340.0\n- 0.0\n- 520.0\n- 240.0\n- 0.0\n- 0.0\n- 1.0\n---\n";
    let found = read("left.yaml", ros2).unwrap();
    assert_eq!(found[0].size, Some([640, 480]));
    assert_eq!(found[0].intrinsics.params()[2..5], [340.5, 240.5, -0.3]);
}

const KALIBR: &str = "cam0:
  camera_model: pinhole
  distortion_model: radtan
  intrinsics: [500, 510, 320, 240]
  distortion_coeffs: [-0.3, 0.1, 0.001, -0.002]
  resolution: [640, 480]
  rostopic: /left/image_raw
cam1:
  T_cn_cnm1:
  - [1, 0, 0, -0.1]
  - [0, 1, 0, 0]
  - [0, 0, 1, 0]
  - [0, 0, 0, 1]
  camera_model: pinhole
  distortion_model: equidistant
  intrinsics: [400, 400, 320, 240]
  distortion_coeffs: [0.1, 0, 0, 0]
  resolution: [640, 480]
";

#[test]
fn kalibr_has_its_first_pixel_at_zero() {
    let found = read("camchain.yaml", KALIBR).unwrap();
    let left = intrinsics(
        CameraModelKind::Opencv,
        &[500.0, 510.0, 320.5, 240.5, -0.3, 0.1, 0.001, -0.002],
    );
    assert_eq!((found[0].name.as_str(), found[0].intrinsics), ("cam0", left));
    assert_eq!(found[0].topic.as_deref(), Some("/left/image_raw"));
    assert_eq!(found[0].size, Some([640, 480]));
    assert_eq!(found[1].intrinsics.kind(), CameraModelKind::OpencvFisheye);
}

#[test]
fn kalibr_has_the_enhanced_unified_model() {
    let eucm = "cam0:\n  camera_model: eucm\n  intrinsics: [0.6, 1.1, 500, 510, 320, 240]\n  \
                distortion_model: none\n  distortion_coeffs: []\n";
    let expected = intrinsics(CameraModelKind::Eucm, &[500.0, 510.0, 320.5, 240.5, 0.6, 1.1]);
    assert_eq!(read("camchain.yaml", eucm).unwrap()[0].intrinsics, expected);
    let wrong = eucm.replace("none", "radtan");
    assert!(read("camchain.yaml", wrong).unwrap_err().contains("line 4: cam0 has eucm"));
}

const KITTI_RAW: &str = "calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_00: 1392 512
K_00: 984 0 690 0 980 233 0 0 1
D_00: -0.37 0.2 0 0 -0.07
S_rect_00: 1242 375
P_rect_00: 721 0 609 0 0 721 172 0 0 0 1 0
S_rect_01: 1242 375
P_rect_01: 721 0 609 -387 0 721 172 0 0 0 1 0
";

#[test]
fn raw_recordings_of_kitti_have_rectified_cameras() {
    let found = read("calib_cam_to_cam.txt", KITTI_RAW).unwrap();
    let pinhole = intrinsics(CameraModelKind::Pinhole, &[721.0, 721.0, 609.5, 172.5]);
    let expected = CameraCalibration {
        name: "P_rect_01".to_owned(),
        topic: Some("image_01".to_owned()),
        size: Some([1242, 375]),
        intrinsics: pinhole,
    };
    assert_eq!((found.len(), &found[1]), (2, &expected));
}

/// A search through all names for each name would take minutes.
#[test]
fn many_names_are_read_in_linear_time() {
    let many: String = (0..50_000).map(|id| format!("{id} SIMPLE_PINHOLE 4 4 9 2 2\n")).collect();
    assert_eq!(read("cameras.txt", many).unwrap().len(), 50_000);
    let many: String = (0..100_000).map(|key| format!("a{key}: 1\n")).collect();
    assert!(read("a.yml", many).unwrap_err().contains("neither a camera matrix"));
}

const KITTI: &str = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -380 0 700 180 0 0 0 1 0\n";

#[test]
fn kitti_has_its_first_pixel_at_zero() {
    let found = read("calib.txt", KITTI).unwrap();
    let pinhole = intrinsics(CameraModelKind::Pinhole, &[700.0, 700.0, 600.5, 180.5]);
    assert_eq!(found[1].name, "P1");
    assert_eq!((found[0].intrinsics, found[0].size), (pinhole, None));
}

#[test]
fn damaged_files_give_one_sentence() {
    let huge = "a: 1\n".repeat(1 << 20);
    for (name, text, says) in [
        ("a.yml", "", "is empty"),
        ("a.txt", "", "is no calibration"),
        ("a.txt", "some words\n", "is no calibration"),
        ("a.yml", &OPENCV[..160], "is no YAML, or is cut off"),
        ("a.yml", &OPENCV.replace("5.3e+02", ".nan"), "`.nan`, not a finite number"),
        ("a.yml", &OPENCV.replace("5.3e+02", "-530"), "fx"),
        ("a.yml", &OPENCV.replace("0., 0., 1. ]", "0., 1. ]"), "8 numbers in place of 9"),
        ("a.yml", &OPENCV.replace("0., 0., 1. ]", "0., 0., 2. ]"), "is no camera matrix"),
        ("a.yml", &OPENCV.replace("image_height: 480\n", ""), "only one of"),
        ("a.yml", "image_width: 4\n", "neither a camera matrix"),
        ("a.yml", &huge, "more than 4 MB"),
        (
            "a.yml",
            &with_matrix("dist_kappas: [0.1]\n"),
            "line 2: has dist_kappas, which is unknown",
        ),
        ("a.yml", &with_matrix("D1: [0.1]\n"), "has D1, which belongs to no camera matrix"),
        ("a.yml", &with_matrix("k1: 0.1\n"), "has k1, a coefficient on its own"),
        ("a.yml", &with_matrix("distortion_model: omni\n"), "distortion_model is omni: plumb_bob"),
        ("a.yml", &with_matrix("fisheye_model: maybe\n"), "fisheye_model is maybe: true or false"),
        ("a.yml", &with_matrix("image_size: [640]\n"), "image_size is no width and height"),
        ("a.txt", &KITTI_RAW.replace("S_rect_01", "S_rect_02"), "has no S_rect_01"),
        ("a.txt", &KITTI_RAW.replace("S_rect_01", "S_rect_00"), "line 8: the name is there twice"),
        ("a.txt", &KITTI_RAW.replace("609 -387", "609"), "line 9: ends where a matrix"),
        ("a.yaml", &KALIBR.replace("pinhole", "omni"), "line 2: cam0 has the camera model omni"),
        ("a.yaml", &KALIBR.replace("radtan", "plumb"), "the distortion model plumb"),
        ("a.yaml", &KALIBR.replace("[500, ", "["), "3 numbers in place of 4"),
        ("a.yaml", &KALIBR.replace("500", "0"), "line 4: cam0"),
        ("a.yaml", &KALIBR.replace("[640, 480]", "[640, 4.5]"), "no width and height"),
        ("cameras.txt", &COLMAP.replace("PINHOLE", "LENS"), "line 2: "),
        ("cameras.txt", &COLMAP.replace("7 SIMPLE", "3 SIMPLE"), "the camera 3 twice"),
        ("cameras.txt", &COLMAP.replace("500 510", "NaN 510"), "NaN"),
        ("calib.txt", &KITTI.replace("P1: 700", "P1: -700"), "line 2: "),
        ("calib.txt", &KITTI[..20], "ends where"),
    ] {
        let error = read(name, text).unwrap_err();
        assert!(error.contains(says), "{says}: {error}");
        assert!(error.lines().count() == 1 && error.len() < 500, "{error}");
    }
    assert!(read("a.yml", [0xFF, 0xAA]).unwrap_err().contains("not UTF-8"));
}
