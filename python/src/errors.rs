//! Exceptions.

use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

create_exception!(tiepoint, Error, PyRuntimeError, "The work failed; the message says what to do.");
create_exception!(tiepoint, UsageError, PyValueError, "An argument is invalid.");

/// The exception of work that failed.
pub(crate) fn failed(error: impl Display) -> PyErr {
    Error::new_err(tiepoint_cli::with_keywords(&error.to_string()))
}

/// The exception of an invalid argument.
pub(crate) fn invalid(what: impl Display) -> PyErr {
    UsageError::new_err(tiepoint_cli::with_keywords(&what.to_string()))
}
