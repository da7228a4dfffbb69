#![doc = include_str!("../README.md")]

mod adjust;
mod error;
mod event;
mod filter;
mod focal;
mod hold_out;
mod incremental;
mod initial_pair;
mod register;
mod rig_pairs;
mod sigma;
mod tracks;
mod triangulation;
mod verify;
mod visibility;

pub use adjust::{AdjustOptions, RefineIntrinsics, Scope, adjust};
pub use error::Error;
pub use event::Event;
pub use filter::{FilterOptions, filter_all_points, filter_images, filter_points};
pub use focal::{FocalPrior, estimate_focal_lengths, focal_priors};
pub use hold_out::{held_out_rms_px, hold_out_tracks};
pub use incremental::{MapperOptions, RigTerm, map};
pub use initial_pair::{InitialPair, initial_pairs};
pub use register::{RegisterOptions, register_image};
pub use rig_pairs::{BaselineLink, RigPair, RigPairs, final_links, growing_links, relative_poses, rig_pairs};
pub use sigma::keypoint_sigma_px;
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use tiepoint_matching as matching;
pub use tiepoint_rig as rig;
pub use tiepoint_scene as scene;
pub use tracks::{TrackOptions, complete_tracks, merge_tracks, retriangulate, triangulate_image};
pub use triangulation::{Sight, Triangulated, triangulate};
pub use verify::{VerifyOptions, View, verify_pair};
