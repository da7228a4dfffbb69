//! Pinhole cameras with poses, on the levels of an image pyramid.

use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Rigid3};
use tiepoint_scene::Camera;

use crate::rows::PixelPoses;

/// Fixed-point steps from the place of a point at the time of the middle row to that at the time of
/// its row. An image moves by a twentieth of its height during the readout, or less, so that an
/// error of 1/40 of the height becomes 1/320,000 of it.
const SEE_STEPS: usize = 3;

/// A pinhole camera with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedPinhole {
    /// Width of the image, in pixels.
    pub width: usize,
    /// Height of the image, in pixels.
    pub height: usize,
    /// fx and fy, in pixels.
    pub focal: [f64; 2],
    /// cx and cy, in pixels; the centre of the top-left pixel is (0.5, 0.5).
    pub centre: [f64; 2],
    /// The pose; that of the middle row of a rolling shutter.
    pub cam_from_world: Rigid3,
    /// The poses of the pixels of a rolling shutter. The depth of a pixel is z in its own pose.
    pub rows: Option<PixelPoses>,
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
            rows: None,
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
            rows: self.rows.as_ref().map(PixelPoses::halved),
        }
    }

    /// The pose at a time, in readouts from the middle row.
    pub(crate) fn at_time(&self, time: f64) -> Rigid3 {
        let middle = &self.cam_from_world;
        self.rows.as_ref().map_or(*middle, |rows| rows.at_time(middle, time))
    }

    /// The pose of a pixel index, which need not be whole. Places far outside of the image have
    /// that of a row one readout from the middle: their own would be metres away, from where a
    /// point may seem to be in the image.
    pub(crate) fn pose(&self, x: f64, y: f64) -> Rigid3 {
        let Some(rows) = &self.rows else { return self.cam_from_world };
        let time = rows.times.at(x as f32, y as f32).time.clamp(-1.0, 1.0);
        rows.at_time(&self.cam_from_world, f64::from(time))
    }

    /// K for pixel indices: the centre of the top-left pixel is (0, 0).
    pub(crate) fn index_matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre.map(|centre| centre - 0.5));
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// A point of the world frame in the frame of the camera when it sees the point, and the pixel
    /// index, not rounded; `None` behind the camera.
    pub(crate) fn see(&self, point: &Vector3<f64>) -> Option<(Vector3<f64>, Vector2<f64>)> {
        let mut in_camera = self.cam_from_world * *point;
        let mut place = self.project(&in_camera)?;
        let steps = if self.rows.is_some() { SEE_STEPS } else { 0 };
        for _ in 0..steps {
            in_camera = self.pose(place.x, place.y) * *point;
            place = self.project(&in_camera)?;
        }
        Some((in_camera, place))
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
