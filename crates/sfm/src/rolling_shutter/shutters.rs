//! Rolling-shutter correction: rows are exposed one after the other
//! while the camera moves.
//!
//! In an image of height h, the row y is exposed at s = (y/h − ½) · readout after the middle row,
//! whose pose is the image's. Velocity ċ and angular velocity ω come from the cubic through the
//! neighbouring images. A point X is observed at π(exp(s ω) R (X − c − s ċ)) instead of π(R (X −
//! c)). The difference is subtracted from the keypoint, so that all other code can assume a global
//! shutter. The shift depends weakly on the pose, a hundredth as much as on the point's depth, and
//! is computed between adjustments.
//!
//! To estimate readout times, they become variables of an adjustment in which each keypoint shifts
//! in proportion. The shifts per second of readout are recomputed between the adjustments.

use std::collections::BTreeMap;
use std::sync::Arc;

use tiepoint_adjust::{AdjustOptions, Term};
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{ImageId, Reconstruction};

use super::motion::{readout_s, shifted};
use super::readout::{Readout, RollingShutter};
use super::term::{ShutterTerm, adjust_readouts, with_standard_deviations};
use crate::Error;
use crate::saved::{Reader, Saved, Writer};

/// The estimation ends if the readout times change by less than this, in seconds, or after
/// `MAX_STEPS` adjustments.
const MIN_STEP_S: f64 = 5e-5;
const MAX_STEPS: usize = 6;
/// The rolling shutters of a model's cameras, and the uncorrected keypoints.
#[derive(Clone)]
pub(crate) struct RollingShutters {
    readout: Readout,
    /// The keypoints as detected.
    detected: Arc<BTreeMap<ImageId, Vec<Vector2<f64>>>>,
    shutters: Vec<RollingShutter>,
}

impl RollingShutters {
    /// Takes a model with uncorrected keypoints.
    pub(crate) fn new(model: &Reconstruction, readout: Readout) -> Self {
        let pixels = |(id, image): (ImageId, &tiepoint_scene::Image)| {
            (id, image.keypoints.iter().map(|keypoint| keypoint.pixel).collect())
        };
        let readout_s = match readout {
            Readout::Known(readout_s) => readout_s,
            Readout::Estimated => 0.0,
        };
        let shutter = |camera| RollingShutter { camera, readout_s, readout_sd_s: None };
        Self {
            readout,
            detected: Arc::new(model.images().map(pixels).collect()),
            shutters: model.cameras().map(|(camera, _)| shutter(camera)).collect(),
        }
    }

    /// The state of each shutter.
    pub(crate) fn get(&self) -> &[RollingShutter] {
        &self.shutters
    }

    /// Estimates the readout times if they are not given, starting from the current ones, and
    /// corrects the keypoints. With estimation the model is adjusted, too, with further terms.
    pub(crate) fn estimate(
        &mut self,
        model: &mut Reconstruction,
        options: &AdjustOptions,
        terms: &mut [&mut dyn Term],
    ) -> Result<(), Error> {
        if self.readout != Readout::Estimated {
            self.rectify(model);
            return Ok(());
        }
        for _ in 0..MAX_STEPS {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            let shutters = ShutterTerm::new(&self.shutters, &keypoints);
            let found = adjust_readouts(model, options, shutters, terms)?;
            let has_changed = |(a, b): (&RollingShutter, &RollingShutter)| {
                (a.readout_s - b.readout_s).abs() > MIN_STEP_S
            };
            let has_converged = !self.shutters.iter().zip(&found).any(has_changed);
            self.shutters = found;
            // Needed in each step: points outside the selection are triangulated from the corrected
            // keypoints.
            self.rectify(model);
            if has_converged {
                break;
            }
        }
        Ok(())
    }

    /// Computes the standard deviations of estimated readout times.
    pub(crate) fn estimate_standard_deviations(
        &mut self,
        model: &Reconstruction,
        options: &AdjustOptions,
        terms: &mut [&mut dyn Term],
    ) -> Result<(), Error> {
        if self.readout == Readout::Estimated {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            let shutters = ShutterTerm::new(&self.shutters, &keypoints);
            self.shutters = with_standard_deviations(model, options, shutters, terms)?;
        }
        Ok(())
    }

    /// Moves the keypoints to their positions under a global shutter.
    pub(crate) fn rectify(&self, model: &mut Reconstruction) {
        for (id, keypoints) in shifted(model, &self.detected, &self.shutters) {
            let readout_s = readout_s(&self.shutters, model.image(id).camera);
            let pixels: Vec<Vector2<f64>> = keypoints
                .iter()
                .map(|keypoint| keypoint.pixel - keypoint.shift * readout_s)
                .collect();
            model.move_keypoints(id, &pixels);
        }
    }
}

/// The detected keypoints are those of the scene.
impl Saved for RollingShutters {
    fn write(&self, to: &mut Writer) {
        let known = match self.readout {
            Readout::Known(readout_s) => Some(readout_s),
            Readout::Estimated => None,
        };
        known.write(to);
        self.shutters.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let readout = Option::read(from)?.map_or(Readout::Estimated, Readout::Known);
        let found = Self { shutters: Vec::read(from)?, ..Self::new(from.scene, readout) };
        let cameras = found.shutters.iter().map(|shutter| shutter.camera);
        cameras.eq(from.scene.cameras().map(|(id, _)| id)).then_some(found)
    }
}
