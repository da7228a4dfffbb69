//! The similarity between a model and measured positions.

use std::f64::consts::PI;
use std::fmt;

use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use tiepoint_geometry::numeric::{MEDIAN_NORM_OF_TWO, median};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{Loss, Rigid3, Rng, Sim3, so3};
use tiepoint_scene::{ImageId, Reconstruction};

use super::measured::MeasuredPosition;

/// Fewest positions: three determine a similarity, and the others tell whether it is right.
pub(super) const MIN_POSITIONS: usize = 6;
/// Samples of three positions. With half of all wrong, all of 500 contain a wrong one with a
/// probability of 0.875⁵⁰⁰ = 1e-29; the others choose among noise.
const NUM_SAMPLES: usize = 500;
/// Median norm of three standard normal variables, and median of the absolute value of one.
const MEDIAN_NORM_OF_THREE: f64 = 1.538;
const MEDIAN_OF_ONE: f64 = 0.6745;
/// Scale of the robust loss, in standard deviations.
pub(super) const LOSS: Loss = Loss::Cauchy(2.0);
/// A position is an outlier beyond this norm in standard deviations, which one in a hundred right
/// ones exceeds: the root of the 99 % quantile of χ² with two and three degrees of freedom.
const MAX_INLIER: [f64; 2] = [3.03, 3.37];
/// Largest standard deviations of the logarithm of the scale and of rotations (0.1 rad are 6°) that
/// are of use.
const MAX_SCALE_SD: f64 = 0.1;
const MAX_ROTATION_SD_RAD: f64 = 0.1;
/// Standard deviations of the assumptions that photos are level on average: their x axes are
/// horizontal (5°), and so are their optical axes (15°). Errors of photographers and mounts are
/// alike in all photos, so that all together count as one observation.
const ROLL_SD_RAD: f64 = 0.09;
const PITCH_SD_RAD: f64 = 0.26;
/// Largest standard deviation of the vertical by these assumptions: no direction of it is less
/// certain than by the optical axes across it.
const MAX_LEVEL_SD_RAD: f64 = 0.35;
/// Least mean of the upward components of the images' upward axes (73°): photos that look down or
/// that are turned by 90° do not tell which side is up.
const MIN_UPRIGHT: f64 = 0.3;
/// A line with a larger vertical component of its direction has no heading.
const MAX_LINE_SLOPE: f64 = 0.9;
/// A model on flat places is upside down if the y axis of this share of the images is upwards by
/// more than 30°, or the optical axis.
const UPSIDE_DOWN_SHARE: f64 = 0.8;
const MAX_SLOPE: f64 = 0.5;
/// A path is mirrored if its mirror image fits with less than this share of the residuals.
const MAX_MIRRORED: f64 = 0.5;
/// Spread across a line, in standard deviations, which determines the rotation about it, and across
/// a plane, which tells places from their mirror image. Errors of receivers are alike over minutes,
/// so that more positions do not need less.
const MIN_SPREAD: f64 = 3.0;

/// How a model lies in the frame of measured positions.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionAlignment {
    /// The similarity.
    pub term_from_model: Sim3,
    /// Number of images with a pose and a position.
    pub num_compared: usize,
    /// Images whose positions deviate by more than three deviations.
    pub outliers: Vec<ImageId>,
    /// Standard deviations of the positions about the model, along a horizontal axis and of the
    /// height, in metres; infinite for the height if too few positions have one. They contain
    /// errors of the model.
    pub sigmas_m: [f64; 2],
    /// Standard deviation of the scale, relative to it; 0 if the model keeps its own.
    pub scale_sd: f64,
    /// Standard deviation of the heading.
    pub heading_sd_rad: f64,
    /// Standard deviation of the vertical, if the images give it and not the positions, which are
    /// on a line or have no heights: the images are assumed to be level on average.
    pub level_sd_rad: Option<f64>,
}

impl PositionAlignment {
    /// Whether heights of positions took part.
    pub fn has_heights(&self) -> bool {
        self.sigmas_m[1].is_finite()
    }
}

/// Why positions do not determine the similarity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Misfit {
    /// There are too few.
    TooFew {
        /// Number of images with a pose and a position.
        compared: usize,
    },
    /// They are all at one place.
    OnePlace,
    /// They do not determine the scale: the path is short beside their errors, or they do not fit
    /// the model.
    NoScale {
        /// Standard deviation of the scale, relative to it.
        scale_sd: f64,
        /// Standard deviation of a position along a horizontal axis, in metres.
        sigma_m: f64,
    },
    /// They do not determine a rotation.
    NoRotation {
        /// Whether it is that about the vertical; else the vertical is uncertain.
        is_heading: bool,
        /// Its standard deviation.
        sd_rad: f64,
        /// Standard deviation of a position along a horizontal axis, in metres.
        sigma_m: f64,
    },
    /// Neither they nor the images tell which side is up.
    NoVertical {
        /// Whether the positions are on a line; else they have no heights.
        is_line: bool,
    },
    /// The model would be upside down: its path is mirrored, as by swapped coordinates.
    UpsideDown,
}

impl fmt::Display for Misfit {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::TooFew { compared } => write!(
                f,
                "{compared} images with a pose have one, and at least {MIN_POSITIONS} are needed"
            ),
            Self::OnePlace => f.write_str("they are all at one place"),
            Self::NoScale { scale_sd, sigma_m } => write!(
                f,
                "they do not determine the scale of the model (to {:.0} %): they deviate from its \
                 path by {sigma_m:.2} m",
                100.0 * scale_sd.min(9.99)
            ),
            Self::NoRotation { is_heading, sd_rad, sigma_m } => write!(
                f,
                "they do not determine {} (to {:.0}°): they deviate from its path by {sigma_m:.2} \
                 m",
                if *is_heading { "the heading of the model" } else { "which side of it is up" },
                sd_rad.to_degrees().min(180.0)
            ),
            Self::NoVertical { is_line } => write!(
                f,
                "they {}, and the photos are not upright enough to tell which side is up, as \
                 control points would",
                if *is_line { "are on a line" } else { "have no altitudes" }
            ),
            Self::UpsideDown => {
                f.write_str("the model would be upside down: are two coordinates swapped?")
            }
        }
    }
}

/// A place in a model and the measured one.
pub(super) struct Pair {
    pub(super) found: Vector3<f64>,
    pub(super) measured: Vector3<f64>,
    /// Standard deviations along the axes of the measured frame; that of an unknown height is
    /// infinite.
    pub(super) sigmas: Vector3<f64>,
    /// Of a camera, its axes in the model.
    pub(super) axes: Matrix3<f64>,
}

impl Pair {
    /// A place in the model that is fixed to a camera, with its measured one.
    pub(super) fn new(
        cam_from_model: &Rigid3,
        found: Vector3<f64>,
        measured: Vector3<f64>,
        has_height: bool,
        sigmas_m: Option<[f64; 2]>,
    ) -> Self {
        let vertical = if has_height { 1.0 } else { f64::INFINITY };
        let sigmas = Vector3::new(1.0, 1.0, vertical);
        let mut pair = Self { found, measured, sigmas, axes: axes(cam_from_model) };
        if let Some(sigmas_m) = sigmas_m {
            pair.set_sigmas(sigmas_m);
        }
        pair
    }

    pub(super) fn residual(&self, similarity: &Sim3) -> Vector3<f64> {
        *similarity * self.found - self.measured
    }

    pub(super) fn whitened(&self, similarity: &Sim3) -> f64 {
        self.residual(similarity).component_div(&self.sigmas).norm()
    }

    /// The residual in deviations, and its derivative by translation, rotation about `middle` and
    /// logarithm of the scale ([`updated`]).
    pub(super) fn linearised(
        &self,
        similarity: &Sim3,
        middle: &Vector3<f64>,
    ) -> (Vector3<f64>, SMatrix<f64, 3, 7>) {
        let lever = *similarity * self.found - middle;
        let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever.cross_matrix());
        jacobian.set_column(6, &lever);
        let whitening = Matrix3::from_diagonal(&self.sigmas.map(f64::recip));
        (whitening * self.residual(similarity), whitening * jacobian)
    }

    fn has_height(&self) -> bool {
        self.sigmas.z.is_finite()
    }

    pub(super) fn set_sigmas(&mut self, [horizontal, vertical]: [f64; 2]) {
        let vertical = if self.has_height() { vertical } else { f64::INFINITY };
        self.sigmas = Vector3::new(horizontal, horizontal, vertical);
    }

    /// Median norm of normal residuals, and the norm that one in a hundred exceeds.
    fn expected(&self) -> [f64; 2] {
        match self.has_height() {
            true => [MEDIAN_NORM_OF_THREE, MAX_INLIER[1]],
            false => [MEDIAN_NORM_OF_TWO, MAX_INLIER[0]],
        }
    }
}

/// The similarity that brings the centres of a model to their measured positions, of which up to
/// half may be wrong; with `keeps_scale` its scale is 1. Where no deviations are known, they are
/// estimated. Heights count if six positions have one; else the images give the vertical.
///
/// # Errors
///
/// The positions do not determine it.
pub fn align(
    model: &Reconstruction,
    positions: &[MeasuredPosition],
    keeps_scale: bool,
    seed: u64,
) -> Result<PositionAlignment, Misfit> {
    let (images, mut pairs): (Vec<ImageId>, Vec<Pair>) =
        positions.iter().filter_map(|p| Some((p.image, pair(model, p)?))).unzip();
    let compared = pairs.len();
    if compared < MIN_POSITIONS {
        return Err(Misfit::TooFew { compared });
    }
    let has_heights = have_heights(&mut pairs);
    let (found, mut level_sd_rad) = match has_heights {
        true => (spatial(&pairs, keeps_scale, NUM_SAMPLES, seed), None),
        false => {
            let (found, sd_rad) = planar(&pairs, keeps_scale, NUM_SAMPLES, seed)?;
            (found, Some(sd_rad))
        }
    };
    let mut similarity = found.ok_or(Misfit::OnePlace)?;
    let turns = if has_heights { Matrix3::identity() } else { about(&Vector3::z()) };
    let mut free = Free::new(&turns, keeps_scale, has_heights);
    if positions.iter().any(|position| position.sigmas_m.is_none()) {
        for _ in 0..2 {
            let sigmas = deviations(&pairs, &similarity);
            pairs.iter_mut().for_each(|pair| pair.set_sigmas(sigmas));
            similarity = refined(&pairs, similarity, &free, LOSS).0;
        }
    }
    if has_heights && is_on_a_line(&pairs, &similarity) {
        for _ in 0..2 {
            let line = line(&pairs, &similarity);
            free = Free::new(&(Matrix3::identity() - about(&line)), keeps_scale, true);
            let fit = refined(&pairs, similarity, &free, LOSS);
            precision(&pairs, &fit)?;
            let (roll, sd_rad) = rolled(&pairs, &fit.0)?;
            (similarity, level_sd_rad) = (roll * fit.0, Some(sd_rad));
        }
    }
    let mut fit = refined(&pairs, similarity, &free, LOSS);
    if !has_heights {
        fit.0 = at_mean_height(&pairs, fit.0);
    }
    let (scale_sd, heading_sd_rad) = precision(&pairs, &fit)?;
    let similarity = fit.0;
    // Else the images gave the vertical.
    if level_sd_rad.is_none() && {
        let axes: Vec<Matrix3<f64>> = pairs.iter().map(|pair| pair.axes).collect();
        is_upside_down(&axes, &similarity, &whitened_places(&pairs, &similarity))
    } {
        return Err(Misfit::UpsideDown);
    }
    let factor = scale_of_residuals(&pairs, &similarity).max(1.0);
    let is_outlier = |pair: &Pair| pair.whitened(&similarity) > pair.expected()[1] * factor;
    let of_images = images.iter().zip(&pairs);
    let outliers = of_images.filter(|(_, pair)| is_outlier(pair)).map(|(id, _)| *id).collect();
    Ok(PositionAlignment {
        term_from_model: similarity,
        num_compared: compared,
        outliers,
        sigmas_m: deviations(&pairs, &similarity),
        scale_sd,
        heading_sd_rad,
        level_sd_rad,
    })
}

/// The deviations of scale and heading of a fit with its variances.
///
/// # Errors
///
/// One of them, or that of the vertical, is too large.
fn precision(
    pairs: &[Pair],
    (similarity, variances): &(Sim3, SVector<f64, 7>),
) -> Result<(f64, f64), Misfit> {
    // Stated deviations may be too small, and drift adds to them.
    let factor = scale_of_residuals(pairs, similarity).max(1.0);
    let sd = |k: usize| factor * variances[k].sqrt();
    let (scale_sd, heading_sd_rad, tilt_sd_rad) = (sd(6), sd(5), sd(3).hypot(sd(4)));
    let sigma_m = deviations(pairs, similarity)[0];
    // No number is within no bound.
    let is_within = |sd: f64, most: f64| sd <= most;
    if !is_within(scale_sd, MAX_SCALE_SD) || !sigma_m.is_finite() {
        return Err(Misfit::NoScale { scale_sd, sigma_m });
    }
    let is_heading = !is_within(heading_sd_rad, MAX_ROTATION_SD_RAD);
    if is_heading || !is_within(tilt_sd_rad, MAX_ROTATION_SD_RAD) {
        let sd_rad = if is_heading { heading_sd_rad } else { tilt_sd_rad };
        return Err(Misfit::NoRotation { is_heading, sd_rad, sigma_m });
    }
    Ok((scale_sd, heading_sd_rad))
}

fn pair(model: &Reconstruction, position: &MeasuredPosition) -> Option<Pair> {
    let pose = model.image(position.image).cam_from_world()?;
    let &MeasuredPosition { xyz, has_height, sigmas_m, .. } = position;
    Some(Pair::new(pose, pose.origin_in_a(), xyz, has_height, sigmas_m))
}

/// Whether heights count, as those of six positions do; else none does.
fn have_heights(pairs: &mut [Pair]) -> bool {
    let has_heights = pairs.iter().filter(|pair| pair.has_height()).count() >= MIN_POSITIONS;
    if !has_heights {
        pairs.iter_mut().for_each(|pair| pair.sigmas.z = f64::INFINITY);
    }
    has_heights
}

/// The first similarity of positions, the best one of `samples` of three.
pub(super) fn first_similarity(pairs: &mut [Pair], samples: usize, seed: u64) -> Option<Sim3> {
    match have_heights(pairs) {
        true => spatial(pairs, false, samples, seed),
        false => planar(pairs, false, samples, seed).ok()?.0,
    }
}

/// A similarity of corresponding points.
type Solve<'a> = &'a dyn Fn(&[Vector3<f64>], &[Vector3<f64>]) -> Option<Sim3>;

/// The first similarity of positions with heights.
pub(super) fn spatial(
    pairs: &[Pair],
    keeps_scale: bool,
    samples: usize,
    seed: u64,
) -> Option<Sim3> {
    let with_height: Vec<&Pair> = pairs.iter().filter(|pair| pair.has_height()).collect();
    least_median(pairs, &with_height, samples, seed, &|found, measured| {
        umeyama(found, measured, !keeps_scale).or_else(|| along(found, measured, keeps_scale))
    })
}

/// A similarity of points that are on a line: the rotation about it is arbitrary.
fn along(found: &[Vector3<f64>], measured: &[Vector3<f64>], keeps_scale: bool) -> Option<Sim3> {
    let [from, to] = [found, measured].map(|places| places[places.len() - 1] - places[0]);
    let rotation = UnitQuaternion::rotation_between(&from, &to)?;
    let scale = if keeps_scale { 1.0 } else { to.norm() / from.norm() };
    let is_number = scale.is_finite() && scale > 0.0 && to.norm() > 0.0;
    is_number.then(|| Sim3 {
        scale,
        rotation,
        translation: measured[0] - scale * (rotation * found[0]),
    })
}

/// The first similarity of positions without heights, if there is one, and the deviation of the
/// vertical, which the images give.
fn planar(
    pairs: &[Pair],
    keeps_scale: bool,
    samples: usize,
    seed: u64,
) -> Result<(Option<Sim3>, f64), Misfit> {
    let vertical = vertical(pairs, &UnitQuaternion::identity(), None);
    let (up, sd_rad) = vertical.ok_or(Misfit::NoVertical { is_line: false })?;
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let upright = Sim3 { rotation, ..Sim3::identity() };
    let fit = |pairs: &[Pair]| {
        let all: Vec<&Pair> = pairs.iter().collect();
        let found = least_median(pairs, &all, samples, seed, &|found, measured| {
            let found: Vec<Vector3<f64>> = found.iter().map(|place| upright * *place).collect();
            Some(about_the_vertical(&found, measured, keeps_scale)? * upright)
        });
        found.map(|found| (scale_of_residuals(pairs, &found), found))
    };
    let found = fit(pairs);
    let mirrored = pairs.iter().map(|pair| Pair {
        measured: Vector3::new(pair.measured.y, pair.measured.x, pair.measured.z),
        ..*pair
    });
    let mirrored: Vec<Pair> = mirrored.collect();
    let is_mirrored = match (&found, &fit(&mirrored)) {
        (Some((error, _)), Some((mirrored, _))) => *mirrored < MAX_MIRRORED * error,
        _ => false,
    };
    if is_mirrored {
        return Err(Misfit::UpsideDown);
    }
    Ok((found.map(|(_, found)| found), sd_rad))
}

/// The similarity of points that leaves the vertical as it is, by their horizontal coordinates.
fn about_the_vertical(
    found: &[Vector3<f64>],
    measured: &[Vector3<f64>],
    keeps_scale: bool,
) -> Option<Sim3> {
    let [from, to] =
        [found, measured].map(|places| places.iter().sum::<Vector3<f64>>() / places.len() as f64);
    let (mut dot, mut cross, mut variance) = (0.0, 0.0, 0.0);
    for (found, measured) in found.iter().zip(measured) {
        let (found, measured) = ((found - from).xy(), (measured - to).xy());
        dot += found.dot(&measured);
        cross += found.perp(&measured);
        variance += found.norm_squared();
    }
    let scale = if keeps_scale { 1.0 } else { dot.hypot(cross) / variance };
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), cross.atan2(dot));
    let is_number = scale.is_finite() && scale > 0.0 && dot.hypot(cross) > 0.0;
    is_number.then(|| Sim3 { scale, rotation, translation: to - scale * (rotation * from) })
}

/// Without heights of positions, the cameras are at that of the origin on average.
fn at_mean_height(pairs: &[Pair], mut similarity: Sim3) -> Sim3 {
    let sum: f64 = pairs.iter().map(|pair| (similarity * pair.found).z).sum();
    similarity.translation.z -= sum / pairs.len() as f64;
    similarity
}

/// The similarity of three of the `sampled` pairs with the least median of the residuals of all.
fn least_median(
    pairs: &[Pair],
    sampled: &[&Pair],
    samples: usize,
    seed: u64,
    solve: Solve,
) -> Option<Sim3> {
    let mut best: Option<(f64, Sim3)> = None;
    let mut residuals = vec![0.0; pairs.len()];
    for sample in 0..samples {
        let mut rng = Rng::stream(seed, &[sample as u64]);
        let picked: Vec<&Pair> = (0..3).map(|_| sampled[rng.below(sampled.len())]).collect();
        let found: Vec<Vector3<f64>> = picked.iter().map(|pair| pair.found).collect();
        let measured: Vec<Vector3<f64>> = picked.iter().map(|pair| pair.measured).collect();
        let Some(similarity) = solve(&found, &measured) else { continue };
        for (residual, pair) in residuals.iter_mut().zip(pairs) {
            *residual = pair.whitened(&similarity);
        }
        let Some(error) = median(&mut residuals) else { continue };
        if error.is_finite() && best.is_none_or(|(least, _)| error < least) {
            best = Some((error, similarity));
        }
    }
    let (error, similarity) = best?;
    let is_wide = |pair: &&&Pair| pair.whitened(&similarity) <= 2.5 / pair.expected()[0] * error;
    let kept: Vec<&Pair> = sampled.iter().filter(is_wide).copied().collect();
    let found: Vec<Vector3<f64>> = kept.iter().map(|pair| pair.found).collect();
    let measured: Vec<Vector3<f64>> = kept.iter().map(|pair| pair.measured).collect();
    let of_kept = if kept.len() < 3 { None } else { solve(&found, &measured) };
    Some(of_kept.unwrap_or(similarity))
}

/// Of a median of residuals of `count` positions, which were chosen to be small, for a fit of three
/// (Rousseeuw & Leroy 1987, 5.1.3).
fn correction(count: usize) -> f64 {
    1.0 + 5.0 / (count.max(4) - 3) as f64
}

/// Least estimated deviation, in metres: residuals of exact positions are roundings.
const MIN_SIGMA_M: f64 = 1e-3;

/// Robust deviations along a horizontal axis and of the height, which is infinite without heights.
pub(super) fn deviations(pairs: &[Pair], similarity: &Sim3) -> [f64; 2] {
    let of = |norms: &mut Vec<f64>, expected: f64| {
        let count = norms.len();
        median(norms).map(|median| (correction(count) * median / expected).max(MIN_SIGMA_M))
    };
    let residuals = || pairs.iter().map(|pair| (pair.residual(similarity), pair.has_height()));
    let mut horizontal: Vec<f64> = residuals().map(|(r, _)| r.xy().norm()).collect();
    let mut vertical: Vec<f64> =
        residuals().filter(|(_, has_height)| *has_height).map(|(r, _)| r.z.abs()).collect();
    [
        of(&mut horizontal, MEDIAN_NORM_OF_TWO).unwrap_or(MIN_SIGMA_M),
        of(&mut vertical, MEDIAN_OF_ONE).unwrap_or(f64::INFINITY),
    ]
}

/// Robust size of the residuals, in their standard deviations.
pub(super) fn scale_of_residuals(pairs: &[Pair], similarity: &Sim3) -> f64 {
    let mut norms: Vec<f64> =
        pairs.iter().map(|pair| pair.whitened(similarity) / pair.expected()[0]).collect();
    correction(pairs.len()) * median(&mut norms).unwrap_or(0.0)
}

/// The directions in which an adjustment moves a similarity: translation, rotation, logarithm of
/// the scale.
pub(super) struct Free(SMatrix<f64, 7, 7>);

impl Free {
    /// All directions.
    pub(super) fn all() -> Self {
        Self::all_but_scale(false)
    }

    /// All directions; with `keeps_scale` without the scale.
    pub(super) fn all_but_scale(keeps_scale: bool) -> Self {
        Self::new(&Matrix3::identity(), keeps_scale, true)
    }

    /// Rotations in the range of a projection.
    fn new(turns: &Matrix3<f64>, keeps_scale: bool, has_heights: bool) -> Self {
        let mut projection = SMatrix::<f64, 7, 7>::identity();
        projection.fixed_view_mut::<3, 3>(3, 3).copy_from(turns);
        projection[(2, 2)] = f64::from(u8::from(has_heights));
        projection[(6, 6)] = f64::from(u8::from(!keeps_scale));
        Self(projection)
    }
}

/// The projection on a direction.
fn about(direction: &Vector3<f64>) -> Matrix3<f64> {
    direction * direction.transpose()
}

/// Minimises the loss of the residuals by Gauss-Newton. Also returns the variances of translation,
/// rotation and logarithm of the scale for residuals of their standard deviations: 0 in the
/// directions that are not free.
pub(super) fn refined(
    pairs: &[Pair],
    mut similarity: Sim3,
    Free(free): &Free,
    loss: Loss,
) -> (Sim3, SVector<f64, 7>) {
    let centre = pairs.iter().map(|pair| pair.found).sum::<Vector3<f64>>() / pairs.len() as f64;
    let mut variances = SVector::repeat(f64::INFINITY);
    let fixed = SMatrix::identity() - free;
    for _ in 0..20 {
        let middle = similarity * centre;
        let factor = scale_of_residuals(pairs, &similarity).max(f64::MIN_POSITIVE);
        let mut information = SMatrix::<f64, 7, 7>::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        for pair in pairs {
            let (residual, jacobian) = pair.linearised(&similarity, &middle);
            let jacobian = jacobian * free;
            let [_, weight, _] = loss.evaluate(residual.norm_squared() / (factor * factor));
            information += weight * jacobian.tr_mul(&jacobian);
            gradient += weight * jacobian.tr_mul(&residual);
        }
        // What the residuals do not tell has an infinite variance, and no inverse.
        let Some(inverse) = (information + fixed).try_inverse() else {
            variances = SVector::repeat(f64::INFINITY);
            break;
        };
        let step = -(inverse * gradient);
        if step.iter().any(|value| !value.is_finite()) {
            break;
        }
        variances = (inverse - fixed).diagonal();
        similarity = updated(&similarity, &step, &middle);
        if step.fixed_rows::<4>(3).norm() < 1e-12 {
            break;
        }
    }
    (similarity, variances.map(|variance| variance.max(0.0)))
}

/// A similarity after a step of translation, rotation and logarithm of the scale about `middle`.
pub(super) fn updated(similarity: &Sim3, step: &SVector<f64, 7>, middle: &Vector3<f64>) -> Sim3 {
    let rotation = so3::exp(&step.fixed_rows::<3>(3).into_owned());
    let scale = step[6].clamp(-1.0, 1.0).exp();
    let translation = middle - scale * (rotation * middle) + step.fixed_rows::<3>(0);
    Sim3 { scale, rotation, translation } * *similarity
}

/// The places of the positions with heights that fit, in deviations.
fn whitened_places(pairs: &[Pair], similarity: &Sim3) -> Vec<Vector3<f64>> {
    let factor = scale_of_residuals(pairs, similarity).max(1.0);
    let fits = |pair: &&Pair| {
        pair.has_height() && pair.whitened(similarity) <= pair.expected()[1] * factor
    };
    let place = |pair: &Pair| (*similarity * pair.found).component_div(&(factor * pair.sigmas));
    pairs.iter().filter(fits).map(place).collect()
}

/// Sum of the outer products of the distances from the mean.
fn scatter(places: &[Vector3<f64>]) -> Matrix3<f64> {
    let mean = places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64;
    places.iter().map(|place| (place - mean) * (place - mean).transpose()).sum()
}

/// Whether the positions that fit leave the rotation about a line open.
fn is_on_a_line(pairs: &[Pair], similarity: &Sim3) -> bool {
    let places = whitened_places(pairs, similarity);
    let variances = scatter(&places).symmetric_eigenvalues();
    let across = variances.sum() - variances.max() - variances.min();
    across <= MIN_SPREAD * MIN_SPREAD * places.len() as f64
}

/// The direction of the line of the positions.
fn line(pairs: &[Pair], similarity: &Sim3) -> Vector3<f64> {
    let places: Vec<Vector3<f64>> = pairs.iter().map(|pair| *similarity * pair.found).collect();
    let eigen = scatter(&places).symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

/// The rotation about the line of the positions after which the images are upright on average, and
/// its standard deviation.
fn rolled(pairs: &[Pair], similarity: &Sim3) -> Result<(Sim3, f64), Misfit> {
    let line = line(pairs, similarity);
    if line.z.abs() > MAX_LINE_SLOPE {
        let sigma_m = deviations(pairs, similarity)[0];
        return Err(Misfit::NoRotation { is_heading: true, sd_rad: PI, sigma_m });
    }
    let (from, sd_rad) = vertical(pairs, &similarity.rotation, Some(&line))
        .ok_or(Misfit::NoVertical { is_line: true })?;
    let to = Vector3::z() - line * line.z;
    let angle = from.cross(&to).dot(&line).atan2(from.dot(&to));
    let rotation = UnitQuaternion::from_scaled_axis(line * angle);
    let middle = *similarity * pairs.iter().map(|pair| pair.found).sum::<Vector3<f64>>()
        / pairs.len() as f64;
    Ok((Sim3 { scale: 1.0, rotation, translation: middle - rotation * middle }, sd_rad))
}

/// Weight of the assumption that the vertical is across a line.
const ACROSS: f64 = 1e6;

/// The upward direction, across a line if there is one, by the assumption that the rotated images
/// are level on average, and its standard deviation. `None` if they do not tell.
fn vertical(
    pairs: &[Pair],
    rotation: &UnitQuaternion<f64>,
    line: Option<&Vector3<f64>>,
) -> Option<(Vector3<f64>, f64)> {
    let count = pairs.len() as f64;
    let mut information = Matrix3::zeros();
    let mut down = Vector3::zeros();
    for pair in pairs {
        let [x, y, z] = [0, 1, 2].map(|axis| *rotation * pair.axes.column(axis));
        information += about(&x) / (ROLL_SD_RAD * ROLL_SD_RAD * count);
        information += about(&z) / (PITCH_SD_RAD * PITCH_SD_RAD * count);
        down += y / count;
    }
    if let Some(line) = line {
        let across = Matrix3::identity() - about(line);
        information = across * information * across + ACROSS * about(line);
    }
    let eigen = information.symmetric_eigen();
    let (least, values) = (eigen.eigenvalues.imin(), eigen.eigenvalues);
    let second = values.sum() - values.max() - values.min();
    let sd_rad = (second - values.min()).sqrt().recip();
    let axis: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
    let up = if down.dot(&axis) > 0.0 { -axis } else { axis };
    (sd_rad <= MAX_LEVEL_SD_RAD && -down.dot(&up) >= MIN_UPRIGHT).then_some((up, sd_rad))
}

/// Whether a similarity to places, which are in deviations, turns images upside down, and may be
/// that of the mirror image: only flat places fit theirs.
pub(super) fn is_upside_down(
    axes: &[Matrix3<f64>],
    similarity: &Sim3,
    places: &[Vector3<f64>],
) -> bool {
    let upwards = |axis: usize| {
        let is_up = |axes: &&Matrix3<f64>| (similarity.rotation * axes.column(axis)).z > MAX_SLOPE;
        axes.iter().filter(is_up).count() as f64
    };
    let thickness = scatter(places).symmetric_eigenvalues().min();
    thickness <= MIN_SPREAD * MIN_SPREAD * places.len() as f64
        && upwards(1).max(upwards(2)) > UPSIDE_DOWN_SHARE * axes.len() as f64
}

/// Whether a similarity to places turns a model upside down, and the places are so flat, for their
/// deviation `sigma_m`, that they would fit with two coordinates swapped as well.
pub fn may_be_mirrored(
    model: &Reconstruction,
    similarity: &Sim3,
    places: &[Vector3<f64>],
    sigma_m: f64,
) -> bool {
    let places: Vec<Vector3<f64>> = places.iter().map(|place| place / sigma_m).collect();
    is_upside_down(&axes_of(model), similarity, &places)
}

/// The axes of the cameras of a model.
pub(super) fn axes_of(model: &Reconstruction) -> Vec<Matrix3<f64>> {
    model.registered().map(|(_, _, pose)| axes(pose)).collect()
}

/// The axes of a camera, in the world.
fn axes(cam_from_world: &Rigid3) -> Matrix3<f64> {
    *cam_from_world.rotation.inverse().to_rotation_matrix().matrix()
}
