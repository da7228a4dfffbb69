//! Camera models of lenses of which nothing is known, selected while a model grows.

use std::collections::BTreeSet;

use tiepoint_adjust::{
    AdjustOptions, BetterCameraModel, Gauge, Scope, better_camera_models, cameras_with_fields,
    relative_noise,
};
use tiepoint_geometry::CameraModelKind;
use tiepoint_scene::{CameraId, Reconstruction};

use super::calibration::VERY_STRONG;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use super::solution::Phase;
use crate::Error;
use crate::event::Watch;

/// The camera models. Each describes the lenses of those before it, OPENCV_FISHEYE nearly and
/// without decentring. THIN_PRISM_FISHEYE is a fisheye with decentring: its prism is zero.
const MODELS: [CameraModelKind; 5] = [
    CameraModelKind::SimpleRadial,
    CameraModelKind::Radial,
    CameraModelKind::Opencv,
    CameraModelKind::OpencvFisheye,
    CameraModelKind::ThinPrismFisheye,
];
/// The camera models with decentring, which looks like a principal point that is off.
const DECENTRED: [CameraModelKind; 2] =
    [CameraModelKind::Opencv, CameraModelKind::ThinPrismFisheye];
/// The first selection has so many images. Not varied.
const MIN_IMAGES: usize = 10;
/// Each later one has so many times the images of the one before it, while images are registered.
/// With 1.5, of the eight drives with an action lens in docs/benchmarks/drives.md one has an ATE of
/// 0.034 m in place of 0.013, and another one with `--rig auto` 0.336 in place of 0.019: they are
/// no test of it.
pub(super) const GROWTH: f64 = 2.0;
/// The same where no further image can be registered: four fifths of a small model's images take
/// part in its last selection. Not varied.
pub(super) const GROWTH_AT_END: f64 = 1.25;
/// No selection follows one that had so many images, and none is made of twice as many, as a joined
/// model may have: a fit costs as much as a global adjustment. Not varied.
const MAX_IMAGES: usize = 160;
/// Logarithm of the Bayes factor for another lens where no camera turns. There, focal length and
/// depths follow each freedom of a lens. Of 16 rendered drives with pinholes (docs/benchmarks/
/// drives.md), 2 have more, with 10 and 21 images, 14 have at most 7, and KITTI 04 has 6; action
/// lenses have 61 to 33,000 with at most 21 images. By these numbers half and double change nothing
/// on the pinholes, and with double a camera of three drives gets its camera model later.
/// Where decentred fisheyes are compared beside a refined principal point, it is 15 to 4,263 on
/// 110 m at ten images a second, and −5 to 11, once 38, on streets and side views with an action
/// lens (the ones above): with half the value one camera more would be decentred.
const VERY_STRONG_WITHOUT_TURNS: f64 = 50.0;
/// The fit of a camera model.
const FIT: RefinementSchedule =
    RefinementSchedule { max_iterations: 50, ..RefinementSchedule::GROWING };

impl Refiner<'_> {
    /// Gives cameras of unknown lenses another camera model where the images ask for it, if the
    /// model has `growth` times the images of the last selection.
    pub(super) fn select_camera_models(
        &mut self,
        growth: f64,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        let options = self.input.options;
        let (before, now) =
            (self.solution.images_at_lens_test, self.solution.model.num_registered());
        let has_grown = now as f64 >= growth * before as f64;
        let is_small = before < MAX_IMAGES && now < 2 * MAX_IMAGES;
        let is_due = now >= MIN_IMAGES && has_grown && is_small;
        if !options.select_camera_models || !options.refine.distortion || !is_due {
            return Ok(());
        }
        self.solution.images_at_lens_test = now;
        let better = self.better_camera_models();
        if better.is_empty() {
            return Ok(());
        }
        // The model is as good as before if it fails.
        let _ = self.transaction(|refiner| refiner.set_camera_models(better, watch))?;
        Ok(())
    }

    fn set_camera_models(
        &mut self,
        better: Vec<BetterCameraModel>,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        for BetterCameraModel { camera, intrinsics, .. } in better {
            self.solution.model.camera_mut(camera).intrinsics = intrinsics;
        }
        // Poses and points follow the intrinsics before tracks change.
        self.adjust(&Scope::Global, &FIT)?;
        self.refine_globally(&RefinementSchedule::GROWING, watch)
    }

    /// Camera models for which the evidence is very strong.
    fn better_camera_models(&self) -> Vec<BetterCameraModel> {
        let model = &self.solution.model;
        let cameras = cameras_of_unknown_lenses(model);
        // With all that is refined of a complete model: a principal point that is held looks like a
        // decentred lens.
        let phase = Phase::Complete { noise: relative_noise(model) };
        let mut options = self.adjust_options_in(phase, &FIT);
        options.gauge = Gauge::FirstAndFarthest;
        if options.refine.principal_point {
            return better_camera_models(model, &cameras, &MODELS, VERY_STRONG, &options)
                .unwrap_or_default();
        }
        // It is held where no camera turns, or where the user holds it.
        let centred = MODELS.into_iter().filter(|kind| !DECENTRED.contains(kind));
        let centred: Vec<CameraModelKind> = centred.collect();
        let least = VERY_STRONG_WITHOUT_TURNS;
        // A fit that fails tells nothing.
        let better =
            better_camera_models(model, &cameras, &centred, least, &options).unwrap_or_default();
        if better.is_empty() { self.decentred_fisheyes(&cameras, options) } else { better }
    }

    /// Those of `cameras` with OPENCV_FISHEYE whose lens is decentred, by evidence beside a refined
    /// principal point. The principal points of before are kept.
    fn decentred_fisheyes(
        &self,
        cameras: &[CameraId],
        mut options: AdjustOptions,
    ) -> Vec<BetterCameraModel> {
        let model = &self.solution.model;
        options.refine.principal_point = true;
        let kinds = [CameraModelKind::OpencvFisheye, CameraModelKind::ThinPrismFisheye];
        let least = VERY_STRONG_WITHOUT_TURNS;
        let mut better =
            better_camera_models(model, cameras, &kinds, least, &options).unwrap_or_default();
        for BetterCameraModel { camera, intrinsics, .. } in &mut better {
            let before = model.camera(*camera).intrinsics.principal_point();
            for (&index, value) in intrinsics.kind().principal_point_indices().iter().zip(&before) {
                intrinsics.params_mut()[index] = *value;
            }
        }
        better
    }
}

/// The cameras of unknown lenses that may have another camera model, in order of their ids. The
/// cameras of one lens in portrait and landscape format are none: both must have one camera model.
fn cameras_of_unknown_lenses(model: &Reconstruction) -> Vec<CameraId> {
    let shared: BTreeSet<CameraId> =
        model.portrait_landscape_pairs.iter().flatten().copied().collect();
    // The last model describes the lenses of all.
    let simpler = &MODELS[..MODELS.len() - 1];
    let is_unknown = |id: &CameraId| {
        simpler.contains(&model.camera(*id).intrinsics.kind())
            && !model.calibrated.contains(id)
            && !model.intrinsics_priors.contains_key(id)
            && !shared.contains(id)
    };
    cameras_with_fields(model, model.cameras().map(|(id, _)| id).filter(is_unknown))
}
