//! The class of models: what it holds. Its methods are in `reconstruction`.

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use tiepoint_scene::{Image, ImageId, PointId};
use tiepoint_sfm::rolling_shutter::RollingShutter;

/// A COLMAP model, read from a workspace or a folder. Images are those with a pose, in the order of
/// their ids; arrays of images have a row for each of them, and arrays of points a row for each
/// point. Poses are cam_from_world as matrices [R | t]. The centre of the top-left pixel is (0.5,
/// 0.5).
#[pyclass(module = "tiepoint")]
pub(crate) struct Reconstruction {
    pub(crate) model: tiepoint_scene::Reconstruction,
    /// The images with a pose.
    pub(crate) images: Vec<ImageId>,
    pub(crate) points: Vec<PointId>,
    pub(crate) shutters: Vec<RollingShutter>,
}

impl Reconstruction {
    pub(crate) fn new(
        model: tiepoint_scene::Reconstruction,
        shutters: Vec<RollingShutter>,
    ) -> Self {
        let mut this = Self { model, images: Vec::new(), points: Vec::new(), shutters };
        this.list();
        this
    }

    /// Lists the images with a pose and the points of the model.
    pub(crate) fn list(&mut self) {
        self.images = self.model.registered().map(|(id, ..)| id).collect();
        self.points = self.model.tracks().map(|(id, _)| id).collect();
    }

    pub(crate) fn image(&self, index: usize) -> PyResult<&Image> {
        let id = self.images.get(index).ok_or_else(|| {
            PyIndexError::new_err(format!("image {index} of {}", self.images.len()))
        })?;
        Ok(self.model.image(*id))
    }

    pub(crate) fn row_of(&self, image: ImageId) -> usize {
        self.images.binary_search(&image).expect("observations are those of images with a pose")
    }
}
