//! The ground truth of Strecha et al. 2008 (fountain-P11, Herz-Jesus-P8 and others). Each image has
//! a `.camera` file with the rows of K, a line `0 0 0`, the rows of R_world_from_cam, the centre,
//! and width and height. K is returned as it is in the file, without a change of the pixel
//! convention.

use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};

use crate::text::Lines;
use crate::{Error, Result, rotation};

/// The ground truth of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct StrechaCamera {
    /// Name of the image: the name of the file without `.camera`.
    pub name: String,
    /// Calibration matrix K, in pixels.
    pub calibration: Matrix3<f64>,
    /// Transform from the world to the camera, in metres.
    pub cam_from_world: Rigid3,
    /// Width of the image, in pixels.
    pub width: u32,
    /// Height of the image, in pixels.
    pub height: u32,
}

const SUFFIX: &str = ".camera";

/// Reads all `.camera` files of a folder, in byte order of their names.
///
/// # Errors
///
/// If the folder has no `.camera` file, and if a file is not as described.
pub fn read(dir: &Path) -> Result<Vec<StrechaCamera>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(Error::io(dir))? {
        let name = entry.map_err(Error::io(dir))?.file_name();
        names.extend(name.to_str().and_then(|name| name.strip_suffix(SUFFIX)).map(str::to_owned));
    }
    if names.is_empty() {
        return Err(Error::content(dir, format!("holds no {SUFFIX} files")));
    }
    names.sort();
    names.into_iter().map(|name| read_camera(&dir.join(format!("{name}{SUFFIX}")), name)).collect()
}

fn read_camera(path: &Path, name: String) -> Result<StrechaCamera> {
    let mut lines = Lines::open(path)?;
    let calibration = matrix(&mut lines, "a row of K")?;
    row(&mut lines, "the line 0 0 0")?;
    let rotation = rotation::from_matrix(&matrix(&mut lines, "a row of R")?)
        .map_err(|what| lines.error(what))?;
    let centre = Vector3::from(row(&mut lines, "the centre")?);
    let mut size = lines.expect("width and height")?;
    let (width, height) = (size.number("the width")?, size.number("the height")?);
    let cam_from_world = Rigid3::new(rotation, centre).inverse(); // of world_from_cam
    Ok(StrechaCamera { name, calibration, cam_from_world, width, height })
}

fn row(lines: &mut Lines, what: &str) -> Result<[f64; 3]> {
    lines.expect(what)?.f64s(what)
}

fn matrix(lines: &mut Lines, what: &str) -> Result<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(
        [row(lines, what)?, row(lines, what)?, row(lines, what)?].as_flattened(),
    ))
}
