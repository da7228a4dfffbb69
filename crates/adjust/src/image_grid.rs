use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::Camera;

/// Returns the row-major index of the cell that contains a pixel, in a grid of `side` × `side`
/// cells.
pub fn grid_cell(camera: &Camera, pixel: &Vector2<f64>, side: usize) -> usize {
    let along = |v: f64, size: u32| ((v / f64::from(size) * side as f64) as usize).min(side - 1);
    along(pixel.y, camera.height) * side + along(pixel.x, camera.width)
}
