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
        let any = &error as &(dyn std::error::Error + 'static);
        let of_experiment = any.downcast_ref();
        if let Some(tiepoint_experiments::Error::Usage(what)) = of_experiment {
            return Self::Usage(what.clone());
        }
        let of_pipeline = match of_experiment {
            Some(tiepoint_experiments::Error::Pipeline(error)) => Some(error),
            _ => any.downcast_ref(),
        };
        match of_pipeline {
            Some(tiepoint_pipeline::Error::Cancelled) => Self::Cancelled,
            Some(tiepoint_pipeline::Error::MovesPoses { .. }) => Self::Usage(error.to_string()),
            _ => Self::CouldNot(error.to_string()),
        }
    }
}
