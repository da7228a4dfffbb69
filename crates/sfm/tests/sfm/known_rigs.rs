//! Rigs with known extrinsics on the drive of [`crate::rig`].

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{
    CorrespondenceGraph, ImageId, ImagePair, Match, Reconstruction, Rig, RigId, RigSensor, TwoView,
};
use tiepoint_sfm::scene::KnownRigs;
use tiepoint_sfm::scene::rig::KnownFrame;
use tiepoint_sfm::{Error, ExistingPoses, MappedModel, Mapper, MapperOptions, OptionalStage};

use crate::rig::{BASELINE_M, NUM_FRAMES, Truth, drive};

/// Turn between frames: a curve.
pub(crate) const TURN_RAD: f64 = 0.05;
pub(crate) const FOCAL_PX: f64 = 400.0;
/// Frames whose matches are deleted.
const POOR_FRAMES: [usize; 2] = [4, 5];
/// Matches that remain of each image of a poor frame: fewer than a registration needs (30), and
/// more than that with the other image of the frame.
const POOR_MATCHES: usize = 24;
/// Largest error of a centre in metres. Points are at 3 to 30 m, and a keypoint's error is 0.3 px
/// of 400, so that a point at 10 m gives a centre to 8 mm; poor frames have 48 keypoints.
const MAX_ERROR_M: f64 = 0.03;

pub(crate) fn right_from_left() -> Rigid3 {
    Rigid3::from_axis_angle(Vector3::new(0.0, 0.01, 0.0), Vector3::new(-BASELINE_M, 0.0, 0.0))
}

/// The rig of the drive with this pose of the right camera.
pub(crate) fn rigs(
    scene: &Reconstruction,
    cam_from_rig: Rigid3,
    refine_extrinsics: bool,
) -> KnownRigs {
    let sensor = |image: usize, cam_from_rig: Rigid3| RigSensor {
        camera: scene.image(ImageId::from_index(image)).camera,
        cam_from_rig: Some(cam_from_rig),
    };
    let sensors = vec![sensor(0, Rigid3::identity()), sensor(NUM_FRAMES, cam_from_rig)];
    let frame = |index: usize| KnownFrame {
        rig: RigId::from_index(0),
        images: [index, NUM_FRAMES + index].map(ImageId::from_index).to_vec(),
    };
    KnownRigs {
        rigs: vec![Rig { sensors }],
        frames: (0..NUM_FRAMES).map(frame).collect(),
        refine_extrinsics,
    }
}

fn is_poor(image: ImageId) -> bool {
    POOR_FRAMES.contains(&(image.index() % NUM_FRAMES))
}

/// The graph with `keep(image)` matched keypoints of an image; all for `None`.
fn thinned(truth: &Truth, keep: impl Fn(ImageId) -> Option<usize>) -> CorrespondenceGraph {
    // The first keypoints that have matches.
    let mut kept: BTreeMap<ImageId, Vec<u32>> = BTreeMap::new();
    let is_kept = |kept: &mut BTreeMap<ImageId, Vec<u32>>, image: ImageId, keypoint: u32| {
        let Some(limit) = keep(image) else { return true };
        let keypoints = kept.entry(image).or_default();
        if !keypoints.contains(&keypoint) && keypoints.len() < limit {
            keypoints.push(keypoint);
        }
        keypoints.contains(&keypoint)
    };
    let pairs: Vec<(ImagePair, TwoView)> = truth
        .graph
        .pairs()
        .iter()
        .map(|(pair, two_view)| {
            let mut both =
                |m: &&Match| is_kept(&mut kept, pair.a, m.a) && is_kept(&mut kept, pair.b, m.b);
            let matches = two_view.matches.iter().filter(&mut both).copied().collect();
            (*pair, TwoView { matches, ..two_view.clone() })
        })
        .filter(|(_, two_view)| !two_view.matches.is_empty())
        .collect();
    let counts: Vec<usize> = truth.scene.images().map(|(_, i)| i.keypoints.len()).collect();
    CorrespondenceGraph::new(&counts, pairs)
}

fn run(graph: &CorrespondenceGraph, scene: &Reconstruction, rigs: &KnownRigs) -> MappedModel {
    let mapper = Mapper::new(graph, scene).known_rigs(rigs);
    let mut models = mapper.run(&MapperOptions::default()).unwrap();
    models[0].reconstruction.validate().unwrap();
    models.swap_remove(0)
}

/// Images that are registered without a known rig.
fn num_registered_alone(graph: &CorrespondenceGraph, scene: &Reconstruction) -> usize {
    let models = Mapper::new(graph, scene).run(&MapperOptions::default()).unwrap();
    models[0].reconstruction.num_registered()
}

/// Asserts that all images have their true poses in metres, up to a rigid motion: that of the first
/// image.
fn assert_true(model: &Reconstruction, poses: &[Rigid3]) {
    assert_eq!(model.num_registered(), poses.len());
    let first = model.image(ImageId::from_index(0)).cam_from_world().unwrap();
    let truth_from_model = poses[0].inverse() * *first;
    for (id, _, pose) in model.registered() {
        let centre = truth_from_model * pose.origin_in_a();
        let error_m = (centre - poses[id.index()].origin_in_a()).norm();
        // The orientation of the first image is part of the error: its 2e-4 radians over 8 m.
        assert!(error_m < MAX_ERROR_M, "{}: {error_m} m", model.image(id).name);
    }
}

#[test]
fn images_without_matches_are_registered_with_their_frames() {
    let truth = drive(3, TURN_RAD, FOCAL_PX, true);
    let is_right = |image: ImageId| image.index() >= NUM_FRAMES;
    let graph = thinned(&truth, |image| (is_poor(image) && is_right(image)).then_some(0));
    assert_eq!(num_registered_alone(&graph, &truth.scene), 2 * NUM_FRAMES - POOR_FRAMES.len());
    let mapped = run(&graph, &truth.scene, &rigs(&truth.scene, right_from_left(), false));
    assert_true(&mapped.reconstruction, &truth.poses);
    assert_eq!(mapped.reconstruction.frames.len(), NUM_FRAMES);
    assert_eq!(mapped.reconstruction.rigs[0].sensors[1].cam_from_rig, Some(right_from_left()));
    assert!(mapped.failures.is_empty());
}

#[test]
fn a_frame_is_registered_from_too_few_correspondences_of_each_image() {
    let truth = drive(4, TURN_RAD, FOCAL_PX, true);
    let graph = thinned(&truth, |image| is_poor(image).then_some(POOR_MATCHES));
    let alone = num_registered_alone(&graph, &truth.scene);
    assert_eq!(alone, 2 * (NUM_FRAMES - POOR_FRAMES.len()));
    let mapped = run(&graph, &truth.scene, &rigs(&truth.scene, right_from_left(), false));
    assert_true(&mapped.reconstruction, &truth.poses);
}

/// Extrinsics that are off by 1 degree and 3 % are constant, or refined at the scale of the file.
#[test]
fn extrinsics_are_refined_if_asked_for() {
    let truth = drive(5, TURN_RAD, FOCAL_PX, true);
    let off = Rigid3::from_axis_angle(Vector3::new(0.0, 0.017, 0.0), Vector3::zeros());
    let initial = off * right_from_left();
    let angle_of = |refine_extrinsics: bool| {
        let known = rigs(&truth.scene, initial, refine_extrinsics);
        let model = run(&truth.graph, &truth.scene, &known).reconstruction;
        let found = model.rigs[0].sensors[1].cam_from_rig.unwrap();
        let length = found.translation.norm();
        assert!((length - BASELINE_M).abs() < 1e-9, "{length} m");
        found.rotation.angle_to(&right_from_left().rotation)
    };
    assert!((angle_of(false) - 0.017).abs() < 1e-9);
    let refined_rad = angle_of(true);
    assert!(refined_rad < 5e-4, "{refined_rad}");
}

#[test]
fn extrinsics_of_another_rig_are_not_used() {
    let truth = drive(6, TURN_RAD, FOCAL_PX, true);
    let turned = Rigid3::from_axis_angle(Vector3::new(0.0, 1.5, 0.0), Vector3::x());
    let mapped = run(&truth.graph, &truth.scene, &rigs(&truth.scene, turned, false));
    assert_eq!(mapped.reconstruction.num_registered(), 2 * NUM_FRAMES);
    assert!(mapped.reconstruction.frames.is_empty());
    let stages: Vec<OptionalStage> = mapped.failures.iter().map(|failure| failure.stage).collect();
    assert_eq!(stages, [OptionalStage::Rig]);
}

#[test]
fn an_existing_model_takes_no_known_rigs() {
    let truth = drive(6, TURN_RAD, FOCAL_PX, true);
    let rigs = rigs(&truth.scene, right_from_left(), false);
    let mapper = Mapper::new(&truth.graph, &truth.scene).known_rigs(&rigs);
    let error = mapper.existing(ExistingPoses::Refined).run(&MapperOptions::default()).unwrap_err();
    assert!(matches!(error, Error::RigsOfExistingModel), "{error}");
}
