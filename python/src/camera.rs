//! Cameras.

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use tiepoint_geometry::Intrinsics;

use crate::arrays::{matrix, rows, vector};
use crate::errors::invalid;

/// A camera: COLMAP's name of its model, its image size in pixels, and its parameters in the order
/// of COLMAP. The centre of the top-left pixel is (0.5, 0.5).
#[pyclass(frozen, from_py_object, module = "tiepoint")]
#[derive(Clone, Copy)]
pub(crate) struct Camera {
    pub(crate) camera: tiepoint_scene::Camera,
}

#[pymethods]
impl Camera {
    #[new]
    fn new(model: &str, width: u32, height: u32, params: Vec<f64>) -> PyResult<Self> {
        let intrinsics = Intrinsics::from_name(model, &params).map_err(invalid)?;
        let camera = tiepoint_scene::Camera { intrinsics, width, height, has_focal_prior: true };
        Ok(Self { camera })
    }

    /// COLMAP's name of the camera model.
    #[getter]
    fn model(&self) -> &'static str {
        self.camera.intrinsics.kind().name()
    }

    /// Width of the image, in pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.camera.width
    }

    /// Height of the image, in pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.camera.height
    }

    /// The parameters, an array of shape (P,).
    #[getter]
    fn params<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(python, self.camera.intrinsics.params().to_vec())
    }

    /// The names of the parameters.
    #[getter]
    fn param_names(&self) -> Vec<&'static str> {
        self.camera.intrinsics.kind().param_names().to_vec()
    }

    /// Pixels of points in the camera's frame: (N, 3) to (N, 2). NaN for points that do not
    /// project.
    fn project<'py>(
        &self,
        python: Python<'py>,
        points_in_cam: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = rows::<3>(points_in_cam, "points_in_cam")?;
        let project = |point| self.camera.intrinsics.project(point).map(Into::into);
        let pixels: Vec<[f64; 2]> =
            points.iter().map(|point| project(point).unwrap_or([f64::NAN; 2])).collect();
        Ok(matrix(python, &pixels))
    }

    /// Unit rays of pixels in the camera's frame: (N, 2) to (N, 3). NaN for pixels without a ray.
    fn unproject<'py>(
        &self,
        python: Python<'py>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let pixels = rows::<2>(pixels, "pixels")?;
        let ray = |pixel| self.camera.intrinsics.unproject(pixel);
        let ray = |pixel| ray(pixel).map(|ray| ray.normalize().into());
        let rays: Vec<[f64; 3]> =
            pixels.iter().map(|pixel| ray(pixel).unwrap_or([f64::NAN; 3])).collect();
        Ok(matrix(python, &rays))
    }

    fn __repr__(&self) -> String {
        let tiepoint_scene::Camera { intrinsics, width, height, .. } = &self.camera;
        format!("Camera({:?}, {width}, {height}, {:?})", self.model(), intrinsics.params())
    }
}
