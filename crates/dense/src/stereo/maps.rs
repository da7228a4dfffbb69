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
    /// `width * height` probabilities that the depth is within five footprints (depths over the
    /// focal length) of the surface; 0 where there is no depth.
    pub confidences: Vec<f32>,
}

impl DepthMap {
    /// Without depths.
    pub fn empty(width: usize, height: usize) -> Self {
        let none = vec![0.0; width * height];
        Self { width, height, depths: none.clone(), confidences: none }
    }
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
