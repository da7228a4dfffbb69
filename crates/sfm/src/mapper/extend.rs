//! Mapping that goes on from a model.

use std::collections::BTreeSet;

use tiepoint_adjust::Term;
use tiepoint_scene::Reconstruction;

use super::checkpoint::{Checkpoints, Step};
use super::existing::{Existing, ExistingPoses};
use super::growth::Growth;
use super::input::Input;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;
use crate::mapped_model::MappedModel;
use crate::rigs::Descriptors;
use crate::terms::reborrow;
use crate::tracks::{filter_all_points, update_tracks};

/// Registers further images onto the model of a scene.
pub(super) fn extend(
    input: Input,
    scene: &Reconstruction,
    poses: ExistingPoses,
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<MappedModel, Error> {
    checkpoints.begin(input, &[], &BTreeSet::new(), Step::Grow);
    let mut model = scene.clone();
    (model.rigs, model.frames) = (Vec::new(), Vec::new());
    for (id, camera) in input.scene.cameras() {
        *model.camera_mut(id) = *camera;
    }
    let existing = Existing::new(&model, poses);
    let mut refiner = Refiner::new(input, model, reborrow(terms));
    refiner.existing = Some(&existing);
    let mut growth = Growth::new(refiner, BTreeSet::new());
    if checkpoints.resumed.is_none() {
        let model = &mut growth.refiner.solution.model;
        update_tracks(input.graph, model, &input.options.tracks);
        filter_all_points(model, &input.options.filter);
        if model.num_tracks() == 0 {
            return Err(Error::NothingToExtend { images: existing.num_images() });
        }
    }
    growth.finish(descriptors, watch, checkpoints)
}

#[cfg(test)]
mod tests {
    use tiepoint_adjust::RefineIntrinsics;
    use tiepoint_scene::CorrespondenceGraph;
    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::mapper::Mapper;
    use crate::mapper::test_scene::scene;
    use crate::options::MapperOptions;

    /// The first images with their true poses, the others without.
    #[test]
    fn further_images_are_registered_in_the_frame_of_the_model() {
        const KNOWN: usize = 4;
        let scene = scene();
        let graph = scene.graph(&MatchOptions::default());
        let truth = scene.truth();
        let mut start = scene.without_poses();
        for (id, _, pose) in truth.registered().take(KNOWN) {
            start.register(id, *pose);
        }
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        for poses in [ExistingPoses::Constant, ExistingPoses::Refined] {
            let found = Mapper::new(&graph, &start).existing(poses).run(&options).unwrap();
            let found = &found[0].reconstruction;
            assert_eq!(found.num_registered(), truth.num_registered());
            for (id, _, pose) in truth.registered() {
                let there = found.image(id).cam_from_world().unwrap();
                if poses == ExistingPoses::Constant && id.index() < KNOWN {
                    assert_eq!(there, pose, "a constant pose keeps its bits");
                }
                // In metres; the keypoints have noise.
                assert!((there.origin_in_a() - pose.origin_in_a()).norm() < 0.05, "{id:?}");
            }
        }
        // All poses are known and constant: only points are new.
        let mut truth_without_points = scene.without_poses();
        for (id, _, pose) in truth.registered() {
            truth_without_points.register(id, *pose);
        }
        let constant = |graph| {
            let mapper = Mapper::new(graph, &truth_without_points);
            mapper.existing(ExistingPoses::Constant).run(&options)
        };
        let found = constant(&graph).unwrap();
        assert!(found[0].reconstruction.num_tracks() > 100);
        let nothing = CorrespondenceGraph::new(
            &start.images().map(|(_, image)| image.keypoints.len()).collect::<Vec<_>>(),
            [],
        );
        assert!(matches!(constant(&nothing), Err(Error::NothingToExtend { .. })));
    }
}
