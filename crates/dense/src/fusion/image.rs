//! A depth map with its camera, normals and colours, and the agreement of two of them.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;

use super::options::FusionOptions;
use crate::Error;
use crate::pinhole::PosedPinhole;
use crate::stereo::{DepthMap, normals_of};

/// Scale of a component of a normal in memory.
const NORMAL_SCALE: f32 = 32_767.0;
/// A confidence of 1 in memory. No depth has it, nor 0: its odds are finite.
const CERTAIN: u8 = u8::MAX;

/// Smallest cosine of the angle between a normal and a ray, for pixels without a normal.
const MIN_COSINE: f64 = 0.1;

/// An image for [`fuse`](super::fuse).
#[derive(Clone, Debug)]
pub struct FusionImage {
    pub(super) camera: PosedPinhole,
    pose: Pose,
    /// By pixel; 0 where there is none.
    pub(super) depths: Vec<f32>,
    /// Of each depth, in units of 1/[`CERTAIN`].
    confidences: Vec<u8>,
    /// Normals in the camera frame.
    normals: Vec<[i16; 3]>,
    /// Red, green, blue by pixel.
    colors: Vec<u8>,
    /// One bit a pixel. Before the image is visited: an earlier image left the surface to this
    /// pixel. After: the surface is in the cloud. Empty if there is none.
    pub(super) marks: Vec<u64>,
}

/// A pose and its inverse.
#[derive(Clone, Copy, Debug)]
struct Pose {
    cam_from_world: Rigid3,
    world_from_cam: Rigid3,
}

impl Pose {
    fn new(cam_from_world: Rigid3) -> Self {
        Self { cam_from_world, world_from_cam: cam_from_world.inverse() }
    }
}

/// The surface at a pixel.
pub(super) struct Surface {
    /// The pose of the pixel.
    pose: Pose,
    pub(super) index: usize,
    /// The ray with z = 1, in the camera frame.
    ray: Vector3<f64>,
    pub(super) depth: f64,
    /// Unit normal in the world frame.
    pub(super) normal: Vector3<f64>,
    pub(super) color: [u8; 3],
    /// That the depth is right.
    pub(super) odds: f32,
}

/// What another image sees at a surface.
pub(super) struct Agreement {
    /// Depth in the reference image of the surface that the other image sees.
    pub(super) depth: f64,
    pub(super) surface: Surface,
    /// Area of the pixel of the other image on the surface, in those of the pixel of the reference.
    pub(super) area: f64,
}

impl FusionImage {
    /// `colors`: red, green and blue of each pixel. Normals are those of the depth map.
    ///
    /// # Errors
    /// [`Error::Size`] if the depth map, its confidences or the colours do not have the size of the
    /// camera.
    pub fn new(camera: PosedPinhole, depths: DepthMap, colors: Vec<u8>) -> Result<Self, Error> {
        let count = camera.width * camera.height;
        let has_size = (depths.width, depths.height) == (camera.width, camera.height);
        let lengths = [depths.depths.len(), depths.confidences.len()];
        if !has_size || lengths != [count; 2] || colors.len() != 3 * count {
            let (width, height) = (camera.width as u32, camera.height as u32);
            return Err(Error::Size { width, height, found: colors.len() });
        }
        let normals = normals_of(&depths, &camera);
        let normals =
            normals.iter().map(|normal| normal.map(|value| (NORMAL_SCALE * value) as i16));
        let confidence = |value: &f32| {
            (f32::from(CERTAIN) * value).round().clamp(1.0, f32::from(CERTAIN - 1)) as u8
        };
        Ok(Self {
            pose: Pose::new(camera.cam_from_world),
            camera,
            confidences: depths.confidences.iter().map(confidence).collect(),
            depths: depths.depths,
            normals: normals.collect(),
            colors,
            marks: Vec::new(),
        })
    }

    /// The surface at a pixel; `None` without a depth.
    pub(super) fn surface(&self, x: usize, y: usize) -> Option<Surface> {
        let index = y * self.camera.width + x;
        let depth = f64::from(self.depths[index]);
        (depth > 0.0).then(|| {
            let normal =
                self.normals[index].map(|value| f64::from(value) / f64::from(NORMAL_SCALE));
            let normal = Vector3::from(normal);
            let (x, y) = (x as f64, y as f64);
            let ray = self.camera.point(x, y, 1.0);
            let pose = match self.camera.rows {
                None => self.pose,
                Some(_) => Pose::new(self.camera.pose(x, y)),
            };
            Surface {
                pose,
                index,
                ray,
                depth,
                normal: pose.world_from_cam.rotation * normal,
                color: std::array::from_fn(|channel| self.colors[3 * index + channel]),
                odds: f32::from(self.confidences[index])
                    / f32::from(CERTAIN - self.confidences[index]),
            }
        })
    }

    /// A point of the world frame in that of the camera, and the pixel that sees it; `None` if it
    /// lies outside of the image.
    pub(super) fn seen(&self, point: &Vector3<f64>) -> Option<(Vector3<f64>, [usize; 2])> {
        let (in_camera, place) = self.camera.see(point)?;
        let (x, y) = ((place.x + 0.5).floor(), (place.y + 0.5).floor());
        let (width, height) = (self.camera.width as f64, self.camera.height as f64);
        let is_inside = x >= 0.0 && y >= 0.0 && x < width && y < height;
        is_inside.then_some((in_camera, [x as usize, y as usize]))
    }

    /// Area of a pixel on a surface of this normal in the world frame, up to the length of the
    /// normal.
    fn area(&self, in_camera: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
        let [fx, fy] = self.camera.focal;
        // A square of one pixel at this depth, seen at the angle between surface and ray.
        let normal = self.pose.cam_from_world.rotation * normal;
        let cosine = normal.dot(in_camera).abs() / in_camera.norm();
        in_camera.z * in_camera.z / (fx * fy * cosine.max(MIN_COSINE))
    }

    pub(super) fn is_marked(&self, index: usize) -> bool {
        self.marks.get(index / 64).is_some_and(|word| word >> (index % 64) & 1 != 0)
    }
}

impl Surface {
    /// The point of the world frame on the ray at a depth.
    pub(super) fn world_point(&self, depth: f64) -> Vector3<f64> {
        self.pose.world_from_cam * (self.ray * depth)
    }
}

/// Sets the bit of a pixel.
pub(super) fn mark(marks: &mut [u64], pixel: usize) {
    marks[pixel / 64] |= 1 << (pixel % 64);
}

/// What `other` sees at a surface of `reference` that lies at `in_other` in its frame and in its
/// pixel `pixel`, if it is the same surface. `min_cosine` is that of the largest angle between the
/// normals.
pub(super) fn agreement(
    reference: &FusionImage,
    own: &Surface,
    other: &FusionImage,
    in_other: &Vector3<f64>,
    pixel: [usize; 2],
    min_cosine: f64,
    options: &FusionOptions,
) -> Option<Agreement> {
    let surface = other.surface(pixel[0], pixel[1])?;
    if surface.normal.dot(&own.normal) < min_cosine {
        return None;
    }
    // The plane of the pixel, met by the ray of the exact place: the depth of the pixel's centre
    // would be off by up to half a pixel of slope.
    let normal = surface.pose.cam_from_world.rotation * surface.normal;
    let ray = in_other / in_other.z;
    let along = normal.dot(&ray);
    let depth = normal.dot(&surface.ray) * surface.depth / along;
    if !(depth > 0.0 && (depth - in_other.z).abs() <= options.max_depth_error * in_other.z) {
        return None;
    }
    let back = own.pose.cam_from_world * (surface.pose.world_from_cam * (ray * depth));
    let seen = reference.camera.project(&back)?;
    let own_place = reference.camera.project(&(own.ray * own.depth))?;
    if (seen - own_place).norm() > options.max_error_px {
        return None;
    }
    // With one normal for both, so that each of the two images finds the same one finer.
    let normal = 0.5 * (own.normal + surface.normal);
    let area = other.area(in_other, &normal) / reference.area(&(own.ray * own.depth), &normal);
    Some(Agreement { depth: back.z, surface, area })
}
