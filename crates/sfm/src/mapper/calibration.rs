//! Whether calibrations are exact or priors.

use tiepoint_adjust::calibration_evidence;

use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;
use crate::tracks::without_points_at_infinity;

/// Logarithm of the Bayes factor above which images contradict a calibration: "very strong"
/// evidence (Kass and Raftery 1995, section 3.2). Nine rendered drives with exact intrinsics and a
/// lens field of 0.15 px have -10 to 0.3, two photo sets -0.2 to 4.7; windows of KITTI 04 and 01
/// have 17 to 27 and 179 to 330. Focal lengths that are 1 % off have 14 to 291, and 0.3 % -8 to 33.
/// Half changes nothing here but one photo set, double one drive and one photo set that are 0.3 %
/// off.
const VERY_STRONG: f64 = 5.0;

impl Refiner<'_> {
    /// Keeps calibrations as they are, unless the images contradict them.
    pub(super) fn judge_calibrations(&mut self, watch: &mut Watch) -> Result<(), Error> {
        if !self.input.options.keep_calibrations {
            return Ok(());
        }
        let options = self.adjust_options(&RefinementSchedule::FINAL);
        let model = &self.solution.model;
        // A model that is too weak for an answer keeps its priors.
        let found = calibration_evidence(&without_points_at_infinity(model), &options);
        let Ok(Some(evidence)) = found else { return Ok(()) };
        self.solution.calibration_evidence = Some(evidence);
        if evidence > VERY_STRONG {
            return Ok(());
        }
        let model = &mut self.solution.model;
        for (id, prior) in model.intrinsics_priors.clone() {
            if model.camera(id).intrinsics.kind() == prior.mean.kind() {
                model.camera_mut(id).intrinsics = prior.mean;
                model.calibrated.insert(id);
            }
        }
        self.refine_globally(&RefinementSchedule::FINAL, watch)
    }
}
