//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod all_around;
mod camera_models;
mod checkpoints;
mod clocks;
mod common;
mod control_points;
mod known_rigs;
mod lens;
mod loop_closure;
mod mapper;
mod merge_by_motion;
mod one_model;
mod options;
mod overlays;
mod point_selection;
mod position_track;
mod positions;
mod repetition;
mod rig;
mod shutter;
mod submaps;
mod terms;
mod unregistered;
