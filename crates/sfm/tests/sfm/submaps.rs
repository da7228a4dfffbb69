//! Sub-maps of a drive against one map.

use std::collections::BTreeSet;
use std::ops::Range;

use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::submaps::cut;
use tiepoint_sfm::{Error, ExistingPoses, MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, RouteKind};

use crate::common::{ate_m, sample};

const SEEDS: [u64; 3] = [1, 2, 3];
const MOMENTS: usize = 60;
/// Three parts.
const SIZE: usize = 40;
/// Standard deviation of the keypoints, in pixels.
const NOISE_PX: f64 = 0.5;
/// Of the errors in parts and as one map: the limit of `docs/design/scale.md`.
const MAX_RATIO: f64 = 1.1;
/// The focal lengths begin so much too long, and are refined.
const WRONG_FOCAL: f64 = 1.1;
/// The shortest loop, in metres. Its first 20 moments turn enough to determine focal lengths
/// (20°), the next 8 do not, so that these keep those that they begin with.
const LOOP_M: f64 = 160.0;
const TURNING: Range<usize> = 0..20;
const STRAIGHT: Range<usize> = 20..28;
/// Of the first part, relative: 0.24 % was measured.
const MAX_FOCAL_ERROR: f64 = 0.01;

struct Setup {
    truth: Reconstruction,
    scene: Reconstruction,
    graph: CorrespondenceGraph,
}

fn drive(seed: u64, route: RouteKind) -> Setup {
    let mut options = DriveOptions { seed, rate_hz: 5.0, route, ..DriveOptions::default() };
    if matches!(route, RouteKind::Loop) {
        options.length_m = LOOP_M;
    }
    let mut drive = Drive::new(&options).expect("a street");
    drive.keep_first(MOMENTS);
    let observations = 2 * 300 * MOMENTS;
    let features =
        FeatureOptions { seed, observations, noise_px: NOISE_PX, ..FeatureOptions::default() };
    let drawn = FeatureScene::new(&drive, &features).expect("sound options");
    let graph = drawn.graph(&MatchOptions { window: Some(5), ..MatchOptions::default() });
    let mut scene = drawn.without_poses();
    let cameras: Vec<_> = scene.cameras().map(|(id, _)| id).collect();
    for camera in cameras {
        let intrinsics = &mut scene.camera_mut(camera).intrinsics;
        let focal_px = WRONG_FOCAL * intrinsics.mean_focal_px();
        for index in intrinsics.kind().focal_indices() {
            intrinsics.params_mut()[*index] = focal_px;
        }
    }
    Setup { truth: drawn.truth().clone(), scene, graph }
}

fn focal_lengths_px(scene: &Reconstruction) -> Vec<f64> {
    scene.cameras().map(|(_, camera)| camera.intrinsics.mean_focal_px()).collect()
}

/// The parts of a size, and their states.
pub(crate) fn states_of(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    size: usize,
    options: &MapperOptions,
) -> Vec<Vec<u8>> {
    let links: Vec<(ImagePair, usize)> =
        graph.pairs().iter().map(|(pair, view)| (*pair, view.matches.len())).collect();
    let parts = cut(scene, &links, size);
    assert!(parts.len() > 1);
    let map = |images: &BTreeSet<ImageId>, first: Option<&[u8]>| {
        Mapper::new(graph, scene).submap(images, first, options).unwrap()
    };
    let first = map(&parts[0], None);
    let others = parts[1..].iter().map(|part| map(part, Some(&first)));
    std::iter::once(first.clone()).chain(others).collect()
}

#[test]
fn parts_are_as_accurate_as_one_map() {
    for &seed in sample(&SEEDS) {
        let Setup { truth, scene, graph } = drive(seed, RouteKind::Open);
        let options = MapperOptions::default();
        let states = states_of(&graph, &scene, SIZE, &options);
        assert_eq!(states.len(), 3);
        let mut merged = Mapper::new(&graph, &scene).submaps(&states).run(&options).unwrap();
        let one = Mapper::new(&graph, &scene).run(&options).unwrap();
        assert_eq!(merged.len(), 1);
        let merged = merged.remove(0).reconstruction;
        assert_eq!(merged.num_registered(), 2 * MOMENTS);
        let [parts, one] = [&merged, &one[0].reconstruction].map(|model| ate_m(model, &truth));
        assert!(parts < MAX_RATIO * one, "seed {seed}: {parts} m in parts, {one} m as one map");
    }
}

#[test]
fn a_part_begins_with_the_intrinsics_of_the_first() {
    let Setup { truth, scene, graph } = drive(1, RouteKind::Loop);
    let options = MapperOptions::default();
    let map = |moments: Range<usize>, first: Option<&[u8]>| {
        let images = scene.images().map(|(id, _)| id);
        let images = images.filter(|id| moments.contains(&(id.index() % MOMENTS))).collect();
        Mapper::new(&graph, &scene).submap(&images, first, &options)
    };
    let first = map(TURNING, None).unwrap();
    let [with, without] = [Some(&first[..]), None].map(|first| map(STRAIGHT, first).unwrap());
    // Models that grow on with constant intrinsics have those of the part.
    let constant = MapperOptions { refine: RefineIntrinsics::NONE, ..options };
    let of_state = |state: &Vec<u8>| {
        let mapper = Mapper::new(&graph, &scene).submaps(std::slice::from_ref(state));
        focal_lengths_px(&mapper.run(&constant).unwrap()[0].reconstruction)
    };
    let [first_px, with_px, without_px] = [&first, &with, &without].map(of_state);
    assert_eq!((&with_px, without_px), (&first_px, focal_lengths_px(&scene)));
    for (found_px, true_px) in first_px.iter().zip(focal_lengths_px(&truth)) {
        assert!((found_px / true_px - 1.0).abs() < MAX_FOCAL_ERROR, "{found_px} and {true_px} px");
    }
    let found = map(STRAIGHT, Some(&first[1..]));
    assert!(matches!(found, Err(Error::OtherSubmaps)), "a state that cannot be read");
}

/// Images between the parts, and those of a part without a model, are registered all the same.
#[test]
fn images_of_no_part_grow_from_the_parts() {
    let Setup { scene, graph, .. } = drive(1, RouteKind::Open);
    let options = MapperOptions::default();
    let half: BTreeSet<ImageId> =
        scene.images().map(|(id, _)| id).filter(|id| id.index() % MOMENTS < 20).collect();
    let none: BTreeSet<ImageId> = [ImageId(0), ImageId::from_index(MOMENTS - 1)].into();
    let map = |images| Mapper::new(&graph, &scene).submap(images, None, &options).unwrap();
    let states = [map(&half), map(&none)];
    let models = Mapper::new(&graph, &scene).submaps(&states).run(&options).unwrap();
    let registered = |models: &[MappedModel]| models[0].reconstruction.num_registered();
    assert_eq!((models.len(), registered(&models)), (1, 2 * MOMENTS));
}

#[test]
fn states_of_other_scenes_and_other_frames_are_errors() {
    let Setup { scene, graph, .. } = drive(1, RouteKind::Open);
    let options = MapperOptions::default();
    let of_other = [vec![1, 2, 3]];
    let found = Mapper::new(&graph, &scene).submaps(&of_other).run(&options);
    assert!(matches!(found, Err(Error::OtherSubmaps)));
    let paper = MapperOptions { rig: RigMode::Paper, ..options };
    let found = Mapper::new(&graph, &scene).submaps(&of_other).run(&paper);
    assert!(matches!(found, Err(Error::SubmapsWithFrame)));
    let mapper = Mapper::new(&graph, &scene).submaps(&of_other);
    let found = mapper.existing(ExistingPoses::Refined).run(&options);
    assert!(matches!(found, Err(Error::SubmapsWithFrame)));
}
