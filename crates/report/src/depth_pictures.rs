//! The dense stage in `report.html`: the cloud, and small pictures of depth maps.

use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::input::Rgb;
use tiepoint_pipeline::io::dense::DenseMap;
use tiepoint_pipeline::io::ply::{self, Vertex};
use tiepoint_pipeline::sfm::scene::Reconstruction;
use tiepoint_pipeline::workspace::depth_map_path;

/// Largest number of pictures of a page, and their largest side: together some 500 kB.
const MAX_PICTURES: usize = 12;
const MAX_SIDE: usize = 200;
/// Shares of the depths that are nearer than the lightest and farther than the darkest colour.
const TAIL: f64 = 0.02;
/// Colours from far to near: five of viridis (Smith & van der Walt 2015), between which colours are
/// interpolated. Brightness grows evenly, also in grey and for the colour-blind.
const COLORS: [[f64; 3]; 5] = [
    [68.0, 1.0, 84.0],
    [59.0, 82.0, 139.0],
    [33.0, 145.0, 140.0],
    [94.0, 201.0, 98.0],
    [253.0, 231.0, 37.0],
];

/// The dense cloud of a workspace, and pictures of its depth maps.
#[derive(Clone, Debug, Default)]
pub struct DenseView {
    /// The points, in the frame of the model.
    pub points: Vec<Vertex>,
    /// Names of images, and their depth maps as PNG files: far depths are dark, near ones light;
    /// pixels without a depth are black.
    pub pictures: Vec<(String, Vec<u8>)>,
}

impl DenseView {
    /// Reads the dense cloud and depth maps of a workspace. At most twelve images have a picture;
    /// those whose depth map was deleted have none.
    ///
    /// # Errors
    ///
    /// A file cannot be read.
    pub(crate) fn read(
        cloud: &Path,
        workspace: &Path,
        model: &Reconstruction,
    ) -> Result<Self, Error> {
        let points = ply::read(cloud)?;
        let step = model.num_registered().div_ceil(MAX_PICTURES).max(1);
        let mut pictures = Vec::new();
        for (_, image, _) in model.registered().step_by(step) {
            let file = workspace.join(depth_map_path(&image.name));
            if !file.is_file() {
                continue;
            }
            let map = DenseMap::read(&file)?;
            if let Some(picture) = picture(&map) {
                pictures.push((image.name.clone(), picture.png()?));
            }
        }
        Ok(Self { points, pictures })
    }
}

/// A picture of a depth map, at most [`MAX_SIDE`] wide and high; `None` without a depth.
fn picture(map: &DenseMap) -> Option<Rgb> {
    let mut inverse: Vec<f32> =
        map.values.iter().filter(|depth| **depth > 0.0).map(|depth| 1.0 / depth).collect();
    inverse.sort_by(f32::total_cmp);
    let tail = (TAIL * inverse.len() as f64) as usize;
    let (far, near) = (inverse.get(tail)?, inverse.get(inverse.len() - 1 - tail)?);
    let step = map.width.max(map.height).div_ceil(MAX_SIDE).max(1);
    let mut data = Vec::new();
    for y in (0..map.height).step_by(step) {
        for x in (0..map.width).step_by(step) {
            let depth = map.values[y * map.width + x];
            let share = (1.0 / depth - far) / (near - far).max(f32::MIN_POSITIVE);
            data.extend(if depth > 0.0 { color(f64::from(share)) } else { [0; 3] });
        }
    }
    let (width, height) = (map.width.div_ceil(step) as u32, map.height.div_ceil(step) as u32);
    Some(Rgb { width, height, data })
}

/// The colour of a share from 0 (far) to 1 (near).
fn color(share: f64) -> [u8; 3] {
    let place = share.clamp(0.0, 1.0) * (COLORS.len() - 1) as f64;
    let index = (place as usize).min(COLORS.len() - 2);
    let part = place - index as f64;
    std::array::from_fn(|channel| {
        let (from, to) = (COLORS[index][channel], COLORS[index + 1][channel]);
        (from + part * (to - from)).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_small_and_light_where_depths_are_near() {
        let (width, height) = (500, 300);
        let depth = |index: usize| match index % width {
            0..100 => 0.0,
            100..300 => 2.0,
            _ => 9.0,
        };
        let values = (0..width * height).map(depth).collect();
        let found = picture(&DenseMap { width, height, channels: 1, values }).unwrap();
        assert_eq!((found.width, found.height), (167, 100));
        assert_eq!(found.pixel(10, 50), [0; 3]);
        assert_eq!(found.pixel(60, 50), [253, 231, 37]);
        assert_eq!(found.pixel(150, 50), [68, 1, 84]);
        let none = DenseMap { width: 2, height: 1, channels: 1, values: vec![0.0; 2] };
        assert_eq!(picture(&none), None);
    }
}
