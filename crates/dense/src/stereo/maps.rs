//! Results of stereo, by pixel.

use crate::plane::Plane;

/// Depths of an image, by rows; 0 where there is none.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` depths (z in the camera frame), in the unit of the model.
    pub depths: Vec<f32>,
}

/// A plane for each pixel of an image, by rows.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneMap {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Inverse depth, its derivatives by x and y (in pixels), and the cost of each pixel.
    pub planes: Vec<[f32; 4]>,
}

impl PlaneMap {
    /// The depths of the pixels whose cost is at most `max_cost`.
    pub fn depth_map(&self, max_cost: f32) -> DepthMap {
        let depth = |plane: &[f32; 4]| {
            if plane[3] <= max_cost && plane[0] > 0.0 { 1.0 / plane[0] } else { 0.0 }
        };
        let depths = self.planes.iter().map(depth).collect();
        DepthMap { width: self.width, height: self.height, depths }
    }

    /// The inverse depth at a pixel index that need not be whole, on the plane of the pixel that
    /// holds it; `None` outside of the image and where there is no plane.
    #[inline(always)]
    pub(crate) fn inverse_depth_at(&self, x: f32, y: f32) -> Option<f32> {
        let (column, row) = ((x + 0.5).floor(), (y + 0.5).floor());
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < self.width as f32 && row < self.height as f32;
        if !is_inside {
            return None;
        }
        let [inverse_depth, a, b, _] = self.planes[row as usize * self.width + column as usize];
        let here = inverse_depth + a * (x - column) + b * (y - row);
        (inverse_depth > 0.0 && here > 0.0).then_some(here)
    }

    pub(crate) fn plane(&self, index: usize) -> (Plane, f32) {
        let [inverse_depth, a, b, cost] = self.planes[index];
        (Plane { inverse_depth, slope: [a, b] }, cost)
    }
}
