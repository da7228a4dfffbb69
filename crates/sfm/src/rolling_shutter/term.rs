//! Readout times as variables of an adjustment.

use std::collections::BTreeMap;

use tiepoint_adjust::{
    AdjustOptions, Error, FitNoise, Scope, Shifted, Term, TermContext, Variables, adjust,
    build_problem, covariance_of_fit, keep_going, without_points_at_infinity,
};
use tiepoint_ba::factors::Prior;
use tiepoint_ba::{AnyKey, EliminationOrder, Key, Problem};
use tiepoint_geometry::Loss;
use tiepoint_geometry::nalgebra::Vector1;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::readout::RollingShutter;
use crate::terms::with_terms;

/// Standard deviation of the prior on a readout time, in seconds. Cameras have 5 to 35 ms.
const READOUT_SIGMA_S: f64 = 0.03;

/// The shutters, and the keypoints with shifts of the images with known motion.
pub(super) struct ShutterTerm<'a> {
    shutters: &'a [RollingShutter],
    keypoints: &'a BTreeMap<ImageId, Vec<Shifted>>,
    /// Readout time of each camera, in seconds.
    keys: BTreeMap<CameraId, Key<Vector1<f64>>>,
    found: Vec<RollingShutter>,
}

impl<'a> ShutterTerm<'a> {
    pub(super) fn new(
        shutters: &'a [RollingShutter],
        keypoints: &'a BTreeMap<ImageId, Vec<Shifted>>,
    ) -> Self {
        Self { shutters, keypoints, keys: BTreeMap::new(), found: Vec::new() }
    }
}

impl Term for ShutterTerm<'_> {
    fn add(&mut self, _: &TermContext, _: &mut Variables) -> Result<(), Error> {
        Ok(())
    }

    /// Adds the readout time of a camera with a prior.
    fn add_to_camera(
        &mut self,
        context: &TermContext,
        camera: CameraId,
        variables: &mut Variables,
    ) -> Result<(), Error> {
        if let Some(shutter) = self.shutters.iter().find(|shutter| shutter.camera == camera) {
            let problem = variables.problem_mut();
            let key =
                problem.add_parameter(Vector1::new(shutter.readout_s), EliminationOrder::Last);
            let prior = Prior::new(Vector1::zeros(), &[READOUT_SIGMA_S / context.noise])?;
            problem.add(key, prior, Loss::Trivial)?;
            self.keys.insert(camera, key);
        }
        Ok(())
    }

    fn shifts_of(
        &self,
        camera: CameraId,
        image: ImageId,
    ) -> Option<(Key<Vector1<f64>>, &[Shifted])> {
        Some((*self.keys.get(&camera)?, self.keypoints.get(&image)?))
    }

    fn read(&mut self, problem: &Problem) {
        let found = |shutter: &RollingShutter| RollingShutter {
            readout_s: self.keys.get(&shutter.camera).map_or(0.0, |key| problem.get(*key).x),
            ..*shutter
        };
        self.found = self.shutters.iter().map(found).collect();
    }
}

/// Runs bundle adjustment with the readout times as variables, and further terms. Returns their
/// estimates.
pub(super) fn adjust_readouts(
    model: &mut Reconstruction,
    options: &AdjustOptions,
    mut shutters: ShutterTerm,
    terms: &mut [&mut dyn Term],
) -> Result<Vec<RollingShutter>, Error> {
    let terms = &mut with_terms(&mut shutters, terms);
    adjust(model, &Scope::Global, options, terms, &mut keep_going)?;
    Ok(shutters.found)
}

/// Returns the shutters with standard deviations at the noise of the fit.
pub(super) fn with_standard_deviations(
    model: &Reconstruction,
    options: &AdjustOptions,
    mut shutters: ShutterTerm,
    terms: &mut [&mut dyn Term],
) -> Result<Vec<RollingShutter>, Error> {
    let noise = FitNoise::of(model, &options.loss);
    let options = &AdjustOptions { noise: noise.sigma, ..*options };
    let near = without_points_at_infinity(model);
    let terms = &mut with_terms(&mut shutters, terms);
    let variables = build_problem(&near, &Scope::Global, options, terms)?;
    let sd_s = |camera: CameraId| {
        let keys: [AnyKey; 1] = [(*shutters.keys.get(&camera)?).into()];
        Some(covariance_of_fit(&near, &variables, &noise, &keys).ok()?[(0, 0)].sqrt())
    };
    let found = |shutter: &RollingShutter| RollingShutter {
        readout_sd_s: Some(sd_s(shutter.camera).unwrap_or(f64::INFINITY)),
        ..*shutter
    };
    Ok(shutters.shutters.iter().map(found).collect())
}
