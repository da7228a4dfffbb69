#![doc = include_str!("../README.md")]

pub mod convert;
mod diagnostics;
mod error;
mod event;
mod frame_names;
mod known_frames;
mod loop_closure;
mod mapped_model;
mod mapper;
mod model_tools;
mod options;
mod register;
mod rigs;
mod rolling_shutter;
mod terms;
mod timeline;
mod tracks;
mod two_view;

pub use diagnostics::{
    ImageScale, Jump, LensResiduals, image_scales, images_with_few_observations, jumps,
    lens_residuals, num_points_behind,
};
pub use error::Error;
pub use event::{Event, Failure, OptionalStage};
pub use frame_names::{natural_order, pairs_by_name};
pub use mapped_model::MappedModel;
pub use mapper::{ExistingPoses, Mapper};
pub use model_tools::{
    BoundingBox, MergeOutcome, ModelAlignment, Transferred, align_models, crop, merge_model,
    transfer_model,
};
pub use options::{MapperOptions, RigMode};
pub use register::{Localization, QueryCamera, RegisterOptions, localize_image, register_image};
pub use rigs::{
    BaselineLink, BaselineTerm, CalibratedCamera, CalibratedRig, ClockState, Descriptors,
    ExtrinsicsCovariance, LinkWeights, ReferencePose, ReferencedImage, RigConstraint, RigPair,
    RigPairs, RigidCamera, SensorPair, SplitRepair, constrain_rigidly, final_links, frames_by_time,
    growing_links, relative_poses, rig_candidates, rig_pairs, sensor_pairs,
};
pub use rolling_shutter::{Readout, RollingShutter, RowPoses, row_poses};
pub use tiepoint_adjust as adjust;
pub use tiepoint_adjust::{AdjustOptions, Gauge, RefineIntrinsics, Scope, Term, adjust, fix_gauge};
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use tiepoint_matching as matching;
pub use tiepoint_rig as rig;
pub use tiepoint_scene as scene;
pub use tiepoint_scene::{KnownFrame, KnownRigs};
pub use tracks::{
    FilterOptions, TrackOptions, complete_tracks, filter_all_points, filter_points,
    held_out_rms_px, hold_out_tracks, merge_tracks, retriangulate, triangulate_image,
};
pub use two_view::{
    Candidates, ImageObservations, InitialPair, Overlay, Stationary, StationarySearch,
    VerifyOptions, estimate_focal_lengths, focal_priors, initial_pairs, verify_pair,
};
