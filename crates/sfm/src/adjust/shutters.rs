//! The readouts of rolling shutters in an adjustment: each keypoint is shifted in proportion to its camera's.

use std::collections::BTreeMap;

use tiepoint_ba::factors::Prior;
use tiepoint_ba::{AnyKey, Key, Order};
use tiepoint_geometry::Loss;
use tiepoint_geometry::nalgebra::{Vector1, Vector2};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::mountings::without_points_at_infinity;
use super::{AdjustOptions, Bundle, Scope, keep_going, retriangulate_others};
use crate::Error;
use crate::shutter::RollingShutter;
use crate::sigma::noise_of_fit;

/// What is believed of a readout, in seconds: cameras take 5 to 35 ms.
const READOUT_SIGMA_S: f64 = 0.03;

/// Where a keypoint was detected, and how far each second of readout shifted it, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shifted {
    pub(crate) pixel: Vector2<f64>,
    pub(crate) shift: Vector2<f64>,
}

/// The shutters of the cameras, and all keypoints of the images of which they are known to shift any.
pub(crate) struct Shutters<'a> {
    pub(crate) shutters: &'a [RollingShutter],
    pub(crate) keypoints: &'a BTreeMap<ImageId, Vec<Shifted>>,
}

/// Adjusts everything with the readouts as variables, and says where those ended.
pub(crate) fn adjust_readouts(
    model: &mut Reconstruction,
    options: &AdjustOptions,
    shutters: &Shutters,
) -> Result<Vec<RollingShutter>, Error> {
    let mut bundle = Bundle::new(model, &Scope::Global, options, &[], Some(shutters))?;
    bundle.solve(model, options, &mut keep_going)?;
    retriangulate_others(model, &Scope::Global, &bundle.points);
    let found = |shutter: &RollingShutter| RollingShutter {
        readout_s: bundle.readouts.get(&shutter.camera).map_or(0.0, |key| bundle.problem.get(*key).x),
        ..*shutter
    };
    Ok(shutters.shutters.iter().map(found).collect())
}

/// The same with standard deviations, from the noise that the model leaves.
pub(crate) fn with_deviations(
    model: &Reconstruction,
    options: &AdjustOptions,
    shutters: &Shutters,
) -> Result<Vec<RollingShutter>, Error> {
    let noise = noise_of_fit(model, &options.loss);
    let options = &AdjustOptions { noise, ..*options };
    let bundle =
        Bundle::new(&without_points_at_infinity(model), &Scope::Global, options, &[], Some(shutters))?;
    let sd_s = |camera: CameraId| {
        let keys: [AnyKey; 1] = [(*bundle.readouts.get(&camera)?).into()];
        Some(bundle.problem.covariance(&keys).ok()?.matrix()[(0, 0)].sqrt() * noise)
    };
    let found = |shutter: &RollingShutter| RollingShutter {
        readout_sd_s: Some(sd_s(shutter.camera).unwrap_or(f64::INFINITY)),
        ..*shutter
    };
    Ok(shutters.shutters.iter().map(found).collect())
}

impl Bundle {
    /// The readout of a camera as a variable.
    pub(super) fn add_readout(
        &mut self,
        camera: CameraId,
        shutters: &Shutters,
        noise: f64,
    ) -> Result<Option<Key<Vector1<f64>>>, Error> {
        let Some(shutter) = shutters.shutters.iter().find(|shutter| shutter.camera == camera) else {
            return Ok(None);
        };
        let key = self.problem.keep(Vector1::new(shutter.readout_s), Order::Shared);
        self.problem.add(key, Prior::new(Vector1::zeros(), &[READOUT_SIGMA_S / noise])?, Loss::Trivial)?;
        self.readouts.insert(camera, key);
        Ok(Some(key))
    }
}
