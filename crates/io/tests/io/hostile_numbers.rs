//! Numbers that would become NaN, never come to an end or overflow are refused where they are read
//! or written.

use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_io::trajectory::{self, TimedPose};
use tiepoint_io::{bal::Bal, colmap, kitti, strecha};

fn in_file<T>(name: &str, text: &str, read: impl FnOnce(&Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    read(&path)
}

fn says<T>(result: tiepoint_io::Result<T>, what: &str) {
    let error = result.map(drop).unwrap_err().to_string();
    assert!(error.contains(what), "{error}");
}

#[test]
fn times_that_do_not_fit_nanoseconds_are_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("poses.csv");
    for time_s in [1e10, -1e10, 1e300, f64::INFINITY, f64::NAN, 9_223_372_036.9] {
        let pose = TimedPose { time_s, cam_from_world: Rigid3::identity() };
        says(trajectory::write_euroc(&path, &[pose]), "cannot be written in nanoseconds");
        assert!(!path.exists());
    }
    for time_s in [9e9, -9e9, 1_403_636_579.763_555_6, -0.25, 0.0] {
        let pose = TimedPose { time_s, cam_from_world: Rigid3::identity() };
        trajectory::write_euroc(&path, &[pose]).unwrap();
        assert_eq!(trajectory::read_euroc(&path).unwrap()[0].time_s, time_s);
    }
}

#[test]
fn quaternions_that_are_no_rotations() {
    for zero in ["0 0 0 0", "1e-9 0 0 0", "1e300 0 0 1e300"] {
        in_file("t.txt", &format!("1 2 3 4 {zero}\n"), |path| {
            says(trajectory::read_tum(path), "no rotation")
        });
        let euroc = format!("1,2,3,4,{}\n", zero.replace(' ', ","));
        in_file("t.csv", &euroc, |path| says(trajectory::read_euroc(path), "no rotation"));
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("cameras.txt"), "1 PINHOLE 640 480 500 500 320 240\n")
            .unwrap();
        std::fs::write(dir.path().join("images.txt"), format!("1 {zero} 0 0 0 1 a.jpg\n\n"))
            .unwrap();
        std::fs::write(dir.path().join("points3D.txt"), "").unwrap();
        says(colmap::read_model(dir.path()), "no rotation");
    }
}

/// The singular values of a matrix whose squares overflow were looked for without end.
#[test]
fn matrices_that_are_no_rotations() {
    for huge in ["1e300", "-1e200", "1e155", "3"] {
        let row = format!("{huge} {huge} 0 0 0 {huge} 1 0 {huge} 0 1 0\n");
        in_file("p.txt", &row, |path| says(trajectory::read_kitti(path), "no rotation"));
        in_file("c.txt", &format!("Tr: {row}"), |path| {
            says(kitti::read_calibration(path), "no rotation")
        });
        let camera =
            format!("1 0 0\n0 1 0\n0 0 1\n0 0 0\n{huge} 0 0\n0 {huge} 1\n0 1 {huge}\n0 0 0\n4 3\n");
        in_file("a.jpg.camera", &camera, |path| {
            says(strecha::read(path.parent().unwrap()), "no rotation")
        });
    }
}

#[test]
fn rotations_of_a_bal_problem_beyond_reason() {
    for angle in ["1e300", "-1e200", "1e9"] {
        let text = format!("1 1 0\n0 {angle} 0 0 0 0 500 0 0\n0 0 -5\n");
        in_file("bal.txt", &text, |path| {
            says(Bal::read(path), "rotation of camera 0 is out of range")
        });
    }
}
