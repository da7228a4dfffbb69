//! Arrays of numpy as vectors of nalgebra, and back.

use numpy::ndarray::{Array1, Array2, Array3, Dimension, Ix2, Ix3};
use numpy::{
    AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayLike, PyReadonlyArray,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, SVector, UnitQuaternion, Vector3};

use crate::errors::invalid;

/// Largest difference of the entries of RᵀR from the identity for a rotation matrix.
const ROTATION_TOLERANCE: f64 = 1e-6;

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

/// The poses of an array of shape (N, 3, 4) of matrices [R | t]; an error names the array.
pub(crate) fn poses_of(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Rigid3>> {
    let array = numbers::<Ix3>(value, name, "(N, 3, 4)")?;
    let array = array.as_array();
    let (_, rows, columns) = array.dim();
    if (rows, columns) != (3, 4) {
        return Err(invalid_array(value, name, "numbers", "(N, 3, 4)"));
    }
    let pose = |matrix: numpy::ndarray::ArrayView2<'_, f64>| {
        let rotation = Matrix3::from_fn(|row, column| matrix[(row, column)]);
        let translation = Vector3::from_fn(|row, _| matrix[(row, 3)]);
        (is_rotation(&rotation) && translation.iter().all(|value| value.is_finite()))
            .then(|| Rigid3::new(UnitQuaternion::from_matrix(&rotation), translation))
    };
    let all: Option<Vec<Rigid3>> = array.outer_iter().map(pose).collect();
    all.ok_or_else(|| invalid(format!("{name} must be matrices [R | t] with rotations R")))
}

/// Whether a matrix is a rotation, up to rounding errors.
pub(crate) fn is_rotation(matrix: &Matrix3<f64>) -> bool {
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    off <= ROTATION_TOLERANCE && matrix.determinant() > 0.0
}

/// Which of `count` rows an argument selects: a mask of shape (`count`,), or the indices of the
/// rows in any order. Returns indices, ascending and each once; an error names the argument.
pub(crate) fn selection(
    value: &Bound<'_, PyAny>,
    name: &str,
    count: usize,
) -> PyResult<Vec<usize>> {
    let shape = format!("({count},)");
    let refused = || invalid_array(value, name, "bool, or of indices", &shape);
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,)).map_err(|_| refused())?;
    let (kind, size): (String, usize) =
        (array.getattr("dtype")?.getattr("kind")?.extract()?, array.getattr("size")?.extract()?);
    let ndim: usize = array.getattr("ndim")?.extract()?;
    let indices = match kind.as_str() {
        _ if ndim != 1 => return Err(refused()),
        "b" if size == count => numpy.call_method1("flatnonzero", (array,))?,
        "i" | "u" => array,
        // An empty list is an array of float64.
        _ if size == 0 => return Ok(Vec::new()),
        _ => return Err(refused()),
    };
    let indices: Vec<i64> = indices.call_method1("astype", ("int64",))?.extract()?;
    let mut chosen = Vec::with_capacity(indices.len());
    for index in indices {
        let valid = usize::try_from(index).ok().filter(|index| *index < count);
        chosen.push(valid.ok_or_else(|| invalid(format!("{name} has {index} of {count}")))?);
    }
    chosen.sort_unstable();
    chosen.dedup();
    Ok(chosen)
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
