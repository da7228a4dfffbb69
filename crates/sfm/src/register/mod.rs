//! Registration: selection of the next image, and estimation of its pose.

mod absolute_pose;
mod continuity;
mod duplicates;
mod evidence;
mod localize;
mod missing;
mod next_image;
mod options;
mod recall;
mod sequences;
mod significance;
mod square_cells;
mod visibility;

pub(crate) use absolute_pose::candidates;
pub use absolute_pose::register_image;
pub(crate) use continuity::Timelines;
pub(crate) use duplicates::{duplicate_place, find_each_other};
pub(crate) use evidence::Evidence;
pub use localize::{Localization, QueryCamera, localize_image};
pub(crate) use missing::contradicted;
pub(crate) use next_image::{History, NextBestView};
pub use options::RegisterOptions;
