//! Errors of commands.

/// Why a command failed.
pub(crate) enum Failure {
    /// The command line is invalid: exit code 2.
    Usage(String),
    /// The work failed: exit code 1.
    CouldNot(String),
    /// A signal interrupted the work.
    Cancelled,
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let of_pipeline = (&error as &dyn std::error::Error).downcast_ref();
        match of_pipeline {
            Some(tiepoint_pipeline::Error::Cancelled) => Self::Cancelled,
            Some(tiepoint_pipeline::Error::MovesPoses { .. }) => Self::Usage(error.to_string()),
            _ => Self::CouldNot(error.to_string()),
        }
    }
}
