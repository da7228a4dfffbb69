//! Kalibr's camchain: one map for each camera, `cam0`, `cam1`, …
//! (<https://github.com/ethz-asl/kalibr/wiki/yaml-formats>).

use std::path::Path;

use super::camera::{CameraCalibration, intrinsics};
use crate::text::excerpt::Excerpt;
use crate::yaml::Node;
use crate::{Error, Result};

/// Whether a name is that of a camera of a camchain.
pub(crate) fn is_camera(name: &str) -> bool {
    let number = name.strip_prefix("cam").unwrap_or("");
    !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
}

/// Whether a document is a camchain.
pub(crate) fn is_camchain(root: &Node) -> bool {
    root.entries().iter().any(|(name, node)| is_camera(name) && node.get("intrinsics").is_some())
}

/// The cameras of a camchain.
pub(crate) fn cameras(path: &Path, root: &Node) -> Result<Vec<CameraCalibration>> {
    let cameras = root.entries().iter().filter(|(name, _)| is_camera(name));
    cameras.map(|(name, node)| camera(path, name, node)).collect()
}

fn camera(path: &Path, name: &str, node: &Node) -> Result<CameraCalibration> {
    let find =
        |key: &str| node.get(key).ok_or_else(|| node.error(path, format!("{name} has no {key}")));
    let word = |key: &str| -> Result<&str> {
        let found = find(key)?;
        found.text().ok_or_else(|| found.error(path, format!("{key} of {name} is no name")))
    };
    let projection = word("camera_model")?;
    if !["pinhole", "eucm"].contains(&projection) {
        let what = format!(
            "{name} has the camera model {}: only pinhole and eucm can be used",
            Excerpt(projection)
        );
        return Err(find("camera_model")?.error(path, what));
    }
    let numbers = |key: &str, count: usize| -> Result<Vec<f64>> {
        let found = find(key)?;
        let numbers = found.numbers(path, &format!("{key} of {name}"))?;
        if numbers.len() == count {
            return Ok(numbers);
        }
        let what = format!("{key} of {name} has {} numbers in place of {count}", numbers.len());
        Err(found.error(path, what))
    };
    let distortion =
        if node.get("distortion_model").is_some() { word("distortion_model")? } else { "none" };
    // α and β stand before the numbers of the image plane.
    let (plane, shape) = match projection {
        "eucm" => {
            let numbers = numbers("intrinsics", 6)?;
            (numbers[2..].to_vec(), numbers[..2].to_vec())
        }
        _ => (numbers("intrinsics", 4)?, Vec::new()),
    };
    let (model, further) = match distortion {
        "none" if projection == "eucm" => ("EUCM", shape),
        _ if projection == "eucm" => {
            let what = format!("{name} has eucm with a distortion model: none is expected");
            return Err(find("distortion_model")?.error(path, what));
        }
        "none" => ("PINHOLE", Vec::new()),
        "radtan" => ("OPENCV", numbers("distortion_coeffs", 4)?),
        "equidistant" => ("OPENCV_FISHEYE", numbers("distortion_coeffs", 4)?),
        "fov" => ("FOV", numbers("distortion_coeffs", 1)?),
        other => {
            let what = format!(
                "{name} has the distortion model {}: radtan, equidistant, fov or none is expected",
                Excerpt(other)
            );
            return Err(find("distortion_model")?.error(path, what));
        }
    };
    let at = find("intrinsics")?;
    let four = [plane[0], plane[1], plane[2], plane[3]];
    let intrinsics = intrinsics(model, four, &further)
        .map_err(|what| -> Error { at.error(path, format!("{name}: {what}")) })?;
    let size = match node.get("resolution") {
        None => None,
        Some(found) => {
            let sides = numbers("resolution", 2)?;
            let is_side =
                |side: &f64| side.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(side);
            if !sides.iter().all(is_side) {
                return Err(
                    found.error(path, format!("resolution of {name} is no width and height"))
                );
            }
            Some([sides[0] as u32, sides[1] as u32])
        }
    };
    let topic = node.get("rostopic").and_then(Node::text).map(str::to_owned);
    Ok(CameraCalibration { name: name.to_owned(), topic, size, intrinsics })
}
