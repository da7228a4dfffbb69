//! Visibility: the images that observe a point.

use std::collections::BTreeMap;

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_scene::Keypoint;

use super::options::FeatureOptions;
use crate::Drive;
use crate::render::surface_at;
use crate::world::Ray;

/// Range of keypoint scales, in pixels: the smallest of SIFT, and the largest of interest.
const SCALE_PX: [f64; 2] = [1.2, 16.0];
/// Largest ratio of scales with matching descriptors.
const MAX_SCALE_RATIO: f64 = 2.5;
/// Smallest cosine between surface normal and viewing direction of an observation.
const MIN_INCIDENCE: f64 = 0.25;
/// Smallest distance of an observed point, in metres.
const MIN_RANGE_M: f64 = 1.5;
/// Tolerance of the occlusion test, as a fraction of the length of the ray.
const SLACK: f64 = 2e-3;
/// Scale of a keypoint with noise of the given standard deviation, in pixels.
const NOISE_SCALE_PX: f64 = 2.0;

/// An observation of a point: image index and keypoint.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeypointObservation {
    pub(super) image: u32,
    pub(super) keypoint: Keypoint,
}

struct SceneImage {
    camera: usize,
    time_s: f64,
    rotation: Matrix3<f64>,
    centre: Vector3<f64>,
    focal_px: f64,
}

/// All images of a drive with a spatial index.
pub(super) struct SceneImages<'d> {
    drive: &'d Drive,
    images: Vec<SceneImage>,
    /// Image indices by cells of a grid in the plane, of side `cell_m`.
    cells: BTreeMap<(i32, i32), Vec<u32>>,
    cell_m: f64,
}

/// A random keypoint scale in pixels, with P(scale > s) proportional to s⁻², truncated at the
/// largest scale.
pub(super) fn sample_scale_px(rng: &mut Rng) -> f64 {
    (SCALE_PX[0] / (1.0 - rng.uniform()).sqrt()).min(SCALE_PX[1])
}

impl<'d> SceneImages<'d> {
    pub(super) fn new(drive: &'d Drive, cell_m: f64) -> Self {
        let mut images = Vec::new();
        let mut cells: BTreeMap<(i32, i32), Vec<u32>> = BTreeMap::new();
        for (camera, with) in drive.cameras().iter().enumerate() {
            for exposure in &with.exposures {
                let pose = drive.cam_from_world(camera, exposure.time_s);
                let centre = pose.origin_in_a();
                let cell = ((centre.x / cell_m).floor() as i32, (centre.y / cell_m).floor() as i32);
                cells.entry(cell).or_default().push(images.len() as u32);
                images.push(SceneImage {
                    camera,
                    time_s: exposure.time_s,
                    rotation: pose.rotation.to_rotation_matrix().into_inner(),
                    centre,
                    focal_px: with.lens.focal_px(),
                });
            }
        }
        Self { drive, images, cells, cell_m }
    }

    pub(super) fn len(&self) -> usize {
        self.images.len()
    }

    /// Samples the surface point of a random pixel of an image, and appends its observations in all
    /// images, ordered by image. `None` if the pixel sees no static surface within range.
    pub(super) fn sample_point(
        &self,
        source: usize,
        options: &FeatureOptions,
        rng: &mut Rng,
        observations: &mut Vec<KeypointObservation>,
    ) -> Option<Vector3<f64>> {
        let from = &self.images[source];
        let camera = &self.drive.cameras()[from.camera];
        let pixel = Vector2::new(
            f64::from(camera.width) * rng.uniform(),
            f64::from(camera.height) * rng.uniform(),
        );
        let scale_px = sample_scale_px(rng);
        let pose = self.drive.row_pose(from.camera, from.time_s, pixel.y);
        let surface = surface_at(self.drive.world(), &camera.lens, &pose, &pixel)?;
        let is_usable =
            !surface.is_moving && (MIN_RANGE_M..options.max_range_m).contains(&surface.distance);
        if !is_usable {
            return None;
        }
        let xyz = surface.point_in_world;
        let size_m = scale_px * surface.distance / from.focal_px;
        let view = (from.centre - xyz).normalize();
        let min_cosine = options.max_view_angle_rad.cos();
        let cell = [xyz.x, xyz.y].map(|x| (x / self.cell_m).floor() as i32);
        let first = observations.len();
        for x in cell[0] - 1..=cell[0] + 1 {
            let column = self.cells.range((x, cell[1] - 1)..=(x, cell[1] + 1));
            for &image in column.flat_map(|(_, images)| images) {
                let candidate = &self.images[image as usize];
                let to_camera = candidate.centre - xyz;
                let distance = to_camera.norm();
                let seen_px = size_m * candidate.focal_px / distance;
                let ratio = seen_px / scale_px;
                if !(MIN_RANGE_M..options.max_range_m).contains(&distance)
                    || !(1.0 / MAX_SCALE_RATIO..MAX_SCALE_RATIO).contains(&ratio)
                    || !(SCALE_PX[0]..=SCALE_PX[1]).contains(&seen_px)
                    || to_camera.dot(&view) < min_cosine * distance
                    || to_camera.dot(&surface.normal) < MIN_INCIDENCE * distance
                {
                    continue;
                }
                if let Some(pixel) = self.observe(candidate, &xyz, options, seen_px, rng) {
                    let keypoint = Keypoint { pixel, scale_px: seen_px as f32 };
                    observations.push(KeypointObservation { image, keypoint });
                }
            }
        }
        observations[first..].sort_by_key(|observation| observation.image);
        Some(xyz)
    }

    /// The noisy keypoint position of a point in an image; `None` if it is not detected.
    fn observe(
        &self,
        image: &SceneImage,
        xyz: &Vector3<f64>,
        options: &FeatureOptions,
        scale_px: f64,
        rng: &mut Rng,
    ) -> Option<Vector2<f64>> {
        let camera = &self.drive.cameras()[image.camera];
        let point_in_cam = image.rotation * (xyz - image.centre);
        let mut pixel = camera.lens.project(&point_in_cam)?;
        let mut centre = image.centre;
        if camera.readout_s > 0.0 {
            pixel = self.drive.project(image.camera, image.time_s, xyz)?;
            centre =
                self.drive.row_pose(image.camera, image.time_s, pixel.y).world_from_cam.translation;
        }
        // All random numbers are drawn before the occlusion test, so that an occlusion changes only
        // this image.
        let is_detected = rng.uniform() < options.detection;
        let noise_px = options.noise_px * (scale_px / NOISE_SCALE_PX).sqrt();
        let noise = Vector2::new(rng.normal(), rng.normal()) * noise_px;
        let noisy = pixel + noise;
        let is_inside = (0.0..f64::from(camera.width)).contains(&noisy.x)
            && (0.0..f64::from(camera.height)).contains(&noisy.y);
        let ray = Ray { origin: centre, direction: xyz - centre };
        (is_detected && is_inside && self.drive.world().is_clear(&ray, image.time_s, SLACK))
            .then_some(noisy)
    }
}
