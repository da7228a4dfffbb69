#![doc = include_str!("../README.md")]

mod calibration_evidence;
mod covariance;
mod error;
mod field_effects;
mod field_fit;
mod field_problem;
mod gauge;
mod image_grid;
mod intrinsics;
mod noise;
mod options;
mod portrait_landscape;
mod problem;
mod rigid_frames;
mod selection;
mod shared_lens;
mod solve;
mod term;
mod triangulation;
mod variables;

pub use calibration_evidence::{CalibrationEvidence, calibration_evidence};
pub use covariance::covariance_of_fit;
pub use error::Error;
pub use field_fit::{FieldFit, fit_with_lens_fields};
pub use gauge::{Gauge, fix_gauge};
pub use image_grid::grid_cell;
pub use noise::{FitNoise, keypoint_sigma_px, relative_noise};
pub use options::{AdjustOptions, FocalPrior, RefineIntrinsics, Scope};
pub use problem::build_problem;
pub use solve::{adjust, keep_going};
pub use term::{Shifted, Term, TermContext, TermFrame};
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use tiepoint_scene as scene;
pub use triangulation::{triangulate_observations, view_ray};
pub use variables::{ComposedPose, Variables};
