//! Square cells of an image, ten along its larger side.

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::Camera;

/// Cells along the larger side. Chosen on the rendered table and facade of
/// docs/benchmarks/photos.md, without half and double.
const CELLS: f64 = 10.0;

/// The column and row of the cell that contains a pixel.
pub(super) fn square_cell(camera: &Camera, pixel: &Vector2<f64>) -> (i64, i64) {
    let side_px = f64::from(camera.width.max(camera.height)) / CELLS;
    ((pixel.x / side_px) as i64, (pixel.y / side_px) as i64)
}
