//! Focal lengths of cameras without a calibration that images hardly determine.

use std::collections::BTreeMap;

use tiepoint_adjust::{FieldFit, Scope, cameras_with_fields, fit_with_lens_fields};
use tiepoint_scene::{Camera, CameraId, IntrinsicsPrior, Reconstruction};

use super::intrinsics_sds::intrinsics_sds;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;

/// A focal length is uncertain if its standard deviation moves the projection of some ray at the
/// border of the image by more than this. It is the unit of calibrations, too
/// (`--calibration-sigma`). By their stated deviations, photos and loops have 0.1 to 0.6 px, drives
/// that go straight 2 to 20 px: half adds one of the 20 sets of docs/benchmarks/drives.md, double
/// takes none away.
const MAX_EFFECT_PX: f64 = 1.0;
/// The difference of two estimates that tells, in their joint standard deviation: 1 % of a normal
/// distribution, if they were independent. Half takes the fit on 4 of 11 drives with uncertain
/// focal lengths and double on one, in place of two. 1.96 deviations of the fit alone took it on
/// highway-2 and two streets as features, too, which it made worse: these had a part in the choice.
const SIGNIFICANT: f64 = 2.58;

/// Standard deviations of the intrinsics of each camera.
type Deviations = BTreeMap<CameraId, Vec<f64>>;

impl Refiner<'_> {
    /// Where a focal length is uncertain, fits the cameras without a calibration with a lens field
    /// for each. If a focal length of this fit contradicts that without fields, all take their
    /// intrinsics from it and keep them; else their standard deviations count the difference. They
    /// keep their own intrinsics, too, if there are other cameras, which the fit takes as exact, if
    /// cameras share a lens, and if an image would lose its pose. Models whose rigs or terms may
    /// determine focal lengths stay as they are.
    pub(super) fn fit_uncertain_focal_lengths(&mut self, watch: &mut Watch) -> Result<(), Error> {
        let is_fixed = self.input.known_rigs.is_some() || !self.terms.is_empty();
        if is_fixed || !self.input.options.refine.focal {
            return Ok(());
        }
        let mut options = self.adjust_options(&RefinementSchedule::FINAL);
        let sds = intrinsics_sds(&self.solution.model, &options, &mut []);
        let cameras = cameras_to_fit(&self.solution.model, &sds);
        // A wrong principal point bends the image as a wrong focal length does.
        let unknown = self.unknown_intrinsics(&RefinementSchedule::FINAL);
        self.solution.intrinsics_sds = (unknown == options.refine).then(|| sds.clone());
        options.refine = unknown;
        if cameras.is_empty() {
            return Ok(());
        }
        let model = &self.solution.model;
        // Nothing is better known where the fit fails.
        let fits = fit_with_lens_fields(model, &cameras, &options).unwrap_or_default();
        let counted = fits.iter().map(|fit| (fit.camera, with_difference(fit, model, &sds)));
        self.solution.field_sds = counted.collect();
        let is_whole = fits.len() == model.registered_cameras().len()
            && model.portrait_landscape_pairs.is_empty();
        if is_whole && fits.iter().any(|fit| contradicts(fit, model, &sds)) {
            // The model is as good as without the fit if it fails.
            let _ = self.transaction(|refiner| refiner.keep_intrinsics(fits, watch))?;
        }
        Ok(())
    }

    /// Keeps the intrinsics of a fit, to which poses and points are adjusted.
    fn keep_intrinsics(&mut self, fits: Vec<FieldFit>, watch: &mut Watch) -> Result<(), Error> {
        let model = &mut self.solution.model;
        let before = model.num_registered();
        for FieldFit { camera, intrinsics, sds } in fits {
            model.camera_mut(camera).intrinsics = intrinsics;
            model.calibrated.insert(camera);
            self.solution.kept_intrinsics.insert(camera);
            self.solution.field_sds.insert(camera, sds);
        }
        // Poses and points follow the intrinsics before tracks change.
        self.adjust(&Scope::Global, &RefinementSchedule::FINAL)?;
        self.complete();
        self.refine_globally(&RefinementSchedule::FINAL, watch)?;
        let after = self.solution.model.num_registered();
        if after < before { Err(Error::ImagesLost { before, after }) } else { Ok(()) }
    }
}

/// The cameras without a calibration, in order of their ids; none if their focal lengths are
/// certain. Intrinsics that a fit keeps would pass for exact.
fn cameras_to_fit(model: &Reconstruction, sds: &Deviations) -> Vec<CameraId> {
    let is_free =
        |id: &CameraId| !model.intrinsics_priors.contains_key(id) && !model.calibrated.contains(id);
    let is_uncertain = |id: &CameraId| {
        let camera = model.camera(*id);
        let of_effect =
            IntrinsicsPrior::new(camera.intrinsics, camera.width, camera.height, MAX_EFFECT_PX);
        focal(camera).is_some_and(|index| sds[id][index] > of_effect.sigmas[index])
    };
    let cameras = cameras_with_fields(model, sds.keys().copied().filter(is_free));
    if cameras.iter().any(is_uncertain) { cameras } else { Vec::new() }
}

/// Index of the first focal length.
fn focal(camera: &Camera) -> Option<usize> {
    camera.intrinsics.kind().focal_indices().first().copied()
}

/// Whether the focal length of a fit contradicts that of the model, given the standard deviations
/// of both.
fn contradicts(fit: &FieldFit, model: &Reconstruction, sds: &Deviations) -> bool {
    let camera = model.camera(fit.camera);
    focal(camera).is_some_and(|index| {
        let moved = fit.intrinsics.params()[index] - camera.intrinsics.params()[index];
        moved.abs() > SIGNIFICANT * fit.sds[index].hypot(sds[&fit.camera][index])
    })
}

/// Standard deviations of a model's intrinsics: those of the fit with the difference from it, or
/// the own ones if they are larger.
fn with_difference(fit: &FieldFit, model: &Reconstruction, sds: &Deviations) -> Vec<f64> {
    let of_model = &model.camera(fit.camera).intrinsics;
    let differences = fit.intrinsics.params().iter().zip(of_model.params()).map(|(a, b)| a - b);
    let of_fit = differences.zip(&fit.sds).map(|(difference, sd)| difference.hypot(*sd));
    of_fit.zip(&sds[&fit.camera]).map(|(of_fit, own)| of_fit.max(*own)).collect()
}
