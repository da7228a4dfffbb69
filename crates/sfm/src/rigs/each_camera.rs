//! Standard deviations for each camera of a rig.
//!
//! All cameras are constrained with common standard deviations first. If these do not reach the
//! floor, one camera on a loose mount may be the reason. Each camera is then judged alone, with the
//! others free, and all are constrained together with what each of them permits. A camera that
//! permits no constraint stays free.

use std::slice;

use tiepoint_scene::Reconstruction;

use super::context::{Context, MERGE_ERROR_FACTOR};
use super::extrinsics::RigConstraint;
use super::gating::UnmatchedImages;
use super::held_out::HeldOutComparison;
use super::sensor_pair::SensorPair;
use super::sigma_selection::{ConstrainedModel, HELD_OUT_TOLERANCE, SigmaSelection, adopt_clocks};
use crate::Error;
use crate::options::RigMode;

impl Context<'_> {
    /// Selects the standard deviations of soft constraints: common ones, or those of each camera.
    /// `model` and the clocks end at the last accepted step.
    pub(super) fn select_sigmas(
        &mut self,
        model: &mut Reconstruction,
        sensor_pairs: &mut [SensorPair],
        mode: RigMode,
        comparison: &HeldOutComparison,
    ) -> Result<SigmaSelection, Error> {
        let (off, mut own) = (model.clone(), sensor_pairs.to_vec());
        let common = self.select_common_sigmas(model, sensor_pairs, mode, comparison)?;
        let is_repaired = !common.split_images.is_empty();
        if own.len() < 2 || common.is_at_floor || is_repaired || mode == RigMode::Rigid {
            return Ok(common);
        }
        let mut permitted = Vec::new();
        for sensor_pair in &mut own {
            let cameras = [sensor_pair.reference, sensor_pair.other];
            let comparison = comparison.of_cameras(cameras, &off);
            let alone = slice::from_mut(sensor_pair);
            let found = self.select_common_sigmas(&mut off.clone(), alone, mode, &comparison)?;
            permitted.push(found.best.map(|best| best.sigmas));
        }
        if common.best.is_some() && permitted.contains(&None) {
            return Ok(common);
        }
        let found = self.constrain_each(&off, &own, &permitted, comparison)?;
        let is_better = |found: &ConstrainedModel| {
            common.best.as_ref().is_none_or(|common| {
                !comparison.is_significantly_worse(&found.model, &common.model)
            })
        };
        let Some(best) = found.filter(is_better) else { return Ok(common) };
        adopt_clocks(sensor_pairs, &best.all_extrinsics);
        *model = best.model.clone();
        let free = own.iter().zip(&permitted).filter(|(_, sigmas)| sigmas.is_none());
        let unconstrained = free.map(|(sensor_pair, _)| sensor_pair.other).collect();
        Ok(SigmaSelection { best: Some(best), unconstrained, ..SigmaSelection::default() })
    }

    /// Constrains each camera with its own standard deviations; `None` if none permits a
    /// constraint, or if the held-out tracks or the relative poses contradict them together.
    fn constrain_each(
        &mut self,
        off: &Reconstruction,
        sensor_pairs: &[SensorPair],
        permitted: &[Option<(f64, f64)>],
        comparison: &HeldOutComparison,
    ) -> Result<Option<ConstrainedModel>, Error> {
        let mut model = off.clone();
        let (mut all_extrinsics, mut largest) = (Vec::new(), (0.0_f64, 0.0_f64));
        for (sensor_pair, sigmas) in sensor_pairs.iter().zip(permitted) {
            let Some(sigmas) = *sigmas else { continue };
            largest = (largest.0.max(sigmas.0), largest.1.max(sigmas.1));
            all_extrinsics.extend(self.rig_extrinsics(
                &model,
                slice::from_ref(sensor_pair),
                RigConstraint::soft(sigmas),
                sigmas,
                UnmatchedImages::Exclude,
            ));
        }
        if all_extrinsics.is_empty() {
            return Ok(None);
        }
        self.approach_extrinsics(&mut model, &mut all_extrinsics)?;
        self.refine(&mut model, &mut all_extrinsics, MERGE_ERROR_FACTOR)?;
        let error_px = comparison.error_px(&model);
        let constrained = ConstrainedModel { model, all_extrinsics, error_px, sigmas: largest };
        let is_right = constrained.residuals_consistent() == [true; 2]
            && !comparison.is_worse(error_px, HELD_OUT_TOLERANCE);
        Ok(is_right.then_some(constrained))
    }
}
