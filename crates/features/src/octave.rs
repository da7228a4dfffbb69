//! One octave, from its source to refined extrema, in one sweep.
//!
//! The Gaussians of an octave are far larger than the caches, and reading and writing them one
//! after the other would take longer than computing them. So they are produced together, row by
//! row: each level is blurred from a ring of the latest rows of the level below as soon as these
//! suffice (columns first, into a temporary row, then along the row), the differences go to rings
//! as well, and extrema are found and refined in these. Only levels 1 … S, in whose gradients
//! orientations and descriptors are measured later, are written to memory.
//!
//! Bands of rows are independent of each other, and within a band tiles of columns, narrow enough
//! that the rings stay in the cache. Both are extended by what the blurs reach, so that each sample
//! is computed from the same numbers in the same order wherever the borders lie: the result does
//! not depend on the division.

use crate::blur::{BLOCK, blur_columns, blur_row};
use crate::buffer::{AlignedBuf, LINE, Ring};
use crate::extrema::{self, Extremum, REACH, Thresholds};
use crate::scale_space::{Kernel, kernel_from_image, kernels_between_levels};
use crate::simd::{LANES, Simd, Task};
use crate::source::Source;
use std::ops::Range;

/// Columns of a tile: narrow enough for rings that stay in a cache of 1 MiB, wide enough for little
/// overlap.
const TILE: usize = 1024;

/// Values beyond the end of a row that a kernel may touch.
const SLACK: usize = 8 * LANES;

/// What is computed for an octave.
pub(crate) struct Plan {
    /// log2 of the sample distance in pixels.
    pub(crate) octave: i32,
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// Scales at which extrema are looked for.
    pub(crate) levels: usize,
    /// The blurs, in the order in which they are applied: one more than between the levels if the
    /// source is blurred.
    stages: Vec<Kernel>,
    /// How far beyond a tile the input of each stage, and the output of the last one, is needed.
    halos: Vec<usize>,
}

impl Plan {
    /// An octave that is made from the image, or from the octave before it.
    pub(crate) fn new(
        octave: i32,
        size: (usize, usize),
        levels: usize,
        first_octave: Option<i32>,
    ) -> Self {
        let mut stages = kernels_between_levels(levels);
        if let Some(first_octave) = first_octave {
            stages.insert(0, kernel_from_image(octave, first_octave));
        }
        let mut halos = vec![REACH];
        for kernel in stages.iter().rev() {
            halos.push(halos[halos.len() - 1] + kernel.len() - 1);
        }
        halos.reverse();
        Plan { octave, width: size.0, height: size.1, levels, stages, halos }
    }

    /// Distance between the rows of a stored level.
    pub(crate) fn stride(&self) -> usize {
        self.width.next_multiple_of(LINE)
    }

    /// Values of so many rows of a stored level, with what kernels may read beyond their end.
    pub(crate) fn level_len(&self, rows: usize) -> usize {
        self.stride() * rows + SLACK
    }

    /// Distance between the rows of the next octave's level 0.
    pub(crate) fn next_stride(&self) -> usize {
        (self.width / 2).next_multiple_of(LINE)
    }

    /// The stage whose output is level 0, or none if the source is.
    fn stages_before_level_0(&self) -> usize {
        self.stages.len() - (self.levels + 2)
    }
}

/// Memory for a sweep.
#[derive(Default)]
pub(crate) struct Scratch {
    /// The input of each stage, and the output of the last one.
    rings: Vec<Ring>,
    /// Differences of levels.
    differences: Vec<Ring>,
    /// Rows that are blurred along columns only.
    rows: AlignedBuf,
    /// For the source.
    source: AlignedBuf,
}

/// One band of rows of an octave.
pub(crate) struct Sweep<'a, 'b> {
    /// What to compute.
    pub(crate) plan: &'a Plan,
    /// From what.
    pub(crate) source: Source<'a>,
    /// The band; it begins at an even row.
    pub(crate) rows: Range<usize>,
    /// These rows of levels 1 … S, or nothing if they are not wanted.
    pub(crate) levels: Vec<&'b mut [f32]>,
    /// These rows of the next octave's level 0, if that is wanted.
    pub(crate) next_octave: Option<&'b mut [f32]>,
    /// Which extrema count; without it, none are looked for.
    pub(crate) thresholds: Option<Thresholds>,
    /// Memory.
    pub(crate) scratch: &'b mut Scratch,
}

impl Task for Sweep<'_, '_> {
    /// Refined extrema.
    type Output = Vec<Extremum>;

    #[inline(always)]
    fn run<S: Simd>(mut self) -> Vec<Extremum> {
        let mut found = Vec::new();
        let width = self.plan.width;
        let tiles = width.div_ceil(TILE);
        let tile = width.div_ceil(tiles).next_multiple_of(LINE);
        let mut x0 = 0;
        while x0 < width {
            let x1 = (x0 + tile).min(width);
            self.sweep_tile::<S>((x0, x1), tile, &mut found);
            x0 = x1;
        }
        S::fence();
        found
    }
}

/// Where the columns of a tile lie in the rows of its rings.
#[derive(Clone, Copy)]
struct Columns {
    x0: usize,
    x1: usize,
    width: usize,
    /// Position of column `x0` in a row.
    origin: usize,
}

impl Columns {
    /// Positions of the columns of the image that are at most `halo` away from the tile.
    #[inline(always)]
    fn extended(&self, halo: usize) -> (usize, usize) {
        let (first, last) = (self.x0.saturating_sub(halo), (self.x1 + halo).min(self.width));
        (self.position(first), self.position(last))
    }

    /// Position of a column.
    #[inline(always)]
    fn position(&self, x: usize) -> usize {
        x + self.origin - self.x0
    }
}

impl Sweep<'_, '_> {
    #[inline(always)]
    fn sweep_tile<S: Simd>(
        &mut self,
        (x0, x1): (usize, usize),
        tile: usize,
        found: &mut Vec<Extremum>,
    ) {
        let Plan { width, height, levels, ref stages, ref halos, .. } = *self.plan;
        let level_0 = self.plan.stages_before_level_0();
        // Without a search, level S is the last one that is needed, and nothing beyond the tile.
        let (last, reach) = match self.thresholds {
            Some(_) => (stages.len(), REACH),
            None => (level_0 + levels, 0),
        };
        let halo = |stage: usize| halos[stage] - halos[last] + reach;
        let margin = (halo(0) + LINE).next_multiple_of(LINE);
        let stride = tile + 2 * margin + SLACK;
        let columns = Columns { x0, x1, width, origin: margin };
        let band = self.rows.clone();
        let first_row = |stage: usize| band.start.saturating_sub(halo(stage));
        let end_row = |stage: usize| (band.end + halo(stage)).min(height);

        let scratch = &mut *self.scratch;
        scratch.rings.resize_with(stages.len() + 1, Ring::default);
        scratch.differences.resize_with(levels + 2, Ring::default);
        for (stage, ring) in scratch.rings[..=last].iter_mut().enumerate() {
            let radius = stages.get(stage).map_or(0, |kernel| kernel.len() - 1);
            ring.reset(2 * radius + 3 * BLOCK, stride, first_row(stage));
        }
        if self.thresholds.is_some() {
            for (i, ring) in scratch.differences.iter_mut().enumerate() {
                let stage = level_0 + i + 1;
                let ahead = halo(stage) - halo(last) + BLOCK * (last - stage + 2);
                ring.reset(2 * REACH + 1 + ahead, stride, first_row(stage));
            }
        }
        scratch.rows.reserve(BLOCK * stride);
        scratch.source.reserve(stride);
        let mut next_searched = band.start;

        while scratch.rings[last].next < end_row(last) || next_searched < band.end {
            for _ in 0..BLOCK.min(end_row(0) - scratch.rings[0].next) {
                let y = scratch.rings[0].next;
                let (from, to) = columns.extended(halo(0));
                let image_columns = (from + x0 - margin, to + x0 - margin);
                let out = scratch.rings[0].next_row();
                // SAFETY: rows of rings and of `source` have `stride` values.
                unsafe {
                    let temp = scratch.source.reserve(stride);
                    self.source.fill_row::<S>(y, image_columns, out.add(from), temp);
                }
            }
            for (stage, kernel) in stages.iter().enumerate().take(last) {
                let radius = kernel.len() - 1;
                let input = &scratch.rings[stage];
                let end = end_row(stage + 1);
                let ready = if input.next == end_row(stage) {
                    end
                } else {
                    input.next.saturating_sub(radius)
                };
                // One block at a time: further ones would overwrite rows of the ring that are still
                // needed.
                let y = scratch.rings[stage + 1].next;
                let rows = BLOCK.min(end - y);
                if y + rows > ready {
                    continue;
                }
                let job = Stage {
                    kernel,
                    stage,
                    height,
                    stride,
                    difference: (reach > 0 && stage >= level_0).then(|| stage - level_0),
                    input_columns: columns.extended(halo(stage)),
                    output_columns: columns.extended(halo(stage + 1)),
                    at_left: x0 <= halo(stage),
                    at_right: x1 + halo(stage) >= width,
                };
                // SAFETY: the rings hold the rows, and the columns are inside of them.
                unsafe {
                    if rows == BLOCK {
                        job.blur_rows::<S, BLOCK>(scratch, y);
                    } else {
                        for y in y..y + rows {
                            job.blur_rows::<S, 1>(scratch, y);
                        }
                    }
                }
                // Level i is the input of stage `level_0 + i`.
                let level = (stage + 1).wrapping_sub(level_0);
                if !(1..=levels).contains(&level) {
                    continue;
                }
                for y in (y..y + rows).filter(|y| band.contains(y)) {
                    // SAFETY: a row of a ring holds the columns of the tile.
                    let row = unsafe {
                        std::slice::from_raw_parts(
                            scratch.rings[stage + 1].row(y).add(margin),
                            x1 - x0,
                        )
                    };
                    if let Some(rows) = self.levels.get_mut(level - 1) {
                        let at = (y - band.start) * self.plan.stride() + x0;
                        // SAFETY: rows of levels and of rings begin on cache lines, and so do
                        // tiles.
                        unsafe { stream_row::<S>(row, &mut rows[at..at + x1 - x0]) };
                    }
                    if let Some(rows) =
                        self.next_octave.as_mut().filter(|_| level == levels && y % 2 == 0)
                    {
                        let at = (y - band.start) / 2 * self.plan.next_stride() + x0 / 2;
                        for (out, pair) in rows[at..].iter_mut().zip(row.chunks_exact(2)) {
                            *out = pair[0];
                        }
                    }
                }
            }
            let Some(thresholds) = self.thresholds else {
                next_searched = band.end;
                continue;
            };
            let next = scratch.rings[last].next;
            let ready = if next == height { height } else { next.saturating_sub(REACH) };
            let search = extrema::Search {
                differences: &scratch.differences,
                origin: margin,
                columns: (x0, x1),
                size: (width, height),
                octave: self.plan.octave,
                levels,
                thresholds,
            };
            while next_searched < ready.min(band.end) {
                search.row::<S>(next_searched, found);
                next_searched += 1;
            }
        }
    }
}

/// Copies a row to memory that is not read soon.
///
/// # Safety
/// Both are equally long and begin on cache lines.
#[inline(always)]
unsafe fn stream_row<S: Simd>(row: &[f32], out: &mut [f32]) {
    let whole = row.len() / LANES * LANES;
    for x in (0..whole).step_by(LANES) {
        // SAFETY: the caller's promise.
        unsafe { S::stream(out.as_mut_ptr().add(x), S::load(row.as_ptr().add(x))) };
    }
    out[whole..].copy_from_slice(&row[whole..]);
}

/// One blur of a tile.
struct Stage<'a> {
    kernel: &'a Kernel,
    stage: usize,
    height: usize,
    stride: usize,
    /// The difference that its output completes.
    difference: Option<usize>,
    input_columns: (usize, usize),
    output_columns: (usize, usize),
    /// Whether the input begins at the border of the image.
    at_left: bool,
    /// Whether it ends there.
    at_right: bool,
}

impl Stage<'_> {
    /// Computes `ROWS` rows from row `y` on.
    ///
    /// # Safety
    /// The ring of the input holds the rows that the kernel reaches, columns are inside of the rows
    /// of the rings.
    #[inline(always)]
    unsafe fn blur_rows<S: Simd, const ROWS: usize>(&self, scratch: &mut Scratch, y: usize) {
        let radius = self.kernel.len() - 1;
        let (inputs, outputs) = scratch.rings.split_at_mut(self.stage + 1);
        let input = &inputs[self.stage];
        let mut rows = [std::ptr::null(); MAX_TAPS];
        let rows = &mut rows[..2 * radius + ROWS];
        for (t, row) in rows.iter_mut().enumerate() {
            *row = input.row((y + t).saturating_sub(radius).min(self.height - 1));
        }
        let all = scratch.rows.reserve(BLOCK * self.stride).as_mut_ptr();
        let (first, end) = self.input_columns;
        let (out_first, out_end) = self.output_columns;
        // SAFETY: `scratch.rows` has room for a block; the rest is the caller's promise.
        unsafe {
            let blurred: [*mut f32; ROWS] = std::array::from_fn(|j| all.add(j * self.stride));
            blur_columns::<S, ROWS>(rows, self.kernel, blurred, (first / LINE * LINE, end));
            for (j, &row) in blurred.iter().enumerate() {
                if self.at_left {
                    let border = *row.add(first);
                    for x in first - radius..first {
                        *row.add(x) = border;
                    }
                }
                if self.at_right {
                    let border = *row.add(end - 1);
                    for x in end..end + radius {
                        *row.add(x) = border;
                    }
                }
                let out = outputs[0].next_row();
                let difference =
                    self.difference.map(|i| (input.row(y + j), scratch.differences[i].next_row()));
                blur_row::<S>(
                    row,
                    self.kernel,
                    out,
                    difference,
                    (out_first / LINE * LINE, out_end),
                );
            }
        }
    }
}

/// Input rows of the widest kernel for a block: with one level per octave, the last blur has σ =
/// 11.1.
const MAX_TAPS: usize = 2 * 45 + BLOCK;
