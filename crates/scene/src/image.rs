use std::sync::Arc;

use tiepoint_geometry::{Rigid3, nalgebra::Vector2};

use crate::{CameraId, PointId};

/// Where something was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// In pixels; the centre of the top-left pixel is (0.5, 0.5).
    pub pixel: Vector2<f64>,
    /// Size of the blob in pixels (SIFT's sigma): its localisation error grows with it.
    pub scale_px: f32,
}

/// One exposure of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Path relative to the input, with `/`.
    pub name: String,
    /// Which camera took it.
    pub camera: CameraId,
    /// When, in seconds on this camera's own clock (the middle row's mid-exposure), where known.
    pub time_s: Option<f64>,
    /// What was detected in it. Copies of a model share it.
    pub keypoints: Arc<[Keypoint]>,
    /// Its pose, once registered. Set it through [`crate::Reconstruction::register`].
    pub(crate) cam_from_world: Option<Rigid3>,
    /// The point that each keypoint sees.
    pub(crate) points: Vec<Option<PointId>>,
}

impl Image {
    /// An image without pose.
    pub fn new(name: impl Into<String>, camera: CameraId, keypoints: Vec<Keypoint>) -> Self {
        let points = vec![None; keypoints.len()];
        Self {
            name: name.into(),
            camera,
            time_s: None,
            keypoints: keypoints.into(),
            cam_from_world: None,
            points,
        }
    }

    /// Its pose, once registered.
    pub fn cam_from_world(&self) -> Option<&Rigid3> {
        self.cam_from_world.as_ref()
    }

    /// The point that a keypoint sees.
    pub fn point_of(&self, keypoint: u32) -> Option<PointId> {
        self.points[keypoint as usize]
    }

    /// The points that the keypoints see, one entry a keypoint.
    pub fn points(&self) -> &[Option<PointId>] {
        &self.points
    }

    /// How many keypoints see a point.
    pub fn num_points(&self) -> usize {
        self.points.iter().flatten().count()
    }
}
