//! Arrays of numpy as vectors of nalgebra, and back.

use numpy::ndarray::{Array1, Array2, Array3, Dimension, Ix2};
use numpy::{
    AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayLike, PyReadonlyArray,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, SVector};

use crate::errors::invalid;

/// An argument that numpy converts to an array of float64: an array of any type of numbers, or
/// nested lists. The error names the argument, the shape that it must have, and the one it has.
pub(crate) fn numbers<'py, D: Dimension + 'py>(
    value: &Bound<'py, PyAny>,
    name: &str,
    shape: &str,
) -> PyResult<PyArrayLike<'py, f64, D, AllowTypeChange>> {
    value.extract().map_err(|_| invalid_array(value, name, "numbers", shape))
}

/// An argument that is an array of uint8. Other types are refused: their values may have any range.
pub(crate) fn bytes<'py, D: Dimension + 'py>(
    value: &Bound<'py, PyAny>,
    name: &str,
    shape: &str,
) -> PyResult<PyReadonlyArray<'py, u8, D>> {
    value.extract().map_err(|_| invalid_array(value, name, "uint8", shape))
}

/// The exception of an argument that is another array than the one that is needed, or none.
pub(crate) fn invalid_array(
    value: &Bound<'_, PyAny>,
    name: &str,
    elements: &str,
    shape: &str,
) -> PyErr {
    let found = match value.cast::<PyUntypedArray>() {
        Ok(array) => array.dtype().to_string(),
        Err(_) => value.get_type().to_string(),
    };
    // Lists have a shape, too, unless their rows differ in length.
    let found_shape = value
        .py()
        .import("numpy")
        .and_then(|numpy| numpy.call_method1("shape", (value,)))
        .map_or(String::new(), |shape| format!(" of shape {shape}"));
    invalid(format!(
        "{name} must be an array of {elements} of shape {shape}, not {found}{found_shape}"
    ))
}

/// The rows of an N × `D` array of finite numbers; an error names the array.
pub(crate) fn rows<const D: usize>(
    value: &Bound<'_, PyAny>,
    name: &str,
) -> PyResult<Vec<SVector<f64, D>>> {
    let shape = format!("(N, {D})");
    let array = numbers::<Ix2>(value, name, &shape)?;
    let array = array.as_array();
    if array.ncols() != D {
        return Err(invalid_array(value, name, "numbers", &shape));
    }
    if !array.iter().all(|value| value.is_finite()) {
        return Err(invalid(format!("{name} has values that are not finite")));
    }
    Ok(array.rows().into_iter().map(|row| SVector::from_fn(|at, _| row[at])).collect())
}

/// Checks that two arrays have equally many rows.
pub(crate) fn require_same_length(one: usize, other: usize, names: [&str; 2]) -> PyResult<()> {
    if one == other {
        return Ok(());
    }
    let [a, b] = names;
    Err(invalid(format!("{a} has {one} rows and {b} has {other}: they must have equally many")))
}

/// An array of shape (N, `D`).
pub(crate) fn matrix<'py, T: numpy::Element + Copy, const D: usize>(
    python: Python<'py>,
    rows: &[[T; D]],
) -> Bound<'py, PyArray2<T>> {
    let flat: Vec<T> = rows.iter().flatten().copied().collect();
    Array2::from_shape_vec((rows.len(), D), flat).expect("the length fits").into_pyarray(python)
}

/// An array of shape (N,).
pub(crate) fn vector<T: numpy::Element>(
    python: Python<'_>,
    values: Vec<T>,
) -> Bound<'_, PyArray1<T>> {
    Array1::from_vec(values).into_pyarray(python)
}

/// A 3 × 3 matrix.
pub(crate) fn matrix3<'py>(python: Python<'py>, m: &Matrix3<f64>) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((3, 3), |(row, column)| m[(row, column)]).into_pyarray(python)
}

/// A pose as the 3 × 4 matrix [R | t].
pub(crate) fn pose<'py>(python: Python<'py>, pose: &Rigid3) -> Bound<'py, PyArray2<f64>> {
    let m = pose.to_matrix();
    Array2::from_shape_fn((3, 4), |(row, column)| m[(row, column)]).into_pyarray(python)
}

/// Poses as an array of shape (N, 3, 4).
pub(crate) fn poses<'py>(python: Python<'py>, poses: &[Rigid3]) -> Bound<'py, PyArray3<f64>> {
    let matrices: Vec<_> = poses.iter().map(Rigid3::to_matrix).collect();
    let shape = (poses.len(), 3, 4);
    Array3::from_shape_fn(shape, |(at, row, column)| matrices[at][(row, column)])
        .into_pyarray(python)
}
