//! Measured positions as a term of bundle adjustments.

use std::collections::BTreeMap;

use tiepoint_adjust::{Error, Term, TermContext, TermFrame, Variables};
use tiepoint_ba::factors::{Centre, RigCentre};
use tiepoint_geometry::Loss;
use tiepoint_scene::{ImageId, Reconstruction};

use super::alignment::align;
use super::measured::MeasuredPosition;

/// Scale of the loss, in standard deviations of a position.
const LOSS_SCALE: f64 = 2.0;

/// Measured positions as a term, from the start of growth on: it waits until a model lies reliably
/// in their frame ([`align`]). Gross errors have a bounded pull.
#[derive(Clone, Debug)]
pub struct PositionTerm {
    positions: BTreeMap<ImageId, MeasuredPosition>,
    seed: u64,
}

impl PositionTerm {
    /// Of those of these positions that have a height, with `sigmas_m` where no deviations are
    /// known.
    pub fn new(positions: &[MeasuredPosition], sigmas_m: [f64; 2], seed: u64) -> Self {
        let with_sigmas = |position: &MeasuredPosition| {
            let sigmas_m = Some(position.sigmas_m.unwrap_or(sigmas_m));
            (position.image, MeasuredPosition { sigmas_m, ..*position })
        };
        let with_height = positions.iter().filter(|position| position.has_height);
        Self { positions: with_height.map(with_sigmas).collect(), seed }
    }

    /// The factor of an image, and its loss. `noise` is the unit of residuals.
    fn factor(&self, image: ImageId, noise: f64) -> Result<Option<(Centre, Loss)>, Error> {
        let Some(position) = self.positions.get(&image) else { return Ok(None) };
        let [horizontal, vertical] =
            position.sigmas_m.unwrap_or([1.0; 2]).map(|sigma| sigma / noise);
        let factor = Centre::new(position.xyz, &[horizontal, horizontal, vertical])?;
        Ok(Some((factor, Loss::Cauchy(LOSS_SCALE * noise))))
    }
}

impl Term for PositionTerm {
    fn frame(&self, model: &Reconstruction) -> TermFrame {
        let positions: Vec<MeasuredPosition> = self.positions.values().copied().collect();
        match align(model, &positions, false, self.seed) {
            Ok(found) => TermFrame::TermFromModel(found.term_from_model),
            Err(_) => TermFrame::Undetermined,
        }
    }

    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        for (image, pose) in variables.poses().to_vec() {
            if let Some((factor, loss)) = self.factor(image, context.noise)? {
                variables.problem_mut().add(pose, factor, loss)?;
            }
        }
        for (image, pose) in variables.composed_poses().to_vec() {
            if let Some((factor, loss)) = self.factor(image, context.noise)? {
                let keys = (pose.cam_from_rig, pose.rig_from_world);
                variables.problem_mut().add(keys, RigCentre(factor), loss)?;
            }
        }
        Ok(())
    }
}
