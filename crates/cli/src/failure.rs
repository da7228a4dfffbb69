//! Why the program did not do what it was asked.

/// Why a command did not do what it was asked.
pub(crate) enum Failure {
    /// The command line contradicts itself.
    Usage(String),
    /// It could not be done.
    CouldNot(String),
    /// A signal asked to stop.
    Cancelled,
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let of_pipeline = (&error as &dyn std::error::Error).downcast_ref();
        match of_pipeline {
            Some(tiepoint_pipeline::Error::Cancelled) => Self::Cancelled,
            _ => Self::CouldNot(error.to_string()),
        }
    }
}
