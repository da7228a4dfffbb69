//! Normals of a depth map: of the plane that fits the neighbourhood of each pixel.

use rayon::prelude::*;

use super::maps::DepthMap;
use crate::pinhole::PosedPinhole;
use crate::plane::{Plane, Rays};

/// Radius of the neighbourhood, in pixels: that of a patch of half the size, within which the
/// depths are independent enough to average.
const RADIUS: usize = 3;
/// Largest step of the inverse depth between neighbours of one surface over the radius, relative: a
/// surface at 80° changes by about this much for a focal length of 500 pixels.
const MAX_STEP: f32 = 0.05;

/// The unit normals of a depth map in the camera frame, towards the camera, by rows; zero where
/// there is no depth.
pub fn normals_of(depths: &DepthMap, camera: &PosedPinhole) -> Vec<[f32; 3]> {
    let rays = Rays::new(camera);
    let DepthMap { width, height, depths, .. } = depths;
    let mut normals = vec![[0.0; 3]; depths.len()];
    normals.par_chunks_mut((*width).max(1)).enumerate().for_each(|(y, normals)| {
        for (x, normal) in normals.iter_mut().enumerate() {
            let depth = depths[y * width + x];
            if depth > 0.0 {
                let plane = fitted(depths, *width, *height, x, y, 1.0 / depth);
                *normal = rays.unit_normal(x as f32, y as f32, &plane);
            }
        }
    });
    normals
}

/// Least-squares plane of the inverse depths around a pixel, which are linear in the pixel
/// coordinates on a plane in space.
fn fitted(
    depths: &[f32],
    width: usize,
    height: usize,
    x: usize,
    y: usize,
    inverse_depth: f32,
) -> Plane {
    let mut normal_matrix = [0.0f32; 6];
    let mut right = [0.0f32; 3];
    for row in y.saturating_sub(RADIUS)..=(y + RADIUS).min(height - 1) {
        for column in x.saturating_sub(RADIUS)..=(x + RADIUS).min(width - 1) {
            let depth = depths[row * width + column];
            let step = 1.0 / depth - inverse_depth;
            if !(depth > 0.0 && step.abs() < MAX_STEP * inverse_depth) {
                continue;
            }
            let (dx, dy) = (column as f32 - x as f32, row as f32 - y as f32);
            let products = [dx * dx, dx * dy, dx, dy * dy, dy, 1.0];
            for (sum, product) in normal_matrix.iter_mut().zip(products) {
                *sum += product;
            }
            for (sum, product) in right.iter_mut().zip([dx * step, dy * step, step]) {
                *sum += product;
            }
        }
    }
    // Elimination of the offset, then Cramer's rule.
    let [xx, xy, x1, yy, y1, n] = normal_matrix;
    let (xx, xy, yy) = (xx - x1 * x1 / n, xy - x1 * y1 / n, yy - y1 * y1 / n);
    let (bx, by) = (right[0] - x1 * right[2] / n, right[1] - y1 * right[2] / n);
    let determinant = xx * yy - xy * xy;
    if determinant < 1e-3 {
        return Plane::frontal(inverse_depth);
    }
    let slope = [(yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant];
    Plane { inverse_depth, slope }
}
