//! Images of a model.

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_scene::ImageId;

use crate::arrays::{matrix, pose, vector};
use crate::camera::Camera;
use crate::errors::invalid;
use crate::model::Reconstruction;

/// An image of a model, with the names of pycolmap. It shows the model as it is now.
#[pyclass(frozen, module = "tiepoint", name = "Image")]
pub(crate) struct ModelImage {
    pub(crate) reconstruction: Py<Reconstruction>,
    pub(crate) id: ImageId,
}

impl ModelImage {
    /// What `find` takes from the model and the image's pose; an error if it has none any more.
    fn with<T>(
        &self,
        python: Python<'_>,
        find: impl FnOnce(&Reconstruction, &Rigid3) -> T,
    ) -> PyResult<T> {
        let reconstruction = self.reconstruction.try_borrow(python)?;
        let image = reconstruction.model.image(self.id);
        match image.cam_from_world() {
            Some(pose) => Ok(find(&reconstruction, pose)),
            None => Err(invalid(format!("the image {} was removed from the model", image.name))),
        }
    }
}

#[pymethods]
impl ModelImage {
    /// Its id in the files.
    #[getter]
    fn image_id(&self, python: Python<'_>) -> PyResult<u64> {
        self.with(python, |all, _| all.model.original_ids.image(self.id))
    }

    /// Its row in the arrays of images.
    #[getter]
    fn index(&self, python: Python<'_>) -> PyResult<usize> {
        self.with(python, |all, _| all.row_of(self.id))
    }

    /// Its name.
    #[getter]
    fn name(&self, python: Python<'_>) -> PyResult<String> {
        self.with(python, |all, _| all.model.image(self.id).name.clone())
    }

    /// Its camera.
    #[getter]
    fn camera(&self, python: Python<'_>) -> PyResult<Camera> {
        self.with(python, |all, _| Camera { camera: *all.model.camera_of(self.id) })
    }

    /// Its pose, a matrix [R | t] of shape (3, 4).
    fn cam_from_world<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.with(python, |_, cam_from_world| pose(python, cam_from_world))
    }

    /// Its centre in the world, of shape (3,).
    fn projection_center<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.with(python, |_, pose| vector(python, pose.origin_in_a().as_slice().to_vec()))
    }

    /// Its keypoints, of shape (K, 2), in pixels.
    #[getter]
    fn keypoints<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.with(python, |all, _| {
            let keypoints = &all.model.image(self.id).keypoints;
            let pixels: Vec<[f64; 2]> =
                keypoints.iter().map(|keypoint| keypoint.pixel.into()).collect();
            matrix(python, &pixels)
        })
    }

    /// Ids of the points of the keypoints in the files, int64 of shape (K,); -1 without a point.
    #[getter]
    fn point_ids<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        self.with(python, |all, _| {
            let id = |point: &Option<_>| {
                point.map_or(-1, |point| all.model.original_ids.point(point) as i64)
            };
            vector(python, all.model.image(self.id).points().iter().map(id).collect())
        })
    }

    fn __repr__(&self, python: Python<'_>) -> PyResult<String> {
        Ok(format!("Image({}, {:?})", self.image_id(python)?, self.name(python)?))
    }
}
