//! Computation of an octave: Gaussian levels, their differences and refined extrema, in one pass.
//!
//! The levels of an octave are far larger than the caches, and one pass over memory per level would
//! take longer than the arithmetic. All levels are therefore computed together, row by row. Each
//! level has a ring buffer of its latest rows. The next row of a level is blurred from the ring
//! buffer of the level below, first along columns into a temporary row, then along the row. The
//! differences of Gaussians have ring buffers too, in which extrema are detected and refined. Only
//! levels 1 … S, from which orientations and descriptors are computed later, are written to memory.
//!
//! An octave is divided into bands of rows, and a band into tiles of columns, so narrow that the
//! ring buffers fit into the cache. Bands and tiles overlap by the radii of the blurs. Each sample
//! is computed from the same values in the same order in any division, so the result does not
//! depend on the division.

use crate::blur::{BLOCK, blur_columns, blur_row};
use crate::buffer::{AlignedBuf, LINE, Ring};
use crate::extrema::{self, Extremum, REFINEMENT_RADIUS, Thresholds};
use crate::scale_space::{Kernel, kernel_from_image, kernels_between_levels};
use crate::simd::{LANES, Simd, Task};
use crate::source::Source;
use std::ops::Range;

/// Maximum width of a tile: ring buffers fit into a cache of 1 MiB, and the overlap is small.
const MAX_TILE_WIDTH: usize = 1024;

/// Number of values beyond the end of a row that vector loads and stores may access.
const SLACK: usize = 8 * LANES;

/// The geometry and the blurs of an octave.
pub(crate) struct OctavePlan {
    /// Index of the octave: log2 of the sample distance in pixels.
    pub(crate) octave: i32,
    /// Number of columns.
    pub(crate) width: usize,
    /// Number of rows.
    pub(crate) height: usize,
    /// Number S of levels in which extrema are detected.
    pub(crate) levels: usize,
    /// The blurs in order: first that of the source, if it is the image, then those between the
    /// levels.
    stages: Vec<Kernel>,
    /// Halo of a tile, in samples, for the input of each stage and the output of the last stage.
    halos: Vec<usize>,
}

impl OctavePlan {
    /// The plan of an octave that is computed from the image, if `first_octave` is given, or from
    /// the previous octave.
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
        // The halo of a stage is the radius of the refinement plus the radii of the later blurs.
        let mut halos = vec![REFINEMENT_RADIUS];
        for kernel in stages.iter().rev() {
            halos.push(halos[halos.len() - 1] + kernel.len() - 1);
        }
        halos.reverse();
        OctavePlan { octave, width: size.0, height: size.1, levels, stages, halos }
    }

    /// Stride of a stored level, in samples.
    pub(crate) fn stride(&self) -> usize {
        self.width.next_multiple_of(LINE)
    }

    /// Length of the buffer of `rows` rows of a stored level, including slack for vector accesses.
    pub(crate) fn level_len(&self, rows: usize) -> usize {
        self.stride() * rows + SLACK
    }

    /// Stride of level 0 of the next octave, in samples.
    pub(crate) fn next_stride(&self) -> usize {
        (self.width / 2).next_multiple_of(LINE)
    }

    /// Number of stages before level 0: one if the source is blurred, otherwise zero.
    fn stages_before_level_0(&self) -> usize {
        self.stages.len() - (self.levels + 2)
    }
}

/// Working memory for a band.
#[derive(Default)]
pub(crate) struct Scratch {
    /// The input of each stage, and the output of the last stage.
    rings: Vec<Ring>,
    /// Differences of Gaussians.
    differences: Vec<Ring>,
    /// Rows that are blurred along columns.
    rows: AlignedBuf,
    /// Temporary row of the source.
    source: AlignedBuf,
}

/// The computation of a band of rows of an octave.
pub(crate) struct Band<'a, 'b> {
    /// Geometry and blurs.
    pub(crate) plan: &'a OctavePlan,
    /// Source of the octave.
    pub(crate) source: Source<'a>,
    /// Rows of the band; the first row is even.
    pub(crate) rows: Range<usize>,
    /// Output: the rows of levels 1 … S; empty if they are not stored.
    pub(crate) levels: Vec<&'b mut [f32]>,
    /// Output: the rows of level 0 of the next octave.
    pub(crate) next_octave: Option<&'b mut [f32]>,
    /// Thresholds of the extrema; `None` for no detection.
    pub(crate) thresholds: Option<Thresholds>,
    /// Working memory.
    pub(crate) scratch: &'b mut Scratch,
}

impl Task for Band<'_, '_> {
    /// The refined extrema.
    type Output = Vec<Extremum>;

    #[inline(always)]
    fn run<S: Simd>(mut self) -> Vec<Extremum> {
        let mut found = Vec::new();
        let width = self.plan.width;
        let tiles = width.div_ceil(MAX_TILE_WIDTH);
        let tile = width.div_ceil(tiles).next_multiple_of(LINE);
        let mut x0 = 0;
        while x0 < width {
            let x1 = (x0 + tile).min(width);
            self.compute_tile::<S>((x0, x1), tile, &mut found);
            x0 = x1;
        }
        S::fence();
        found
    }
}

/// The columns of a tile and their positions in the rows of the ring buffers.
#[derive(Clone, Copy)]
struct TileColumns {
    x0: usize,
    x1: usize,
    width: usize,
    /// Position of column `x0` in a row.
    origin: usize,
}

impl TileColumns {
    /// Position range of the columns of the tile and its halo, clipped to the octave.
    #[inline(always)]
    fn extended(&self, halo: usize) -> (usize, usize) {
        let (first, last) = (self.x0.saturating_sub(halo), (self.x1 + halo).min(self.width));
        (self.position(first), self.position(last))
    }

    /// Position of column `x` in a row.
    #[inline(always)]
    fn position(&self, x: usize) -> usize {
        x + self.origin - self.x0
    }
}

impl Band<'_, '_> {
    /// Computes a tile of the band and appends its refined extrema to `found`.
    #[inline(always)]
    fn compute_tile<S: Simd>(
        &mut self,
        (x0, x1): (usize, usize),
        tile: usize,
        found: &mut Vec<Extremum>,
    ) {
        let OctavePlan { width, height, levels, ref stages, ref halos, .. } = *self.plan;
        let level_0 = self.plan.stages_before_level_0();
        // Without detection, level S is the last required level, without a halo.
        let (last, reach) = match self.thresholds {
            Some(_) => (stages.len(), REFINEMENT_RADIUS),
            None => (level_0 + levels, 0),
        };
        let halo = |stage: usize| halos[stage] - halos[last] + reach;
        let margin = (halo(0) + LINE).next_multiple_of(LINE);
        let stride = tile + 2 * margin + SLACK;
        let columns = TileColumns { x0, x1, width, origin: margin };
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
                ring.reset(2 * REFINEMENT_RADIUS + 1 + ahead, stride, first_row(stage));
            }
        }
        scratch.rows.reserve(BLOCK * stride);
        scratch.source.reserve(stride);
        let mut next_detected = band.start;

        while scratch.rings[last].next < end_row(last) || next_detected < band.end {
            for _ in 0..BLOCK.min(end_row(0) - scratch.rings[0].next) {
                let y = scratch.rings[0].next;
                let (from, to) = columns.extended(halo(0));
                let image_columns = (from + x0 - margin, to + x0 - margin);
                let out = scratch.rings[0].next_row();
                // SAFETY: rows of ring buffers and of `source` have `stride` values.
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
                // One block at a time: more would overwrite rows of the ring buffer that later
                // stages need.
                let y = scratch.rings[stage + 1].next;
                let rows = BLOCK.min(end - y);
                if y + rows > ready {
                    continue;
                }
                let job = BlurStage {
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
                // SAFETY: the ring buffers hold the rows and columns.
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
                    // SAFETY: a row of a ring buffer holds the columns of the tile.
                    let row = unsafe {
                        std::slice::from_raw_parts(
                            scratch.rings[stage + 1].row(y).add(margin),
                            x1 - x0,
                        )
                    };
                    if let Some(rows) = self.levels.get_mut(level - 1) {
                        let at = (y - band.start) * self.plan.stride() + x0;
                        // SAFETY: rows of levels, rows of ring buffers and tiles are aligned to
                        // cache lines.
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
                next_detected = band.end;
                continue;
            };
            let next = scratch.rings[last].next;
            let ready =
                if next == height { height } else { next.saturating_sub(REFINEMENT_RADIUS) };
            let detector = extrema::Detector {
                differences: &scratch.differences,
                origin: margin,
                columns: (x0, x1),
                size: (width, height),
                octave: self.plan.octave,
                levels,
                thresholds,
            };
            while next_detected < ready.min(band.end) {
                detector.detect_row::<S>(next_detected, found);
                next_detected += 1;
            }
        }
    }
}

/// Copies a row with non-temporal stores.
///
/// # Safety
/// Both slices have the same length and are aligned to cache lines.
#[inline(always)]
unsafe fn stream_row<S: Simd>(row: &[f32], out: &mut [f32]) {
    let whole = row.len() / LANES * LANES;
    for x in (0..whole).step_by(LANES) {
        // SAFETY: guaranteed by the caller.
        unsafe { S::stream(out.as_mut_ptr().add(x), S::load(row.as_ptr().add(x))) };
    }
    out[whole..].copy_from_slice(&row[whole..]);
}

/// One blur of a tile.
struct BlurStage<'a> {
    kernel: &'a Kernel,
    stage: usize,
    height: usize,
    stride: usize,
    /// Index of the difference of Gaussians that is computed from the output.
    difference: Option<usize>,
    input_columns: (usize, usize),
    output_columns: (usize, usize),
    /// Whether the input starts at the left border of the octave.
    at_left: bool,
    /// Whether the input ends at the right border of the octave.
    at_right: bool,
}

impl BlurStage<'_> {
    /// Computes `ROWS` output rows from row `y` on.
    ///
    /// # Safety
    /// The ring buffer of the input holds the rows of the kernel, and its rows hold the columns.
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
        // SAFETY: `scratch.rows` holds a block; the rest is guaranteed by the caller.
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

/// Maximum number of input rows of a block: with one level per octave, the last blur has σ = 11.1.
const MAX_TAPS: usize = 2 * 45 + BLOCK;
