//! YAML of OpenCV's `FileStorage`: a camera matrix, distortion coefficients and the image size, as
//! the samples of OpenCV and the calibration of ROS write them. Case and underscores of keys do not
//! matter. A number at the end of the keys tells the cameras of a stereo pair apart (`M1`, `D1`,
//! `M2`, `D2`).
//!
//! The coefficients are k1, k2, p1, p2, k3, k4, k5, k6, …, as in
//! <https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html>.

use std::path::Path;

use super::camera::{CameraCalibration, intrinsics};
use crate::excerpt::Excerpt;
use crate::yaml::Node;
use crate::{Error, Result};

/// Keys of the camera matrix and of the distortion, without a number.
const MATRIX_KEYS: [&str; 5] = ["cameramatrix", "intrinsicmatrix", "k", "m", "matrix"];
const DISTORTION_KEYS: [&str; 6] =
    ["distortioncoefficients", "distcoeffs", "distcoeff", "distortion", "d", "dist"];

/// A key in lower case without underscores, and the number at its end.
fn normalised(key: &str) -> (String, String) {
    let plain: String = key.chars().filter(|c| *c != '_').collect::<String>().to_ascii_lowercase();
    let name = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    (name.to_owned(), plain[name.len()..].to_owned())
}

/// The cameras of a document.
pub(super) fn cameras(path: &Path, root: &Node) -> Result<Vec<CameraCalibration>> {
    let found = |keys: &[&str], number: &str| {
        root.entries().iter().find_map(|(key, node)| {
            let (name, own) = normalised(key);
            (own == number && keys.contains(&name.as_str())).then_some(node)
        })
    };
    let matrices: Vec<(&str, String, &Node)> = root
        .entries()
        .iter()
        .filter_map(|(key, node)| {
            let (name, number) = normalised(key);
            // A scalar k1 is no matrix.
            let is_matrix = MATRIX_KEYS.contains(&name.as_str()) && node.text().is_none();
            is_matrix.then_some((key.as_str(), number, node))
        })
        .collect();
    if matrices.is_empty() {
        let what = "has neither a camera matrix (camera_matrix of OpenCV) nor cameras (cam0 of \
        Kalibr)";
        return Err(Error::content(path, what));
    }
    let size = size(path, root)?;
    let is_fisheye = root.entries().iter().any(|(key, node)| {
        let value = node.text().unwrap_or("");
        match normalised(key).0.as_str() {
            "distortionmodel" => ["equidistant", "fisheye"].contains(&value),
            "fisheyemodel" => value == "1",
            _ => false,
        }
    });
    matrices
        .into_iter()
        .map(|(key, number, matrix)| {
            let pinhole = pinhole(path, key, matrix)?;
            let (model, further) = match found(&DISTORTION_KEYS, &number) {
                None => ("PINHOLE", Vec::new()),
                Some(node) => distortion(path, node, is_fisheye)?,
            };
            let intrinsics = intrinsics(model, pinhole, &further)
                .map_err(|what| matrix.error(path, format!("{}: {what}", Excerpt(key))))?;
            let name = if number.is_empty() { "camera".to_owned() } else { format!("M{number}") };
            Ok(CameraCalibration { name, topic: None, size, intrinsics })
        })
        .collect()
}

/// The numbers of a matrix: of its `data`, or of a plain list.
fn data(path: &Path, what: &str, node: &Node) -> Result<Vec<f64>> {
    node.get("data").unwrap_or(node).numbers(path, what)
}

/// fx, fy, cx, cy of a camera matrix.
fn pinhole(path: &Path, key: &str, node: &Node) -> Result<[f64; 4]> {
    let numbers = data(path, &format!("{}", Excerpt(key)), node)?;
    let &[fx, skew, cx, zero, fy, cy, a, b, c] = numbers.as_slice() else {
        let what = format!("{} has {} numbers in place of 9", Excerpt(key), numbers.len());
        return Err(node.error(path, what));
    };
    if [skew, zero, a, b, c] != [0.0, 0.0, 0.0, 0.0, 1.0] {
        let what = format!("{} is no camera matrix fx 0 cx, 0 fy cy, 0 0 1", Excerpt(key));
        return Err(node.error(path, what));
    }
    Ok([fx, fy, cx, cy])
}

/// The name of the camera model and its coefficients.
fn distortion(path: &Path, node: &Node, is_fisheye: bool) -> Result<(&'static str, Vec<f64>)> {
    let mut numbers = data(path, "the distortion", node)?;
    // Trailing zeros do not distort.
    while numbers.last() == Some(&0.0) {
        numbers.pop();
    }
    let (model, count) = match numbers.len() {
        0..=4 if is_fisheye => ("OPENCV_FISHEYE", 4),
        0 => ("PINHOLE", 0),
        1..=4 => ("OPENCV", 4),
        5..=8 if !is_fisheye => ("FULL_OPENCV", 8),
        count => {
            let most = if is_fisheye { 4 } else { 8 };
            let what = format!("the distortion has {count} coefficients, and {most} can be used");
            return Err(node.error(path, what));
        }
    };
    numbers.resize(count, 0.0);
    Ok((model, numbers))
}

/// Width and height of the images, if the document has them.
fn size(path: &Path, root: &Node) -> Result<Option<[u32; 2]>> {
    let find = |wanted: &str| {
        root.entries().iter().find(|(key, _)| normalised(key).0 == wanted).map(|(_, node)| node)
    };
    match (find("imagewidth"), find("imageheight")) {
        (Some(width), Some(height)) => {
            Ok(Some([width.whole(path, "the width")?, height.whole(path, "the height")?]))
        }
        (None, None) => Ok(None),
        (Some(node), None) | (None, Some(node)) => {
            Err(node.error(path, "only one of image_width and image_height is given"))
        }
    }
}
