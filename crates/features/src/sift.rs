//! The whole of it: octaves, choice of extrema, orientations and descriptors.

use crate::buffer::AlignedBuf;
use crate::descriptor::{Frame, describe};
use crate::extrema::{Extremum, Thresholds};
use crate::gradient::Level;
use crate::octave::{Plan, Scratch, Sweep};
use crate::options::{Keep, Normalization, Orientation};
use crate::orientation::{Directions, directions};
use crate::simd::{Isa, Simd, Task, dispatch};
use crate::source::Source;
use crate::{Descriptor, Error, Features, GrayView, Keypoint, Options};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::num::NonZeroUsize;

/// An octave with fewer columns or rows is not looked at: its extrema would all lie at its border.
const MIN_SIDE: usize = 8;
/// Bands per thread when one image is divided: more balance the load, fewer compute less twice.
const BANDS_PER_THREAD: usize = 2;
/// A band has at least this many rows: below, most of its work would be the overlap with its neighbours.
const MIN_BAND: usize = 128;
/// Extrema that are described as one task.
const DESCRIBE_CHUNK: usize = 128;
/// Where the centre of the first pixel is in pixel coordinates.
const PIXEL_CENTRE: f32 = 0.5;

/// Extracts the features of an image on the calling thread. For many images, [`Sift`] keeps its memory from one to the
/// next.
pub fn extract(image: &GrayView<'_>, options: &Options) -> Result<Features, Error> {
    Sift::new(*options)?.extract(image, None)
}

/// Extracts features, image after image, in memory that it keeps: 12 bytes for each pixel of the finest octave that
/// was computed. Have one per thread.
pub struct Sift {
    options: Options,
    isa: Isa,
    /// Levels 1 … S of each octave, the finest first.
    octaves: Vec<Vec<AlignedBuf>>,
    scratches: Vec<Scratch>,
}

/// Levels of an octave that was swept.
struct Swept {
    plan: Plan,
    /// Where its levels are.
    slot: usize,
}

impl Sift {
    /// Checks the options.
    pub fn new(options: Options) -> Result<Self, Error> {
        options.validate()?;
        Ok(Sift { options, isa: Isa::best(), octaves: Vec::new(), scratches: Vec::new() })
    }

    /// Extracts the features of an image on the calling thread: the way for many images, each on its own thread. Where
    /// the mask is zero, no keypoint is kept.
    pub fn extract(&mut self, image: &GrayView<'_>, mask: Option<&GrayView<'_>>) -> Result<Features, Error> {
        self.extract_with(image, mask, NonZeroUsize::MIN)
    }

    /// As [`extract`](Self::extract), and with the same result, on all threads of rayon's current pool: the way for a
    /// single large image.
    pub fn extract_parallel(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Error> {
        let threads = NonZeroUsize::new(rayon::current_num_threads()).unwrap_or(NonZeroUsize::MIN);
        self.extract_with(image, mask, threads)
    }

    fn extract_with(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
        threads: NonZeroUsize,
    ) -> Result<Features, Error> {
        image.check()?;
        let (width, height) = (image.width, image.height);
        if let Some(mask) = mask {
            mask.check()?;
            if (mask.width, mask.height) != (width, height) {
                let (mask_width, mask_height) = (mask.width, mask.height);
                return Err(Error::MaskSize { width, height, mask_width, mask_height });
            }
        }
        let (extrema, swept) = self.detect(image, mask, threads);
        Ok(self.describe(&extrema, &swept, threads))
    }

    /// The extrema that are to be described, the most wanted first, and the levels for it.
    fn detect(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
        threads: NonZeroUsize,
    ) -> (Vec<Extremum>, Vec<Swept>) {
        let Options { first_octave, octaves, levels, max_features, keep, .. } = self.options;
        let mut swept: Vec<Swept> = Vec::new();
        let mut extrema = Vec::new();
        let end = first_octave + octaves as i32;
        // The octave of the image itself and those above it, then the doubled one, if it can still contribute.
        let order = (0..end).chain((first_octave == -1).then_some(-1));
        for (slot, octave) in order.enumerate() {
            if octave == -1 && keep == Keep::Coarsest && extrema.len() >= max_features {
                break;
            }
            let size = if octave < 0 {
                (2 * image.width, 2 * image.height)
            } else {
                (image.width >> octave, image.height >> octave)
            };
            if size.0.min(size.1) < MIN_SIDE {
                continue;
            }
            self.octaves.resize_with(self.octaves.len().max(slot + 1), Vec::new);
            let mut levels_here = std::mem::take(&mut self.octaves[slot]);
            let from_image = octave <= 0;
            let plan = Plan::new(octave, size, levels, from_image.then_some(first_octave));
            let source = if octave < 0 {
                Source::Doubled(*image)
            } else if from_image {
                Source::Image(*image)
            } else {
                let before = &swept[swept.len() - 1].plan;
                Source::Halved {
                    level: self.octaves[slot - 1][levels - 1].as_slice(),
                    stride: before.stride(),
                }
            };
            let mut scratches = std::mem::take(&mut self.scratches);
            let mut found = sweep(&plan, source, self, &mut scratches, &mut levels_here, threads);
            self.scratches = scratches;
            self.octaves[slot] = levels_here;
            swept.push(Swept { plan, slot });
            if octave >= first_octave {
                if let Some(mask) = mask {
                    found.retain(|e| is_unmasked(mask, e));
                }
                extrema.append(&mut found);
            }
        }
        choose(&mut extrema, keep, max_features);
        (extrema, swept)
    }

    fn describe(&self, extrema: &[Extremum], swept: &[Swept], threads: NonZeroUsize) -> Features {
        let Options { orientation, max_orientations, max_features, normalization, .. } = self.options;
        let oriented: Vec<(Extremum, f32)> = match orientation {
            Orientation::Upright => extrema.iter().map(|&e| (e, 0.0)).collect(),
            Orientation::Dominant => {
                let found = in_chunks(extrema, threads, |chunk| {
                    dispatch(self.isa, Orient { sift: self, swept, extrema: chunk, max: max_orientations })
                });
                let pairs = extrema.iter().zip(&found);
                pairs.flat_map(|(&e, found)| found.as_slice().iter().map(move |&angle| (e, angle))).collect()
            }
        };
        let oriented = &oriented[..oriented.len().min(max_features)];
        let descriptors = in_chunks(oriented, threads, |chunk| {
            dispatch(self.isa, Describe { sift: self, swept, oriented: chunk, normalization })
        });
        Features { keypoints: oriented.iter().map(|(e, angle)| keypoint(e, *angle)).collect(), descriptors }
    }

    /// The level in whose gradients an extremum is described.
    #[inline(always)]
    fn level<'a>(&'a self, swept: &[Swept], extremum: &Extremum) -> Level<'a> {
        let found = swept.iter().find(|s| s.plan.octave == extremum.octave);
        let Swept { plan, slot } = found.expect("extrema come from octaves that were swept");
        let data = self.octaves[*slot][extremum.level - 1].as_slice();
        Level { data, stride: plan.stride(), width: plan.width, height: plan.height }
    }
}

/// Computes the levels of an octave and finds its extrema.
fn sweep(
    plan: &Plan,
    source: Source<'_>,
    sift: &Sift,
    scratches: &mut Vec<Scratch>,
    levels: &mut Vec<AlignedBuf>,
    threads: NonZeroUsize,
) -> Vec<Extremum> {
    levels.resize_with(plan.levels, AlignedBuf::default);
    let bands = match threads.get() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).min(plan.height / MIN_BAND).max(1),
    };
    let band = plan.height.div_ceil(bands);
    let bands = plan.height.div_ceil(band);
    scratches.resize_with(scratches.len().max(bands), Scratch::default);
    let Options { peak_threshold, edge_threshold, .. } = sift.options;

    // Each band with its rows of every level.
    let mut rows_of_levels: Vec<_> =
        levels.iter_mut().map(|l| l.reserve(plan.level_len()).chunks_mut(band * plan.stride())).collect();
    let jobs: Vec<_> = scratches[..bands]
        .iter_mut()
        .enumerate()
        .map(|(i, scratch)| {
            let rows = i * band..((i + 1) * band).min(plan.height);
            let levels: Vec<&mut [f32]> = rows_of_levels.iter_mut().filter_map(Iterator::next).collect();
            (rows, levels, scratch)
        })
        .collect();
    let work = |(rows, mut levels, scratch): (_, Vec<&mut [f32]>, &mut Scratch)| {
        let mut found = Vec::new();
        let thresholds = Thresholds { peak: peak_threshold, edge: edge_threshold };
        dispatch(
            sift.isa,
            Sweep { plan, source, thresholds, rows, levels: &mut levels, scratch, found: &mut found },
        );
        found
    };
    let found: Vec<Vec<Extremum>> = if bands > 1 {
        jobs.into_par_iter().map(work).collect()
    } else {
        jobs.into_iter().map(work).collect()
    };
    found.concat()
}

/// Sorts extrema by how much they are wanted, drops duplicates, and keeps the first `max`.
fn choose(extrema: &mut Vec<Extremum>, keep: Keep, max: usize) {
    // Position and scale of a sample identify an extremum: two that were refined to the same sample are the same.
    extrema.sort_unstable_by(|a, b| {
        let coarsest = || (b.octave, b.level).cmp(&(a.octave, a.level));
        let strongest = || b.response.total_cmp(&a.response);
        let order = match keep {
            Keep::Coarsest => coarsest().then_with(strongest),
            Keep::Strongest => strongest().then_with(coarsest),
        };
        order.then_with(|| (a.iy, a.ix).cmp(&(b.iy, b.ix)))
    });
    extrema.dedup_by_key(|e| (e.octave, e.level, e.iy, e.ix));
    extrema.truncate(max);
}

/// Whether the mask keeps the pixel in which an extremum lies.
fn is_unmasked(mask: &GrayView<'_>, extremum: &Extremum) -> bool {
    let Keypoint { x, y, .. } = keypoint(extremum, 0.0);
    let (column, row) = ((x as usize).min(mask.width - 1), (y as usize).min(mask.height - 1));
    mask.row(row)[column] != 0
}

/// From samples of an octave to pixels.
fn keypoint(extremum: &Extremum, angle: f32) -> Keypoint {
    let pixels = 2f32.powi(extremum.octave);
    Keypoint {
        x: extremum.x * pixels + PIXEL_CENTRE,
        y: extremum.y * pixels + PIXEL_CENTRE,
        scale: extremum.sigma * pixels,
        orientation: if angle > PI { angle - TAU } else { angle },
    }
}

/// Maps chunks of a list to lists, on one thread or all, and joins these.
fn in_chunks<T: Sync, U: Send>(
    items: &[T],
    threads: NonZeroUsize,
    work: impl Fn(&[T]) -> Vec<U> + Sync + Send,
) -> Vec<U> {
    if threads.get() == 1 {
        return work(items);
    }
    let parts: Vec<Vec<U>> = items.par_chunks(DESCRIBE_CHUNK).map(work).collect();
    parts.into_iter().flatten().collect()
}

struct Orient<'a> {
    sift: &'a Sift,
    swept: &'a [Swept],
    extrema: &'a [Extremum],
    max: usize,
}

impl Task for Orient<'_> {
    type Output = Vec<Directions>;

    #[inline(always)]
    fn run<S: Simd>(self) -> Self::Output {
        let mut all = Vec::with_capacity(self.extrema.len());
        for extremum in self.extrema {
            all.push(directions::<S>(&self.sift.level(self.swept, extremum), extremum, self.max));
        }
        all
    }
}

struct Describe<'a> {
    sift: &'a Sift,
    swept: &'a [Swept],
    oriented: &'a [(Extremum, f32)],
    normalization: Normalization,
}

impl Task for Describe<'_> {
    type Output = Vec<Descriptor>;

    #[inline(always)]
    fn run<S: Simd>(self) -> Self::Output {
        let mut all = Vec::with_capacity(self.oriented.len());
        for (extremum, angle) in self.oriented {
            let frame = Frame { x: extremum.x, y: extremum.y, sigma: extremum.sigma, angle: *angle };
            all.push(describe::<S>(&self.sift.level(self.swept, extremum), frame, self.normalization));
        }
        all
    }
}
