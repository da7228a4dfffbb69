//! Whether models that were built with positions are better: held-out positions tell.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Loss, Sim3};
use tiepoint_scene::{ImageId, Reconstruction};

use super::measured::MeasuredPosition;
use crate::student_t::student_t;

/// Positions are held out in blocks of consecutive ones, since their errors are alike over seconds:
/// every fifth of at most this many blocks.
const NUM_BLOCKS: usize = 50;
const HELD_OUT: usize = 5;
/// Fewest blocks with held-out positions: with a deviation of two, any difference is no chance.
const MIN_BLOCKS: usize = 5;
/// Smallest t-statistic of the differences of the blocks that is no chance.
const MIN_T: f64 = 2.0;
/// Least decrease of the squared distance, as a part of it: positions that contradict the images
/// may give a small one by chance of many.
const MIN_GAIN: f64 = 0.1;
/// Largest increase of the mean reprojection error, and least share of images, with positions.
const MAX_ERROR: f64 = 1.02;
const MIN_IMAGES: f64 = 0.98;
/// Distances count up to a few deviations, so that gross errors of positions do not decide.
const LOSS: Loss = Loss::GemanMcClure(3.0);

/// Comparison of models without and with a term of positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Median distance of the cameras from the held-out positions, in metres: without, and with.
    pub median_m: [f64; 2],
    /// By which part the bounded squared distance is smaller with the term.
    pub gain: f64,
    /// By how many of its standard deviations it is smaller.
    pub t: f64,
    /// Number of images with a pose.
    pub images: [usize; 2],
    /// Number of images in the largest model without, and of those that the largest one with has.
    pub kept: [usize; 2],
    /// Mean reprojection errors, in pixels.
    pub error_px: [f64; 2],
}

impl Comparison {
    /// Whether the models with the term are better.
    pub fn is_better(&self) -> bool {
        self.why_not_better().is_none()
    }

    /// Why the models with the term are no better, as a relative clause; `None` if they are.
    pub fn why_not_better(&self) -> Option<String> {
        let loses = |[before, after]: [usize; 2]| (after as f64) < MIN_IMAGES * before as f64;
        // No number is none.
        let is_at_least = |value: f64, least: f64| value >= least;
        if !is_at_least(self.gain, MIN_GAIN) {
            return Some(format!("which is not better by {:.0} %", 100.0 * MIN_GAIN));
        }
        if !is_at_least(self.t, MIN_T) {
            return Some("which may be chance".to_owned());
        }
        for [before, after] in [self.images, self.kept] {
            if loses([before, after]) {
                return Some(format!("which would lose {} of {before} images", before - after));
            }
        }
        let [before, after] = self.error_px;
        (!is_at_least(MAX_ERROR * before, after)).then(|| {
            format!("which would raise the reprojection error from {before:.3} px to {after:.3} px")
        })
    }
}

/// The block of a position, and whether it is held out.
fn block(index: usize, count: usize) -> (usize, bool) {
    let block = index * NUM_BLOCKS.min(count) / count;
    (block, block % HELD_OUT == HELD_OUT / 2)
}

/// The positions that take part, and those that are held out to tell whether they help. They come
/// in the order in which they were measured.
pub fn held_out(positions: &[MeasuredPosition]) -> (Vec<MeasuredPosition>, Vec<MeasuredPosition>) {
    let indexed = positions.iter().copied().enumerate();
    let (out, used): (Vec<_>, Vec<_>) =
        indexed.partition(|(index, _)| block(*index, positions.len()).1);
    let plain = |list: Vec<(usize, MeasuredPosition)>| list.into_iter().map(|(_, p)| p).collect();
    (plain(used), plain(out))
}

/// Compares models by the held-out ones of all `positions`, in the order of [`held_out`], in the
/// images that have a pose in both. Those without a height do not count.
/// `sigmas_m` are the deviations about the first model, which count where stated ones are smaller:
/// wrong positions may state any. Each model comes with its similarity to the frame of the
/// positions. `None` with fewer than five blocks of
/// positions.
pub fn compare(
    without: &[(&Reconstruction, Sim3)],
    with: &[(&Reconstruction, Sim3)],
    positions: &[MeasuredPosition],
    sigmas_m: [f64; 2],
) -> Option<Comparison> {
    let mut blocks: Vec<(usize, f64, usize)> = Vec::new();
    let mut distances: [Vec<f64>; 2] = Default::default();
    let (mut total, mut gained) = (0.0, 0.0);
    for (index, position) in positions.iter().enumerate() {
        let (block, true) = block(index, positions.len()) else { continue };
        if !position.has_height {
            continue;
        }
        let both = [without, with].map(|models| centre(models, position.image));
        let [Some(before), Some(after)] = both else { continue };
        let stated = position.sigmas_m.unwrap_or(sigmas_m);
        let [horizontal, vertical] = [0, 1].map(|axis| stated[axis].max(sigmas_m[axis]));
        let sigmas = Vector3::new(horizontal, horizontal, vertical);
        let [before, after] = [before, after].map(|centre| centre - position.xyz);
        let cost = |r: &Vector3<f64>| LOSS.evaluate(r.component_div(&sigmas).norm_squared())[0];
        let gain = cost(&before) - cost(&after);
        total += cost(&before);
        gained += gain;
        distances[0].push(before.norm());
        distances[1].push(after.norm());
        match blocks.last_mut() {
            Some((last, sum, count)) if *last == block => {
                *sum += gain;
                *count += 1;
            }
            _ => blocks.push((block, gain, 1)),
        }
    }
    let gains: Vec<f64> = blocks.iter().map(|(_, sum, count)| sum / *count as f64).collect();
    if gains.len() < MIN_BLOCKS {
        return None;
    }
    let images = |models: &[(&Reconstruction, Sim3)]| {
        models.iter().map(|(model, _)| model.num_registered()).sum()
    };
    let error_px = |models: &[(&Reconstruction, Sim3)]| {
        models.first().map_or(0.0, |(model, _)| model.mean_reprojection_error_px())
    };
    let median = |distances: &mut Vec<f64>| {
        tiepoint_geometry::numeric::median(distances).unwrap_or(f64::INFINITY)
    };
    Some(Comparison {
        median_m: distances.each_mut().map(median),
        gain: gained / total.max(f64::MIN_POSITIVE),
        t: student_t(&gains),
        images: [images(without), images(with)],
        kept: kept(without, with),
        error_px: [error_px(without), error_px(with)],
    })
}

/// Number of images of the first of these models, and of those that the first one `with` has.
fn kept(without: &[(&Reconstruction, Sim3)], with: &[(&Reconstruction, Sim3)]) -> [usize; 2] {
    let [before, after] = [without, with].map(|models| models.first().map(|(model, _)| *model));
    let has = |id: ImageId| after.is_some_and(|after| after.image(id).cam_from_world().is_some());
    let images = || before.into_iter().flat_map(|before| before.registered());
    [images().count(), images().filter(|(id, ..)| has(*id)).count()]
}

/// The centre of an image in the first model that has its pose, in the frame of the positions.
fn centre(models: &[(&Reconstruction, Sim3)], image: ImageId) -> Option<Vector3<f64>> {
    models.iter().find_map(|(model, similarity)| {
        Some(*similarity * model.image(image).cam_from_world()?.origin_in_a())
    })
}
