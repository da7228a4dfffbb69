//! Whether calibrations are exact or priors.

use tiepoint_adjust::{CalibrationEvidence, Scope, calibration_evidence};
use tiepoint_scene::{CameraId, IntrinsicsPrior, Reconstruction};

use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;

/// Logarithm of the Bayes factor above which images contradict a calibration: "very strong"
/// evidence (Kass and Raftery 1995, section 3.2). Rendered drives with exact intrinsics and a lens
/// field of 0.15 px have -10 to -2, photos of two places -0.3 to 2, windows of KITTI 04 and 01 16
/// to 363. Focal lengths that are 1 % off have 23 to 227 on the photos, 70 to 142 on a loop and
/// from a drone, 3 to 4 from a hand and -3 on a highway. Half refines those from a hand; double
/// keeps some that are 0.3 % off.
pub(super) const VERY_STRONG: f64 = 5.0;

impl Refiner<'_> {
    /// Makes calibrations priors again that were kept: the model may be a joined one.
    pub(super) fn restore_calibration_priors(&mut self) {
        let Reconstruction { calibrated, intrinsics_priors, .. } = &mut self.solution.model;
        calibrated.retain(|camera| !intrinsics_priors.contains_key(camera));
    }

    /// Keeps calibrations as they are, unless the images contradict them. Images that are too few
    /// to tell contradict nothing.
    pub(super) fn test_calibrations(&mut self, watch: &mut Watch) -> Result<(), Error> {
        let model = &self.solution.model;
        let registered = model.registered_cameras();
        let calibrated: Vec<(CameraId, IntrinsicsPrior)> = model
            .intrinsics_priors
            .iter()
            .filter(|(id, prior)| {
                registered.contains(id) && model.camera(**id).intrinsics.kind() == prior.mean.kind()
            })
            .map(|(id, prior)| (*id, prior.clone()))
            .collect();
        if !self.input.options.keep_calibrations || calibrated.is_empty() {
            return Ok(());
        }
        let options = self.adjust_options(&RefinementSchedule::FINAL);
        let found = calibration_evidence(model, &options);
        let CalibrationEvidence { log_bayes_factor, cameras } = found.unwrap_or_default();
        if let Some(evidence) = log_bayes_factor {
            let tested = cameras.into_iter().map(|camera| (camera, evidence));
            self.solution.calibration_evidence = tested.collect();
            if evidence > VERY_STRONG {
                return Ok(());
            }
        }
        let model = &mut self.solution.model;
        for (id, prior) in calibrated {
            model.camera_mut(id).intrinsics = prior.mean;
            model.calibrated.insert(id);
        }
        // Poses and points follow the intrinsics before tracks change.
        self.adjust(&Scope::Global, &RefinementSchedule::FINAL)?;
        self.complete();
        self.refine_globally(&RefinementSchedule::FINAL, watch)
    }
}
