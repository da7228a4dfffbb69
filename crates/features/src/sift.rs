//! SIFT: detection in octaves, selection of extrema, orientations and descriptors.

use std::f32::consts::{PI, TAU};
use std::num::NonZeroUsize;

use crate::bands::{OctaveJob, compute_octave};
use crate::buffer::AlignedBuf;
use crate::describe::{Description, describe_extrema, window_rows};
use crate::duplicates::remove_duplicates;
use crate::extrema::{Extremum, Thresholds};
use crate::octave::{OctavePlan, Scratch};
use crate::options::Limit;
use crate::simd::Isa;
use crate::source::Source;
use crate::{Error, Features, GrayView, Keypoint, Options};

/// Minimum width and height of an octave: all extrema of a smaller octave are at its border.
const MIN_SIDE: usize = 8;
/// Maximum memory of the stored levels of an octave. Larger octaves (the doubled octave of images
/// above 11 megapixels) are computed a second time, in parts, for orientations and descriptors.
const MAX_LEVEL_BYTES: usize = 512 << 20;
/// The memory of such a part is the maximum divided by this.
const PARTS_PER_LIMIT: usize = 4;
/// Pixel coordinate of the centre of the first pixel.
const PIXEL_CENTRE: f32 = 0.5;

/// Extracts the features of an image on the calling thread. For several images, [`Sift`] reuses
/// memory.
///
/// # Errors
/// An option is out of its range, or the view does not fit its slice.
pub fn extract(image: &GrayView<'_>, options: &Options) -> Result<Features, Error> {
    Sift::new(*options)?.extract(image, None)
}

/// A SIFT extractor that reuses memory between images: 12 bytes per pixel of the finest computed
/// octave, at most 512 MiB per octave. Use one extractor per thread.
pub struct Sift {
    options: Options,
    pub(crate) isa: Isa,
    pub(crate) max_level_bytes: usize,
    octaves: Vec<Octave>,
    scratches: Vec<Scratch>,
}

/// The stored data of an octave.
#[derive(Default)]
struct Octave {
    /// Levels 1 … S; empty if they exceed the maximum memory.
    levels: Vec<AlignedBuf>,
    /// Level 0 of the next octave.
    next: AlignedBuf,
}

/// An octave of the current image in which extrema were detected.
struct DetectedOctave<'a> {
    plan: OctavePlan,
    /// The image that the octave is computed from; `None` if it is computed from the previous
    /// octave.
    image: Option<Source<'a>>,
    /// Whether its levels are stored.
    is_stored: bool,
}

impl Sift {
    /// An extractor with these options.
    ///
    /// # Errors
    /// [`Error::Option`] if an option is out of its range.
    pub fn new(options: Options) -> Result<Self, Error> {
        options.validate()?;
        let (octaves, scratches) = Default::default();
        Ok(Sift { options, isa: Isa::best(), max_level_bytes: MAX_LEVEL_BYTES, octaves, scratches })
    }

    /// Extracts the features of an image on the calling thread. For many images, run one extractor
    /// per thread. Keypoints at pixels where the mask is zero are removed.
    ///
    /// # Errors
    /// The image or the mask does not fit its slice, or their sizes differ.
    pub fn extract(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Error> {
        self.extract_with(image, mask, NonZeroUsize::MIN)
    }

    /// Extracts the features of one large image on all threads of rayon's current pool. The result
    /// is the same as that of [`extract`](Self::extract).
    ///
    /// # Errors
    /// As [`extract`](Self::extract).
    pub fn extract_parallel(
        &mut self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Error> {
        let threads = NonZeroUsize::new(rayon::current_num_threads()).unwrap_or(NonZeroUsize::MIN);
        self.extract_with(image, mask, threads)
    }

    /// Extracts features on a number of threads.
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
        let (extrema, octaves) = self.detect(image, mask, threads);
        let descriptions = self.describe(&extrema, &octaves, threads);
        let max_features = match self.options.limit {
            Limit::WholeLevels => usize::MAX,
            Limit::Exact => self.options.max_features,
        };
        let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
        for (extremum, description) in extrema.iter().zip(&descriptions) {
            let oriented = description.orientations.as_slice().iter().zip(&description.descriptors);
            for (&angle, &descriptor) in oriented.take(max_features - keypoints.len()) {
                keypoints.push(keypoint(extremum, angle));
                descriptors.push(descriptor);
            }
        }
        Ok(Features { keypoints, descriptors: descriptors.into() })
    }

    /// Detects and selects extrema. Returns them from coarse to fine, and the computed octaves, of
    /// which the doubled octave is the last.
    fn detect<'a>(
        &mut self,
        image: &GrayView<'a>,
        mask: Option<&GrayView<'_>>,
        threads: NonZeroUsize,
    ) -> (Vec<Extremum>, Vec<DetectedOctave<'a>>) {
        let Options { first_octave, octaves, levels, max_features, limit, domain_sizes, .. } =
            self.options;
        let mut detected: Vec<DetectedOctave<'a>> = Vec::new();
        let mut extrema = Vec::new();
        let end = first_octave + octaves as i32;
        // Octave 0 and coarser octaves come first, then the doubled octave unless the limit is
        // reached.
        for octave in (0..end).chain((first_octave == -1).then_some(-1)) {
            if octave == -1 {
                sort_coarse_to_fine(&mut extrema);
                if domain_sizes.is_some() {
                    remove_duplicates(&mut extrema, image.height);
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
            let plan =
                OctavePlan::new(octave, size, levels, source.is_some().then_some(first_octave));
            let is_stored = 4 * levels * plan.level_len(size.1) <= self.max_level_bytes
                && octave >= first_octave;
            self.octaves.resize_with(self.octaves.len().max(detected.len() + 1), Octave::default);
            let (before, here) = self.octaves.split_at_mut(detected.len());
            let Octave { levels: kept, next } = &mut here[0];
            let mut found = compute_octave(OctaveJob {
                plan: &plan,
                source: source.unwrap_or_else(|| halved(&plan, &before[before.len() - 1])),
                rows: 0..size.1,
                levels: is_stored.then_some(kept),
                next_octave: (0..end - 1).contains(&octave).then_some(next),
                thresholds: Some(Thresholds {
                    peak: self.options.peak_threshold,
                    edge: self.options.edge_threshold,
                }),
                scratches: &mut self.scratches,
                isa: self.isa,
                threads,
            });
            detected.push(DetectedOctave { plan, image: source, is_stored });
            if octave >= first_octave {
                if let Some(mask) = mask {
                    found.retain(|e| is_unmasked(mask, e));
                }
                sort_coarse_to_fine(&mut found);
                // Extrema that were refined to the same sample are duplicates.
                found.dedup_by_key(|e| (e.level, e.iy, e.ix));
                extrema.append(&mut found);
            }
        }
        sort_coarse_to_fine(&mut extrema);
        if domain_sizes.is_some() {
            remove_duplicates(&mut extrema, image.height);
        }
        let level = |e: &Extremum| (e.octave, e.level);
        let kept = match extrema.get(max_features) {
            Some(beyond) if limit == Limit::WholeLevels => {
                extrema.partition_point(|e| level(e) >= level(beyond))
            }
            _ => max_features.min(extrema.len()),
        };
        extrema.truncate(kept);
        (extrema, detected)
    }

    /// Computes orientations and descriptors, in the order of the extrema.
    fn describe(
        &mut self,
        extrema: &[Extremum],
        detected: &[DetectedOctave<'_>],
        threads: NonZeroUsize,
    ) -> Vec<Description> {
        let mut all = vec![Description::default(); extrema.len()];
        for (slot, DetectedOctave { plan, image, is_stored }) in detected.iter().enumerate() {
            // From top to bottom, so that overlapping windows are in the cache.
            let mut order: Vec<usize> =
                (0..extrema.len()).filter(|&i| extrema[i].octave == plan.octave).collect();
            order.sort_unstable_by_key(|&i| (extrema[i].iy, extrema[i].level, extrema[i].ix));
            let here: Vec<Extremum> = order.iter().map(|&i| extrema[i]).collect();
            let mut described = Vec::with_capacity(here.len());
            if *is_stored {
                let levels: Vec<&[f32]> =
                    self.octaves[slot].levels.iter().map(AlignedBuf::as_slice).collect();
                described =
                    describe_extrema(&here, plan, &levels, 0, &self.options, self.isa, threads);
            } else {
                let row_bytes = 4 * plan.levels * plan.stride();
                let mut part = Vec::new();
                let mut rest = &here[..];
                while let [first, ..] = rest {
                    let end =
                        first.iy + (self.max_level_bytes / PARTS_PER_LIMIT / row_bytes).max(1);
                    let (group, others) = rest.split_at(rest.partition_point(|e| e.iy < end));
                    let reach = window_rows(group, &self.options);
                    let rows =
                        first.iy.saturating_sub(reach) / 2 * 2..(end + reach).min(plan.height);
                    compute_octave(OctaveJob {
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
                    described.extend(describe_extrema(
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
            for (i, description) in order.into_iter().zip(described) {
                all[i] = description;
            }
        }
        all
    }
}

/// The source of an octave that is computed from the previous octave.
fn halved<'a>(plan: &OctavePlan, before: &'a Octave) -> Source<'a> {
    Source::Halved { data: before.next.as_slice(), stride: plan.stride() }
}

/// Sorts extrema from coarse to fine levels, and by descending response within a level.
fn sort_coarse_to_fine(extrema: &mut [Extremum]) {
    extrema.sort_unstable_by(|a, b| {
        let coarsest = (b.octave, b.level).cmp(&(a.octave, a.level));
        coarsest
            .then_with(|| b.response.total_cmp(&a.response))
            .then_with(|| (a.iy, a.ix).cmp(&(b.iy, b.ix)))
    });
}

/// Whether the limit is reached, so that finer levels cannot contribute keypoints.
fn is_reached(limit: Limit, max_features: usize, keypoints: usize) -> bool {
    match limit {
        Limit::WholeLevels => keypoints > max_features,
        Limit::Exact => keypoints >= max_features,
    }
}

/// Whether the mask is non-zero at the pixel of an extremum.
fn is_unmasked(mask: &GrayView<'_>, extremum: &Extremum) -> bool {
    let Keypoint { x, y, .. } = keypoint(extremum, 0.0);
    let (column, row) = ((x as usize).min(mask.width - 1), (y as usize).min(mask.height - 1));
    mask.row(row)[column] != 0
}

/// The keypoint of an extremum: converts samples of an octave to pixels of the image.
fn keypoint(extremum: &Extremum, angle: f32) -> Keypoint {
    let pixels = 2f32.powi(extremum.octave);
    Keypoint {
        x: extremum.x * pixels + PIXEL_CENTRE,
        y: extremum.y * pixels + PIXEL_CENTRE,
        scale: extremum.sigma * pixels,
        orientation: if angle > PI { angle - TAU } else { angle },
    }
}
