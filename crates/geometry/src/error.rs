/// Errors of this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// No camera model has this name or COLMAP id.
    #[error("unknown camera model `{name}`: known are {known}")]
    UnknownCameraModel {
        /// The given name or id.
        name: String,
        /// The existing names or ids.
        known: String,
    },
    /// The parameter list of a camera has the wrong length.
    #[error("camera model {model} takes {expected} parameters ({names}), not {found}")]
    CameraParamCount {
        /// The model's name.
        model: &'static str,
        /// Number of parameters of the model.
        expected: usize,
        /// Names of the parameters.
        names: String,
        /// Number of given parameters.
        found: usize,
    },
    /// A camera parameter is not a finite number, or a focal length is not positive.
    #[error("camera model {model}: parameter {name} = {value} is out of range")]
    CameraParamRange {
        /// Name of the model.
        model: &'static str,
        /// The parameter's name.
        name: &'static str,
        /// The given value.
        value: f64,
    },
}
