//! Rendered photos of a corner of a room: three textured planes, with true poses.

use std::fs;
use std::path::Path;

use image::{GrayImage, Luma};
use tiepoint_pipeline::sfm::geometry::Rigid3;
use tiepoint_pipeline::sfm::geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

pub(crate) const WIDTH: u32 = 320;
pub(crate) const HEIGHT: u32 = 240;
/// Focal length of a pinhole camera, in pixels; the program's default is 1.2 × 320 = 384.
pub(crate) const FOCAL_PX: f64 = 330.0;

/// Planes of the walls, in metres: x = 1.5, y (down) = 1, z = 5.
const WALLS_M: [f64; 3] = [1.5, 1.0, 5.0];
/// Cells of the finest texture, per metre: about three pixels at the distance of the corner.
const FINEST_PER_M: f64 = 24.0;

/// Camera `index`, on an arc of 0.35 m steps round the corner, looking at it.
pub(crate) fn cam_from_world(index: usize) -> Rigid3 {
    let s = 0.35 * index as f64;
    let centre = Vector3::new(-1.0 + s, -0.4 + 0.1 * s, 0.15 * s * s);
    let forward = (Vector3::new(0.6, 0.4, 4.0) - centre).normalize();
    let right = Vector3::y().cross(&forward).normalize();
    let down = forward.cross(&right);
    let world_from_cam =
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    Rigid3::new(UnitQuaternion::from_rotation_matrix(&world_from_cam), centre).inverse()
}

/// The image of camera `index`; `room` is the seed of the texture.
pub(crate) fn photo(index: usize, room: u64) -> GrayImage {
    photo_from(&cam_from_world(index), room)
}

/// The image of a camera with this pose.
pub(crate) fn photo_from(cam_from_world: &Rigid3, room: u64) -> GrayImage {
    let world_from_cam = cam_from_world.inverse();
    GrayImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let pixel = [
            f64::from(x) + 0.5 - f64::from(WIDTH) / 2.0,
            f64::from(y) + 0.5 - f64::from(HEIGHT) / 2.0,
        ];
        let ray = world_from_cam.rotation * Vector3::new(pixel[0], pixel[1], FOCAL_PX);
        let centre = world_from_cam.translation;
        // The nearest wall in front of the camera.
        let hit = (0..3)
            .map(|wall| ((WALLS_M[wall] - centre[wall]) / ray[wall], wall))
            .filter(|(distance, _)| *distance > 0.0)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let brightness = hit.map_or(0.0, |(distance, wall)| {
            let point = centre + ray * distance;
            texture(room ^ wall as u64, point[(wall + 1) % 3], point[(wall + 2) % 3])
        });
        Luma([(255.0 * brightness) as u8])
    })
}

/// Three octaves of value noise, from 0 to 1.
fn texture(seed: u64, u: f64, v: f64) -> f64 {
    let octave = |level: u64, weight: f64| {
        let per_m = FINEST_PER_M / (1 << level) as f64;
        weight * noise(seed.wrapping_mul(31).wrapping_add(level), u * per_m, v * per_m)
    };
    octave(0, 0.4) + octave(1, 0.35) + octave(2, 0.25)
}

/// Value noise: random values at integer coordinates, interpolated smoothly.
fn noise(seed: u64, u: f64, v: f64) -> f64 {
    let corner = |i: f64, j: f64| {
        let mut z = (i as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ (j as i64 as u64).rotate_left(32)
            ^ (seed << 17);
        for _ in 0..2 {
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z ^= z >> 27;
        }
        (z >> 11) as f64 / (1u64 << 53) as f64
    };
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (i, j) = (u.floor(), v.floor());
    let (s, t) = (smooth(u - i), smooth(v - j));
    let top = corner(i, j) * (1.0 - s) + corner(i + 1.0, j) * s;
    let bottom = corner(i, j + 1.0) * (1.0 - s) + corner(i + 1.0, j + 1.0) * s;
    top * (1.0 - t) + bottom * t
}

/// Writes photos 0 to `count` of a room as `0.png`, …
pub(crate) fn write(dir: &Path, count: usize, room: u64) {
    fs::create_dir_all(dir).unwrap();
    for index in 0..count {
        photo(index, room).save(dir.join(format!("{index}.png"))).unwrap();
    }
}

/// Writes the truth of photos 0 to `count` in the format of Strecha et al.
pub(crate) fn write_truth(dir: &Path, count: usize) {
    fs::create_dir_all(dir).unwrap();
    for index in 0..count {
        let world_from_cam = cam_from_world(index).inverse();
        let (r, c) = (world_from_cam.rotation.to_rotation_matrix(), world_from_cam.translation);
        let row = |i: usize| format!("{} {} {}\n", r[(i, 0)], r[(i, 1)], r[(i, 2)]);
        let (cx, cy) = (f64::from(WIDTH) / 2.0, f64::from(HEIGHT) / 2.0);
        let text = format!(
            "{FOCAL_PX} 0 {cx}\n0 {FOCAL_PX} {cy}\n0 0 1\n0 0 0\n{}{}{}{} {} {}\n{WIDTH} \
            {HEIGHT}\n",
            row(0),
            row(1),
            row(2),
            c.x,
            c.y,
            c.z
        );
        fs::write(dir.join(format!("{index}.png.camera")), text).unwrap();
    }
}
