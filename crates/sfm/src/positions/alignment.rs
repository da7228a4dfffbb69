//! The similarity between a model and measured positions.

use std::fmt;

use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use tiepoint_geometry::numeric::{MEDIAN_NORM_OF_TWO, median};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{Loss, Rng, Sim3, so3};
use tiepoint_scene::{ImageId, Reconstruction};

use super::measured::MeasuredPosition;

/// Fewest positions: three determine a similarity, and the others tell whether it is right.
const MIN_POSITIONS: usize = 6;
/// Samples of three positions. With half of all wrong, all of 500 contain a wrong one with a
/// probability of 0.875⁵⁰⁰ = 1e-29; the others choose among noise.
const NUM_SAMPLES: usize = 500;
/// Median norm of three standard normal variables, and median of the absolute value of one.
const MEDIAN_NORM_OF_THREE: f64 = 1.538;
const MEDIAN_OF_ONE: f64 = 0.6745;
/// Scale of the robust loss, in standard deviations.
const LOSS: Loss = Loss::Cauchy(2.0);
/// A position is an outlier beyond this norm in standard deviations, which one in a hundred right
/// ones exceeds: the root of the 99 % quantile of χ² with three degrees of freedom.
const MAX_INLIER: f64 = 3.37;
/// Largest standard deviations of the logarithm of the scale and of the heading (0.1 rad are 6°)
/// that are of use.
const MAX_SCALE_SD: f64 = 0.1;
const MAX_HEADING_SD_RAD: f64 = 0.1;
/// Standard deviation of the assumption that photos are level on average: the x axes of the images
/// are horizontal. Five degrees: it decides where positions on a line leave the roll open.
const LEVEL_SD_RAD: f64 = 0.09;
/// Where the x axes of half of the images are steeper (30°), the photos are not upright.
const MAX_SLOPE: f64 = 0.5;
/// Spread across a line, in standard deviations, which determines the rotation about it.
const MIN_SPREAD: f64 = 3.0;
/// A model is upside down if the y axis of this share of the images is upwards, or the optical
/// axis.
const UPSIDE_DOWN_SHARE: f64 = 0.8;

/// How a model lies in the frame of measured positions.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionAlignment {
    /// The similarity.
    pub term_from_model: Sim3,
    /// Number of images with a pose and a position.
    pub num_compared: usize,
    /// Images whose positions are wrong.
    pub outliers: Vec<ImageId>,
    /// Standard deviations of the positions about the model, along a horizontal axis and of the
    /// height, in metres. They contain errors of the model.
    pub sigmas_m: [f64; 2],
    /// Standard deviation of the scale, relative to it.
    pub scale_sd: f64,
    /// Standard deviation of the heading.
    pub heading_sd_rad: f64,
    /// Whether the positions are on a line, and the images being level gives the rotation about it.
    pub is_levelled: bool,
}

/// Why positions do not determine the similarity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Misfit {
    /// There are too few.
    TooFew {
        /// Number of images with a pose and a position.
        compared: usize,
    },
    /// Scale or heading are uncertain: the path is short beside the errors of the positions, or
    /// they do not fit the model.
    Undetermined {
        /// Standard deviation of the scale, relative to it.
        scale_sd: f64,
        /// Standard deviation of a position along a horizontal axis, in metres.
        sigma_m: f64,
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
            Self::Undetermined { scale_sd, sigma_m } => write!(
                f,
                "they do not determine the scale of the model (to {:.0} %): they deviate from its \
                 path by {sigma_m:.2} m",
                100.0 * scale_sd.min(9.99)
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
    /// Standard deviations along the axes of the measured frame.
    pub(super) sigmas: Vector3<f64>,
    /// Of a camera, its axes in the model.
    pub(super) axes: Matrix3<f64>,
}

impl Pair {
    fn residual(&self, similarity: &Sim3) -> Vector3<f64> {
        *similarity * self.found - self.measured
    }

    pub(super) fn whitened(&self, similarity: &Sim3) -> f64 {
        self.residual(similarity).component_div(&self.sigmas).norm()
    }
}

fn axes_sigmas([horizontal, vertical]: [f64; 2]) -> Vector3<f64> {
    Vector3::new(horizontal, horizontal, vertical)
}

/// The similarity that brings the centres of a model to their measured positions, of which up to
/// half may be wrong. Where no deviations are known, they are estimated.
///
/// # Errors
///
/// The positions do not determine it.
pub fn align(
    model: &Reconstruction,
    positions: &[MeasuredPosition],
    seed: u64,
) -> Result<PositionAlignment, Misfit> {
    let (images, mut pairs): (Vec<ImageId>, Vec<Pair>) =
        positions.iter().filter_map(|p| Some((p.image, pair(model, p)?))).unzip();
    let compared = pairs.len();
    if compared < MIN_POSITIONS {
        return Err(Misfit::TooFew { compared });
    }
    let has_sigmas = positions.iter().all(|position| position.sigmas_m.is_some());
    let mut similarity =
        least_median(&pairs, seed).ok_or(Misfit::Undetermined { scale_sd: 9.0, sigma_m: 0.0 })?;
    if !has_sigmas {
        for _ in 0..2 {
            let sigmas = deviations(&pairs, &similarity);
            pairs.iter_mut().for_each(|pair| pair.sigmas = axes_sigmas(sigmas));
            similarity = refined(&pairs, similarity, false).0;
        }
    }
    let is_levelled = is_on_a_line(&pairs, &similarity);
    if is_levelled {
        similarity = rolled(&pairs, &similarity) * similarity;
    }
    let (similarity, variances) = refined(&pairs, similarity, true);
    let sigmas_m = deviations(&pairs, &similarity);
    // Stated deviations may be too small, and drift adds to them.
    let factor = scale_of_residuals(&pairs, &similarity).max(1.0);
    let (scale_sd, heading_sd_rad) = (factor * variances[6].sqrt(), factor * variances[5].sqrt());
    let is_determined = scale_sd <= MAX_SCALE_SD && heading_sd_rad <= MAX_HEADING_SD_RAD;
    if !is_determined {
        return Err(Misfit::Undetermined { scale_sd, sigma_m: sigmas_m[0] });
    }
    if is_upside_down(&pairs, &similarity) {
        return Err(Misfit::UpsideDown);
    }
    let is_outlier = |pair: &Pair| pair.whitened(&similarity) > MAX_INLIER * factor;
    let of_images = images.iter().zip(&pairs);
    let outliers = of_images.filter(|(_, pair)| is_outlier(pair)).map(|(id, _)| *id).collect();
    Ok(PositionAlignment {
        term_from_model: similarity,
        num_compared: compared,
        outliers,
        sigmas_m,
        scale_sd,
        heading_sd_rad,
        is_levelled,
    })
}

fn pair(model: &Reconstruction, position: &MeasuredPosition) -> Option<Pair> {
    let pose = model.image(position.image).cam_from_world()?;
    Some(Pair {
        found: pose.origin_in_a(),
        measured: position.xyz,
        sigmas: axes_sigmas(position.sigmas_m.unwrap_or([1.0; 2])),
        axes: *pose.rotation.inverse().to_rotation_matrix().matrix(),
    })
}

/// The similarity of three positions with the least median of the residuals of all.
fn least_median(pairs: &[Pair], seed: u64) -> Option<Sim3> {
    let mut best: Option<(f64, Sim3)> = None;
    let mut residuals = vec![0.0; pairs.len()];
    for sample in 0..NUM_SAMPLES {
        let mut rng = Rng::stream(seed, &[sample as u64]);
        let picked: Vec<&Pair> = (0..3).map(|_| &pairs[rng.below(pairs.len())]).collect();
        let found: Vec<Vector3<f64>> = picked.iter().map(|pair| pair.found).collect();
        let measured: Vec<Vector3<f64>> = picked.iter().map(|pair| pair.measured).collect();
        let Some(similarity) = umeyama(&found, &measured, true) else { continue };
        for (residual, pair) in residuals.iter_mut().zip(pairs) {
            *residual = pair.whitened(&similarity);
        }
        let Some(error) = median(&mut residuals) else { continue };
        if error.is_finite() && best.is_none_or(|(least, _)| error < least) {
            best = Some((error, similarity));
        }
    }
    let (error, similarity) = best?;
    let is_wide = |pair: &&Pair| pair.whitened(&similarity) <= 2.5 / MEDIAN_NORM_OF_THREE * error;
    let kept: Vec<&Pair> = pairs.iter().filter(is_wide).collect();
    let found: Vec<Vector3<f64>> = kept.iter().map(|pair| pair.found).collect();
    let measured: Vec<Vector3<f64>> = kept.iter().map(|pair| pair.measured).collect();
    Some(umeyama(&found, &measured, true).unwrap_or(similarity))
}

/// Of a median of residuals of `count` positions, which were chosen to be small, for a fit of three
/// (Rousseeuw & Leroy 1987, 5.1.3).
fn correction(count: usize) -> f64 {
    1.0 + 5.0 / (count.max(4) - 3) as f64
}

/// Least estimated deviation, in metres: residuals of exact positions are roundings.
const MIN_SIGMA_M: f64 = 1e-3;

/// Robust deviations along a horizontal axis and of the height.
fn deviations(pairs: &[Pair], similarity: &Sim3) -> [f64; 2] {
    let residuals: Vec<Vector3<f64>> = pairs.iter().map(|pair| pair.residual(similarity)).collect();
    let of = |norm: &dyn Fn(&Vector3<f64>) -> f64, expected: f64| {
        let mut norms: Vec<f64> = residuals.iter().map(norm).collect();
        let median = median(&mut norms).unwrap_or(0.0);
        (correction(pairs.len()) * median / expected).max(MIN_SIGMA_M)
    };
    [of(&|r| r.xy().norm(), MEDIAN_NORM_OF_TWO), of(&|r| r.z.abs(), MEDIAN_OF_ONE)]
}

/// Robust size of the residuals, in their standard deviations.
fn scale_of_residuals(pairs: &[Pair], similarity: &Sim3) -> f64 {
    let mut norms: Vec<f64> = pairs.iter().map(|pair| pair.whitened(similarity)).collect();
    correction(pairs.len()) * median(&mut norms).unwrap_or(0.0) / MEDIAN_NORM_OF_THREE
}

/// Minimises the robust residuals by Gauss-Newton, with the levels of the images if `is_level`.
/// Also returns the variances of translation, rotation and logarithm of the scale for residuals of
/// their standard deviations.
pub(super) fn refined(
    pairs: &[Pair],
    mut similarity: Sim3,
    is_level: bool,
) -> (Sim3, SVector<f64, 7>) {
    let centre = pairs.iter().map(|pair| pair.found).sum::<Vector3<f64>>() / pairs.len() as f64;
    let mut variances = SVector::repeat(f64::INFINITY);
    for _ in 0..20 {
        let middle = similarity * centre;
        let factor = scale_of_residuals(pairs, &similarity).max(f64::MIN_POSITIVE);
        let mut information = SMatrix::<f64, 7, 7>::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        for pair in pairs {
            let lever = similarity * pair.found - middle;
            let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever.cross_matrix());
            jacobian.set_column(6, &lever);
            let whitened = Matrix3::from_diagonal(&pair.sigmas.map(f64::recip));
            let (jacobian, residual) = (whitened * jacobian, whitened * pair.residual(&similarity));
            let [_, weight, _] = LOSS.evaluate(residual.norm_squared() / (factor * factor));
            information += weight * jacobian.tr_mul(&jacobian);
            gradient += weight * jacobian.tr_mul(&residual);
        }
        if is_level && let Some((by_level, slope)) = level(pairs, &similarity) {
            information += by_level;
            gradient += slope;
        }
        // The roll about a line has no information without levels.
        let Some(inverse) = (information + SMatrix::identity() * f64::MIN_POSITIVE).try_inverse()
        else {
            break;
        };
        let step = -(inverse * gradient);
        if step.iter().any(|value| !value.is_finite()) {
            break;
        }
        variances = inverse.diagonal();
        let rotation = so3::exp(&step.fixed_rows::<3>(3).into_owned());
        let scale = step[6].clamp(-1.0, 1.0).exp();
        let translation = middle - scale * (rotation * middle) + step.fixed_rows::<3>(0);
        similarity = Sim3 { scale, rotation, translation } * similarity;
        if step.fixed_rows::<4>(3).norm() < 1e-12 {
            break;
        }
    }
    (similarity, variances)
}

/// Information and gradient of the assumption that the images are level, as of one observation of
/// all images together. `None` if the photos are not upright.
fn level(pairs: &[Pair], similarity: &Sim3) -> Option<(SMatrix<f64, 7, 7>, SVector<f64, 7>)> {
    let x_axes: Vec<Vector3<f64>> =
        pairs.iter().map(|pair| similarity.rotation * pair.axes.column(0)).collect();
    let mut slopes: Vec<f64> = x_axes.iter().map(|axis| axis.z.abs()).collect();
    if median(&mut slopes)? > MAX_SLOPE {
        return None;
    }
    let weight = 1.0 / (LEVEL_SD_RAD * LEVEL_SD_RAD * pairs.len() as f64);
    let (mut information, mut gradient) = (SMatrix::zeros(), SVector::zeros());
    for axis in x_axes {
        let mut by_rotation = SVector::<f64, 7>::zeros();
        by_rotation.fixed_rows_mut::<3>(3).copy_from(&axis.cross(&Vector3::z()));
        information += weight * by_rotation * by_rotation.transpose();
        gradient += weight * axis.z * by_rotation;
    }
    Some((information, gradient))
}

/// Whether the positions that fit leave the rotation about a line open.
fn is_on_a_line(pairs: &[Pair], similarity: &Sim3) -> bool {
    let factor = scale_of_residuals(pairs, similarity).max(1.0);
    let kept = pairs.iter().filter(|pair| pair.whitened(similarity) <= MAX_INLIER * factor);
    let kept: Vec<Vector3<f64>> = kept
        .map(|pair| (*similarity * pair.found).component_div(&(factor * pair.sigmas)))
        .collect();
    let mean = kept.iter().sum::<Vector3<f64>>() / kept.len().max(1) as f64;
    let scatter: Matrix3<f64> =
        kept.iter().map(|place| (place - mean) * (place - mean).transpose()).sum();
    let variances = scatter.symmetric_eigenvalues();
    let across = variances.sum() - variances.max() - variances.min();
    across <= MIN_SPREAD * MIN_SPREAD * kept.len() as f64
}

/// The rotation about the line of the positions after which the images are upright on average.
fn rolled(pairs: &[Pair], similarity: &Sim3) -> Sim3 {
    let places: Vec<Vector3<f64>> = pairs.iter().map(|pair| *similarity * pair.found).collect();
    let mean = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    let scatter: Matrix3<f64> =
        places.iter().map(|place| (place - mean) * (place - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let line: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let across = |vector: Vector3<f64>| vector - line * line.dot(&vector);
    let down: Vector3<f64> =
        pairs.iter().map(|pair| similarity.rotation * pair.axes.column(1)).sum();
    let (from, to) = (across(down), across(-Vector3::z()));
    let angle = from.cross(&to).dot(&line).atan2(from.dot(&to));
    let rotation = UnitQuaternion::from_scaled_axis(line * angle);
    Sim3 { scale: 1.0, rotation, translation: mean - rotation * mean }
}

fn is_upside_down(pairs: &[Pair], similarity: &Sim3) -> bool {
    let upwards = |axis: usize| {
        let is_up = |pair: &&Pair| (similarity.rotation * pair.axes.column(axis)).z > MAX_SLOPE;
        pairs.iter().filter(is_up).count() as f64
    };
    upwards(1).max(upwards(2)) > UPSIDE_DOWN_SHARE * pairs.len() as f64
}
