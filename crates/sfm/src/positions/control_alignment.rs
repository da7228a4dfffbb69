//! The similarity between a model and control points.
//!
//! A start that up to half of wrong points do not move, of least median of the residuals; then
//! least squares without the points that the others contradict ([`Redundancy`]).

use tiepoint_geometry::nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Loss, Sim3};
use tiepoint_scene::Reconstruction;

use super::alignment::{
    Free, LOSS, Pair, axes_of, is_upside_down, refined, scale_of_residuals, spatial,
};
use super::control_points::{Found, MarkedPoint, PointError, errors, places, sigmas};
use super::redundancy::Redundancy;

/// Fewest points: three determine a similarity.
pub(super) const MIN_POINTS: usize = 3;
/// Largest standard deviation of a rotation (3°), and of the logarithm of the scale, that is of
/// use: as far from the points as they are from each other, an error of a twentieth of that.
const MAX_SD: f64 = 0.05;
/// Samples of three points for the start. With half of all points wrong, all of 100 contain a wrong
/// one with a probability of 0.875¹⁰⁰ = 2e-6.
const NUM_SAMPLES: usize = 100;
/// Largest residuals at the start, relative to the extent of the points: an unknown lens bends
/// models by hundredths. Points with swapped coordinates or of other places are off by their
/// extent.
const MAX_BENDING: f64 = 0.1;
/// Norm of a point's residual, in standard deviations, that one right point in a thousand exceeds:
/// the root of the 99.9 % quantile of χ² with three degrees of freedom.
pub(super) const MAX_RIGHT: f64 = 4.03;

/// Why control points do not determine the similarity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlMisfit {
    /// There are fewer than three.
    TooFew {
        /// Number of points that are no check points and that their marks determine.
        usable: usize,
    },
    /// They leave a rotation or the scale uncertain: they are near a line, or near each other.
    Uncertain {
        /// Number of points that are no check points, that their marks determine, and that the
        /// others do not contradict.
        usable: usize,
        /// Standard deviation of the most uncertain rotation.
        rotation_sd_rad: f64,
        /// Standard deviation of the scale, relative to it.
        scale_sd: f64,
    },
    /// The model would be upside down: flat points are mirrored, as by swapped coordinates.
    UpsideDown,
    /// Most of them are so far from their places in the model that no adjustment explains it.
    Contradiction {
        /// Robust standard deviation of a coordinate, in metres.
        sigma_m: f64,
        /// Median distance of the points from their median, in metres.
        extent_m: f64,
    },
}

/// A model in the frame of control points.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlAlignment {
    /// The similarity.
    pub term_from_model: Sim3,
    /// The points, in their order.
    pub points: Vec<PointError>,
}

/// The control points that their marks determine, with their deviations after a similarity, and
/// their indices.
pub(super) fn determined(
    points: &[MarkedPoint],
    found: &[Option<Found>],
    similarity: &Sim3,
) -> (Vec<usize>, Vec<Pair>) {
    let pair = |(k, point): (usize, &MarkedPoint)| {
        let found = found[k].as_ref()?;
        let sigmas = sigmas(point, found, similarity);
        let axes = Matrix3::identity();
        Some((k, Pair { found: found.xyz, measured: point.xyz, sigmas, axes }))
    };
    let control = points.iter().enumerate().filter(|(_, point)| !point.is_check);
    control.filter_map(pair).unzip()
}

/// Those whose residuals are at most `max` deviations, and no fewer than determine a similarity.
pub(super) fn fitting(pairs: &[Pair], similarity: &Sim3, max: f64) -> Vec<usize> {
    let mut all: Vec<(f64, usize)> =
        pairs.iter().map(|pair| pair.whitened(similarity)).zip(0..).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let fits = |(rank, (norm, _)): &(usize, (f64, usize))| *rank < MIN_POINTS || *norm <= max;
    let mut fitting: Vec<usize> =
        all.into_iter().enumerate().filter(fits).map(|(_, (_, k))| k).collect();
    fitting.sort_unstable();
    fitting
}

/// The similarity that brings a model, which may be bent, near to the measured coordinates of
/// marked points, of which up to half may be wrong. With `keeps_scale` its scale is 1.
///
/// # Errors
///
/// The points do not determine it.
pub fn first_similarity_to_points(
    model: &Reconstruction,
    points: &[MarkedPoint],
    keeps_scale: bool,
) -> Result<Sim3, ControlMisfit> {
    let found = places(model, points);
    // In metres, as errors of a bent model are alike for all points.
    let (_, mut pairs) = determined(points, &found, &Sim3::identity());
    pairs.iter_mut().for_each(|pair| pair.sigmas = Vector3::repeat(1.0));
    let usable = pairs.len();
    if usable < MIN_POINTS {
        return Err(ControlMisfit::TooFew { usable });
    }
    let Some(similarity) = spatial(&pairs, keeps_scale, NUM_SAMPLES, 0) else {
        let (rotation_sd_rad, scale_sd) = (f64::INFINITY, f64::INFINITY);
        return Err(ControlMisfit::Uncertain { usable, rotation_sd_rad, scale_sd });
    };
    let sigma_m = scale_of_residuals(&pairs, &similarity);
    let extent_m = extent(pairs.iter().map(|pair| pair.measured));
    // No number is within no bound.
    let fits = sigma_m <= MAX_BENDING * extent_m;
    if !fits {
        return Err(ControlMisfit::Contradiction { sigma_m, extent_m });
    }
    let free = Free::all_but_scale(keeps_scale);
    let (_, whitened) = determined(points, &found, &similarity);
    let (_, variances) = refined(&whitened, similarity, &free, LOSS);
    check_certain(usable, &variances)?;
    let (similarity, _) = refined(&pairs, similarity, &free, LOSS);
    check_upright(model, &whitened, &similarity)?;
    Ok(similarity)
}

/// The similarity of least squares that brings the marked points of a model to their measured
/// coordinates, without the points that the others contradict.
///
/// # Errors
///
/// The points do not determine the similarity.
pub fn align_to_points(
    model: &Reconstruction,
    points: &[MarkedPoint],
) -> Result<ControlAlignment, ControlMisfit> {
    let start = first_similarity_to_points(model, points, false)?;
    let found = places(model, points);
    let (tested, pairs) = determined(points, &found, &start);
    let redundancy = redundancy(&pairs, &start);
    // All points are off that a bent model does not fit; wrong ones are farther off.
    let scale = scale_of_residuals(&pairs, &start).max(1.0);
    let near = fitting(&pairs, &start, scale * MAX_RIGHT);
    let far: Vec<usize> = (0..pairs.len()).filter(|k| !near.contains(k)).collect();
    let left_out = redundancy.left_out(&far, MIN_POINTS);
    let verdicts = redundancy.verdicts(&left_out);
    let of_used = tested.iter().copied().zip(pairs).enumerate();
    let (used, pairs): (Vec<usize>, Vec<Pair>) =
        of_used.filter(|(k, _)| !left_out.contains(k)).map(|(_, used)| used).unzip();
    let (similarity, variances) = refined(&pairs, start, &Free::all(), Loss::Trivial);
    check_certain(used.len(), &variances)?;
    check_upright(model, &pairs, &similarity)?;
    let mut points = errors(model, points, &found, &similarity, &|k| used.contains(&k));
    for (&point, verdict) in tested.iter().zip(verdicts) {
        points[point].set_verdict(verdict, &tested);
    }
    Ok(ControlAlignment { term_from_model: similarity, points })
}

/// What the residuals of a least-squares similarity to all pairs tell, linearised at one.
fn redundancy(pairs: &[Pair], similarity: &Sim3) -> Redundancy {
    let middle = pairs.iter().map(|pair| *similarity * pair.found).sum::<Vector3<f64>>()
        / pairs.len() as f64;
    let mut residuals = DVector::zeros(3 * pairs.len());
    let mut jacobian = DMatrix::zeros(3 * pairs.len(), 7);
    for (k, pair) in pairs.iter().enumerate() {
        let (residual, rows) = pair.linearised(similarity, &middle);
        residuals.rows_mut(3 * k, 3).copy_from(&residual);
        jacobian.rows_mut(3 * k, 3).copy_from(&rows);
    }
    Redundancy::of_fit(&residuals, jacobian, pairs.iter().map(|pair| pair.sigmas).collect())
}

/// # Errors
///
/// A rotation or the scale is uncertain.
fn check_certain(usable: usize, variances: &SVector<f64, 7>) -> Result<(), ControlMisfit> {
    let rotation_sd_rad = variances.fixed_rows::<3>(3).sum().sqrt();
    let scale_sd = variances[6].sqrt();
    // No number is within no bound.
    match rotation_sd_rad <= MAX_SD && scale_sd <= MAX_SD {
        true => Ok(()),
        false => Err(ControlMisfit::Uncertain { usable, rotation_sd_rad, scale_sd }),
    }
}

/// # Errors
///
/// The model would be upside down.
fn check_upright(
    model: &Reconstruction,
    pairs: &[Pair],
    similarity: &Sim3,
) -> Result<(), ControlMisfit> {
    let places: Vec<Vector3<f64>> =
        pairs.iter().map(|pair| pair.measured.component_div(&pair.sigmas)).collect();
    match is_upside_down(&axes_of(model), similarity, &places) {
        true => Err(ControlMisfit::UpsideDown),
        false => Ok(()),
    }
}

/// The median distance of places from their median.
fn extent(places: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let of_axis =
        |axis: usize| median(&mut places.clone().map(|xyz| xyz[axis]).collect::<Vec<_>>());
    let middle = Vector3::from_fn(|axis, _| of_axis(axis).unwrap_or(f64::NAN));
    let mut distances: Vec<f64> = places.map(|xyz| (xyz - middle).norm()).collect();
    median(&mut distances).unwrap_or(f64::NAN)
}
