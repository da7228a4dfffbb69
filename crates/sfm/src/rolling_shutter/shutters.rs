//! Rolling shutter: rows are read one after the other, while the camera moves.
//!
//! A row at y of a frame of height h is exposed (y/h − ½) · readout after the middle one, whose
//! pose is the image's. In that time the camera's centre goes on with the velocity, and its
//! rotation with the angular velocity, that the cubic through its neighbouring images has there. So
//! a point X is seen at π(exp(s ω) R (X − c − s ċ)) instead of at π(R (X − c)), and what lies
//! between the two is taken off the keypoint: afterwards the model is one of cameras that see all
//! rows at once, and nothing else needs to know. The shift hardly changes with the pose (a
//! hundredth of what the point's depth does), so that it is computed between adjustments and not in
//! them.
//!
//! Where the readouts are to be found, they are variables of an adjustment in which each keypoint
//! is shifted in proportion; the shifts of a second of readout are computed anew between its steps.

use std::collections::BTreeMap;
use std::sync::Arc;

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{ImageId, Reconstruction};

use super::motion::{readout_s, shifted};
use super::readout::{Readout, RollingShutter};
use super::term::{ShutterTerm, adjust_readouts, with_deviations};
use crate::Error;
use crate::adjust::AdjustOptions;

/// The readouts are found when a step moves them by less than this, in seconds, or after so many
/// steps.
const MIN_STEP_S: f64 = 5e-5;
const MAX_STEPS: usize = 6;
/// The shutters of a model's cameras, and what they did to its keypoints.
#[derive(Clone)]
pub(crate) struct RollingShutters {
    readout: Readout,
    /// The keypoints as they were detected.
    detected: Arc<BTreeMap<ImageId, Vec<Vector2<f64>>>>,
    shutters: Vec<RollingShutter>,
}

impl RollingShutters {
    /// Of a model whose keypoints are as they were detected.
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

    /// What is known of each shutter.
    pub(crate) fn get(&self) -> &[RollingShutter] {
        &self.shutters
    }

    /// Finds the readouts where they are not given, from those that were found before, and takes
    /// off the keypoints what they did. The model is left adjusted for them.
    pub(crate) fn find(
        &mut self,
        model: &mut Reconstruction,
        options: &AdjustOptions,
    ) -> Result<(), Error> {
        if self.readout != Readout::Estimated {
            self.rectify(model);
            return Ok(());
        }
        for _ in 0..MAX_STEPS {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            let found =
                adjust_readouts(model, options, ShutterTerm::new(&self.shutters, &keypoints))?;
            let has_moved = |(a, b): (&RollingShutter, &RollingShutter)| {
                (a.readout_s - b.readout_s).abs() > MIN_STEP_S
            };
            let is_over = !self.shutters.iter().zip(&found).any(has_moved);
            self.shutters = found;
            // In each step, for points that take no part in the next one are put where the
            // keypoints say.
            self.rectify(model);
            if is_over {
                break;
            }
        }
        Ok(())
    }

    /// Says how well the readouts that were found are known.
    pub(crate) fn find_deviations(
        &mut self,
        model: &Reconstruction,
        options: &AdjustOptions,
    ) -> Result<(), Error> {
        if self.readout == Readout::Estimated {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            self.shutters =
                with_deviations(model, options, ShutterTerm::new(&self.shutters, &keypoints))?;
        }
        Ok(())
    }

    /// Puts the keypoints where a global shutter would have them, as the cameras move in the model.
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
