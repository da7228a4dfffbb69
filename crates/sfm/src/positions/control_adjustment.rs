//! Adjustment of a model together with control points, of which some may be wrong.
//!
//! 1. *Start.* The similarity of least median of the residuals, which up to half of wrong points do
//!    not move. The model may be bent: an unknown lens, or drift.
//! 2. *Robust adjustments.* Marks and positions have a Cauchy loss. Its scale begins with the size
//!    of the residuals, so that all points straighten a bent model, and shrinks by four from one
//!    adjustment to the next, so that wrong points lose their pull (graduated non-convexity, Blake
//!    and Zisserman 1987).
//! 3. *Least squares.* The points that fit take part with the squared loss. Those that the adjusted
//!    model predicts are taken in, and those that contradict the others are left out
//!    ([`Redundancy`]), until that changes nothing.

use std::ops::ControlFlow;

use tiepoint_adjust::{AdjustOptions, Error, Scope, Term, adjust, build_problem};
use tiepoint_ba::{AnyKey, IterationRecord, Key, Summary};
use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::{DMatrix, Matrix3, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_scene::Reconstruction;

use super::alignment::{Free, Pair, axes_of, is_upside_down, refined, scale_of_residuals, spatial};
use super::control_points::{
    ControlMisfit, Found, MAX_SD, MIN_POINTS, MarkedPoint, PointError, errors, places, sigmas,
};
use super::control_term::{ControlLandmark, ControlTerm};
use super::redundancy::Redundancy;
use crate::terms::with_terms;
use crate::tracks::{filter_images, without_points_at_infinity};

/// Samples of three points for the start. With half of all points wrong, all of 100 contain a wrong
/// one with a probability of 0.875¹⁰⁰ = 2e-6.
const NUM_SAMPLES: usize = 100;
/// Largest residuals at the start, relative to the extent of the points: an unknown lens bends
/// models by hundredths. Points with swapped coordinates or of other places are off by their
/// extent.
const MAX_BENDING: f64 = 0.1;
/// Scale of the loss in the last robust adjustment, in standard deviations: two thirds of
/// [`MAX_RIGHT`], so that a point at that limit has a third of its weight.
const LOSS_SCALE: f64 = 2.7;
/// From one robust adjustment to the next the scale of the loss shrinks by this factor: a choice.
/// With 2 there are twice as many adjustments.
const SHRINKAGE: f64 = 4.0;
/// Norm of a point's residual, in standard deviations, that one right point in a thousand exceeds:
/// the root of the 99.9 % quantile of χ² with three degrees of freedom.
const MAX_RIGHT: f64 = 4.03;
/// Fewest points that determine the pose of an image. One that they do not determine would leave
/// the whole information matrix singular.
const MIN_IMAGE_POINTS: usize = 3;
/// Adjustments without robust loss: where it is not settled after these which points contradict the
/// others, two explanations are alike, and the last one is taken.
const MAX_ROUNDS: usize = 5;

/// A model that was adjusted with control points.
#[derive(Clone, Debug)]
pub struct ControlAdjustment {
    /// Of the last adjustment.
    pub summary: Summary,
    /// The points, in their order.
    pub points: Vec<PointError>,
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
    let used: Vec<(&MarkedPoint, &Found)> = points
        .iter()
        .zip(&found)
        .filter(|(point, _)| !point.is_check)
        .filter_map(|(point, found)| Some((point, found.as_ref()?)))
        .collect();
    let usable = used.len();
    if usable < MIN_POINTS {
        return Err(ControlMisfit::TooFew { usable });
    }
    let uncertain = |rotation_sd_rad, scale_sd| {
        Err(ControlMisfit::Uncertain { usable, rotation_sd_rad, scale_sd })
    };
    let pairs_with = |sigmas: &dyn Fn(&MarkedPoint, &Found) -> Vector3<f64>| -> Vec<Pair> {
        let pair = |(point, found): &(&MarkedPoint, &Found)| Pair {
            found: found.xyz,
            measured: point.xyz,
            sigmas: sigmas(point, found),
            axes: Matrix3::identity(),
        };
        used.iter().map(pair).collect()
    };
    // In metres, as errors of a bent model are alike for all points.
    let pairs = pairs_with(&|_, _| Vector3::repeat(1.0));
    let Some(similarity) = spatial(&pairs, keeps_scale, NUM_SAMPLES, 0) else {
        return uncertain(f64::INFINITY, f64::INFINITY);
    };
    let sigma_m = scale_of_residuals(&pairs, &similarity);
    let extent_m = extent(used.iter().map(|(point, _)| point.xyz));
    // No number is within no bound.
    let fits = sigma_m <= MAX_BENDING * extent_m;
    if !fits {
        return Err(ControlMisfit::Contradiction { sigma_m, extent_m });
    }
    let free = Free::all_but_scale(keeps_scale);
    let whitened = pairs_with(&|point, found| sigmas(point, found, &similarity));
    let (_, variances) = refined(&whitened, similarity, &free);
    let rotation_sd_rad = variances.fixed_rows::<3>(3).sum().sqrt();
    let scale_sd = variances[6].sqrt();
    let is_certain = rotation_sd_rad <= MAX_SD && scale_sd <= MAX_SD;
    if !is_certain {
        return uncertain(rotation_sd_rad, scale_sd);
    }
    let (similarity, _) = refined(&pairs, similarity, &free);
    let places: Vec<Vector3<f64>> =
        whitened.iter().map(|pair| pair.measured.component_div(&pair.sigmas)).collect();
    if is_upside_down(&axes_of(model), &similarity, &places) {
        return Err(ControlMisfit::UpsideDown);
    }
    Ok(similarity)
}

/// The median distance of places from their median.
fn extent(places: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let of_axis =
        |axis: usize| median(&mut places.clone().map(|xyz| xyz[axis]).collect::<Vec<_>>());
    let middle = Vector3::from_fn(|axis, _| of_axis(axis).unwrap_or(f64::NAN));
    let mut distances: Vec<f64> = places.map(|xyz| (xyz - middle).norm()).collect();
    median(&mut distances).unwrap_or(f64::NAN)
}

/// Adjusts a model that is near the frame of control points ([`first_similarity_to_points`])
/// together with them. `options` are those of the adjustment, whose gauge the points fix; `terms`
/// are further ones.
///
/// # Errors
///
/// Those of [`tiepoint_adjust::adjust`].
pub fn adjust_to_points(
    model: &mut Reconstruction,
    points: &[MarkedPoint],
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
    watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
) -> Result<ControlAdjustment, Error> {
    let mut run = Run { points, options, terms, watch };
    run.robustly(model)?;
    let mut used = run.fitting(&places(model, points));
    let mut round = 1;
    let (fit, verdicts) = loop {
        let fit = run.with(model, &used)?;
        let Some((tested, redundancy)) = run.redundancy(model, &fit.landmarks, &used) else {
            break (fit, None);
        };
        let left_out: Vec<usize> =
            (0..tested.len()).filter(|k| !used.contains(&tested[*k])).collect();
        let next = redundancy.left_out(&left_out, MIN_POINTS);
        if next == left_out || round == MAX_ROUNDS {
            break (fit, Some((tested, redundancy.verdicts(&left_out))));
        }
        used = (0..tested.len()).filter(|k| !next.contains(k)).map(|k| tested[k]).collect();
        round += 1;
    };
    let found = places(model, points);
    let mut errors = errors(model, points, &found, &Sim3::identity(), &|k| used.contains(&k));
    if let Some((tested, verdicts)) = verdicts {
        for (&point, verdict) in tested.iter().zip(verdicts) {
            errors[point].set_verdict(verdict, &tested);
        }
    } else {
        // Nothing tells the points that do not fit from the others.
        let all: Vec<usize> = run.control().filter(|k| found[*k].is_some()).collect();
        for (k, error) in errors.iter_mut().enumerate().filter(|(_, error)| error.is_wrong) {
            error.is_wrong = false;
            error.alternatives = all.iter().copied().filter(|other| *other != k).collect();
        }
    }
    Ok(ControlAdjustment { summary: fit.summary, points: errors })
}

/// An adjustment, and the points after it.
struct Fit {
    summary: Summary,
    landmarks: Vec<ControlLandmark>,
}

struct Run<'a, 'b> {
    points: &'a [MarkedPoint],
    options: &'a AdjustOptions<'a>,
    terms: &'a mut [&'b mut dyn Term],
    watch: &'a mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
}

impl Run<'_, '_> {
    /// Indices of the points that are no check points.
    fn control(&self) -> impl Iterator<Item = usize> + use<'_> {
        (0..self.points.len()).filter(|k| !self.points[*k].is_check)
    }

    fn adjust(
        &mut self,
        model: &mut Reconstruction,
        landmarks: Vec<ControlLandmark>,
        loss_scale: Option<f64>,
    ) -> Result<Fit, Error> {
        let mut term = ControlTerm::new(landmarks, loss_scale);
        let terms = &mut with_terms(&mut term, self.terms);
        let summary = adjust(model, &Scope::Global, self.options, terms, self.watch)?;
        Ok(Fit { summary, landmarks: term.landmarks })
    }

    /// A landmark for each control point that its marks determine, of these marks.
    fn landmark(&self, k: usize, found: &Found, is_used: bool, marks: &[usize]) -> ControlLandmark {
        let point = &self.points[k];
        ControlLandmark {
            xyz: found.xyz,
            measured: is_used.then_some((point.xyz, point.sigmas_m)),
            marks: marks.iter().map(|&mark| point.marks[mark]).collect(),
            mark_sigma_px: point.mark_sigma_px,
        }
    }

    /// Adjusts with a robust loss, whose scale shrinks.
    fn robustly(&mut self, model: &mut Reconstruction) -> Result<(), Error> {
        let mut scale = self.spread(&places(model, self.points)).max(1.0);
        loop {
            let found = places(model, self.points);
            let of_point = |k: usize| {
                let marks: Vec<usize> = (0..self.points[k].marks.len()).collect();
                Some(self.landmark(k, found[k].as_ref()?, true, &marks))
            };
            let landmarks = self.control().filter_map(of_point).collect();
            let fit = self.adjust(model, landmarks, Some(LOSS_SCALE * scale))?;
            if scale <= 1.0 || fit.summary.termination == tiepoint_ba::Termination::Cancelled {
                return Ok(());
            }
            scale = (scale / SHRINKAGE).max(1.0);
        }
    }

    /// Robust size of the residuals of a model, in their deviations.
    fn spread(&self, found: &[Option<Found>]) -> f64 {
        let pair = |k: usize| {
            let (point, found) = (&self.points[k], found[k].as_ref()?);
            let sigmas = sigmas(point, found, &Sim3::identity());
            let axes = Matrix3::identity();
            Some(Pair { found: found.xyz, measured: point.xyz, sigmas, axes })
        };
        let pairs: Vec<Pair> = self.control().filter_map(pair).collect();
        scale_of_residuals(&pairs, &Sim3::identity())
    }

    /// The points that fit a model, and no fewer than determine its frame.
    fn fitting(&self, found: &[Option<Found>]) -> Vec<usize> {
        let norm = |k: usize| {
            let (point, found) = (&self.points[k], found[k].as_ref()?);
            let error = found.xyz - point.xyz;
            Some((error.component_div(&sigmas(point, found, &Sim3::identity())).norm(), k))
        };
        let mut all: Vec<(f64, usize)> = self.control().filter_map(norm).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let fits =
            |(rank, (norm, _)): &(usize, (f64, usize))| *rank < MIN_POINTS || *norm <= MAX_RIGHT;
        let mut fitting: Vec<usize> =
            all.into_iter().enumerate().filter(fits).map(|(_, (_, k))| k).collect();
        fitting.sort_unstable();
        fitting
    }

    /// Adjusts with the squared loss for some points, by their marks that agree.
    fn with(&mut self, model: &mut Reconstruction, used: &[usize]) -> Result<Fit, Error> {
        let landmarks = self.landmarks(&places(model, self.points), used);
        self.adjust(model, landmarks, None)
    }

    /// A landmark for each point; those that are not used have no measured coordinates, and those
    /// that are not determined no marks.
    fn landmarks(&self, found: &[Option<Found>], used: &[usize]) -> Vec<ControlLandmark> {
        let of_point = |(k, found): (usize, &Option<Found>)| match found {
            Some(found) if used.contains(&k) => self.landmark(k, found, true, &found.inliers),
            _ => {
                let (xyz, mark_sigma_px) = (self.points[k].xyz, self.points[k].mark_sigma_px);
                ControlLandmark { xyz, measured: None, marks: Vec::new(), mark_sigma_px }
            }
        };
        found.iter().enumerate().map(of_point).collect()
    }

    /// What the residuals of the control points tell that the marks determine, and these points.
    /// `None` where the model does not determine its covariance.
    fn redundancy(
        &mut self,
        model: &Reconstruction,
        adjusted: &[ControlLandmark],
        used: &[usize],
    ) -> Option<(Vec<usize>, Redundancy)> {
        let found = places(model, self.points);
        let mut landmarks = self.landmarks(&found, used);
        for (k, landmark) in landmarks.iter_mut().enumerate() {
            match &found[k] {
                Some(_) if used.contains(&k) => landmark.xyz = adjusted[k].xyz,
                Some(found) if !self.points[k].is_check => {
                    *landmark = self.landmark(k, found, false, &found.inliers);
                }
                _ => {}
            }
        }
        let mut term = ControlTerm::new(landmarks, None);
        let mut near = without_points_at_infinity(model);
        filter_images(&mut near, MIN_IMAGE_POINTS, &|_| false);
        let variables = {
            let terms = &mut with_terms(&mut term, self.terms);
            build_problem(&near, &Scope::Global, self.options, terms).ok()?
        };
        let with_key = |(k, key): (usize, &Option<Key<Vector3<f64>>>)| {
            let key: AnyKey = (*key)?.into();
            Some((k, key))
        };
        let (tested, keys): (Vec<usize>, Vec<AnyKey>) =
            term.keys.iter().enumerate().filter_map(with_key).unzip();
        let covariance = variables.problem().covariance(&keys).ok()?;
        let covariance: DMatrix<f64> = covariance.matrix() * self.options.noise.powi(2);
        let points = self.points;
        let errors = tested.iter().map(|&k| term.landmarks[k].xyz - points[k].xyz);
        let errors: Vec<Vector3<f64>> = errors.collect();
        let sigmas: Vec<Vector3<f64>> = tested.iter().map(|&k| points[k].sigmas_m).collect();
        let is_used: Vec<bool> = tested.iter().map(|k| used.contains(k)).collect();
        Some((tested, Redundancy::new(&errors, &sigmas, &covariance, &is_used)))
    }
}
