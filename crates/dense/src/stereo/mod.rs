//! Multi-view PatchMatch stereo, after Schönberger 2016 (Pixelwise View Selection for Unstructured
//! Multi-View Stereo) and Xu & Tao 2019 (Multi-Scale Geometric Consistency Guided Multi-View
//! Stereo, ACMH and ACMM).
//!
//! [`estimate_coarse`] makes the planes of an image at half resolution from its photos alone;
//! [`estimate_fine`] makes them consistent with those of the neighbours and refines them at full
//! resolution.

mod coarse;
mod cost;
mod field;
mod filter;
mod fine;
mod initial;
mod maps;
mod normals;
mod rng;
mod sweep;

pub use coarse::estimate_coarse;
pub use fine::{FineEstimate, FineSource, estimate_fine};
pub use initial::Seed;
pub use maps::{DepthMap, PlaneMap};
pub use normals::normals_of;

use crate::Grey;
use crate::pinhole::PosedPinhole;

/// Most source images of a reference image.
pub const MAX_SOURCES: usize = 8;

/// An image with its camera.
#[derive(Clone, Debug)]
pub struct View {
    /// The camera.
    pub camera: PosedPinhole,
    /// The image, of the size of the camera.
    pub grey: Grey,
}

impl View {
    pub(crate) fn halved(&self) -> Self {
        Self { camera: self.camera.halved(), grey: self.grey.halved() }
    }
}

/// Range of the depths of an image, as inverse depths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthRange {
    /// Of the farthest surface.
    pub min: f32,
    /// Of the nearest surface.
    pub max: f32,
}

impl InverseDepthRange {
    /// The range of the seeds without the most extreme hundredth on both sides, which may be wrong
    /// matches, and widened by half, since surfaces lie between and beyond the seeds. `None`
    /// without seeds.
    pub fn of(seeds: &[Seed]) -> Option<Self> {
        let mut all: Vec<f32> = seeds.iter().map(|seed| seed.inverse_depth).collect();
        all.sort_by(f32::total_cmp);
        let tail = all.len() / 100;
        let (min, max) = (all.get(tail)?, all.get(all.len() - 1 - tail)?);
        Some(Self { min: min / 1.5, max: max * 1.5 })
    }

    #[inline(always)]
    pub(crate) fn contains(&self, inverse_depth: f32) -> bool {
        (self.min..=self.max).contains(&inverse_depth)
    }
}
