//! Known intrinsics of cameras, in the files of several programs. All have the centre of the
//! top-left pixel at (0.5, 0.5) after reading: COLMAP has it there, and OpenCV, Kalibr and KITTI,
//! which have it at (0, 0), get half a pixel added to their principal points.

mod camera;
pub(crate) mod kalibr;
mod kitti_raw;
mod opencv;

use std::collections::BTreeSet;
use std::path::Path;

pub use camera::CameraCalibration;

use crate::text::{Lines, read_text};
use crate::{Error, Result, colmap, kitti, yaml};

/// Longest file that is read, in bytes. A calibration has some kilobytes, and `cameras.txt` of ten
/// thousand cameras one million.
pub(crate) const MAX_BYTES: u64 = 4 << 20;

/// Reads COLMAP's `cameras.txt`, OpenCV's YAML of `FileStorage` (also of ROS), Kalibr's camchain or
/// KITTI's `calib.txt` (also `calib_cam_to_cam.txt` of its raw recordings, of which the rectified
/// cameras are read); the content decides which it is. Returns at least one camera, in the order
/// of the file, with unique names.
///
/// # Errors
///
/// If the file cannot be read, is larger than four megabytes, is none of these or not as its format
/// says, and if a camera model is unknown, a number is not finite or a focal length not positive.
pub fn read(path: &Path) -> Result<Vec<CameraCalibration>> {
    let text = read_text(path, MAX_BYTES, "calibration")?;
    let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !is_comment(line));
    let first_word = first.and_then(|line| line.split_whitespace().next()).unwrap_or("");
    let is_yaml_name = path.extension().is_some_and(|ending| {
        ["yaml", "yml"].iter().any(|known| ending.eq_ignore_ascii_case(known))
    });
    let is_matrix_name =
        |word: &str| word.starts_with(['P', 'R', 'T']) && word.ends_with(':') && word.len() > 2;
    let cameras = if is_yaml_name || text.starts_with("%YAML") {
        of_yaml(path, &text)?
    } else if !first_word.is_empty() && first_word.bytes().all(|byte| byte.is_ascii_digit()) {
        of_colmap(path)?
    } else if kitti_raw::is_raw(&text) {
        kitti_raw::cameras(path)?
    } else if is_matrix_name(first_word) {
        of_kitti(path)?
    } else if first_word.ends_with(':') {
        of_yaml(path, &text)?
    } else {
        return Err(Error::content(
            path,
            "is no calibration: give COLMAP's cameras.txt, OpenCV's YAML, Kalibr's camchain or \
            KITTI's calib.txt",
        ));
    };
    let mut names = BTreeSet::new();
    for camera in &cameras {
        if !names.insert(camera.name.as_str()) {
            return Err(Error::content(path, format!("has the camera {} twice", camera.name)));
        }
    }
    Ok(cameras)
}

fn is_comment(line: &str) -> bool {
    line.starts_with('#')
}

fn of_yaml(path: &Path, text: &str) -> Result<Vec<CameraCalibration>> {
    let root = yaml::parse(path, text)?;
    if kalibr::is_camchain(&root) {
        kalibr::cameras(path, &root)
    } else {
        opencv::cameras(path, &root)
    }
}

fn of_colmap(path: &Path) -> Result<Vec<CameraCalibration>> {
    let cameras = colmap::read_cameras(Lines::open(path)?)?;
    let cameras = cameras.into_iter().map(|(id, camera)| CameraCalibration {
        name: id.to_string(),
        topic: None,
        size: Some([camera.width, camera.height]),
        intrinsics: camera.intrinsics,
    });
    Ok(cameras.collect())
}

fn of_kitti(path: &Path) -> Result<Vec<CameraCalibration>> {
    let cameras = kitti::read_calibration(path)?.cameras.into_iter();
    let cameras = cameras.map(|camera| CameraCalibration {
        name: format!("P{}", camera.number),
        topic: None,
        size: None,
        intrinsics: camera.intrinsics,
    });
    Ok(cameras.collect())
}
