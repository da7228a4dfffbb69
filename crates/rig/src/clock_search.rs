//! Initial time offset of a camera from the motion of two cameras: the offset at which their
//! relative pose is most constant.
//!
//! For an offset d, the relative pose p_i(d) of each image i of the second camera is taken with
//! respect to the interpolated trajectory of the first one. Translations c_i and rotations r_i of
//! p_i scatter about unknown extrinsics with unknown deviations. The cost is therefore the mean of
//! ln(1 + |c_i − c|²/σ_c²) + ln(1 + |r_i − r|²/σ_r²), the negative log-likelihood of a Cauchy
//! distribution, minimised over d and the centres c and r. σ_c and σ_r are proportional to the
//! smallest median deviations over all offsets. A median would not do as the cost, because most of
//! a drive goes straight at constant speed and is independent of the offset. Neither would a
//! deviation relative to the baseline, because a wrong offset lengthens the baseline.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::{golden_section, median};
use tiepoint_geometry::{Rigid3, so3};

use crate::robust_average::componentwise_median;
use crate::{RelativePose, Trajectory};

/// Largest offset of clocks that were set by hand, in seconds.
const MAX_OFFSET_S: f64 = 1.5;
/// Clocks count as set by hand if the drives overlap by this fraction of the shorter one.
const MIN_OVERLAP: f64 = 0.5;
/// Steps of the grid search per image interval.
const STEPS_PER_INTERVAL: f64 = 8.0;
/// Limit on the number of offsets. Longer ranges come from clocks without relation and long drives,
/// or from photos that are not a drive.
const MAX_CANDIDATES: usize = 50_000;
/// Limit on the number of images in the search.
const MAX_IMAGES: usize = 250;
/// An offset is considered if at least this fraction of the largest number of images over all
/// offsets can be compared, and at least this number of images.
const MIN_SHARE: f64 = 0.6;
const MIN_IMAGES: usize = 6;
/// Scale of the Cauchy loss in median deviations.
const LOSS_SCALE: f64 = 1.5;
const REWEIGHTINGS: usize = 8;
/// Golden-section steps, which shrink the interval from two grid steps to a ten-thousandth of one.
const GOLDEN_STEPS: usize = 24;

/// An estimated time offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffsetEstimate {
    /// Offset to add to the second camera's times to get the first one's, in seconds.
    pub offset_s: f64,
    /// Increase of the log-likelihood over `offset_s` = 0, as if images were independent; infinite
    /// if too few images can be compared without an offset.
    pub gain: f64,
    /// The same, infinite only if fewer than six images can be compared without an offset.
    pub gain_at_any_overlap: f64,
    /// The same over the best offset that is more than an interval between images away; infinite
    /// if there is none, and zero at an end of the offsets at which enough images can be compared.
    /// Small where the cameras move in the same way all the time, as around a turntable.
    pub gain_apart: f64,
    /// Standard deviation from the curvature of the log-likelihood, in seconds, as if images were
    /// independent.
    pub sd_s: f64,
}

impl OffsetEstimate {
    /// Least gain that counts. It is far above the level of chance, because errors of neighbouring
    /// poses are correlated. Half and double were not tried for numbers of frames, and for clocks
    /// more than 1.5 s apart.
    pub const MIN_GAIN: f64 = 10.0;
}

/// Searches the time offset of the camera `other`, given as pairs of time in seconds and
/// `cam_from_world`, to the reference camera. The range is ±1.5 s if the drives overlap on their
/// clocks, unless the motion tells one offset beyond; else all offsets at which half of the shorter
/// drive overlaps. `None` if too few images can be compared.
pub fn find_offset(reference: &Trajectory, other: &[(f64, Rigid3)]) -> Option<OffsetEstimate> {
    let (first, last) = (*reference.times_s().first()?, *reference.times_s().last()?);
    let (other_first, other_last) = (other.first()?.0, other.last()?.0);
    let shorter_s = (last - first).min(other_last - other_first);
    let overlap_s = last.min(other_last) - first.max(other_first);
    let any = find_unrelated_offset(reference, other);
    if overlap_s <= MIN_OVERLAP * shorter_s {
        return any;
    }
    let is_beyond = |found: &OffsetEstimate| {
        found.offset_s.abs() > MAX_OFFSET_S && found.gain_apart >= OffsetEstimate::MIN_GAIN
    };
    any.filter(is_beyond).or_else(|| find_within(reference, other, [-MAX_OFFSET_S, MAX_OFFSET_S]))
}

/// [`find_offset`] for clocks that have nothing in common: among all offsets at which half of the
/// shorter drive overlaps.
pub fn find_unrelated_offset(
    reference: &Trajectory,
    other: &[(f64, Rigid3)],
) -> Option<OffsetEstimate> {
    let (first, last) = (*reference.times_s().first()?, *reference.times_s().last()?);
    let (other_first, other_last) = (other.first()?.0, other.last()?.0);
    let half_s = 0.5 * (last - first).min(other_last - other_first);
    find_within(reference, other, [first - other_last + half_s, last - other_first - half_s])
}

fn find_within(
    reference: &Trajectory,
    other: &[(f64, Rigid3)],
    [from_s, to_s]: [f64; 2],
) -> Option<OffsetEstimate> {
    let step_s = reference.interval_s() / STEPS_PER_INTERVAL;
    if !(step_s > 0.0 && step_s.is_finite()) {
        return None;
    }
    let every = other.len().div_ceil(MAX_IMAGES);
    let other: Vec<(f64, Rigid3)> = other.iter().step_by(every).copied().collect();
    // Multiples of the step, so that zero is among them.
    let ends = [(from_s / step_s).ceil(), (to_s / step_s).floor()];
    if ends[1] - ends[0] >= MAX_CANDIDATES as f64 {
        return None;
    }
    let indices = ends[0] as i64..=ends[1] as i64;
    let offsets: Vec<f64> = indices.map(|index| index as f64 * step_s).collect();
    let candidates: Vec<(usize, (f64, f64))> = offsets
        .iter()
        .map(|offset_s| Samples::at(reference, &other, *offset_s))
        .map(|samples| (samples.len(), samples.medians()))
        .collect();
    let max_images_compared = candidates.iter().map(|(count, _)| *count).max()?;
    let min_images = ((MIN_SHARE * max_images_compared as f64) as usize).max(MIN_IMAGES);
    let scales = candidates
        .iter()
        .filter(|(count, _)| *count >= min_images)
        .map(|(_, medians)| *medians)
        .reduce(|a, b| (a.0.min(b.0), a.1.min(b.1)))?;
    let scales =
        (LOSS_SCALE * scales.0.max(MIN_DEVIATION), LOSS_SCALE * scales.1.max(MIN_DEVIATION));
    let cost = |offset_s: f64| {
        let samples = Samples::at(reference, &other, offset_s);
        if samples.len() >= min_images { samples.cost(scales) } else { f64::INFINITY }
    };
    let grid: Vec<(f64, f64)> =
        offsets.iter().map(|offset_s| (cost(*offset_s), *offset_s)).collect();
    let (_, coarse_s) = *grid.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let offset_s = golden_section(cost, coarse_s - step_s, coarse_s + step_s, GOLDEN_STEPS);
    let (best, count) = (cost(offset_s), other.len() as f64);
    // Curvature over a tenth of a step, where the loss is smooth.
    let h = 0.1 * step_s;
    let curvature = count * (cost(offset_s - h) - 2.0 * best + cost(offset_s + h)) / (h * h);
    let sd_s = if curvature > 0.0 { (1.0 / curvature).sqrt() } else { f64::INFINITY };
    // At an end of the offsets that compare enough images, the right one may be beyond it.
    let is_inside = [-step_s, step_s].iter().all(|step_s| cost(coarse_s + step_s).is_finite());
    let is_apart = |(_, other_s): &&(f64, f64)| (other_s - offset_s).abs() > reference.interval_s();
    let apart = grid.iter().filter(is_apart).map(|(cost, _)| *cost).fold(f64::INFINITY, f64::min);
    let at_zero = Samples::at(reference, &other, 0.0);
    let gain_over_zero = |min_images: usize| {
        let is_comparable = at_zero.len() >= min_images;
        count * (if is_comparable { at_zero.cost(scales) } else { f64::INFINITY } - best)
    };
    Some(OffsetEstimate {
        offset_s,
        gain: gain_over_zero(min_images),
        // Where few images overlap, zero is no candidate, but it may be right.
        gain_at_any_overlap: gain_over_zero(MIN_IMAGES),
        gain_apart: if is_inside { count * (apart - best) } else { 0.0 },
        sd_s,
    })
}

/// Deviations below this are rounding.
const MIN_DEVIATION: f64 = 1e-12;

/// The relative poses at one offset.
struct Samples {
    centres: Vec<Vector3<f64>>,
    /// Rotations, as tangents at one of them.
    rotations: Vec<Vector3<f64>>,
}

impl Samples {
    fn at(reference: &Trajectory, other: &[(f64, Rigid3)], offset_s: f64) -> Self {
        let relative = |(time_s, pose): &(f64, Rigid3)| {
            reference.at(time_s + offset_s).map(|reference| RelativePose::between(&reference, pose))
        };
        let poses: Vec<RelativePose> = other.iter().filter_map(relative).collect();
        let back = poses.get(poses.len() / 2).map(|middle| so3::exp(&middle.axis_angle).inverse());
        let rotation = |pose: &RelativePose| Some(so3::log(&(so3::exp(&pose.axis_angle) * back?)));
        Self {
            centres: poses.iter().map(|pose| pose.translation).collect(),
            rotations: poses.iter().filter_map(rotation).collect(),
        }
    }

    fn len(&self) -> usize {
        self.centres.len()
    }

    /// Median deviations of the centres (model units) and of the rotations (radians).
    fn medians(&self) -> (f64, f64) {
        (median_distance(&self.centres), median_distance(&self.rotations))
    }

    fn cost(&self, scales: (f64, f64)) -> f64 {
        cauchy(&self.centres, scales.0) + cauchy(&self.rotations, scales.1)
    }
}

/// Median distance of the values from their median.
fn median_distance(values: &[Vector3<f64>]) -> f64 {
    let centre = componentwise_median(values);
    let mut distances: Vec<f64> = values.iter().map(|value| (value - centre).norm()).collect();
    median(&mut distances).unwrap_or(f64::INFINITY)
}

/// Mean Cauchy loss about the centre that minimises it.
fn cauchy(values: &[Vector3<f64>], scale: f64) -> f64 {
    let relative = |value: &Vector3<f64>, centre: &Vector3<f64>| {
        (value - centre).norm_squared() / (scale * scale)
    };
    let mut centre = componentwise_median(values);
    for _ in 0..REWEIGHTINGS {
        let weights: Vec<f64> =
            values.iter().map(|value| 1.0 / (1.0 + relative(value, &centre))).collect();
        let sum: Vector3<f64> =
            values.iter().zip(&weights).map(|(value, weight)| value * *weight).sum();
        centre = sum / weights.iter().sum::<f64>();
    }
    values.iter().map(|value| relative(value, &centre).ln_1p()).sum::<f64>() / values.len() as f64
}
