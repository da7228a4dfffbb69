//! SIFT and matching.

use numpy::ndarray::Ix2;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use tiepoint_features::{Descriptors, GrayView, Options, Orientation, Sift};
use tiepoint_matching::match_features;

use crate::arrays::{bytes, invalid_array, matrix};
use crate::errors::{failed, invalid};
use crate::fork::refuse_after_fork;

/// Keypoints, descriptors.
type Arrays<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u8>>);

/// SIFT keypoints and RootSIFT descriptors of a grey image, an array of uint8 of shape (H, W).
/// Where `mask`, of the same shape, is 0 or false, no keypoints are detected. Returns the
/// keypoints, float32 of shape (N, 4): x, y, scale in pixels and orientation in radians; and the
/// descriptors, uint8 of shape (N, 128). The centre of the top-left pixel is (0.5, 0.5). As in
/// COLMAP, levels of the scale space are added from coarse to fine until there are more than
/// `max_features` keypoints: the last level is complete.
#[pyfunction]
#[pyo3(signature = (image, *, max_features=8192, upright=false, mask=None))]
pub(crate) fn sift<'py>(
    python: Python<'py>,
    image: &Bound<'py, PyAny>,
    max_features: usize,
    upright: bool,
    mask: Option<Bound<'py, PyAny>>,
) -> PyResult<Arrays<'py>> {
    let image = bytes::<Ix2>(image, "image", "(H, W)")?;
    let (height, width) = image.as_array().dim();
    if height == 0 || width == 0 {
        return Err(invalid("image is empty"));
    }
    refuse_after_fork()?;
    let pixels = image.as_array().iter().copied().collect::<Vec<u8>>();
    let mask = mask.map(|mask| mask_of(&mask, (height, width))).transpose()?;
    let orientation = if upright { Orientation::Upright } else { Orientation::default() };
    let options = Options { max_features, orientation, ..Options::default() };
    let found = python.detach(|| {
        let mask = mask.as_ref().map(|mask| GrayView::new(mask, width, height));
        let view = GrayView::new(&pixels, width, height);
        Sift::new(options).and_then(|mut sift| sift.extract_parallel(&view, mask.as_ref()))
    });
    let found = found.map_err(failed)?;
    let keypoints: Vec<[f32; 4]> =
        found.keypoints.iter().map(|k| [k.x, k.y, k.scale, k.orientation]).collect();
    Ok((
        matrix(python, &keypoints),
        matrix(python, found.descriptors.as_sift().unwrap_or_default()),
    ))
}

/// Matches of two sets of descriptors, uint8 of shape (N, 128): indices of shape (M, 2). Exact
/// nearest neighbours with the tests of COLMAP: the ratio test and the largest angle (in radians);
/// None leaves a test out.
#[pyfunction]
#[pyo3(
    name = "match",
    signature = (a, b, *, max_ratio=Some(0.8), max_angle=Some(0.7), cross_check=true)
)]
pub(crate) fn match_descriptors<'py>(
    python: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
    max_ratio: Option<f64>,
    max_angle: Option<f64>,
    cross_check: bool,
) -> PyResult<Bound<'py, PyArray2<u32>>> {
    let (a, b) = (descriptors(a, "a")?, descriptors(b, "b")?);
    let options = tiepoint_matching::Options {
        max_ratio,
        max_angle_rad: max_angle,
        mutual: cross_check,
        ..tiepoint_matching::Options::default()
    };
    options.validate().map_err(invalid)?;
    let found = python.detach(|| match_features(&a, &b, &options));
    let pairs: Vec<[u32; 2]> = found.iter().map(|found| [found.a, found.b]).collect();
    Ok(matrix(python, &pairs))
}

/// The pixels of a mask of this shape.
fn mask_of(mask: &Bound<'_, PyAny>, shape: (usize, usize)) -> PyResult<Vec<u8>> {
    let pixels = if let Ok(mask) = mask.extract::<PyReadonlyArray2<'_, bool>>() {
        mask.as_array().mapv(u8::from)
    } else if let Ok(mask) = mask.extract::<PyReadonlyArray2<'_, u8>>() {
        mask.as_array().to_owned()
    } else {
        return Err(invalid_array(mask, "mask", "uint8 or bool", "(H, W)"));
    };
    if pixels.dim() != shape {
        return Err(invalid("mask must have the shape of image"));
    }
    Ok(pixels.into_iter().collect())
}

fn descriptors(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Descriptors> {
    const SHAPE: &str = "(N, 128)";
    let array = bytes::<Ix2>(value, name, SHAPE)?;
    let array = array.as_array();
    if array.ncols() != 128 {
        return Err(invalid_array(value, name, "uint8", SHAPE));
    }
    Ok(array
        .rows()
        .into_iter()
        .map(|row| std::array::from_fn::<u8, 128, _>(|at| row[at]))
        .collect())
}
