//! Arrays of numpy as vectors of nalgebra, and back.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2};
use pyo3::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, SVector};

use crate::errors::invalid;

/// The rows of an N × `D` array; an error names the array.
pub(crate) fn rows<const D: usize>(
    array: &PyReadonlyArray2<'_, f64>,
    name: &str,
) -> PyResult<Vec<SVector<f64, D>>> {
    let array = array.as_array();
    if array.ncols() != D {
        return Err(invalid(format!("{name} must be an array of shape (N, {D})")));
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
