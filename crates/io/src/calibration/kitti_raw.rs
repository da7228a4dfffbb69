//! `calib_cam_to_cam.txt` of KITTI's raw recordings (Geiger, Lenz, Stiller & Urtasun 2013): of the
//! camera NN, the projection matrix `P_rect_NN` and the size `S_rect_NN` of its rectified images.

use std::collections::BTreeMap;
use std::path::Path;

use super::camera::{CameraCalibration, intrinsics};
use crate::text::Lines;
use crate::{Error, Result};

const MATRIX: &str = "P_rect_";
const SIZE: &str = "S_rect_";

/// Whether a text has the matrix of a rectified camera.
pub(super) fn is_raw(text: &str) -> bool {
    text.lines().any(|line| line.starts_with(MATRIX))
}

/// The rectified cameras, in the order of their numbers.
pub(super) fn cameras(path: &Path) -> Result<Vec<CameraCalibration>> {
    let mut lines = Lines::open(path)?;
    let mut sizes = BTreeMap::new();
    let mut matrices = BTreeMap::new();
    while let Some(mut words) = lines.next()? {
        let name = words.word("a name")?.trim_end_matches(':');
        let is_twice = if let Some(number) = name.strip_prefix(SIZE) {
            let [width, height] = words.f64s("a width and a height")?;
            let is_side =
                |side: f64| side.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&side);
            if !is_side(width) || !is_side(height) {
                return Err(words.error("is no width and height"));
            }
            sizes.insert(number.to_owned(), [width as u32, height as u32]).is_some()
        } else if let Some(number) = name.strip_prefix(MATRIX) {
            let p = words.f64s::<12>("a matrix of 12 numbers")?;
            if [p[1], p[4], p[8], p[9], p[10]] != [0.0, 0.0, 0.0, 0.0, 1.0] {
                return Err(words.error("the matrix is none of a rectified camera"));
            }
            let intrinsics = intrinsics("PINHOLE", [p[0], p[5], p[2], p[6]], &[])
                .map_err(|what| words.error(what))?;
            matrices.insert(number.to_owned(), intrinsics).is_some()
        } else {
            false
        };
        if is_twice {
            return Err(words.error("the name is there twice"));
        }
    }
    let camera = |(number, intrinsics)| {
        let size = sizes.get(&number).copied();
        let size = size.ok_or_else(|| Error::content(path, format!("has no {SIZE}{number}")))?;
        Ok(CameraCalibration {
            name: format!("{MATRIX}{number}"),
            topic: Some(format!("image_{number}")),
            size: Some(size),
            intrinsics,
        })
    };
    matrices.into_iter().map(camera).collect()
}
