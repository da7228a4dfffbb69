//! Parallel computation of an octave, or a range of its rows, in independent bands of rows.

use crate::buffer::AlignedBuf;
use crate::extrema::{Extremum, Thresholds};
use crate::octave::{Band, OctavePlan, Scratch};
use crate::simd::{Isa, dispatch};
use crate::source::Source;
use rayon::prelude::*;
use std::num::NonZeroUsize;
use std::ops::Range;

/// Bands per thread: more bands balance the load, fewer bands overlap less.
const BANDS_PER_THREAD: usize = 2;
/// Minimum number of rows of a band: for smaller bands, most of the work would be the overlap.
const MIN_BAND: usize = 128;

/// Arguments of [`compute_octave`].
pub(crate) struct OctaveJob<'a> {
    /// Geometry and blurs.
    pub(crate) plan: &'a OctavePlan,
    /// Source of the octave.
    pub(crate) source: Source<'a>,
    /// Rows to compute; the first row is even.
    pub(crate) rows: Range<usize>,
    /// Output: the rows of levels 1 … S.
    pub(crate) levels: Option<&'a mut Vec<AlignedBuf>>,
    /// Output: the rows of level 0 of the next octave.
    pub(crate) next_octave: Option<&'a mut AlignedBuf>,
    /// Thresholds of the extrema; `None` for no detection.
    pub(crate) thresholds: Option<Thresholds>,
    /// Working memory of each band.
    pub(crate) scratches: &'a mut Vec<Scratch>,
    /// Instruction set.
    pub(crate) isa: Isa,
    /// Number of threads.
    pub(crate) threads: NonZeroUsize,
}

/// Computes rows of an octave and returns the refined extrema.
pub(crate) fn compute_octave(job: OctaveJob<'_>) -> Vec<Extremum> {
    let OctaveJob { plan, source, rows, levels, next_octave, thresholds, scratches, isa, threads } =
        job;
    let max_bands = match threads.get() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).min(rows.len() / MIN_BAND).max(1),
    };
    let band_rows = rows.len().div_ceil(max_bands).next_multiple_of(2);
    let num_bands = rows.len().div_ceil(band_rows);
    scratches.resize_with(scratches.len().max(num_bands), Scratch::default);

    // Each band writes its own rows of the outputs.
    let levels = levels.map_or(Default::default(), |levels| {
        levels.resize_with(plan.levels, AlignedBuf::default);
        &mut levels[..]
    });
    let level_len = plan.level_len(rows.len());
    let mut level_rows: Vec<_> = levels
        .iter_mut()
        .map(|level| level.reserve(level_len).chunks_mut(band_rows * plan.stride()))
        .collect();
    let next_len = plan.next_stride() * plan.height.div_ceil(2);
    let mut next_rows = next_octave
        .map(|next| next.reserve(next_len).chunks_mut(band_rows / 2 * plan.next_stride()));
    let bands: Vec<Band<'_, '_>> = scratches[..num_bands]
        .iter_mut()
        .enumerate()
        .map(|(i, scratch)| Band {
            plan,
            source,
            rows: rows.start + i * band_rows..(rows.start + (i + 1) * band_rows).min(rows.end),
            levels: level_rows.iter_mut().filter_map(Iterator::next).collect(),
            next_octave: next_rows.as_mut().and_then(Iterator::next),
            thresholds,
            scratch,
        })
        .collect();
    let found: Vec<Vec<Extremum>> = if num_bands > 1 {
        bands.into_par_iter().map(|band| dispatch(isa, band)).collect()
    } else {
        bands.into_iter().map(|band| dispatch(isa, band)).collect()
    };
    found.concat()
}
