//! The whole of it: octaves, choice of extrema, orientations and descriptors.

use crate::bands::{SweepAll, sweep_all};
use crate::buffer::AlignedBuf;
use crate::distinct::distinct;
use crate::extrema::{Extremum, Thresholds};
use crate::measure::{Measured, measure, window_reach};
use crate::octave::{Plan, Scratch};
use crate::options::Limit;
use crate::simd::Isa;
use crate::source::Source;
use crate::{Error, Features, GrayView, Keypoint, Options};
use std::f32::consts::{PI, TAU};
use std::num::NonZeroUsize;

/// An octave with fewer columns or rows is not looked at: its extrema would all lie at its border.
const MIN_SIDE: usize = 8;
/// Levels of an octave that take more memory than this are not kept, but computed once more, a part
/// at a time, where orientations and descriptors need them: the doubled octave of images beyond 11
/// megapixels.
const MAX_LEVEL_BYTES: usize = 512 << 20;
/// Such a part takes the limit divided by this.
const PARTS_PER_LIMIT: usize = 4;
/// Where the centre of the first pixel is in pixel coordinates.
const PIXEL_CENTRE: f32 = 0.5;

/// Extracts the features of an image on the calling thread. For many images, [`Sift`] keeps its
/// memory from one to the next.
pub fn extract(image: &GrayView<'_>, options: &Options) -> Result<Features, Error> {
    Sift::new(*options)?.extract(image, None)
}

/// Extracts features, image after image, in memory that it keeps: 12 bytes for each pixel of the
/// finest octave that was computed, at most 512 MiB for an octave. Have one per thread.
pub struct Sift {
    options: Options,
    pub(crate) isa: Isa,
    pub(crate) max_level_bytes: usize,
    octaves: Vec<Octave>,
    scratches: Vec<Scratch>,
}

/// What is kept of an octave.
#[derive(Default)]
struct Octave {
    /// Levels 1 … S, unless they are too large.
    levels: Vec<AlignedBuf>,
    /// Level 0 of the next one.
    next: AlignedBuf,
}

/// An octave of the image at hand.
struct Swept<'a> {
    plan: Plan,
    /// What it is made from; nothing if it is the octave before.
    image: Option<Source<'a>>,
    /// Whether its levels were kept.
    is_kept: bool,
}

impl Sift {
    /// Checks the options.
    pub fn new(options: Options) -> Result<Self, Error> {
        options.validate()?;
        let (octaves, scratches) = Default::default();
        Ok(Sift { options, isa: Isa::best(), max_level_bytes: MAX_LEVEL_BYTES, octaves, scratches })
    }

    /// Extracts the features of an image on the calling thread: the way for many images, each on
    /// its own thread. Where the mask is zero, no keypoint is kept.
    pub fn extract(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Error> {
        self.extract_with(image, mask, NonZeroUsize::MIN)
    }

    /// As [`extract`](Self::extract), and with the same result, on all threads of rayon's current
    /// pool: the way for a single large image.
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
        let measured = self.measure(&extrema, &swept, threads);
        let most = match self.options.limit {
            Limit::WholeLevels => usize::MAX,
            Limit::Exact => self.options.max_features,
        };
        let mut features = Features::default();
        for (extremum, measured) in extrema.iter().zip(&measured) {
            let each = measured.directions.as_slice().iter().zip(&measured.descriptors);
            for (&angle, &descriptor) in each.take(most - features.keypoints.len()) {
                features.keypoints.push(keypoint(extremum, angle));
                features.descriptors.push(descriptor);
            }
        }
        Ok(features)
    }

    /// The extrema that are to be described, the most wanted first, and the octaves for it, the
    /// doubled one last.
    fn detect<'a>(
        &mut self,
        image: &GrayView<'a>,
        mask: Option<&GrayView<'_>>,
        threads: NonZeroUsize,
    ) -> (Vec<Extremum>, Vec<Swept<'a>>) {
        let Options { first_octave, octaves, levels, max_features, limit, domain_sizes, .. } =
            self.options;
        let mut swept: Vec<Swept<'a>> = Vec::new();
        let mut extrema = Vec::new();
        let end = first_octave + octaves as i32;
        // The octave of the image itself and those above it, then the doubled one, if it can still
        // contribute.
        for octave in (0..end).chain((first_octave == -1).then_some(-1)) {
            if octave == -1 {
                sort(&mut extrema);
                if domain_sizes.is_some() {
                    distinct(&mut extrema, image.height);
                }
                if is_reached(limit, max_features, extrema.len()) {
                    break;
                }
            }
            let size = match octave {
                -1 => (2 * image.width, 2 * image.height),
                _ => (image.width >> octave, image.height >> octave),
            };
            if size.0.min(size.1) < MIN_SIDE {
                continue;
            }
            let source = match octave {
                -1 => Some(Source::Doubled(*image)),
                0 => Some(Source::Image(*image)),
                _ => None,
            };
            let plan = Plan::new(octave, size, levels, source.is_some().then_some(first_octave));
            let is_kept = 4 * levels * plan.level_len(size.1) <= self.max_level_bytes
                && octave >= first_octave;
            self.octaves.resize_with(self.octaves.len().max(swept.len() + 1), Octave::default);
            let (before, here) = self.octaves.split_at_mut(swept.len());
            let Octave { levels: kept, next } = &mut here[0];
            let mut found = sweep_all(SweepAll {
                plan: &plan,
                source: source.unwrap_or_else(|| halved(&plan, &before[before.len() - 1])),
                rows: 0..size.1,
                levels: is_kept.then_some(kept),
                next_octave: (0..end - 1).contains(&octave).then_some(next),
                thresholds: Some(Thresholds {
                    peak: self.options.peak_threshold,
                    edge: self.options.edge_threshold,
                }),
                scratches: &mut self.scratches,
                isa: self.isa,
                threads,
            });
            swept.push(Swept { plan, image: source, is_kept });
            if octave >= first_octave {
                if let Some(mask) = mask {
                    found.retain(|e| is_unmasked(mask, e));
                }
                sort(&mut found);
                // Two that were refined to the same sample are the same.
                found.dedup_by_key(|e| (e.level, e.iy, e.ix));
                extrema.append(&mut found);
            }
        }
        sort(&mut extrema);
        if domain_sizes.is_some() {
            distinct(&mut extrema, image.height);
        }
        let level = |e: &Extremum| (e.octave, e.level);
        let kept = match extrema.get(max_features) {
            Some(beyond) if limit == Limit::WholeLevels => {
                extrema.partition_point(|e| level(e) >= level(beyond))
            }
            _ => max_features.min(extrema.len()),
        };
        extrema.truncate(kept);
        (extrema, swept)
    }

    /// Orientations and descriptors, in the order of the extrema.
    fn measure(
        &mut self,
        extrema: &[Extremum],
        swept: &[Swept<'_>],
        threads: NonZeroUsize,
    ) -> Vec<Measured> {
        let mut all = vec![Measured::default(); extrema.len()];
        for (slot, Swept { plan, image, is_kept }) in swept.iter().enumerate() {
            // From top to bottom, so that windows that overlap are in the cache.
            let mut order: Vec<usize> =
                (0..extrema.len()).filter(|&i| extrema[i].octave == plan.octave).collect();
            order.sort_unstable_by_key(|&i| (extrema[i].iy, extrema[i].level, extrema[i].ix));
            let here: Vec<Extremum> = order.iter().map(|&i| extrema[i]).collect();
            let mut measured = Vec::with_capacity(here.len());
            if *is_kept {
                let levels: Vec<&[f32]> =
                    self.octaves[slot].levels.iter().map(AlignedBuf::as_slice).collect();
                measured = measure(&here, plan, &levels, 0, &self.options, self.isa, threads);
            } else {
                let row_bytes = 4 * plan.levels * plan.stride();
                let mut part = Vec::new();
                let mut rest = &here[..];
                while let [first, ..] = rest {
                    let end =
                        first.iy + (self.max_level_bytes / PARTS_PER_LIMIT / row_bytes).max(1);
                    let (group, others) = rest.split_at(rest.partition_point(|e| e.iy < end));
                    let reach = window_reach(group, &self.options);
                    let rows =
                        first.iy.saturating_sub(reach) / 2 * 2..(end + reach).min(plan.height);
                    sweep_all(SweepAll {
                        plan,
                        source: image.unwrap_or_else(|| halved(plan, &self.octaves[slot - 1])),
                        rows: rows.clone(),
                        levels: Some(&mut part),
                        next_octave: None,
                        thresholds: None,
                        scratches: &mut self.scratches,
                        isa: self.isa,
                        threads,
                    });
                    let levels: Vec<&[f32]> = part.iter().map(AlignedBuf::as_slice).collect();
                    measured.extend(measure(
                        group,
                        plan,
                        &levels,
                        rows.start,
                        &self.options,
                        self.isa,
                        threads,
                    ));
                    rest = others;
                }
            }
            for (i, measured) in order.into_iter().zip(measured) {
                all[i] = measured;
            }
        }
        all
    }
}

/// Level 0 of an octave that is made from the one before it.
fn halved<'a>(plan: &Plan, before: &'a Octave) -> Source<'a> {
    Source::Halved { data: before.next.as_slice(), stride: plan.stride() }
}

/// Sorts extrema by how much they are wanted: coarse levels first, and the strongest first in each.
fn sort(extrema: &mut [Extremum]) {
    extrema.sort_unstable_by(|a, b| {
        let coarsest = (b.octave, b.level).cmp(&(a.octave, a.level));
        coarsest
            .then_with(|| b.response.total_cmp(&a.response))
            .then_with(|| (a.iy, a.ix).cmp(&(b.iy, b.ix)))
    });
}

/// Whether finer levels can add nothing more to so many keypoints.
fn is_reached(limit: Limit, max_features: usize, keypoints: usize) -> bool {
    match limit {
        Limit::WholeLevels => keypoints > max_features,
        Limit::Exact => keypoints >= max_features,
    }
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
