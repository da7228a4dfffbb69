//! An octave, or some rows of it, on one thread or several: bands of rows that are swept
//! independently.

use crate::buffer::AlignedBuf;
use crate::extrema::{Extremum, Thresholds};
use crate::octave::{Plan, Scratch, Sweep};
use crate::simd::{Isa, dispatch};
use crate::source::Source;
use rayon::prelude::*;
use std::num::NonZeroUsize;
use std::ops::Range;

/// Bands per thread: more balance the load, fewer compute less twice.
const BANDS_PER_THREAD: usize = 2;
/// A band has at least this many rows: below, most of its work would be the overlap with its
/// neighbours.
const MIN_BAND: usize = 128;

/// What [`sweep_all`] does.
pub(crate) struct SweepAll<'a> {
    /// What to compute.
    pub(crate) plan: &'a Plan,
    /// From what.
    pub(crate) source: Source<'a>,
    /// Which rows, from an even one on.
    pub(crate) rows: Range<usize>,
    /// Where these rows of levels 1 … S go.
    pub(crate) levels: Option<&'a mut Vec<AlignedBuf>>,
    /// Where these rows of the next octave's level 0 go.
    pub(crate) next_octave: Option<&'a mut AlignedBuf>,
    /// Which extrema count; without it, none are looked for.
    pub(crate) thresholds: Option<Thresholds>,
    /// Memory for each band.
    pub(crate) scratches: &'a mut Vec<Scratch>,
    /// What the machine has.
    pub(crate) isa: Isa,
    /// Into how many threads' work to divide it.
    pub(crate) threads: NonZeroUsize,
}

/// Computes rows of an octave; gives the extrema.
pub(crate) fn sweep_all(job: SweepAll<'_>) -> Vec<Extremum> {
    let SweepAll { plan, source, rows, levels, next_octave, thresholds, scratches, isa, threads } =
        job;
    let bands = match threads.get() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).min(rows.len() / MIN_BAND).max(1),
    };
    let band = rows.len().div_ceil(bands).next_multiple_of(2);
    let bands = rows.len().div_ceil(band);
    scratches.resize_with(scratches.len().max(bands), Scratch::default);

    // Each band gets its rows of everything that is written.
    let levels = levels.map_or(Default::default(), |levels| {
        levels.resize_with(plan.levels, AlignedBuf::default);
        &mut levels[..]
    });
    let level_len = plan.level_len(rows.len());
    let mut level_rows: Vec<_> = levels
        .iter_mut()
        .map(|level| level.reserve(level_len).chunks_mut(band * plan.stride()))
        .collect();
    let next_len = plan.next_stride() * plan.height.div_ceil(2);
    let mut next_rows =
        next_octave.map(|next| next.reserve(next_len).chunks_mut(band / 2 * plan.next_stride()));
    let sweeps: Vec<Sweep<'_, '_>> = scratches[..bands]
        .iter_mut()
        .enumerate()
        .map(|(i, scratch)| Sweep {
            plan,
            source,
            rows: rows.start + i * band..(rows.start + (i + 1) * band).min(rows.end),
            levels: level_rows.iter_mut().filter_map(Iterator::next).collect(),
            next_octave: next_rows.as_mut().and_then(Iterator::next),
            thresholds,
            scratch,
        })
        .collect();
    let found: Vec<Vec<Extremum>> = if bands > 1 {
        sweeps.into_par_iter().map(|sweep| dispatch(isa, sweep)).collect()
    } else {
        sweeps.into_iter().map(|sweep| dispatch(isa, sweep)).collect()
    };
    found.concat()
}
