//! Merging of models from one rig.

use std::mem;

use tiepoint_adjust::Term;
use tiepoint_scene::Reconstruction;

use super::checkpoint::{Checkpoints, Step};
use super::input::Input;
use super::join::registered;
use super::refiner::Refiner;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, OptionalStage, Watch, notify};
use crate::mapped_model::MappedModel;
use crate::rigs::{CalibratedRig, Descriptors, merge_by_motion};
use crate::rolling_shutter::row_poses;
use crate::terms::reborrow;

/// Merges the largest model with models of other cameras that have no common points with it but
/// move as one rig. A merge is accepted if a rig constraint does not increase the error of held-out
/// tracks. Models before `index` are compared already.
pub(super) fn merge_rig_models(
    input: Input,
    models: &mut Vec<MappedModel>,
    mut index: usize,
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<(), Error> {
    while index < models.len() {
        let images = models.iter().flat_map(|model| registered(&model.reconstruction)).collect();
        checkpoints.begin(input, models, &images, Step::Merge { index });
        let merged = merge_by_motion(&models[0].reconstruction, &models[index].reconstruction);
        // If the constraint fails, the models stay separate.
        let constrained =
            merged.and_then(|model| constrained(input, model, terms, descriptors).ok()?);
        let Some((reconstruction, rig)) = constrained else {
            index += 1;
            continue;
        };
        let other = models.remove(index);
        let merged = &mut models[0];
        // The constraint refines intrinsics, whose deviations are no longer known.
        let mut sds = mem::take(&mut merged.intrinsics_sds);
        sds.extend(other.intrinsics_sds);
        let of_parts = [&merged.reconstruction, &other.reconstruction];
        sds.retain(|id, _| {
            let now = reconstruction.camera(*id).intrinsics;
            of_parts.iter().any(|part| part.camera(*id).intrinsics == now)
        });
        merged.intrinsics_sds = sds;
        merged.reconstruction = reconstruction;
        merged.rig = Some(rig);
        // The models have no camera in common.
        merged.shutters.extend(other.shutters);
        merged.calibration_evidence.extend(other.calibration_evidence);
        merged.row_poses = row_poses(&merged.reconstruction, &merged.shutters);
        merged.num_loop_pairs += other.num_loop_pairs;
        merged.other_places.extend(other.other_places);
        merged.failures.extend(other.failures);
        // The rig stage has run on the merged model.
        merged.failures.retain(|failure| failure.stage != OptionalStage::Rig);
        notify(watch, &Event::Merged { num_images: merged.reconstruction.num_registered() })?;
    }
    Ok(())
}

/// Constrains the cameras of a model; `None` if no constraint is accepted.
fn constrained(
    input: Input,
    model: Reconstruction,
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
) -> Result<Option<(Reconstruction, CalibratedRig)>, Error> {
    let mut refiner = Refiner::new(input, model, reborrow(terms));
    refiner.complete();
    refiner.constrain_rig(descriptors)?;
    let Solution { model, rig, .. } = refiner.solution;
    Ok(rig.filter(|rig| rig.constraint.is_some()).map(|rig| (model, rig)))
}
