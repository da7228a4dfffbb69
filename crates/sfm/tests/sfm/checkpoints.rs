//! A run goes on from each of its checkpoints to the same bytes. Each state leads to the next one,
//! bit for bit, and the last one to the models: so any chain of kills ends there.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_geometry::Rng;
use tiepoint_scene::{CorrespondenceGraph, ImageId, KnownRigs, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::rolling_shutter::Readout;
use tiepoint_sfm::{
    CheckpointStore, Error, Event, ExistingPoses, MappedModel, Mapper, MapperOptions, RigMode,
};
use tiepoint_synth::{
    Drive, DriveOptions, Effects, FeatureOptions, FeatureScene, MatchOptions, Mount, ViewDirection,
};

use crate::{camera_models, known_rigs, one_model, rig, submaps};

/// Damaged states that are tried.
const DAMAGED: usize = 60;

/// What is mapped.
struct Setup {
    graph: CorrespondenceGraph,
    scene: Reconstruction,
    existing: Option<ExistingPoses>,
    known_rigs: Option<KnownRigs>,
    submaps: Vec<Vec<u8>>,
    options: MapperOptions,
}

/// All states of a run that begins with a state.
struct States<'a> {
    last: Option<Vec<u8>>,
    resumed: Option<Option<usize>>,
    kept: Vec<Vec<u8>>,
    has_kept: &'a Cell<bool>,
}

impl CheckpointStore for States<'_> {
    fn last(&mut self) -> Option<Vec<u8>> {
        self.last.clone()
    }

    fn resumed(&mut self, num_registered: Option<usize>) {
        self.resumed = Some(num_registered);
    }

    fn is_due(&mut self) -> bool {
        true
    }

    fn keep(&mut self, state: &[u8]) {
        // A run that goes on between two models keeps that state again.
        if self.last.as_deref() != Some(state) {
            self.kept.push(state.to_vec());
            self.has_kept.set(true);
        }
    }
}

/// The result of a run, what the mapper said of its first state, and the states that it kept.
struct Run {
    models: Result<Vec<MappedModel>, Error>,
    resumed: Option<Option<usize>>,
    kept: Vec<Vec<u8>>,
}

impl Setup {
    fn of(graph: CorrespondenceGraph, scene: Reconstruction) -> Self {
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        let submaps = Vec::new();
        Self { graph, scene, existing: None, known_rigs: None, submaps, options }
    }

    /// `until_kept`: the run ends at the next event after it has kept a state.
    fn run(&self, last: Option<&[u8]>, until_kept: bool) -> Run {
        let has_kept = Cell::new(false);
        let last = last.map(<[u8]>::to_vec);
        let mut states = States { last, resumed: None, kept: Vec::new(), has_kept: &has_kept };
        let mut watch = |_: &Event| match until_kept && has_kept.get() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let models = self.mapper().checkpoints(&mut states).watch(&mut watch).run(&self.options);
        let States { resumed, kept, .. } = states;
        Run { models, resumed, kept }
    }

    fn mapper(&self) -> Mapper<'_> {
        let mut mapper = Mapper::new(&self.graph, &self.scene).submaps(&self.submaps);
        if let Some(poses) = self.existing {
            mapper = mapper.existing(poses);
        }
        if let Some(rigs) = &self.known_rigs {
            mapper = mapper.known_rigs(rigs);
        }
        mapper
    }

    /// Goes on from each state; returns the states.
    fn check(&self) -> Vec<Vec<u8>> {
        let expected = self.mapper().run(&self.options).unwrap();
        let whole = self.run(None, false);
        // The text of a number tells all its bits.
        assert!(format!("{:?}", whole.models.unwrap()) == format!("{expected:?}"));
        assert_eq!(whole.resumed, None);
        let states = whole.kept;
        for (index, state) in states.iter().enumerate() {
            let rest = &states[index + 1..];
            let run = self.run(Some(state), true);
            assert!(run.resumed.flatten().is_some(), "state {index} is not read");
            assert!(run.kept.len() <= rest.len(), "after state {index}");
            assert!(rest.starts_with(&run.kept), "state {index} leads elsewhere");
            assert_eq!(run.kept.is_empty(), rest.is_empty(), "after state {index}");
        }
        let end = self.run(states.last().map(Vec::as_slice), false);
        assert!(format!("{:?}", end.models.unwrap()) == format!("{expected:?}"));
        states
    }
}

/// Moments of two cameras whose rows are exposed one after another, with all variables.
fn street(moments: usize) -> Setup {
    let effects = Effects { readout_s: 0.02, ..Effects::default() };
    let mounts = Mount::stereo(ViewDirection::Front, 0.5).to_vec();
    let options =
        DriveOptions { seed: 2, rate_hz: 5.0, effects, mounts, ..DriveOptions::default() };
    let mut drive = Drive::new(&options).expect("a street of 200 m");
    drive.keep_first(moments);
    let observations = 1000 * moments;
    let features = FeatureOptions { seed: 2, observations, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let graph = scene.graph(&MatchOptions { window: Some(4), ..MatchOptions::default() });
    let options = MapperOptions {
        rig: RigMode::Auto,
        readout: Some(Readout::Estimated),
        ..MapperOptions::default()
    };
    Setup { options, ..Setup::of(graph, scene.without_poses()) }
}

#[test]
fn a_drive_goes_on_from_each_state() {
    let states = street(12).check();
    // One state for each further image, and one for each stage.
    assert!(states.len() > 24, "{} states", states.len());
}

/// Each half has a model; then one grows into the other.
#[test]
fn joined_models_go_on_from_each_state() {
    let walk = one_model::corner(0, one_model::HALF - 2..one_model::HALF);
    Setup::of(walk.graph, walk.truth).check();
}

/// Models with one common image stay apart.
#[test]
fn models_that_stay_apart_go_on_from_each_state() {
    let walk = one_model::corner(0, one_model::HALF - 1..one_model::HALF);
    let mut setup = Setup::of(walk.graph, walk.truth);
    setup.options.rig = RigMode::Auto;
    setup.check();
}

#[test]
fn frames_of_known_rigs_go_on_from_each_state() {
    let truth = rig::drive(3, known_rigs::TURN_RAD, known_rigs::FOCAL_PX, true);
    let rigs = known_rigs::rigs(&truth.scene, known_rigs::right_from_left(), true);
    Setup { known_rigs: Some(rigs), ..Setup::of(truth.graph, truth.scene) }.check();
}

#[test]
fn an_extended_model_goes_on_from_each_state() {
    let mut setup = street(8);
    let mapped = setup.mapper().run(&setup.options).unwrap().remove(0);
    for (id, _, pose) in mapped.reconstruction.registered().take(5) {
        setup.scene.register(id, *pose);
    }
    for poses in [ExistingPoses::Refined, ExistingPoses::Constant] {
        setup.existing = Some(poses);
        setup.check();
    }
}

/// Assembled sub-maps: of a drive, and of halves that stay apart until they are grown on.
#[test]
fn assembled_sub_maps_go_on_from_each_state() {
    let mut setup = street(12);
    setup.submaps = submaps::states_of(&setup.graph, &setup.scene, 14, &setup.options);
    setup.check();
    let walk = one_model::corner(0, one_model::HALF - 1..one_model::HALF);
    let mut setup = Setup::of(walk.graph, walk.truth);
    let half = |is_second: bool| -> BTreeSet<ImageId> {
        let images = setup.scene.images().map(|(id, _)| id);
        images.filter(|id| (id.index() >= one_model::HALF) == is_second).collect()
    };
    let map = |images| setup.mapper().submap(images, None, &setup.options).unwrap();
    setup.submaps = vec![map(&half(false)), map(&half(true))];
    setup.check();
}

/// States that are cut or changed are refused, or lead to some model; states of other images are
/// refused. Nothing panics.
#[test]
fn damaged_and_foreign_states_do_no_harm() {
    let setup = street(6);
    let states = setup.run(None, false).kept;
    let mut rng = Rng::stream(0, &[]);
    let mut refused = 0;
    for trial in 0..DAMAGED {
        let mut state = states[rng.below(states.len())].clone();
        let at = rng.below(state.len());
        match trial % 4 {
            0 => state.truncate(at),
            1 => state[at] ^= 1 << rng.below(8),
            2 => state[at] = 255,
            _ => state.insert(at, 0),
        }
        let found = setup.run(Some(&state), true).resumed.unwrap();
        assert!(found.is_none() || trial % 4 == 1 || trial % 4 == 2, "trial {trial}");
        refused += usize::from(found.is_none());
    }
    // Most bytes are those of coordinates.
    assert!(refused > DAMAGED / 2, "{refused}");
    let fewer = street(5);
    for state in [&states[1], states.last().unwrap(), &Vec::new(), &vec![255; 1000]] {
        assert_eq!(fewer.run(Some(state), true).resumed, Some(None));
    }
}

/// Moments of two cameras: as many images as a selection of camera models has.
const MOMENTS: usize = 6;

#[test]
fn a_camera_has_another_camera_model() {
    let (scene, graph, _) = camera_models::street(MOMENTS, true, 0.0);
    let mut setup = Setup::of(graph, scene);
    setup.options = MapperOptions { select_camera_models: true, ..MapperOptions::default() };
    let models = setup.mapper().run(&setup.options).unwrap();
    let kind = |it: &Reconstruction| it.cameras().next().unwrap().1.intrinsics.kind();
    assert_ne!(kind(&models[0].reconstruction), kind(&setup.scene), "another camera model");
    setup.check();
}
