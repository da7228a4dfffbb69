//! Tracks: creation, completion, merging and filtering.

mod filter;
mod grow;
mod hold_out;

pub(crate) use filter::filter_images;
pub use filter::{FilterOptions, filter_all_points, filter_points};
pub(crate) use grow::{TOLERANCE_BEFORE_TRACK_UPDATE, mean_position, update_tracks};
pub use grow::{TrackOptions, complete_tracks, merge_tracks, retriangulate, triangulate_image};
pub use hold_out::{held_out_rms_px, hold_out_tracks};
