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

use tiepoint_adjust::{
    AdjustOptions, Error, Scope, Term, adjust, build_problem, without_points_at_infinity,
};
use tiepoint_ba::{AnyKey, IterationRecord, Key, Summary};
use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::{DMatrix, Vector3};
use tiepoint_scene::Reconstruction;

use super::alignment::scale_of_residuals;
use super::control_alignment::{MAX_RIGHT, MIN_POINTS, determined, fitting};
use super::control_points::{Found, MarkedPoint, PointError, errors, places};
use super::control_term::{ControlLandmark, ControlTerm};
use super::redundancy::Redundancy;
use crate::terms::with_terms;
use crate::tracks::filter_images;

/// Scale of the loss in the last robust adjustment, in standard deviations: two thirds of
/// [`MAX_RIGHT`], so that a point at that limit has a third of its weight.
const LOSS_SCALE: f64 = 2.7;
/// From one robust adjustment to the next the scale of the loss shrinks by this factor: a choice.
/// With 2 there are twice as many adjustments.
const SHRINKAGE: f64 = 4.0;
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

/// Adjusts a model that is near the frame of control points ([`super::first_similarity_to_points`])
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
    let (control, pairs) = determined(points, &places(model, points), &Sim3::identity());
    let mut used: Vec<usize> =
        fitting(&pairs, &Sim3::identity(), MAX_RIGHT).into_iter().map(|k| control[k]).collect();
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
        let similarity = Sim3::identity();
        let (_, pairs) = determined(self.points, &places(model, self.points), &similarity);
        let mut scale = scale_of_residuals(&pairs, &similarity).max(1.0);
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
