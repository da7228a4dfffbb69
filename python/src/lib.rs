//! The Python package `tiepoint`: the commands of the program, and models, features, matches and
//! poses as numpy arrays.

mod adjustment;
mod arrays;
mod camera;
mod command;
mod errors;
mod estimate;
mod features;
mod fork;
mod image;
mod model;
mod reconstruction;
mod rig;
mod undistort;

use pyo3::prelude::*;

#[pymodule]
fn _tiepoint(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let python = module.py();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Error", python.get_type::<errors::Error>())?;
    module.add("UsageError", python.get_type::<errors::UsageError>())?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<model::Reconstruction>()?;
    module.add_class::<image::ModelImage>()?;
    module.add_function(wrap_pyfunction!(command::commands, module)?)?;
    module.add_function(wrap_pyfunction!(command::run, module)?)?;
    module.add_function(wrap_pyfunction!(features::sift, module)?)?;
    module.add_function(wrap_pyfunction!(features::match_descriptors, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::relative_pose, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::absolute_pose, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::generalized_absolute_pose, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::similarity, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::triangulate, module)?)?;
    module.add_function(wrap_pyfunction!(rig::average_relative_pose, module)?)?;
    module.add_function(wrap_pyfunction!(rig::clock_offset, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::homography, module)?)?;
    module.add_function(wrap_pyfunction!(estimate::fundamental, module)?)?;
    module.add_function(wrap_pyfunction!(adjustment::bundle_adjust, module)?)?;
    module.add_function(wrap_pyfunction!(undistort::undistort, module)?)?;
    Ok(())
}
