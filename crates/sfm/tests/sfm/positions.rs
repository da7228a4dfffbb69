//! Measured positions: the similarity to them, their term, and whether it helps.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng, Sim3, so3};
use tiepoint_scene::{Camera, CorrespondenceGraph, Image, ImageId, Reconstruction};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::positions::{
    Comparison, ControlMisfit, MarkedPoint, MeasuredPosition, Misfit, PositionAlignment,
    PositionTerm, align, align_to_points, compare, held_out,
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
        positions.push(MeasuredPosition { image, xyz, has_height: true, sigmas_m: None });
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
    align(model, positions, false, 0).unwrap()
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
        assert!(found.level_sd_rad.is_none() && found.scale_sd < 0.02, "{every}: {found:?}");
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
    assert!(found.level_sd_rad.is_some_and(|sd_rad| sd_rad.to_degrees() < 6.0), "{found:?}");
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

/// Photos at these places; the columns are the axes of all cameras, which are off by 2° at random.
fn photos(places: &[Vector3<f64>], axes: [Vector3<f64>; 3], seed: u64) -> Reconstruction {
    let mut rng = Rng::stream(seed, &[2]);
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    let camera =
        model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes));
    let upright = UnitQuaternion::from_rotation_matrix(&axes);
    for (index, place) in places.iter().enumerate() {
        let id = model.add_image(Image::new(format!("{index:03}.jpg"), camera, Vec::new()));
        let off = so3::exp(&Vector3::from_fn(|_, _| 2f64.to_radians() * rng.normal()));
        let cam_from_world = (off * upright).inverse();
        model.register(id, Rigid3::new(cam_from_world, -(cam_from_world * place)));
    }
    model
}

/// Photos along a line to the east with a metre of noise of positions.
fn on_a_line(axes: [Vector3<f64>; 3], seed: u64) -> (Reconstruction, Vec<MeasuredPosition>) {
    let mut rng = Rng::stream(seed, &[3]);
    let mut noise = |sigma_m: f64| Vector3::from_fn(|_, _| sigma_m * rng.normal());
    let places: Vec<Vector3<f64>> =
        (0..40).map(|k| Vector3::new(5.0 * f64::from(k), 0.0, 0.0) + noise(0.05)).collect();
    let truth = photos(&places, axes, seed);
    let position = |(image, place): (usize, &Vector3<f64>)| MeasuredPosition {
        image: ImageId::from_index(image),
        xyz: place + noise(SIGMA_M),
        has_height: true,
        sigmas_m: None,
    };
    let positions = places.iter().enumerate().map(position).collect();
    (truth, positions)
}

/// Positions on a line tell nothing of the rotation about it: fits to their noise have any.
#[test]
fn about_a_line_the_upright_photos_give_the_rotation_and_others_none() {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    let (forward, sideways) = ([-y, -z, x], [x, -z, y]);
    // The tops of the photos are ahead, or they are portraits that are stored as landscapes.
    let (nadir, turned) = ([-y, -x, -z], [-z, -x, y]);
    for seed in 0..20 {
        for (axes, sd_deg) in [(forward, 5.0), (sideways, 15.0)] {
            let (truth, positions) = on_a_line(axes, seed);
            let found = aligned(&moved(&truth), &positions);
            let sd = found.level_sd_rad.unwrap().to_degrees();
            assert!((sd - sd_deg).abs() < 1.0, "{seed}: {sd}");
            let [here, there] = [&moved(&truth), &truth].map(|model| {
                let (_, _, pose) = model.registered().next().unwrap();
                pose.rotation
            });
            // The mean of 40 photos is off by 2°/√40, and the heading of 40 positions along 200 m
            // by 0.2°: three deviations of both.
            let off = here * found.term_from_model.rotation.inverse() * there.inverse();
            assert!(off.angle().to_degrees() < 2.0, "{seed}: {}", off.angle().to_degrees());
        }
        for axes in [nadir, turned] {
            let (truth, positions) = on_a_line(axes, seed);
            let found = align(&moved(&truth), &positions, false, 0);
            assert_eq!(found, Err(Misfit::NoVertical { is_line: true }), "{seed}");
        }
    }
    // Also if not even rounding tells of the rotation.
    let (truth, mut positions) = on_a_line(sideways, 0);
    for position in &mut positions {
        position.xyz = Vector3::new(position.xyz.x, 0.0, 0.0);
    }
    assert!(aligned(&moved(&truth), &positions).level_sd_rad.is_some());
    // A vertical line has no heading.
    positions.iter_mut().for_each(|position| position.xyz.swap_rows(0, 2));
    let up = align(&moved(&truth), &positions, false, 0);
    assert!(matches!(up, Err(Misfit::NoRotation { is_heading: true, .. })), "{up:?}");
}

/// A hill of 30 m on a path of 300 m.
#[test]
fn without_altitudes_the_photos_give_the_heights() {
    let mut rng = Rng::stream(4, &[]);
    let place = |k: i32| {
        let t = f64::from(k) / 10.0;
        Vector3::new(30.0 * t, 40.0 * t.sin(), 15.0 * (1.0 - (t / 1.6).cos()))
    };
    let places: Vec<Vector3<f64>> = (0..100).map(place).collect();
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    let truth = photos(&places, [-y, -z, x], 0);
    let position = |(image, place): (usize, &Vector3<f64>)| MeasuredPosition {
        image: ImageId::from_index(image),
        xyz: Vector3::new(place.x + rng.normal(), place.y + rng.normal(), 0.0),
        has_height: false,
        sigmas_m: None,
    };
    let positions: Vec<MeasuredPosition> = places.iter().enumerate().map(position).collect();
    let found = aligned(&moved(&truth), &positions);
    assert!(!found.has_heights() && found.level_sd_rad.is_some(), "{found:?}");
    assert!((found.sigmas_m[0] - SIGMA_M).abs() < 0.3 * SIGMA_M, "{found:?}");
    let mean = places.iter().map(|place| place.z).sum::<f64>() / places.len() as f64;
    let model = moved(&truth);
    for (image, _, pose) in model.registered() {
        let place = found.term_from_model * pose.origin_in_a();
        // Half a degree of tilt over 150 m.
        let error = place.z - (places[image.index()].z - mean);
        assert!(error.abs() < 1.5, "{image:?}: {error} m");
    }
    // Some altitudes are enough, and positions without one count by their places.
    let mut some = positions.clone();
    for (position, place) in some.iter_mut().zip(&places).step_by(5) {
        (position.has_height, position.xyz.z) = (true, place.z);
    }
    let found = aligned(&moved(&truth), &some);
    assert!(found.has_heights() && found.level_sd_rad.is_none(), "{found:?}");
    assert_eq!(found.num_compared, 100);
    let mut swapped = positions;
    swapped.iter_mut().for_each(|position| position.xyz.swap_rows(0, 1));
    let found = align(&moved(&truth), &swapped, false, 0);
    assert_eq!(found, Err(Misfit::UpsideDown));
}

/// Only a flat path fits its mirror image: on a hill, right positions of cameras that are mounted
/// upside down are told from swapped coordinates.
#[test]
fn cameras_upside_down_on_a_hill_are_right_and_on_a_plain_may_be_mirrored() {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    for height in [0.0, 15.0] {
        let place = |k: i32| {
            let t = f64::from(k) / 10.0;
            Vector3::new(30.0 * t, 40.0 * t.sin(), height * (1.0 - (t / 1.6).cos()))
        };
        let places: Vec<Vector3<f64>> = (0..100).map(place).collect();
        let truth = photos(&places, [y, z, x], 0);
        let mut rng = Rng::stream(6, &[]);
        let position = |(image, place): (usize, &Vector3<f64>)| MeasuredPosition {
            image: ImageId::from_index(image),
            xyz: place + Vector3::from_fn(|_, _| SIGMA_M * rng.normal()),
            has_height: true,
            sigmas_m: None,
        };
        let positions: Vec<MeasuredPosition> = places.iter().enumerate().map(position).collect();
        let found = align(&moved(&truth), &positions, false, 0);
        match height {
            0.0 => assert_eq!(found, Err(Misfit::UpsideDown)),
            _ => {
                let rms_m = rms_m(&moved(&truth), &found.unwrap().term_from_model, &truth);
                assert!(rms_m < max_rms_m(100), "{rms_m} m");
            }
        }
    }
}

/// With a scale of its own, what the model deviates from the positions is not fitted away.
#[test]
fn a_known_scale_stays_and_counts_in_the_deviations() {
    let Street { truth, .. } = street(RouteKind::Open, 200.0);
    let (positions, _) = measured(&truth, 1000, 7);
    let mut model = truth.clone();
    let rotation = UnitQuaternion::from_euler_angles(1.0, -0.5, 2.5);
    model.transform(&Sim3 { scale: 1.1, rotation, translation: Vector3::new(3.0, 1.0, -7.0) });
    let [kept, free] = [true, false].map(|keeps| align(&model, &positions, keeps, 0).unwrap());
    assert_eq!((kept.term_from_model.scale, kept.scale_sd), (1.0, 0.0));
    assert!((free.term_from_model.scale * 1.1 - 1.0).abs() < 3.0 * free.scale_sd, "{free:?}");
    // A tenth of a path of 200 m: its ends are off by 10 m, the median by 5 m.
    assert!(free.sigmas_m[0] < 1.5 * SIGMA_M && kept.sigmas_m[0] > 2.5 * SIGMA_M, "{kept:?}");
}

/// Four control points, marked in two photos.
#[test]
fn control_points_near_a_line_are_refused() {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    let places = [Vector3::new(-8.0, 0.0, 0.0), Vector3::zeros(), Vector3::new(8.0, 0.0, 0.0)];
    let truth = photos(&places, [x, -z, y], 1);
    let point = |xyz: Vector3<f64>| {
        let mark = |(image, _, pose): (ImageId, &Image, &Rigid3)| {
            let seen = *pose * xyz;
            let centre = Vector2::new(320.0, 240.0);
            (image, centre + seen.xy() * (500.0 / seen.z))
        };
        let marks = truth.registered().map(mark).collect();
        let sigmas_m = Vector3::repeat(0.01);
        MarkedPoint { xyz, sigmas_m, is_check: false, mark_sigma_px: 3.0, marks }
    };
    let model = moved(&truth);
    // A wall of 12 m and a depth of 15 m.
    let corner = |k: i32, up: f64| point(Vector3::new(3.0 * f64::from(k), 15.0, up));
    let wall = [corner(-2, 0.0), corner(2, 0.1), corner(-2, 6.0), corner(2, 6.0)];
    let found = align_to_points(&model, &wall);
    assert!(found.is_ok(), "{found:?}");
    let line = [corner(-2, 0.0), corner(2, 0.1), corner(-1, 0.1), corner(1, 0.0)];
    let found = align_to_points(&model, &line).unwrap_err();
    let ControlMisfit::Uncertain { usable: 4, rotation_sd_rad, scale_sd } = found else {
        panic!("{found:?}")
    };
    assert!(rotation_sd_rad > 0.1 && scale_sd < 0.1, "{found:?}");
    // A floor, two metres below, also with swapped coordinates.
    let floor = [(-8, 12.0), (8, 12.0), (-8, 30.0), (8, 30.0)]
        .map(|(x, y)| point(Vector3::new(f64::from(x), y, -2.0)));
    let found = align_to_points(&model, &floor);
    assert!(found.is_ok(), "{found:?}");
    let swapped = floor.map(|mut point| {
        point.xyz.swap_rows(0, 1);
        point
    });
    assert_eq!(align_to_points(&model, &swapped), Err(ControlMisfit::UpsideDown));
    let two = align_to_points(&model, &line[..2]).unwrap_err();
    assert_eq!(two, ControlMisfit::TooFew { usable: 2 });
}

#[test]
fn positions_that_tell_nothing_are_refused() {
    let Street { truth, .. } = street(RouteKind::Open, 200.0);
    let model = moved(&truth);
    let (positions, _) = measured(&truth, 1000, 7);
    let few = align(&model, &positions[..5], false, 0);
    assert_eq!(few, Err(Misfit::TooFew { compared: 5 }));
    let changed = |change: &mut dyn FnMut(&mut Vector3<f64>)| {
        let mut positions = positions.clone();
        positions.iter_mut().for_each(|position| change(&mut position.xyz));
        align(&model, &positions, false, 0)
    };
    // A receiver that stands still, with and without noise.
    let still = changed(&mut |xyz| *xyz = Vector3::new(1.0, 2.0, 3.0));
    assert_eq!(still, Err(Misfit::OnePlace));
    for seed in 0..20 {
        let mut rng = Rng::stream(seed, &[1]);
        let noise = changed(&mut |xyz| *xyz = xyz.map(|_| 50.0 * rng.normal()));
        assert!(matches!(noise, Err(Misfit::NoScale { .. })), "{seed}: {noise:?}");
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
            has_height: true,
            sigmas_m: Some([0.02; 2]),
        })
        .collect();
    let run = |positions: &[MeasuredPosition], rig: RigMode, without: &[MappedModel]| {
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
    let [off, rigid] = [RigMode::Off, RigMode::Rigid].map(|rig| mapped(&street, None, rig));
    for (rig, without) in [(RigMode::Off, &off), (RigMode::Rigid, &rigid)] {
        let (compared, [before, after]) = run(&exact, rig, without);
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
    let (compared, _) = run(&bent, RigMode::Off, &off);
    assert!(!compared.is_better(), "{compared:?}");
    // What is better is not taken if the largest model loses images.
    let better = Comparison { gain: 0.5, t: 9.0, images: [100; 2], kept: [100; 2], ..compared };
    let better = Comparison { error_px: [0.5; 2], ..better };
    assert_eq!(better.why_not_better(), None);
    let torn = Comparison { kept: [100, 97], ..better };
    assert_eq!(torn.why_not_better().unwrap(), "which would lose 3 of 100 images");
    // Four blocks tell nothing.
    let model = [(&street.truth, Sim3::identity())];
    assert_eq!(compare(&model, &model, &exact[..22], [1.0; 2]), None);
    let same = compare(&model, &model, &exact[..23], [1.0; 2]).unwrap();
    assert_eq!(same.why_not_better().unwrap(), "which is not better by 10 %");
}
