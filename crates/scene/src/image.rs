use std::sync::Arc;

use tiepoint_geometry::{Rigid3, nalgebra::Vector2};

use crate::{CameraId, PointId};

/// A detected keypoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Position in pixels. The centre of the top-left pixel is (0.5, 0.5).
    pub pixel: Vector2<f64>,
    /// Scale of the blob in pixels (SIFT's σ). The localisation error grows with it.
    pub scale_px: f32,
}

/// An image of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Path relative to the input, with `/`.
    pub name: String,
    /// The camera.
    pub camera: CameraId,
    /// The body that took it, such as `left`: images of one stream were taken one after another,
    /// and images of two may belong to a frame of a rig. A stream with several settings (zoom,
    /// resolution) has several cameras. [`Image::new`] takes the folder in the name.
    pub stream: Arc<str>,
    /// Time of the middle row's mid-exposure in seconds on this camera's own clock, if known.
    pub time_s: Option<f64>,
    /// Detected keypoints. Copies of a model share them.
    pub keypoints: Arc<[Keypoint]>,
    /// Pose, if registered. [`crate::Reconstruction::register`] sets it.
    pub(crate) cam_from_world: Option<Rigid3>,
    /// The point that each keypoint observes.
    pub(crate) points: Vec<Option<PointId>>,
}

impl Image {
    /// An image without a pose. Its stream is the folder in its name, as in folders of photos.
    pub fn new(name: impl Into<String>, camera: CameraId, keypoints: Vec<Keypoint>) -> Self {
        let points = vec![None; keypoints.len()];
        let name = name.into();
        let stream = name.rsplit_once('/').map_or("", |(folder, _)| folder).into();
        Self {
            name,
            camera,
            stream,
            time_s: None,
            keypoints: keypoints.into(),
            cam_from_world: None,
            points,
        }
    }

    /// Pose, if registered.
    pub fn cam_from_world(&self) -> Option<&Rigid3> {
        self.cam_from_world.as_ref()
    }

    /// The point that a keypoint observes.
    pub fn point_of(&self, keypoint: u32) -> Option<PointId> {
        self.points[keypoint as usize]
    }

    /// The points that the keypoints observe, one entry for each keypoint.
    pub fn points(&self) -> &[Option<PointId>] {
        &self.points
    }

    /// Number of keypoints that observe a point.
    pub fn num_points(&self) -> usize {
        self.points.iter().flatten().count()
    }
}
