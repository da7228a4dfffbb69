//! Multi-view PatchMatch stereo, after Schönberger 2016 (Pixelwise View Selection for Unstructured
//! Multi-View Stereo) and Xu & Tao 2019 (Multi-Scale Geometric Consistency Guided Multi-View
//! Stereo, ACMH and ACMM).
//!
//! [`estimate_coarse`] makes the planes of an image at half resolution from its photos alone;
//! [`estimate_fine`] makes them consistent with those of the neighbours and refines them at full
//! resolution.

mod coarse;
mod confidence;
mod cost;
mod field;
mod filter;
mod fine;
mod initial;
mod maps;
mod normals;
mod rng;
mod seeds;
mod sweep;
mod view;

pub use coarse::estimate_coarse;
pub use fine::{FineEstimate, FineSource, estimate_fine};
pub use maps::{DepthMap, PlaneMap};
pub use normals::normals_of;
pub use seeds::{InverseDepthRange, Seed};
pub use view::{MAX_SOURCES, StereoImage};
