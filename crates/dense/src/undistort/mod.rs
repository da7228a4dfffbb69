//! Undistortion: PINHOLE cameras, and images, masks and models as these cameras see them. The
//! sizes of the cameras are those of COLMAP's `image_undistorter`.

mod camera;
mod mix;
mod model;
mod resample;
mod rgb_row;
mod source_map;

pub use camera::{UndistortOptions, is_too_wide_for_pinhole, undistort_camera};
pub use model::undistort_model;
pub use resample::Undistortion;
