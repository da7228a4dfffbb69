//! Selection of the standard deviations of a soft rig constraint by the error of held-out tracks.

use std::collections::BTreeSet;

use tiepoint_adjust::AdjustOptions;
use tiepoint_rig::robust_average;
use tiepoint_scene::{CameraId, Reconstruction};

use super::context::{Context, ITERATIONS, MERGE_ERROR_FACTOR};
use super::extrinsics::{RigConstraint, RigExtrinsics, SplitImage, relative_poses, robust_sigmas};
use super::extrinsics_term::adjust_with_extrinsics;
use super::gating::UnmatchedImages;
use super::held_out::HeldOutComparison;
use super::sensor_pair::{ClockState, SensorPair};
use super::solution::ConstraintLimit;
use crate::Error;
use crate::options::RigMode;

/// Smallest standard deviations: translation in baselines, rotation in radians. At this level the
/// constraint is rigid for any image.
const SIGMA_FLOOR: (f64, f64) = (0.0001, 0.0006 * std::f64::consts::PI / 180.0);
/// Largest initial standard deviations.
const SIGMA_CEILING: (f64, f64) = (0.3, 0.05);
/// Division of the standard deviations in each step, and the number of steps.
const SIGMA_STEP: f64 = 3.0;
const MAX_STEPS: usize = 8;
/// Maximum relative increase of the held-out error by the constraint. Lens biases cause an
/// increase: on KITTI 01 a rigid rig causes 6 %. Clock errors that matter cause far more.
pub(super) const HELD_OUT_TOLERANCE: f64 = 0.08;
/// Factors on the standard deviations, applied one after the other, to move images of a split
/// towards their extrinsics.
const SPLIT_SIGMA_FACTORS: [f64; 3] = [30.0, 10.0, 3.0];
/// Maximum relative increase of the held-out error for a repaired split, before all tracks are
/// re-created.
const SPLIT_TOLERANCE: f64 = 0.3;

/// A model adjusted with a rig constraint.
pub(super) struct ConstrainedModel {
    pub(super) model: Reconstruction,
    pub(super) all_extrinsics: Vec<RigExtrinsics>,
    pub(super) error_px: f64,
    /// The largest standard deviations of a camera.
    pub(super) sigmas: (f64, f64),
}

impl ConstrainedModel {
    /// Whether the residuals of translation and of rotation are consistent for all cameras.
    pub(super) fn residuals_consistent(&self) -> [bool; 2] {
        let each = self
            .all_extrinsics
            .iter()
            .map(|extrinsics| extrinsics.residuals_consistent(&self.model));
        each.fold([true; 2], |all, one| [all[0] && one[0], all[1] && one[1]])
    }

    pub(super) fn has_synchronised_sensors(&self) -> bool {
        self.all_extrinsics
            .iter()
            .any(|extrinsics| extrinsics.sensor_pair.clock_state == ClockState::Synchronised)
    }
}

/// Result of the selection.
#[derive(Default)]
pub(super) struct SigmaSelection {
    pub(super) best: Option<ConstrainedModel>,
    /// Whether `best` has the smallest standard deviations.
    pub(super) is_at_floor: bool,
    /// Why it has no smaller ones, if it has not the smallest.
    pub(super) limit: Option<ConstraintLimit>,
    /// Images of splits that were constrained without matches across cameras.
    pub(super) split_images: BTreeSet<SplitImage>,
    /// Cameras that permit no constraint although others do.
    pub(super) unconstrained: Vec<CameraId>,
}

impl Context<'_> {
    /// Selects common standard deviations of soft constraints. `model` and the clocks end at the
    /// last accepted step. Splits without matches across cameras are repaired only if the held-out
    /// error permits it.
    pub(super) fn select_common_sigmas(
        &mut self,
        model: &mut Reconstruction,
        sensor_pairs: &mut [SensorPair],
        mode: RigMode,
        comparison: &HeldOutComparison,
    ) -> Result<SigmaSelection, Error> {
        let (mut repaired, mut clocks) = (model.clone(), sensor_pairs.to_vec());
        let selection = self.select_sigmas_with(
            &mut repaired,
            &mut clocks,
            mode,
            comparison,
            UnmatchedImages::ConstrainRuns,
        )?;
        let is_worse = |constrained: &ConstrainedModel| {
            comparison.is_worse(constrained.error_px, HELD_OUT_TOLERANCE)
        };
        if !selection.split_images.is_empty() && selection.best.as_ref().is_none_or(is_worse) {
            return self.select_sigmas_with(
                model,
                sensor_pairs,
                mode,
                comparison,
                UnmatchedImages::Exclude,
            );
        }
        *model = repaired;
        sensor_pairs.copy_from_slice(&clocks);
        Ok(selection)
    }

    /// The selection with or without repair of splits.
    fn select_sigmas_with(
        &mut self,
        model: &mut Reconstruction,
        sensor_pairs: &mut [SensorPair],
        mode: RigMode,
        comparison: &HeldOutComparison,
        unmatched: UnmatchedImages,
    ) -> Result<SigmaSelection, Error> {
        let found = largest_sigmas(model, sensor_pairs);
        let mut sigmas = (
            found.0.clamp(SIGMA_FLOOR.0, SIGMA_CEILING.0),
            found.1.clamp(SIGMA_FLOOR.1, SIGMA_CEILING.1),
        );
        let mut selection = SigmaSelection::default();
        // The spread of free poses is more than the mount turns, but neighbouring frames turn
        // alike: one step more.
        let loosest = (SIGMA_STEP * sigmas.1).min(SIGMA_CEILING.1);
        let mut is_flexible = false;
        // The model with the least error of the held-out tracks.
        let (mut least, mut least_px) = (model.clone(), comparison.error_off_px);
        for step in 0..MAX_STEPS {
            let merge_error_factor = if step == 0 { MERGE_ERROR_FACTOR } else { 1.0 };
            let mut constrain = |sigmas| {
                self.constrain_softly(
                    model,
                    sensor_pairs,
                    sigmas,
                    unmatched,
                    merge_error_factor,
                    comparison,
                )
            };
            let (mut constrained, tolerance) = constrain(sigmas)?;
            // The tracks of a split fit its extrinsics only when they are created again.
            let has_split = tolerance == SPLIT_TOLERANCE;
            if !(is_flexible || has_split) && is_costly(&constrained, &least, comparison) {
                is_flexible = loosen_rotation(&mut constrained, loosest, comparison, constrain)?;
                sigmas = constrained.sigmas;
            }
            let ConstrainedModel { model: candidate, all_extrinsics, error_px, .. } = constrained;
            selection.split_images.extend(
                all_extrinsics
                    .iter()
                    .flat_map(|extrinsics| extrinsics.split_images.iter().copied()),
            );
            let is_mandatory = mode != RigMode::Auto && step == 0;
            if !is_mandatory && comparison.is_worse(error_px, tolerance) {
                if selection.limit != Some(ConstraintLimit::Residuals) {
                    selection.limit = Some(ConstraintLimit::HeldOutError { error_px });
                }
                break;
            }
            adopt_clocks(sensor_pairs, &all_extrinsics);
            let constrained =
                ConstrainedModel { model: candidate.clone(), all_extrinsics, error_px, sigmas };
            if constrained.residuals_consistent() == [true; 2] || is_mandatory {
                selection.best = Some(constrained);
                selection.is_at_floor = sigmas == SIGMA_FLOOR;
                selection.limit = is_flexible.then_some(ConstraintLimit::FlexibleRotation);
            } else {
                selection.limit = Some(ConstraintLimit::Residuals);
            }
            if error_px < least_px {
                (least, least_px) = (candidate.clone(), error_px);
            }
            *model = candidate;
            let divided = |sigma: f64, floor: f64| (sigma / SIGMA_STEP).max(floor);
            let rotation = if is_flexible { sigmas.1 } else { divided(sigmas.1, SIGMA_FLOOR.1) };
            let next = (divided(sigmas.0, SIGMA_FLOOR.0), rotation);
            if next == sigmas {
                break;
            }
            sigmas = next;
        }
        Ok(selection)
    }

    /// Adjusts a model with a soft constraint. Also returns the tolerance on its held-out error.
    fn constrain_softly(
        &mut self,
        model: &Reconstruction,
        sensor_pairs: &[SensorPair],
        sigmas: (f64, f64),
        unmatched: UnmatchedImages,
        merge_error_factor: f64,
        comparison: &HeldOutComparison,
    ) -> Result<(ConstrainedModel, f64), Error> {
        let mut model = model.clone();
        let mut all_extrinsics = self.rig_extrinsics(
            &model,
            sensor_pairs,
            RigConstraint::soft(sigmas),
            sigmas,
            unmatched,
        );
        let tolerance =
            if all_extrinsics.iter().any(|extrinsics| !extrinsics.split_images.is_empty()) {
                self.approach_extrinsics(&mut model, &mut all_extrinsics)?;
                SPLIT_TOLERANCE
            } else {
                HELD_OUT_TOLERANCE
            };
        self.refine(&mut model, &mut all_extrinsics, merge_error_factor)?;
        let error_px = comparison.error_px(&model);
        Ok((ConstrainedModel { model, all_extrinsics, error_px, sigmas }, tolerance))
    }

    /// Moves images of a split near to their extrinsics with decreasing standard deviations and
    /// constant clocks. In a single step the adjustment would need hundreds of iterations and would
    /// move the clocks to wrong values.
    pub(super) fn approach_extrinsics(
        &mut self,
        model: &mut Reconstruction,
        all_extrinsics: &mut [RigExtrinsics],
    ) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        for factor in SPLIT_SIGMA_FACTORS {
            let mut loose: Vec<RigExtrinsics> = all_extrinsics
                .iter()
                .map(|m| {
                    let sensor_pair = SensorPair {
                        clock_state: m.sensor_pair.clock_state.constant(),
                        ..m.sensor_pair
                    };
                    RigExtrinsics {
                        constraint: m.constraint.scaled(factor),
                        sensor_pair,
                        ..m.clone()
                    }
                })
                .collect();
            adjust_with_extrinsics(model, &options, &mut loose, &mut self.terms)?;
            for (extrinsics, loose) in all_extrinsics.iter_mut().zip(loose) {
                extrinsics.cam_from_rig = loose.cam_from_rig;
            }
        }
        Ok(())
    }
}

/// Whether a constraint increases the error of the held-out tracks significantly, or leaves
/// rotations that are too large for it.
fn is_costly(
    constrained: &ConstrainedModel,
    than: &Reconstruction,
    comparison: &HeldOutComparison,
) -> bool {
    !constrained.residuals_consistent()[1]
        || comparison.is_significantly_worse(&constrained.model, than)
}

/// Multiplies the standard deviation of the rotation alone, up to `loosest`, as long as the smaller
/// one is costly. Returns whether it was: the mount is flexible.
fn loosen_rotation(
    constrained: &mut ConstrainedModel,
    loosest: f64,
    comparison: &HeldOutComparison,
    mut constrain: impl FnMut((f64, f64)) -> Result<(ConstrainedModel, f64), Error>,
) -> Result<bool, Error> {
    let mut is_flexible = false;
    loop {
        let (translation, rotation) = constrained.sigmas;
        let looser = (translation, (SIGMA_STEP * rotation).min(loosest));
        if looser == constrained.sigmas {
            break;
        }
        let (loose, _) = constrain(looser)?;
        if !is_costly(constrained, &loose.model, comparison) {
            break;
        }
        is_flexible = true;
        *constrained = loose;
    }
    Ok(is_flexible)
}

/// Sets the clocks to those of an adjusted model.
pub(super) fn adopt_clocks(sensor_pairs: &mut [SensorPair], all_extrinsics: &[RigExtrinsics]) {
    for extrinsics in all_extrinsics {
        sensor_pairs
            .iter_mut()
            .filter(|sensor_pair| sensor_pair.other == extrinsics.sensor_pair.other)
            .for_each(|sensor_pair| sensor_pair.clock = extrinsics.sensor_pair.clock);
    }
}

/// The largest robust standard deviations over all sensor pairs.
fn largest_sigmas(model: &Reconstruction, sensor_pairs: &[SensorPair]) -> (f64, f64) {
    let mut largest = (0.0_f64, 0.0_f64);
    for sensor_pair in sensor_pairs {
        let poses =
            relative_poses(model, &sensor_pair.referenced_images(model), &sensor_pair.clock);
        let Some(average) = robust_average(&poses) else { continue };
        let (t, r) = robust_sigmas(&poses, &average, sensor_pair.assumed_baseline);
        largest = (largest.0.max(t), largest.1.max(r));
    }
    largest
}
