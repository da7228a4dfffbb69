//! Registration: selection of the next image, and estimation of its pose.

mod absolute_pose;
mod continuity;
mod localize;
mod next_image;
mod visibility;

pub(crate) use absolute_pose::candidates;
pub use absolute_pose::{RegisterOptions, register_image};
pub use localize::{Localization, QueryCamera, localize_image};
pub(crate) use next_image::NextBestView;
