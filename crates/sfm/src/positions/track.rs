//! Positions along the time of a clock of their own: its offset from the clock of the pictures, and
//! the lever arm from the camera to the antenna.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::{AddAssign, Range};

use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Rigid3, Sim3, so3};
use tiepoint_rig::{Trajectory, interval_s};
use tiepoint_scene::{ImageId, Reconstruction};

use super::alignment::{
    LOSS, MIN_POSITIONS, Pair, deviations, first_similarity, scale_of_residuals, updated,
};
use super::measured::MeasuredPosition;

/// Steps of the search for the offset, in seconds: a step at least this, since turns and stops take
/// some seconds, and at most this, as far as Gauss-Newton comes on a turn.
const STEPS_S: Range<f64> = 0.2..1.0;
/// Largest number of steps.
const MAX_STEPS: f64 = 1e5;
/// Positions, and samples of three of them, in each step: with two fifths of all wrong, each of 40
/// samples contains a wrong one with a probability of 0.784⁴⁰ = 6e-5.
const MAX_IN_STEP: usize = 100;
const SAMPLES_IN_STEP: usize = 40;
/// Minima of the search that are refined.
const MAX_MINIMA: usize = 5;
/// Another offset whose residuals are not larger by this factor may be the right one.
const MIN_WORSE: f64 = 1.2;
/// Largest standard deviation of an offset that is of use, with a known arm.
const MAX_OFFSET_SD_S: f64 = 0.5;
/// Standard deviation of the lever arm along each axis before the motion tells it: what arms of
/// cars and drones are. Without it the arm would have to be told by the motion, or be left out, and
/// the offset would be too certain: at a constant speed, an antenna behind the camera is a later
/// clock.
const ARM_SD_M: f64 = 1.0;
/// Consecutive positions have similar errors: deviations are those of sums over this many blocks of
/// time (a sandwich estimator, Liang & Zeger 1986).
const NUM_BLOCKS: usize = 30;

/// A measured position with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPosition {
    /// When it was measured, in seconds of its own clock.
    pub time_s: f64,
    /// The place of the antenna, in a metric frame with z up.
    pub xyz: Vector3<f64>,
    /// Whether its height is measured; else z is arbitrary.
    pub has_height: bool,
    /// Standard deviations along x and y, and along z, in metres; `None` if they are not known.
    pub sigmas_m: Option<[f64; 2]>,
}

/// How positions with a clock of their own lie to the pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackAlignment {
    /// The time on the clock of the positions minus that on the clock of the pictures.
    pub offset_s: f64,
    /// Its standard deviation.
    pub offset_sd_s: f64,
    /// The antenna in the axes of the camera, in metres; 0 along an axis of which the motion tells
    /// nothing.
    pub arm_m: Vector3<f64>,
    /// Standard deviations of the arm along the axes; a metre where the motion tells nothing, which
    /// is an assumption.
    pub arm_sds_m: Vector3<f64>,
    /// The positions of the camera in images, in the order of time: each is measured in the image
    /// nearest to it in time, and moved there along the path of the model.
    pub positions: Vec<MeasuredPosition>,
}

/// Why the clock offset between positions and pictures is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrackMisfit {
    /// Too few images of a stream have times.
    NoTimes,
    /// The clocks have no times in common.
    NoOverlap {
        /// The first time of the positions minus the first one of the pictures.
        apart_s: f64,
    },
    /// Whatever the offset, too few positions are from the time of the pictures.
    TooFew {
        /// Their number.
        during: usize,
    },
    /// The drive does not determine it.
    NoOffset {
        /// Its standard deviation.
        sd_s: f64,
    },
    /// Two fit alike, as of a way that was driven twice.
    TwoOffsets([f64; 2]),
}

impl fmt::Display for TrackMisfit {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::NoTimes => f.write_str("too few photos with a pose have a time"),
            Self::NoOverlap { apart_s } => write!(
                f,
                "they are from another time: they begin {:.1} h {} the photos",
                apart_s.abs() / 3600.0,
                if *apart_s < 0.0 { "before" } else { "after" }
            ),
            Self::TooFew { during } => write!(
                f,
                "{during} of them are from the time of the photos, and at least {MIN_POSITIONS} \
                 are needed"
            ),
            Self::NoOffset { sd_s } => write!(
                f,
                "the drive does not determine the offset between their clock and that of the \
                 photos (to {:.1} s), as turns and changes of speed would",
                sd_s.min(9999.0)
            ),
            Self::TwoOffsets([one, other]) => write!(
                f,
                "two offsets between their clock and that of the photos fit alike, {one:.1} s and \
                 {other:.1} s, as on a way that was driven twice"
            ),
        }
    }
}

/// The clock offset and the lever arm, as far as turns determine it, of a track of positions of
/// the body that has most images with a pose and a time. Of the offsets in `offsets_s`, that is
/// found whose similarity leaves the smallest residuals beside the length of the path. Then
/// similarity, offset and arm are refined together.
///
/// # Errors
///
/// The model does not determine the offset.
pub fn align_track(
    model: &Reconstruction,
    track: &[TimedPosition],
    offsets_s: Range<f64>,
    seed: u64,
) -> Result<TrackAlignment, TrackMisfit> {
    let images = images_of_body(model);
    let drive = Drive::new(&images, track);
    if images.len() < MIN_POSITIONS || drive.trajectory.interval_s() == 0.0 {
        return Err(TrackMisfit::NoTimes);
    }
    let minima = drive.search(&offsets_s, seed)?;
    let mut fits: Vec<(f64, Fit)> = Vec::new();
    for start in minima {
        let Some(fit) = drive.refined(start, false) else { continue };
        let pairs = drive.pairs(&fit, 1);
        let error = error(&pairs, &fit.similarity);
        if offsets_s.contains(&fit.offset_s) && error.is_finite() {
            fits.push((error, fit));
        }
    }
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((least, best)) = fits.first().cloned() else {
        return Err(TrackMisfit::NoOffset { sd_s: f64::INFINITY });
    };
    // No number is within no bound.
    let is_certain = |fit: &Fit| fit.sds[OFFSET] <= MAX_OFFSET_SD_S;
    if !is_certain(&best) {
        return Err(TrackMisfit::NoOffset { sd_s: best.sds[OFFSET] });
    }
    let is_other = |fit: &Fit| (fit.offset_s - best.offset_s).abs() > 2.0 * STEPS_S.end;
    if let Some((_, other)) =
        fits.iter().find(|(error, fit)| is_other(fit) && *error < MIN_WORSE * least)
    {
        return Err(TrackMisfit::TwoOffsets([best.offset_s, other.offset_s]));
    }
    let fit = drive.refined(best.clone(), true).unwrap_or(best);
    Ok(TrackAlignment {
        offset_s: fit.offset_s,
        offset_sd_s: fit.sds[OFFSET],
        arm_m: fit.arm_m,
        arm_sds_m: fit.sds.fixed_rows::<3>(ARM).into_owned(),
        positions: drive.in_images(&fit, &images),
    })
}

/// An image with its time and its pose.
type Timed = (f64, ImageId, Rigid3);

/// The images of the stream that has most with a pose and a time, in order of time.
fn images_of_body(model: &Reconstruction) -> Vec<Timed> {
    let mut of_streams: BTreeMap<&str, Vec<Timed>> = BTreeMap::new();
    for (id, image, pose) in model.registered() {
        if let Some(time_s) = image.time_s {
            of_streams.entry(&*image.stream).or_default().push((time_s, id, *pose));
        }
    }
    // The first one of several.
    let mut images = Vec::new();
    for found in of_streams.into_values() {
        if found.len() > images.len() {
            images = found;
        }
    }
    images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    images
}

/// Parameters of a fit: translation, rotation, logarithm of the scale, offset, arm.
const NUM_PARAMETERS: usize = 11;
const OFFSET: usize = 7;
const ARM: usize = 8;

/// The similarity, the offset and the arm, with the deviations of all parameters.
#[derive(Clone, Debug)]
struct Fit {
    similarity: Sim3,
    offset_s: f64,
    arm_m: Vector3<f64>,
    has_arm: bool,
    sds: SVector<f64, NUM_PARAMETERS>,
}

impl Fit {
    fn start(offset_s: f64, similarity: Sim3) -> Self {
        Self {
            similarity,
            offset_s,
            arm_m: Vector3::zeros(),
            has_arm: false,
            sds: SVector::repeat(f64::INFINITY),
        }
    }
}

/// The path of a camera and a track of positions.
struct Drive<'a> {
    trajectory: Trajectory,
    track: &'a [TimedPosition],
}

impl<'a> Drive<'a> {
    fn new(images: &[Timed], track: &'a [TimedPosition]) -> Self {
        let trajectory = Trajectory::new(images.iter().map(|(time_s, _, pose)| (*time_s, *pose)));
        Self { trajectory, track }
    }

    /// The positions during the images for an offset.
    fn during(&self, offset_s: f64) -> &'a [TimedPosition] {
        let times_s = self.trajectory.times_s();
        let (Some(first_s), Some(last_s)) = (times_s.first(), times_s.last()) else { return &[] };
        let before = |time_s: f64| {
            self.track.partition_point(|position| position.time_s < time_s + offset_s)
        };
        &self.track[before(*first_s)..before(*last_s).max(before(*first_s))]
    }

    /// The places of the antenna in the model, at the times of each `every` positions.
    fn pairs(&self, fit: &Fit, every: usize) -> Vec<Pair> {
        let of_position = |position: &TimedPosition| self.pair(fit, position);
        self.during(fit.offset_s).iter().step_by(every).filter_map(of_position).collect()
    }

    fn pair(&self, fit: &Fit, position: &TimedPosition) -> Option<Pair> {
        let pose = self.trajectory.at(position.time_s - fit.offset_s)?;
        let antenna = pose.rotation.inverse() * fit.arm_m / fit.similarity.scale;
        let found = pose.origin_in_a() + antenna;
        let TimedPosition { xyz, has_height, sigmas_m, .. } = *position;
        Some(Pair::new(&pose, found, xyz, has_height, sigmas_m))
    }

    /// The minima of the residuals over the offsets, with their similarities, the smallest first.
    fn search(&self, offsets_s: &Range<f64>, seed: u64) -> Result<Vec<Fit>, TrackMisfit> {
        let times_s = self.trajectory.times_s();
        let ends = (times_s.first(), times_s.last(), self.track.first(), self.track.last());
        let (Some(first_s), Some(last_s), Some(from), Some(to)) = ends else {
            return Err(TrackMisfit::NoTimes);
        };
        let apart_s = from.time_s - first_s;
        let low_s = (from.time_s - last_s).max(offsets_s.start);
        let high_s = (to.time_s - first_s).min(offsets_s.end);
        if low_s >= high_s {
            return Err(TrackMisfit::NoOverlap { apart_s });
        }
        let track_s: Vec<f64> = self.track.iter().map(|position| position.time_s).collect();
        let step_s = interval_s(&track_s).clamp(STEPS_S.start, STEPS_S.end);
        let step_s = step_s.max((high_s - low_s) / MAX_STEPS);
        let count = ((high_s - low_s) / step_s) as usize + 1;
        let offset_s = |step: usize| low_s + step as f64 * step_s;
        let counts: Vec<usize> = (0..count).map(|step| self.during(offset_s(step)).len()).collect();
        let most = counts.iter().copied().max().unwrap_or(0);
        if most < MIN_POSITIONS {
            return Err(TrackMisfit::TooFew { during: most });
        }
        // Of a few positions any path fits.
        let least = (most / 2).max(MIN_POSITIONS);
        let of_step = |step: usize| -> Option<(f64, Fit)> {
            let fit = Fit::start(offset_s(step), Sim3::identity());
            let mut pairs = self.pairs(&fit, counts[step].div_ceil(MAX_IN_STEP).max(1));
            let is_enough = counts[step] >= least && pairs.len() >= MIN_POSITIONS;
            let similarity =
                is_enough.then(|| first_similarity(&mut pairs, SAMPLES_IN_STEP, seed)).flatten()?;
            let error = error(&pairs, &similarity);
            error.is_finite().then_some((error, Fit { similarity, ..fit }))
        };
        let steps: Vec<Option<(f64, Fit)>> = (0..count).map(of_step).collect();
        let error_at = |step: Option<usize>| {
            let found = step.and_then(|step| steps.get(step)?.as_ref());
            found.map_or(f64::INFINITY, |(error, _)| *error)
        };
        let is_minimum = |step: &usize| {
            let here = error_at(Some(*step));
            here < error_at(step.checked_sub(1)) && here <= error_at(Some(step + 1))
        };
        let minima = (0..count).filter(is_minimum).filter_map(|step| steps[step].clone());
        let mut minima: Vec<(f64, Fit)> = minima.collect();
        minima.sort_by(|a, b| a.0.total_cmp(&b.0));
        minima.truncate(MAX_MINIMA);
        Ok(minima.into_iter().map(|(_, fit)| fit).collect())
    }

    /// Minimises the robust residuals by Gauss-Newton. `None` if they determine nothing.
    fn refined(&self, start: Fit, has_arm: bool) -> Option<Fit> {
        let mut fit = Fit { has_arm, ..start };
        let mut pairs = self.pairs(&fit, 1);
        for _ in 0..30 {
            let is_stated = self.track.iter().all(|position| position.sigmas_m.is_some());
            let sigmas = deviations(&pairs, &fit.similarity);
            fit = self.step(&fit, (!is_stated).then_some(sigmas))?;
            pairs = self.pairs(&fit, 1);
            if pairs.len() < MIN_POSITIONS {
                return None;
            }
        }
        Some(fit)
    }

    /// A step of Gauss-Newton, with the deviations of the parameters before it.
    fn step(&self, fit: &Fit, sigmas_m: Option<[f64; 2]>) -> Option<Fit> {
        let positions = self.during(fit.offset_s);
        let mut pairs = Vec::new();
        for position in positions {
            let Some(mut pair) = self.pair(fit, position) else { continue };
            if let Some(sigmas_m) = sigmas_m {
                pair.set_sigmas(sigmas_m);
            }
            pairs.push((position.time_s, pair));
        }
        let (times_s, pairs): (Vec<f64>, Vec<Pair>) = pairs.into_iter().unzip();
        let found = pairs.iter().map(|pair| pair.found).sum::<Vector3<f64>>();
        let middle = fit.similarity * (found / pairs.len() as f64);
        let factor = scale_of_residuals(&pairs, &fit.similarity).max(f64::MIN_POSITIVE);
        let mut information = SMatrix::<f64, NUM_PARAMETERS, NUM_PARAMETERS>::zeros();
        let mut gradient = SVector::<f64, NUM_PARAMETERS>::zeros();
        let mut blocks = vec![SVector::<f64, NUM_PARAMETERS>::zeros(); NUM_BLOCKS];
        for (index, (pair, time_s)) in pairs.iter().zip(&times_s).enumerate() {
            let whitened = Matrix3::from_diagonal(&pair.sigmas.map(f64::recip));
            let jacobian = whitened * self.jacobian(fit, pair, *time_s, &middle)?;
            let residual = whitened * pair.residual(&fit.similarity);
            let [_, weight, _] = LOSS.evaluate(residual.norm_squared() / (factor * factor));
            information += weight * jacobian.tr_mul(&jacobian);
            let of_pair = weight * jacobian.tr_mul(&residual);
            gradient += of_pair;
            blocks[index * NUM_BLOCKS / pairs.len()] += of_pair;
        }
        let is_free = |k: usize| k < ARM || fit.has_arm;
        // What nothing determines does not move.
        let weak = Vector11::from_fn(|k, _| if is_free(k) { prior_sd(k).powi(-2) } else { 1.0 });
        gradient.fixed_rows_mut::<3>(ARM).add_assign(fit.arm_m / ARM_SD_M.powi(2));
        let inverse = (information + SMatrix::from_diagonal(&weak)).try_inverse()?;
        let step = -(inverse * gradient);
        if step.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let count = NUM_BLOCKS.min(pairs.len()) as f64;
        let squares: SMatrix<f64, NUM_PARAMETERS, NUM_PARAMETERS> =
            blocks.iter().map(|block| block * block.transpose()).sum();
        let clustered = inverse * squares * inverse * (count / (count - 1.0));
        let factor = factor.max(1.0);
        let sd = |k: usize| clustered[(k, k)].max(factor * factor * inverse[(k, k)]).sqrt();
        let moved = step.fixed_rows::<7>(0).into_owned();
        Some(Fit {
            similarity: updated(&fit.similarity, &moved, &middle),
            offset_s: fit.offset_s + step[OFFSET].clamp(-STEPS_S.end, STEPS_S.end),
            arm_m: fit.arm_m + step.fixed_rows::<3>(ARM),
            has_arm: fit.has_arm,
            sds: Vector11::from_fn(|k, _| if is_free(k) { sd(k) } else { 0.0 }),
        })
    }

    /// Of the residual with respect to the parameters.
    fn jacobian(
        &self,
        fit: &Fit,
        pair: &Pair,
        time_s: f64,
        middle: &Vector3<f64>,
    ) -> Option<SMatrix<f64, 3, NUM_PARAMETERS>> {
        let lever = fit.similarity * pair.found - middle;
        let mut jacobian = SMatrix::<f64, 3, NUM_PARAMETERS>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-so3::hat(&lever));
        let measured_from_cam = fit.similarity.rotation.to_rotation_matrix() * pair.axes;
        jacobian.set_column(6, &(lever - measured_from_cam * fit.arm_m));
        // By the motion in a hundredth of an interval.
        let h = 0.01 * self.trajectory.interval_s();
        let place = |time_s: f64| -> Option<Vector3<f64>> {
            let pose = self.trajectory.at(time_s)?;
            let antenna = pose.rotation.inverse() * fit.arm_m / fit.similarity.scale;
            Some(pose.origin_in_a() + antenna)
        };
        let (at_s, zero) = (time_s - fit.offset_s, Vector3::zeros());
        let velocity = match (place(at_s - h), place(at_s + h)) {
            (Some(before), Some(after)) => (after - before) / (2.0 * h),
            _ => zero,
        };
        let by_offset = -fit.similarity.scale * (fit.similarity.rotation * velocity);
        jacobian.set_column(OFFSET, &by_offset);
        if fit.has_arm {
            jacobian.fixed_view_mut::<3, 3>(0, ARM).copy_from(&measured_from_cam);
        }
        Some(jacobian)
    }

    /// The positions of the camera in images: each measured one in the image nearest in time.
    fn in_images(&self, fit: &Fit, images: &[Timed]) -> Vec<MeasuredPosition> {
        let mut nearest: BTreeMap<usize, (f64, &TimedPosition)> = BTreeMap::new();
        for position in self.during(fit.offset_s) {
            let time_s = position.time_s - fit.offset_s;
            let after = images.partition_point(|(other_s, ..)| *other_s < time_s);
            let away_s = |k: &usize| (images[*k].0 - time_s).abs();
            let near = (after.saturating_sub(1)..(after + 1).min(images.len()))
                .min_by(|a, b| away_s(a).total_cmp(&away_s(b)));
            if let Some(image) = near {
                let best = nearest.entry(image).or_insert((f64::INFINITY, position));
                if away_s(&image) < best.0 {
                    *best = (away_s(&image), position);
                }
            }
        }
        let of_image = |(image, (_, position)): (usize, (f64, &TimedPosition))| {
            let (_, id, pose) = &images[image];
            let pair = self.pair(fit, position)?;
            let camera = fit.similarity * pose.origin_in_a();
            let xyz = position.xyz + camera - fit.similarity * pair.found;
            let TimedPosition { has_height, sigmas_m, .. } = *position;
            Some(MeasuredPosition { image: *id, xyz, has_height, sigmas_m })
        };
        nearest.into_iter().filter_map(of_image).collect()
    }
}

type Vector11 = SVector<f64, NUM_PARAMETERS>;

/// Standard deviations of the parameters before the positions tell them. But for that of the arm
/// they are no information beside that of any drive: a thousand kilometres, ten turns, a factor of
/// e⁶⁰, and a day.
fn prior_sd(parameter: usize) -> f64 {
    match parameter {
        0..3 => 1e6,
        3..7 => 60.0,
        OFFSET => 86_400.0,
        _ => ARM_SD_M,
    }
}

/// The median residual beside the spread of the path, which has no unit: without it a receiver that
/// stood still would fit any path.
fn error(pairs: &[Pair], similarity: &Sim3) -> f64 {
    let places = || pairs.iter().map(|pair| *similarity * pair.found);
    let mean = places().sum::<Vector3<f64>>() / pairs.len() as f64;
    let spread = places().map(|place| (place - mean).norm_squared()).sum::<f64>();
    let residual = |pair: &Pair| {
        let residual = pair.residual(similarity);
        if pair.sigmas.z.is_finite() { residual.norm() } else { residual.xy().norm() }
    };
    let mut residuals: Vec<f64> = pairs.iter().map(residual).collect();
    median(&mut residuals).unwrap_or(f64::INFINITY) / (spread / pairs.len() as f64).sqrt()
}
