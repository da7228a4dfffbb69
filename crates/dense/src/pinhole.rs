//! Pinhole cameras with poses, on the levels of an image pyramid.

use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Rigid3};
use tiepoint_scene::Camera;

/// A pinhole camera with its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosedPinhole {
    /// Width of the image, in pixels.
    pub width: usize,
    /// Height of the image, in pixels.
    pub height: usize,
    /// fx and fy, in pixels.
    pub focal: [f64; 2],
    /// cx and cy, in pixels; the centre of the top-left pixel is (0.5, 0.5).
    pub centre: [f64; 2],
    /// The pose.
    pub cam_from_world: Rigid3,
}

impl PosedPinhole {
    /// From a camera of the models PINHOLE and SIMPLE_PINHOLE; `None` for others.
    pub fn new(camera: &Camera, cam_from_world: &Rigid3) -> Option<Self> {
        let kind = camera.intrinsics.kind();
        let k = camera.intrinsics.calibration_matrix();
        matches!(kind, CameraModelKind::SimplePinhole | CameraModelKind::Pinhole).then(|| Self {
            width: camera.width as usize,
            height: camera.height as usize,
            focal: [k[(0, 0)], k[(1, 1)]],
            centre: [k[(0, 2)], k[(1, 2)]],
            cam_from_world: *cam_from_world,
        })
    }

    /// The camera of an image at half resolution ([`crate::Grey`]'s halves).
    pub(crate) fn halved(&self) -> Self {
        Self {
            width: self.width / 2,
            height: self.height / 2,
            focal: self.focal.map(|focal| 0.5 * focal),
            centre: self.centre.map(|centre| 0.5 * centre),
            cam_from_world: self.cam_from_world,
        }
    }

    /// K for pixel indices: the centre of the top-left pixel is (0, 0).
    fn index_matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre.map(|centre| centre - 0.5));
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// The ray (x/z, y/z) of a pixel index.
    pub(crate) fn ray(&self, x: f64, y: f64) -> [f64; 2] {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        [(x + 0.5 - cx) / fx, (y + 0.5 - cy) / fy]
    }

    /// The point in the camera frame of a pixel index and a depth.
    pub(crate) fn point(&self, x: f64, y: f64, depth: f64) -> Vector3<f64> {
        let [u, v] = self.ray(x, y);
        Vector3::new(u, v, 1.0) * depth
    }

    /// The pixel index (not rounded) of a point in the camera frame; `None` behind the camera.
    pub(crate) fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        (point.z > tiepoint_geometry::cameras::MIN_DEPTH).then(|| {
            Vector2::new(fx * point.x / point.z + cx - 0.5, fy * point.y / point.z + cy - 0.5)
        })
    }
}

/// Transfer of a pixel with an inverse depth to another image (Hartley & Zisserman, Eq. 9.7):
/// x' ~ infinite_homography · x + epipole · (1/z), for pixel indices.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transfer {
    /// K' R K⁻¹, by columns.
    pub(crate) columns: [[f32; 3]; 3],
    /// K' t.
    pub(crate) epipole: [f32; 3],
}

impl Transfer {
    pub(crate) fn new(from: &PosedPinhole, to: &PosedPinhole) -> Self {
        let to_from = to.cam_from_world * from.cam_from_world.inverse();
        let rotation = to_from.rotation.to_rotation_matrix().into_inner();
        let ([fx, fy], [cx, cy]) = (from.focal, from.centre.map(|centre| centre - 0.5));
        let inverse = Matrix3::new(1.0 / fx, 0.0, -cx / fx, 0.0, 1.0 / fy, -cy / fy, 0.0, 0.0, 1.0);
        let homography = to.index_matrix() * rotation * inverse;
        let epipole = to.index_matrix() * to_from.translation;
        let column = |index: usize| std::array::from_fn(|row| homography[(row, index)] as f32);
        Self {
            columns: std::array::from_fn(column),
            epipole: std::array::from_fn(|row| epipole[row] as f32),
        }
    }

    /// The transferred pixel at infinity, homogeneous.
    #[inline(always)]
    pub(crate) fn at_infinity(&self, x: f32, y: f32) -> [f32; 3] {
        let [a, b, c] = &self.columns;
        [a[0] * x + b[0] * y + c[0], a[1] * x + b[1] * y + c[1], a[2] * x + b[2] * y + c[2]]
    }

    /// The transferred pixel, homogeneous, from that at infinity.
    #[inline(always)]
    pub(crate) fn at(&self, at_infinity: &[f32; 3], inverse_depth: f32) -> [f32; 3] {
        let e = &self.epipole;
        [
            at_infinity[0] + e[0] * inverse_depth,
            at_infinity[1] + e[1] * inverse_depth,
            at_infinity[2] + e[2] * inverse_depth,
        ]
    }

    /// Squared derivative of a transferred pixel, of this homogeneous place, by the inverse depth.
    #[inline(always)]
    pub(crate) fn squared_parallax(&self, [x, y, z]: &[f32; 3]) -> f32 {
        let e = &self.epipole;
        let inverse = 1.0 / z;
        let (u, v) = (x * inverse, y * inverse);
        let (du, dv) = ((e[0] - e[2] * u) * inverse, (e[1] - e[2] * v) * inverse);
        du * du + dv * dv
    }
}
