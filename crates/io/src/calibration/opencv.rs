//! YAML of OpenCV's `FileStorage`: a camera matrix, distortion coefficients and the image size, as
//! the samples of OpenCV, the calibration of ROS, and `ros2 topic echo` of a `CameraInfo` write
//! them.
//! Case and underscores of keys do not matter. A number at the end of the keys tells the cameras of
//! a stereo pair apart (`M1`, `D1`, `M2`, `D2`).
//!
//! The coefficients are k1, k2, p1, p2, k3, k4, k5, k6, …, as in
//! <https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html>.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::camera::{CameraCalibration, intrinsics};
use crate::text::excerpt::Excerpt;
use crate::yaml::Node;
use crate::{Error, Result};

/// Keys of the camera matrix and of the distortion, without a number.
const MATRIX_KEYS: [&str; 5] = ["cameramatrix", "intrinsicmatrix", "k", "m", "matrix"];
const DISTORTION_KEYS: [&str; 11] = [
    "distortioncoefficients",
    "distortioncoeffs",
    "distortioncoefs",
    "distortionparameters",
    "distortionparams",
    "distcoeffs",
    "distcoeff",
    "distcoefs",
    "distortion",
    "d",
    "dist",
];
const MODEL_KEY: &str = "distortionmodel";
const FISHEYE_KEY: &str = "fisheyemodel";
/// Keys of the width and the height of the images, and of both.
const SIDE_KEYS: [[&str; 2]; 2] = [["imagewidth", "imageheight"], ["width", "height"]];
const SIZE_KEYS: [&str; 2] = ["imagesize", "resolution"];

/// A key in lower case without underscores, and the number at its end.
fn normalised(key: &str) -> (String, String) {
    let plain: String = key.chars().filter(|c| *c != '_').collect::<String>().to_ascii_lowercase();
    let name = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    (name.to_owned(), plain[name.len()..].to_owned())
}

/// An entry of the document.
struct Entry<'a> {
    /// The key as it stands there.
    key: &'a str,
    node: &'a Node,
}

/// The entries of a document by their normalised keys.
struct Document<'a> {
    path: &'a Path,
    entries: BTreeMap<(String, String), Entry<'a>>,
}

impl<'a> Document<'a> {
    fn new(path: &'a Path, root: &'a Node) -> Result<Self> {
        let mut entries = BTreeMap::new();
        for (key, node) in root.entries() {
            if let Some(Entry { key: other, .. }) =
                entries.insert(normalised(key), Entry { key, node })
                && is_used(key)
            {
                let what = format!("has both {} and {}", Excerpt(other), Excerpt(key));
                return Err(node.error(path, what));
            }
        }
        Ok(Self { path, entries })
    }

    /// The first of these keys that the camera with this number has.
    fn find(&self, keys: &[&str], number: &str) -> Option<&Entry<'a>> {
        keys.iter().find_map(|key| self.entries.get(&((*key).to_owned(), number.to_owned())))
    }

    /// The same; a key without a number holds for all cameras.
    fn find_common(&self, keys: &[&str], number: &str) -> Option<&Entry<'a>> {
        self.find(keys, number).or_else(|| self.find(keys, ""))
    }

    /// Checks that all that distorts belongs to a camera: these are the numbers of the matrices.
    fn require_no_other_distortion(&self, numbers: &BTreeSet<&str>) -> Result<()> {
        for ((name, number), Entry { key, node }) in &self.entries {
            let is_coefficients = DISTORTION_KEYS.contains(&name.as_str());
            let is_known = is_coefficients || name == MODEL_KEY;
            let is_distance = name.starts_with("distance");
            let what = if is_known && node.text().is_none() && !numbers.contains(number.as_str()) {
                "which belongs to no camera matrix: matrix and distortion need the same number"
            } else if !is_known && name.starts_with("dist") && !is_distance {
                "which is unknown: give distortion_coefficients and distortion_model"
            } else if ["k", "p"].contains(&name.as_str())
                && !number.is_empty()
                && node.text().is_some()
            {
                "a coefficient on its own: give distortion_coefficients: [k1, k2, p1, p2]"
            } else {
                continue;
            };
            return Err(node.error(self.path, format!("has {}, {what}", Excerpt(key))));
        }
        Ok(())
    }

    /// Whether the camera with this number has OpenCV's fisheye model.
    fn is_fisheye(&self, number: &str) -> Result<bool> {
        let word = |key: &str| -> Option<(&Entry, String)> {
            let entry = self.find_common(&[key], number)?;
            Some((entry, entry.node.text().unwrap_or("").to_ascii_lowercase()))
        };
        let wrong = |entry: &Entry, text: &str, expected: &str| {
            let Entry { key, node } = entry;
            let what = format!("{} is {}: {expected} is expected", Excerpt(key), Excerpt(text));
            Err(node.error(self.path, what))
        };
        let flag = match word(FISHEYE_KEY) {
            None => false,
            Some((entry, text)) => match text.as_str() {
                "1" | "true" => true,
                "0" | "false" => false,
                _ => return wrong(entry, &text, "true or false"),
            },
        };
        match word(MODEL_KEY) {
            None => Ok(flag),
            Some((entry, text)) => match text.as_str() {
                "plumb_bob" | "rational_polynomial" | "radtan" | "none" | "" => Ok(flag),
                "equidistant" | "fisheye" => Ok(true),
                _ => wrong(entry, &text, "plumb_bob, rational_polynomial or equidistant"),
            },
        }
    }

    /// Width and height of the images of the camera with this number, if they are given.
    fn size(&self, number: &str) -> Result<Option<[u32; 2]>> {
        let path = self.path;
        for [width, height] in SIDE_KEYS {
            let side = |key: &str| self.find_common(&[key], number);
            match (side(width), side(height)) {
                (Some(width), Some(height)) => {
                    let width = width.node.whole(path, "the width")?;
                    return Ok(Some([width, height.node.whole(path, "the height")?]));
                }
                (None, None) => {}
                (Some(Entry { key, node }), None) | (None, Some(Entry { key, node })) => {
                    let what = format!("only one of width and height is given: {}", Excerpt(key));
                    return Err(node.error(path, what));
                }
            }
        }
        let Some(Entry { key, node }) = self.find_common(&SIZE_KEYS, number) else {
            return Ok(None);
        };
        let sides = data(path, &format!("{}", Excerpt(key)), node)?;
        let is_side =
            |side: &f64| side.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(side);
        match sides[..] {
            [width, height] if sides.iter().all(is_side) => Ok(Some([width as u32, height as u32])),
            _ => Err(node.error(path, format!("{} is no width and height", Excerpt(key)))),
        }
    }
}

/// Whether a key says something of a camera.
fn is_used(key: &str) -> bool {
    let name = normalised(key).0;
    let name = name.as_str();
    MATRIX_KEYS.contains(&name)
        || DISTORTION_KEYS.contains(&name)
        || [MODEL_KEY, FISHEYE_KEY].contains(&name)
        || SIDE_KEYS.as_flattened().contains(&name)
        || SIZE_KEYS.contains(&name)
}

/// The cameras of a document.
pub(super) fn cameras(path: &Path, root: &Node) -> Result<Vec<CameraCalibration>> {
    let document = Document::new(path, root)?;
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
    let numbers = matrices.iter().map(|(_, number, _)| number.as_str()).collect();
    document.require_no_other_distortion(&numbers)?;
    let topic = document.find(&["cameraname"], "").and_then(|entry| entry.node.text());
    matrices
        .into_iter()
        .map(|(key, number, matrix)| {
            let pinhole = pinhole(path, key, matrix)?;
            let is_fisheye = document.is_fisheye(&number)?;
            let (model, further) = match document.find(&DISTORTION_KEYS, &number) {
                None if is_fisheye => ("OPENCV_FISHEYE", vec![0.0; 4]),
                None => ("PINHOLE", Vec::new()),
                Some(entry) => distortion(path, entry.node, is_fisheye)?,
            };
            let intrinsics = intrinsics(model, pinhole, &further)
                .map_err(|what| matrix.error(path, format!("{}: {what}", Excerpt(key))))?;
            let size = document.size(&number)?;
            let name = if number.is_empty() { "camera".to_owned() } else { format!("M{number}") };
            // A name on its own is that of the only camera.
            let topic = if number.is_empty() { topic.map(str::to_owned) } else { None };
            Ok(CameraCalibration { name, topic, size, intrinsics })
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
