use thiserror::Error;

/// Bad input of dense reconstruction.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Error {
    /// An option is out of its range.
    #[error("{name} is {value}: {range}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The permitted range.
        range: &'static str,
    },
    /// The pixels of an image do not have the size of its camera.
    #[error("{found} bytes of pixels, but the camera has {width} × {height} pixels")]
    Size {
        /// Width of the camera, in pixels.
        width: u32,
        /// Height of the camera, in pixels.
        height: u32,
        /// Number of bytes.
        found: usize,
    },
    /// A camera sees all directions, and a PINHOLE camera less than a half-space.
    #[error(
        "cameras of the model {model} have no PINHOLE camera: cut the panoramas into views first"
    )]
    NoPinhole {
        /// Name of the camera model in COLMAP.
        model: &'static str,
    },
    /// A camera has distortion, or is no perspective camera.
    #[error("the camera of {image} is a {model}: undistort first")]
    Distorted {
        /// Name of an image of the camera.
        image: String,
        /// Name of the camera model in COLMAP.
        model: &'static str,
    },
}
