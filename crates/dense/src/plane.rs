//! Planes in space as a pixel sees them: the inverse depth is linear in the pixel coordinates.

use crate::pinhole::PosedPinhole;

/// Largest angle between the normal of a plane and the ray to the camera, as a cosine: at 80° a
/// patch is six times longer on the surface than wide, and its image in another view has another
/// shape than a plane predicts.
const MIN_COSINE: f32 = 0.173_648_18;

/// A plane through a pixel: 1/z = `inverse_depth` + `slope[0]` · dx + `slope[1]` · dy, for offsets
/// (dx, dy) from the pixel, in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Plane {
    pub(crate) inverse_depth: f32,
    pub(crate) slope: [f32; 2],
}

impl Plane {
    /// Parallel to the image.
    pub(crate) fn frontal(inverse_depth: f32) -> Self {
        Self { inverse_depth, slope: [0.0; 2] }
    }

    /// The same plane through another pixel.
    #[inline(always)]
    pub(crate) fn moved(&self, dx: f32, dy: f32) -> Self {
        let Self { inverse_depth, slope: [a, b] } = *self;
        Self { inverse_depth: inverse_depth + a * dx + b * dy, slope: [a, b] }
    }

    /// The same plane on the level of twice the resolution, through the pixel at an offset of
    /// (dx, dy) pixels of that level.
    pub(crate) fn refined(&self, dx: f32, dy: f32) -> Self {
        let Self { inverse_depth, slope } = *self;
        Self { inverse_depth, slope: slope.map(|slope| 0.5 * slope) }.moved(dx, dy)
    }
}

/// The rays of a camera, for normals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rays {
    pub(crate) focal: [f32; 2],
    centre: [f32; 2],
}

impl Rays {
    pub(crate) fn new(camera: &PosedPinhole) -> Self {
        Self {
            focal: camera.focal.map(|focal| focal as f32),
            centre: camera.centre.map(|centre| (centre - 0.5) as f32),
        }
    }

    /// The normal of a plane, not of unit length, away from the camera; n · (x/z, y/z, 1) is the
    /// inverse depth.
    #[inline(always)]
    pub(crate) fn normal(&self, x: f32, y: f32, plane: &Plane) -> [f32; 3] {
        let [a, b] = plane.slope;
        let [dx, dy] = [x - self.centre[0], y - self.centre[1]];
        [a * self.focal[0], b * self.focal[1], plane.inverse_depth - a * dx - b * dy]
    }

    /// The unit normal of a plane, towards the camera.
    pub(crate) fn unit_normal(&self, x: f32, y: f32, plane: &Plane) -> [f32; 3] {
        let normal = self.normal(x, y, plane);
        let length = length(&normal);
        if length > 0.0 { normal.map(|value| -value / length) } else { [0.0, 0.0, -1.0] }
    }

    /// The plane of a normal (of any length and side) and an inverse depth; `None` if the plane
    /// holds the ray of the pixel.
    pub(crate) fn plane(
        &self,
        x: f32,
        y: f32,
        inverse_depth: f32,
        normal: &[f32; 3],
    ) -> Option<Plane> {
        let ray = self.ray(x, y);
        let along = normal[0] * ray[0] + normal[1] * ray[1] + normal[2];
        let scale = inverse_depth / along;
        let slope = [normal[0] / self.focal[0] * scale, normal[1] / self.focal[1] * scale];
        slope.iter().all(|slope| slope.is_finite()).then_some(Plane { inverse_depth, slope })
    }

    fn ray(&self, x: f32, y: f32) -> [f32; 2] {
        [(x - self.centre[0]) / self.focal[0], (y - self.centre[1]) / self.focal[1]]
    }

    /// Whether the camera sees the plane at less than the largest angle.
    #[inline(always)]
    pub(crate) fn sees(&self, x: f32, y: f32, plane: &Plane) -> bool {
        let n = self.normal(x, y, plane);
        let [u, v] = self.ray(x, y);
        let squared = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) * (u * u + v * v + 1.0);
        plane.inverse_depth * plane.inverse_depth > MIN_COSINE * MIN_COSINE * squared
    }
}

fn length(vector: &[f32; 3]) -> f32 {
    vector.iter().map(|value| value * value).sum::<f32>().sqrt()
}
