/// What can be wrong with the input of this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// No camera model of that name.
    #[error("unknown camera model `{name}`: known are {known}")]
    UnknownCameraModel {
        /// The name that was asked for.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// The parameter list of a camera has the wrong length.
    #[error("camera model {model} takes {expected} parameters ({names}), not {found}")]
    CameraParamCount {
        /// The model's name.
        model: &'static str,
        /// How many it takes.
        expected: usize,
        /// Their names.
        names: String,
        /// How many were given.
        found: usize,
    },
    /// A camera parameter is not a finite number, or a focal length is not positive.
    #[error("camera model {model}: parameter {name} = {value} is out of range")]
    CameraParamRange {
        /// The model's name.
        model: &'static str,
        /// The parameter's name.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}
