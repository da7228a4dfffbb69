//! Measured positions: the similarity to them, their term, and whether it helps.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_geometry::{Rng, Sim3};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::positions::{
    MeasuredPosition, Misfit, PositionAlignment, PositionTerm, align, compare, held_out,
};
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, RouteKind};

const SIGMA_M: f64 = 1.0;
const OUTLIER_M: f64 = 30.0;

struct Street {
    truth: Reconstruction,
    blank: Reconstruction,
    graph: CorrespondenceGraph,
}

fn street(route: RouteKind, length_m: f64) -> Street {
    let options = DriveOptions { route, length_m, rate_hz: 3.0, ..DriveOptions::default() };
    let drive = Drive::new(&options).unwrap();
    let features = FeatureOptions { observations: 40_000, ..FeatureOptions::default() };
    let street = FeatureScene::new(&drive, &features).unwrap();
    let graph = street.graph(&MatchOptions { window: Some(8), ..MatchOptions::default() });
    Street { truth: street.truth().clone(), blank: street.without_poses(), graph }
}

/// Of each image of the truth, with noise, and one in `every` beside it by far.
fn measured(
    truth: &Reconstruction,
    every: usize,
    seed: u64,
) -> (Vec<MeasuredPosition>, BTreeSet<ImageId>) {
    let mut rng = Rng::stream(seed, &[]);
    let mut wrong = BTreeSet::new();
    let mut positions = Vec::new();
    for (index, (image, _, pose)) in truth.registered().enumerate() {
        let mut xyz = pose.origin_in_a().map(|metres| metres + SIGMA_M * rng.normal());
        if index % every == 1 {
            let direction = Vector3::new(rng.normal(), rng.normal(), 0.3 * rng.normal());
            xyz += direction.normalize() * OUTLIER_M;
            wrong.insert(image);
        }
        positions.push(MeasuredPosition { image, xyz, sigmas_m: None });
    }
    (positions, wrong)
}

/// The truth in another frame and unit.
fn moved(truth: &Reconstruction) -> Reconstruction {
    let mut model = truth.clone();
    model.transform(&Sim3 {
        scale: 0.05,
        rotation: UnitQuaternion::from_euler_angles(1.0, -0.5, 2.5),
        translation: Vector3::new(3.0, 1.0, -7.0),
    });
    model
}

/// Root mean square distance of the centres from the true ones, in metres.
fn rms_m(model: &Reconstruction, similarity: &Sim3, truth: &Reconstruction) -> f64 {
    let squares: Vec<f64> = model
        .registered()
        .filter_map(|(id, _, pose)| {
            let there = truth.image(id).cam_from_world()?.origin_in_a();
            Some((*similarity * pose.origin_in_a() - there).norm_squared())
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn aligned(model: &Reconstruction, positions: &[MeasuredPosition]) -> PositionAlignment {
    align(model, positions, 0).unwrap()
}

/// The similarity has seven parameters, which 3 n coordinates determine, so that the squared error
/// of the centres is σ² 7 / n on average; three times as much is beyond chance (χ² of 7: 1e-4).
/// Cauchy's loss loses a fifth.
fn max_rms_m(num_right: usize) -> f64 {
    SIGMA_M * (3.0 * 1.2 * 7.0 / num_right as f64).sqrt()
}

#[test]
fn a_third_of_wrong_positions_does_no_harm_and_is_named() {
    let Street { truth, .. } = street(RouteKind::Open, 200.0);
    let model = moved(&truth);
    for every in [1000, 10, 3] {
        let (positions, wrong) = measured(&truth, every, 7);
        let found = aligned(&model, &positions);
        let rms_m = rms_m(&model, &found.term_from_model, &truth);
        let right = positions.len() - wrong.len();
        assert!(rms_m < max_rms_m(right), "{every}: {rms_m} m, {found:?}");
        let named: BTreeSet<ImageId> = found.outliers.iter().copied().collect();
        assert!(wrong.is_subset(&named), "{every}: {wrong:?} {named:?}");
        // One in a hundred right ones is named, too.
        assert!(named.len() - wrong.len() <= 2 + right / 25, "{every}: {wrong:?} {named:?}");
        // Half a median is a standard deviation to a tenth for a hundred positions; wrong ones
        // make it larger.
        assert!((0.7..1.8).contains(&(found.sigmas_m[0] / SIGMA_M)), "{every}: {found:?}");
        assert!(!found.is_levelled && found.scale_sd < 0.02, "{every}: {found:?}");
    }
}

#[test]
fn on_a_straight_road_the_level_images_give_up() {
    let Street { truth, .. } = street(RouteKind::Highway, 200.0);
    let model = moved(&truth);
    let (mut positions, _) = measured(&truth, 10, 3);
    for position in &mut positions {
        position.sigmas_m = Some([2.0 * SIGMA_M; 2]);
    }
    let found = aligned(&model, &positions);
    assert!(found.is_levelled, "{found:?}");
    let up = |id: ImageId, model: &Reconstruction, by: &UnitQuaternion<f64>| {
        let pose = model.image(id).cam_from_world().unwrap();
        pose.rotation * (by.inverse() * Vector3::z())
    };
    let (first, ..) = truth.registered().next().unwrap();
    let expected = up(first, &truth, &UnitQuaternion::identity());
    let angle = up(first, &model, &found.term_from_model.rotation).angle(&expected);
    // The cameras of a car are level to a few degrees.
    assert!(angle.to_degrees() < 5.0, "{} degrees", angle.to_degrees());
}

#[test]
fn positions_that_tell_nothing_are_refused() {
    let Street { truth, .. } = street(RouteKind::Open, 200.0);
    let model = moved(&truth);
    let (positions, _) = measured(&truth, 1000, 7);
    let few = align(&model, &positions[..5], 0);
    assert_eq!(few, Err(Misfit::TooFew { compared: 5 }));
    let changed = |change: &mut dyn FnMut(&mut Vector3<f64>)| {
        let mut positions = positions.clone();
        positions.iter_mut().for_each(|position| change(&mut position.xyz));
        align(&model, &positions, 0)
    };
    // A receiver that stands still, with and without noise.
    let still = changed(&mut |xyz| *xyz = Vector3::new(1.0, 2.0, 3.0));
    assert!(matches!(still, Err(Misfit::Undetermined { .. })), "{still:?}");
    for seed in 0..20 {
        let mut rng = Rng::stream(seed, &[1]);
        let noise = changed(&mut |xyz| *xyz = xyz.map(|_| 50.0 * rng.normal()));
        assert!(matches!(noise, Err(Misfit::Undetermined { .. })), "{seed}: {noise:?}");
    }
    // A flat path that is mirrored fits upside down.
    let swapped = changed(&mut |xyz| xyz.swap_rows(0, 1));
    assert_eq!(swapped, Err(Misfit::UpsideDown));
}

fn mapped(street: &Street, term: Option<&mut PositionTerm>, rig: RigMode) -> Vec<MappedModel> {
    let options = MapperOptions { refine: RefineIntrinsics::NONE, rig, ..MapperOptions::default() };
    let mut mapper = Mapper::new(&street.graph, &street.blank);
    if let Some(term) = term {
        mapper = mapper.term(term);
    }
    mapper.run(&options).unwrap()
}

/// Positions far more precise than the path of the images hold it together.
#[test]
fn precise_positions_remove_drift_and_wrong_ones_are_not_believed() {
    let street = street(RouteKind::Open, 200.0);
    let mut rng = Rng::stream(5, &[]);
    let exact: Vec<MeasuredPosition> = street
        .truth
        .registered()
        .map(|(image, _, pose)| MeasuredPosition {
            image,
            xyz: pose.origin_in_a().map(|metres| metres + 0.02 * rng.normal()),
            sigmas_m: Some([0.02; 2]),
        })
        .collect();
    let run = |positions: &[MeasuredPosition], rig: RigMode| {
        let without = mapped(&street, None, rig);
        let model = &without[0].reconstruction;
        let found = aligned(model, positions);
        let (used, _) = held_out(positions);
        let mut term = PositionTerm::new(&used, found.sigmas_m, 0);
        let with = mapped(&street, Some(&mut term), rig);
        assert!(with[0].is_in_frame_of_terms);
        let compared = compare(
            &[(model, found.term_from_model)],
            &[(&with[0].reconstruction, Sim3::identity())],
            positions,
            found.sigmas_m,
        );
        let rms = [
            rms_m(model, &found.term_from_model, &street.truth),
            rms_m(&with[0].reconstruction, &Sim3::identity(), &street.truth),
        ];
        (compared.unwrap(), rms)
    };
    for rig in [RigMode::Off, RigMode::Rigid] {
        let (compared, [before, after]) = run(&exact, rig);
        // A rigid rig leaves little drift.
        let is_better = compared.is_better() && after < 0.7 * before;
        assert!(is_better || rig == RigMode::Rigid, "{before} m, {after} m: {compared:?}");
        // The error of a single position is 2 cm √3.
        assert!(after < 0.035, "{rig:?}: {before} m, {after} m");
    }
    // A bent path: the errors of a receiver, which grow to 20 m. The images know better.
    let bent: Vec<MeasuredPosition> = exact
        .iter()
        .map(|position| {
            let along = position.xyz.x / 100.0;
            let xyz = position.xyz + Vector3::new(0.0, 20.0, 5.0) * (2.0 * along).sin();
            MeasuredPosition { xyz, ..*position }
        })
        .collect();
    let (compared, _) = run(&bent, RigMode::Off);
    assert!(!compared.is_better(), "{compared:?}");
}
