//! Undistortion: PINHOLE cameras, and images, masks and models as these cameras see them. The
//! sizes of the cameras are those of COLMAP's `image_undistorter`.

mod camera;
mod model;
mod resample;

pub use camera::{UndistortOptions, undistort_camera};
pub use model::undistort_model;
pub use resample::Undistortion;
