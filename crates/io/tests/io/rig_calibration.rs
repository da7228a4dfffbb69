//! Known rigs: both formats, and damaged files.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_io::rig_calibration::{self, CameraOnRig, PhotosOfCamera};

fn read(name: &str, text: &str) -> Result<Vec<Vec<CameraOnRig>>, String> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    rig_calibration::read(&path).map_err(|error| error.to_string())
}

/// The reference camera is not the first, as COLMAP permits.
const COLMAP: &str = r#"[{"cameras": [
    {"image_prefix": "right/", "cam_from_rig_rotation": [0.6, 0.0, 0.8, 0.0],
     "cam_from_rig_translation": [-0.5, 0.1, 0], "camera_model_name": "SIMPLE_PINHOLE",
     "camera_params": [500, 320, 240]},
    {"image_prefix": "left/", "ref_sensor": true}
  ]},
  {"cameras": [{"image_prefix": "rear/", "ref_sensor": true, "unknown": 1}]}]"#;

#[test]
fn colmap_has_the_reference_camera_first() {
    let rigs = read("rig_config.json", COLMAP).unwrap();
    assert_eq!((rigs.len(), rigs[0].len(), rigs[1].len()), (2, 2, 1));
    let [left, right] = [&rigs[0][0], &rigs[0][1]];
    assert_eq!(left.photos, PhotosOfCamera::Prefix("left/".to_owned()));
    assert!(left.calibration.is_none());
    assert_eq!(right.cam_from_rig.translation, Vector3::new(-0.5, 0.1, 0.0));
    // w = 0.6 is half the angle's cosine: 106 degrees about y.
    let turned = right.cam_from_rig.rotation.scaled_axis();
    assert!((turned - Vector3::new(0.0, 2.0 * 0.6f64.acos(), 0.0)).norm() < 1e-12, "{turned}");
    let lens = Intrinsics::new(CameraModelKind::SimplePinhole, &[500.0, 320.0, 240.0]).unwrap();
    assert_eq!(right.calibration.as_ref().unwrap().intrinsics, lens);
}

const KALIBR: &str = "cam0:
  camera_model: pinhole
  intrinsics: [500, 500, 319.5, 239.5]
  resolution: [640, 480]
  timeshift_cam_imu: 0.25
cam1:
  T_cn_cnm1:
  - [0, -1, 0, 1]
  - [1, 0, 0, 0]
  - [0, 0, 1, 0]
  - [0, 0, 0, 1]
  camera_model: pinhole
  intrinsics: [500, 500, 319.5, 239.5]
  rostopic: /right/image_raw
  timeshift_cam_imu: 0.75
cam2:
  T_cn_cnm1:
  - [1, 0, 0, 2]
  - [0, 1, 0, 0]
  - [0, 0, 1, 0]
  - [0, 0, 0, 1]
  camera_model: pinhole
  intrinsics: [500, 500, 319.5, 239.5]
";

#[test]
fn kalibr_chains_poses_and_time_offsets() {
    let rigs = read("camchain.yaml", KALIBR).unwrap();
    let [rig] = &rigs[..] else { panic!("one rig") };
    assert_eq!(rig.len(), 3);
    let topic = Some("/right/image_raw".to_owned());
    assert_eq!(rig[1].photos, PhotosOfCamera::Named { name: "cam1".to_owned(), topic });
    // t_imu = t_cam + shift, so that the clock of cam0 shows half a second more than that of cam1.
    assert_eq!([rig[0].time_offset_s, rig[1].time_offset_s], [0.0, 0.5]);
    // A point of cam0 is turned by 90 degrees about z and moved; cam2 moves it on.
    let point = rig[1].cam_from_rig * Vector3::new(1.0, 0.0, 3.0);
    assert!((point - Vector3::new(1.0, 1.0, 3.0)).norm() < 1e-12, "{point}");
    let point = rig[2].cam_from_rig * Vector3::new(1.0, 0.0, 3.0);
    assert!((point - Vector3::new(3.0, 1.0, 3.0)).norm() < 1e-12, "{point}");
}

#[test]
fn kalibr_has_time_offsets_to_the_first_camera_as_our_export_writes_them() {
    let text = KALIBR
        .replace("  timeshift_cam_imu: 0.25\n", "")
        .replace("timeshift_cam_imu: 0.75", "timeshift_cam0: 0.5")
        + "  timeshift_cam0: -1\n";
    let rigs = read("camchain.yaml", &text).unwrap();
    let offsets: Vec<f64> = rigs[0].iter().map(|camera| camera.time_offset_s).collect();
    assert_eq!(offsets, [0.0, 0.5, -1.0]);
}

#[test]
fn kalibr_with_an_imu_has_poses_without_a_chain() {
    let with_imu = |x: f64| {
        format!(
            "  T_cam_imu: [[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n  \
            camera_model: pinhole\n  intrinsics: [500, 500, 319.5, 239.5]\n"
        )
    };
    let text = format!("cam0:\n{}cam1:\n{}", with_imu(0.25), with_imu(-0.25));
    let rigs = read("camchain.yaml", &text).unwrap();
    assert_eq!(rigs[0][1].cam_from_rig.translation, Vector3::new(-0.5, 0.0, 0.0));
}

#[test]
fn damaged_files_have_one_sentence() {
    let json = |from: &str, to: &str| {
        assert!(COLMAP.contains(from), "{from}");
        read("rig_config.json", &COLMAP.replacen(from, to, 1)).unwrap_err()
    };
    let yaml = |from: &str, to: &str| {
        assert!(KALIBR.contains(from), "{from}");
        read("camchain.yaml", &KALIBR.replacen(from, to, 1)).unwrap_err()
    };
    for (error, says) in [
        (json(r#", "ref_sensor": true}"#, "}"), "rig 1 has 0 reference cameras"),
        (json(r#""right/","#, r#""right/", "ref_sensor": true,"#), "rig 1 has 2 reference"),
        (json("rear/", "left/"), "image_prefix \"left/\" twice"),
        (json("0.6, 0.0, 0.8, 0.0", "0, 0, 0, 0"), "norm 0"),
        (json("0.6, 0.0, 0.8, 0.0", "NaN, 0, 0, 0"), "line 2: is no rig_config.json"),
        (json("0.6, 0.0, 0.8, 0.0", "1e999, 0, 0, 0"), "line 2: is no rig_config.json"),
        (json("0.6, 0.0, 0.8, 0.0", "1, 0, 0"), "length 3"),
        (json("cam_from_rig_translation", "translation"), "needs both cam_from_rig_rotation"),
        (json("camera_params", "params"), "both camera_model_name and camera_params"),
        (json("[500, 320, 240]", "[500, 320]"), "wrong intrinsics"),
        (json("\"cameras\"", "\"camera\""), "missing field `cameras`"),
        (yaml("[0, -1, 0, 1]", "[0, 0, 0, 1]"), "line 8: T_cn_cnm1 of cam1 is no pose"),
        (yaml("[0, -1, 0, 1]", "[0, 1, 0, 1]"), "are no rotation"),
        (yaml("[0, -1, 0, 1]", "[0, .nan, 0, 1]"), "not a finite number"),
        (yaml("[0, -1, 0, 1]", "[0, -1, 0]"), "15 numbers in place of 16"),
        (yaml("T_cn_cnm1", "T"), "cam1 has no T_cn_cnm1"),
        (read("a.yaml", "a: 1\n").unwrap_err(), "is no known rig"),
        (read("a.json", "[]").unwrap_err(), "has no rig"),
    ] {
        assert!(error.contains(says) && !error.contains('\n'), "{says}: {error}");
    }
}
