//! Terms of a caller in the mapper: the measured positions of the example.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::rig::KnownFrame;
use tiepoint_scene::{
    CorrespondenceGraph, ImageId, KnownRigs, Reconstruction, Rig, RigId, RigSensor,
};
use tiepoint_sfm::adjust::{Error, TermContext, TermFrame, Variables};
use tiepoint_sfm::adjust::{RefineIntrinsics, Scope, Term};
use tiepoint_sfm::{ExistingPoses, MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions};

use position_priors::Positions;

#[path = "../../examples/position_priors.rs"]
#[allow(dead_code, reason = "the example's main")]
mod position_priors;

const NUM_FRAMES: usize = 10;
/// Standard deviation of a measured position along each axis, in metres.
const SIGMA_M: f64 = 0.05;
/// The origin of the measured frame, in metres: far away, as that of a map.
const ORIGIN_M: Vector3<f64> = Vector3::new(-4e3, 1e4, 200.0);

struct Street {
    drive: Drive,
    truth: Reconstruction,
    blank: Reconstruction,
    graph: CorrespondenceGraph,
}

fn street() -> Street {
    let mut drive = Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() }).unwrap();
    drive.keep_first(NUM_FRAMES);
    let features = FeatureOptions { observations: 20_000, ..FeatureOptions::default() };
    let street = FeatureScene::new(&drive, &features).unwrap();
    let graph = street.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    Street { truth: street.truth().clone(), blank: street.without_poses(), graph, drive }
}

impl Street {
    /// The true positions of the images.
    fn places(&self) -> impl Iterator<Item = (ImageId, Vector3<f64>)> {
        self.truth.registered().map(|(id, _, pose)| (id, pose.origin_in_a() + ORIGIN_M))
    }

    fn measured(&self) -> Positions {
        let mut rng = Rng::stream(1, &[]);
        let mut measured =
            |place: Vector3<f64>| place.map(|metres| metres + SIGMA_M * rng.normal());
        Positions(self.places().map(|(id, place)| (id, measured(place), SIGMA_M)).collect())
    }

    /// Root mean square distance of the cameras from their true positions, in metres.
    fn rms_m(&self, model: &Reconstruction) -> f64 {
        rms_m(&Positions(self.places().map(|(id, place)| (id, place, 0.0)).collect()), model)
    }
}

fn rms_m(positions: &Positions, model: &Reconstruction) -> f64 {
    let (found, measured) = positions.pairs(model);
    let squares = found.iter().zip(&measured).map(|(a, b)| (a - b).norm_squared());
    (squares.sum::<f64>() / found.len() as f64).sqrt()
}

fn options(rig: RigMode) -> MapperOptions {
    MapperOptions { refine: RefineIntrinsics::NONE, rig, ..MapperOptions::default() }
}

/// Positions with a record of the adjustments that they took part in.
struct Recorded {
    positions: Positions,
    uses: Vec<Use>,
}

/// An adjustment.
struct Use {
    num_registered: usize,
    is_local: bool,
    /// Distance of the model before it from the positions.
    rms_m: f64,
}

impl Term for Recorded {
    fn frame(&self, model: &Reconstruction) -> TermFrame {
        self.positions.frame(model)
    }

    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        self.uses.push(Use {
            num_registered: context.model.num_registered(),
            is_local: matches!(context.scope, Scope::Local(_)),
            rms_m: rms_m(&self.positions, context.model),
        });
        self.positions.add(context, variables)
    }
}

/// Three images are the fewest that determine a similarity.
const MIN_IMAGES: usize = 3;
/// Largest error of the model, as root mean square. The similarity of a model to its frame has
/// seven parameters, which three coordinates of each measured position determine. The shape of the
/// model is known to millimetres. 1.9 is exceeded by chance once in a thousand: the squared error
/// has seven degrees of freedom.
fn max_error_m(num_positions: usize) -> f64 {
    1.9 * SIGMA_M * 3.0_f64.sqrt() * (7.0 / (3.0 * num_positions as f64)).sqrt()
}

#[test]
fn positions_take_part_from_the_third_image_on() {
    let street = street();
    let mut term = Recorded { positions: street.measured(), uses: Vec::new() };
    let models =
        Mapper::new(&street.graph, &street.blank).term(&mut term).run(&options(RigMode::Off));
    let MappedModel { reconstruction: model, is_in_frame_of_terms, .. } = &models.unwrap()[0];
    assert_eq!(model.num_registered(), 2 * NUM_FRAMES);
    assert!(is_in_frame_of_terms);
    let error_m = street.rms_m(model);
    assert!(error_m < max_error_m(2 * NUM_FRAMES), "{error_m}");
    assert_eq!(term.uses[0].num_registered, MIN_IMAGES);
    for is_local in [false, true] {
        let used = term.uses.iter().filter(|term_use| term_use.is_local == is_local);
        let sizes: BTreeSet<usize> = used.map(|term_use| term_use.num_registered).collect();
        // Each image after the third is adjusted with its neighbours. A global adjustment follows
        // where the model has grown by a tenth: after each of the first ten.
        let expected = if is_local { MIN_IMAGES + 1..2 * NUM_FRAMES } else { MIN_IMAGES..10 };
        assert!(expected.into_iter().all(|size| sizes.contains(&size)), "{is_local}: {sizes:?}");
    }
    // The model grows in the frame of the positions: it is never farther from them than noise and
    // the drift of one new image.
    let farthest_m = term.uses.iter().map(|term_use| term_use.rms_m).fold(0.0, f64::max);
    assert!(farthest_m < 3.0 * 3.0_f64.sqrt() * SIGMA_M, "{farthest_m}");
}

/// Positions of two images do not determine the frame.
#[test]
fn a_term_without_a_frame_changes_nothing() {
    let street = street();
    let mut positions = street.measured();
    positions.0.truncate(2);
    let mut term = Recorded { positions, uses: Vec::new() };
    let with =
        Mapper::new(&street.graph, &street.blank).term(&mut term).run(&options(RigMode::Off));
    assert!(term.uses.is_empty());
    let without = Mapper::new(&street.graph, &street.blank).run(&options(RigMode::Off));
    assert_eq!(with.unwrap(), without.unwrap());
}

#[test]
fn a_constrained_rig_is_in_the_frame_of_the_positions() {
    let street = street();
    // The example leaves out images whose poses are composed: those of the other camera.
    for (mode, used) in [(RigMode::Soft, 2 * NUM_FRAMES), (RigMode::Rigid, NUM_FRAMES)] {
        let mut positions = street.measured();
        let mapper = Mapper::new(&street.graph, &street.blank).term(&mut positions);
        let models = mapper.run(&options(mode)).unwrap();
        let MappedModel { reconstruction: model, rig, .. } = &models[0];
        let error_m = street.rms_m(model);
        assert!(error_m < max_error_m(used), "{mode:?}: {error_m}");
        // The positions fix the gauge of the covariance, too.
        let rig = rig.as_ref().unwrap();
        assert!(rig.constraint.is_some() && rig.cameras[0].covariance.is_some(), "{mode:?}");
    }
}

/// The rig's scale is exact, and the positions are those of a frame that is larger by this factor.
const SCALE: f64 = 1.02;
/// Errors of double precision.
const ROUNDING: f64 = 1e-9;

#[test]
fn constant_rigs_keep_their_scale() {
    let street = street();
    let cameras: Vec<_> = street.truth.cameras().map(|(id, _)| id).collect();
    let cam_from_rig = street.drive.cam_from_rig(1);
    let sensors = vec![
        RigSensor { camera: cameras[0], cam_from_rig: None },
        RigSensor { camera: cameras[1], cam_from_rig: Some(cam_from_rig) },
    ];
    let image = |index: usize| ImageId::from_index(index);
    let frames = (0..NUM_FRAMES)
        .map(|n| KnownFrame { rig: RigId(0), images: vec![image(n), image(NUM_FRAMES + n)] })
        .collect();
    let rigs = KnownRigs { rigs: vec![Rig { sensors }], frames, refine_extrinsics: false };
    let mut positions = street.measured();
    positions.0.iter_mut().for_each(|(_, place, _)| *place *= SCALE);
    let mapper = Mapper::new(&street.graph, &street.blank).known_rigs(&rigs).term(&mut positions);
    let model = &mapper.run(&options(RigMode::Off)).unwrap()[0];
    assert!(model.is_in_frame_of_terms && model.failures.is_empty());
    let found = model.reconstruction.rigs[0].sensors[1].cam_from_rig.unwrap();
    assert!((found.translation - cam_from_rig.translation).norm() < ROUNDING, "{found:?}");
}

#[test]
fn existing_poses_stay_or_move_into_the_frame_of_the_positions() {
    let street = street();
    let mut start = street.blank.clone();
    for (id, _, pose) in street.truth.registered().filter(|(id, ..)| id.index() < NUM_FRAMES / 2) {
        start.register(id, *pose);
    }
    for poses in [ExistingPoses::Constant, ExistingPoses::Refined] {
        let mut positions = street.measured();
        let mapper = Mapper::new(&street.graph, &start).existing(poses).term(&mut positions);
        let models = mapper.run(&options(RigMode::Off)).unwrap();
        let model = &models[0].reconstruction;
        let is_kept =
            |(id, _, pose): (ImageId, _, &Rigid3)| model.image(id).cam_from_world() == Some(pose);
        assert_eq!(start.registered().all(is_kept), poses == ExistingPoses::Constant);
        if poses == ExistingPoses::Refined {
            let error_m = street.rms_m(model);
            assert!(error_m < max_error_m(2 * NUM_FRAMES), "{error_m}");
        }
    }
}
