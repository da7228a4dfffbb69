//! Undistortion of images.

use numpy::ndarray::{Array3, Ix3};
use numpy::{IntoPyArray, PyArray3};
use pyo3::prelude::*;
use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_camera};

use crate::arrays::{bytes, invalid_array};
use crate::camera::Camera;
use crate::errors::{failed, invalid};
use crate::fork::refuse_after_fork;

/// Undistorts an image, uint8 of shape (H, W, 1) or (H, W, 3), of a camera. Returns the image and
/// its PINHOLE camera, with the options and the sizes of COLMAP's image_undistorter. Pixels without
/// a source are 0.
#[pyfunction]
#[pyo3(
    signature = (image, camera, *, blank_pixels=0.0, min_scale=0.2, max_scale=2.0, max_size=None)
)]
pub(crate) fn undistort<'py>(
    python: Python<'py>,
    image: &Bound<'py, PyAny>,
    camera: Camera,
    blank_pixels: f64,
    min_scale: f64,
    max_scale: f64,
    max_size: Option<u32>,
) -> PyResult<(Bound<'py, PyArray3<u8>>, Camera)> {
    const SHAPE: &str = "(H, W, 1) or (H, W, 3)";
    refuse_after_fork()?;
    let array = bytes::<Ix3>(image, "image", SHAPE)?;
    let (height, width, channels) = array.as_array().dim();
    if ![1, 3].contains(&channels) {
        return Err(invalid_array(image, "image", "uint8", SHAPE));
    }
    let options = UndistortOptions { blank_pixels, min_scale, max_scale, max_image_size: max_size };
    let to = undistort_camera(&camera.camera, &options).map_err(invalid)?;
    let undistortion = Undistortion::new(&camera.camera, &to);
    let size = (camera.camera.width as usize, camera.camera.height as usize);
    if (width, height) != size {
        return Err(invalid(format!(
            "the image has {width} x {height} pixels, and the camera {} x {}",
            size.0, size.1
        )));
    }
    let pixels: Vec<u8> = array.as_array().iter().copied().collect();
    let pixels = python.detach(|| match channels {
        1 => undistortion.image::<1>(&pixels),
        _ => undistortion.image::<3>(&pixels),
    });
    let pixels = pixels.map_err(failed)?;
    let shape = (to.height as usize, to.width as usize, channels);
    let array = Array3::from_shape_vec(shape, pixels).map_err(failed)?;
    Ok((array.into_pyarray(python), Camera { camera: to }))
}
