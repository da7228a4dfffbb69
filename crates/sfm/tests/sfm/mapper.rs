//! The mapper on synthetic scenes: points in a box, cameras on an arc around it, keypoints with
//! noise, and a fraction of wrong matches.

use std::ops::ControlFlow;

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::triangulate::{ViewRay, nearest_to_rays};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Observation,
    Reconstruction, Track, TwoView,
};
use tiepoint_sfm::adjust::{AdjustOptions, RefineIntrinsics, Scope, adjust};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};
use tiepoint_sfm::{Event, Mapper, MapperOptions};

use crate::common::sample;

/// Standard deviation of a keypoint's position, in pixels, as SIFT has on sharp photos.
const NOISE_PX: f64 = 0.5;
/// Fraction of matches between random keypoints.
const WRONG_SHARE: f64 = 0.2;
/// True focal length in pixels, for images of 1000 × 750.
const FOCAL_PX: f64 = 900.0;
/// Radius of the arc of cameras, in metres.
const RADIUS: f64 = 4.0;
const NUM_IMAGES: usize = 9;
const NUM_POINTS: usize = 600;

struct Truth {
    scene: Reconstruction,
    graph: CorrespondenceGraph,
    poses: Vec<Rigid3>,
    /// For each image, the point of each keypoint, in ascending order.
    seen: Vec<Vec<usize>>,
}

/// Cameras on an arc, all looking at the box.
fn truth(seed: u64, guessed_focal_px: f64, has_focal_prior: bool) -> Truth {
    let true_intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, FOCAL_PX, 1000, 750);
    truth_of(seed, &true_intrinsics, NOISE_PX, guessed_focal_px, has_focal_prior)
}

fn truth_of(
    seed: u64,
    true_intrinsics: &Intrinsics,
    noise_px: f64,
    guessed_focal_px: f64,
    has_focal_prior: bool,
) -> Truth {
    let mut rng = Rng::stream(seed, &[]);
    let mut scene = Reconstruction::default();
    let camera = scene.add_camera(Camera {
        intrinsics: Intrinsics::centred(CameraModelKind::SimpleRadial, guessed_focal_px, 1000, 750),
        width: 1000,
        height: 750,
        has_focal_prior,
    });
    let points: Vec<Vector3<f64>> = (0..NUM_POINTS)
        .map(|_| Vector3::new(rng.uniform() - 0.5, rng.uniform() - 0.5, rng.uniform() - 0.5) * 2.0)
        .collect();
    let mut poses = Vec::new();
    let mut seen: Vec<Vec<usize>> = Vec::new();
    for index in 0..NUM_IMAGES {
        let angle = 0.15 * index as f64;
        let centre =
            Vector3::new(RADIUS * angle.sin(), 0.3 * (3.0 * angle).sin(), -RADIUS * angle.cos());
        let forward = (-centre).normalize();
        let world_from_cam = UnitQuaternion::face_towards(&forward, &Vector3::new(0.0, 1.0, 0.0));
        let rotation = world_from_cam.inverse();
        let pose = Rigid3::new(rotation, -(rotation * centre));
        let mut keypoints = Vec::new();
        let mut which = Vec::new();
        for (point, xyz) in points.iter().enumerate() {
            let Some(pixel) = true_intrinsics.project(&(pose * *xyz)) else { continue };
            let pixel = pixel + Vector2::new(rng.normal(), rng.normal()) * noise_px;
            if (0.0..1000.0).contains(&pixel.x) && (0.0..750.0).contains(&pixel.y) {
                keypoints.push(Keypoint { pixel, scale_px: 2.0 });
                which.push(point);
            }
        }
        scene.add_image(Image::new(format!("{index:03}.png"), camera, keypoints));
        poses.push(pose);
        seen.push(which);
    }
    let mut two_views: Vec<(ImagePair, TwoView)> = Vec::new();
    for a in 0..NUM_IMAGES {
        for b in a + 1..(a + 5).min(NUM_IMAGES) {
            let mut matches: Vec<Match> = Vec::new();
            for (i, point) in seen[a].iter().enumerate() {
                if let Ok(j) = seen[b].binary_search(point) {
                    let j = if rng.uniform() < WRONG_SHARE { rng.below(seen[b].len()) } else { j };
                    matches.push(Match { a: i as u32, b: j as u32 });
                }
            }
            let pair = ImagePair::new(ImageId(a as u32), ImageId(b as u32)).expect("two images");
            let view = |id| ImageObservations::new(&scene, id);
            two_views.push((
                pair,
                verify_pair(view(pair.a), view(pair.b), &matches, &VerifyOptions::default(), seed),
            ));
        }
    }
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    Truth { graph: CorrespondenceGraph::new(&counts, two_views), scene, poses, seen }
}

/// Largest error of a distance between two camera centres, relative to the largest distance, after
/// scaling the model by the sum of all distances.
fn shape_error(model: &Reconstruction, poses: &[Rigid3]) -> f64 {
    let centres: Vec<(Vector3<f64>, Vector3<f64>)> = model
        .registered()
        .map(|(id, _, pose)| (pose.origin_in_a(), poses[id.index()].origin_in_a()))
        .collect();
    let pairs: Vec<(f64, f64)> = centres
        .iter()
        .enumerate()
        .flat_map(|(n, a)| centres[..n].iter().map(|b| ((a.0 - b.0).norm(), (a.1 - b.1).norm())))
        .collect();
    let scale = pairs.iter().map(|p| p.1).sum::<f64>() / pairs.iter().map(|p| p.0).sum::<f64>();
    let largest = pairs.iter().map(|p| p.1).fold(0.0, f64::max);
    pairs.iter().map(|p| (p.0 * scale - p.1).abs()).fold(0.0, f64::max) / largest
}

fn run(truth: &Truth, options: &MapperOptions) -> Reconstruction {
    let mut models =
        Mapper::new(&truth.graph, &truth.scene).run(options).expect("the scene is easy");
    models.remove(0).reconstruction
}

/// Noise of 0.5 px at 900 px and 4 m is 2 mm an observation. Some hundred observations an image
/// give well under a millimetre of 4.4 m, and the intrinsics add to it.
const MAX_SHAPE_ERROR_CALIBRATED: f64 = 1e-3;
const MAX_SHAPE_ERROR_UNCALIBRATED: f64 = 4e-3;
/// The parallax of the arc determines the focal length.
const MAX_RELATIVE_FOCAL_ERROR: f64 = 0.01;

#[test]
fn calibrated_images_give_the_true_shape() {
    for &seed in sample(&[0, 1, 2]) {
        let truth = truth(seed, FOCAL_PX, true);
        let model = run(
            &truth,
            &MapperOptions { refine: RefineIntrinsics::NONE, seed, ..Default::default() },
        );
        model.validate().unwrap();
        assert_eq!(model.num_registered(), NUM_IMAGES);
        let error = shape_error(&model, &truth.poses);
        assert!(error < MAX_SHAPE_ERROR_CALIBRATED, "seed {seed}: {error}");
    }
}

#[test]
fn an_unknown_focal_length_is_estimated() {
    for &seed in sample(&[0, 1, 2]) {
        let truth = truth(seed, 1200.0, false);
        let model = run(&truth, &MapperOptions { seed, ..Default::default() });
        model.validate().unwrap();
        assert_eq!(model.num_registered(), NUM_IMAGES);
        let (_, camera) = model.cameras().next().unwrap();
        let focal_error = (camera.intrinsics.mean_focal_px() / FOCAL_PX - 1.0).abs();
        assert!(focal_error < MAX_RELATIVE_FOCAL_ERROR, "seed {seed}: {focal_error}");
        let error = shape_error(&model, &truth.poses);
        assert!(error < MAX_SHAPE_ERROR_UNCALIBRATED, "seed {seed}: {error}");
    }
}

/// Offset of two standard deviations of the principal point's prior (10 px for 1000) in each
/// direction.
const FAR_CENTRE: Vector2<f64> = Vector2::new(520.0, 355.0);
/// Corners of a chessboard have this noise, a tenth of the nominal one.
const PRECISE_NOISE_PX: f64 = 0.05;
/// Observed: 0.2 to 1.4 px. With a noise scale of 1 px, the prior keeps the principal point 14 px
/// nearer to the centre.
const MAX_CENTRE_ERROR_PX: f64 = 3.0;

#[test]
fn precise_keypoints_outweigh_the_prior_on_the_principal_point() {
    for &seed in sample(&[0, 1, 2]) {
        let params = [FOCAL_PX, FAR_CENTRE.x, FAR_CENTRE.y, 0.0];
        let intrinsics = Intrinsics::new(CameraModelKind::SimpleRadial, &params).unwrap();
        let truth = truth_of(seed, &intrinsics, PRECISE_NOISE_PX, 1000.0, false);
        let model = run(&truth, &MapperOptions { seed, ..Default::default() });
        let (_, camera) = model.cameras().next().unwrap();
        let error = (camera.intrinsics.principal_point() - FAR_CENTRE).norm();
        assert!(error < MAX_CENTRE_ERROR_PX, "seed {seed}: {error}");
    }
}

#[test]
fn two_scenes_without_matches_become_two_models() {
    let (one, other) = (truth(5, FOCAL_PX, true), truth(6, FOCAL_PX, true));
    let mut scene = one.scene.clone();
    let camera = scene.cameras().next().unwrap().0;
    for (_, image) in other.scene.images() {
        scene.add_image(Image::new(
            format!("other/{}", image.name),
            camera,
            image.keypoints.to_vec(),
        ));
    }
    let shift = |id: ImageId| ImageId(id.0 + NUM_IMAGES as u32);
    let shifted = other.graph.pairs().iter().map(|(pair, two_view)| {
        (ImagePair { a: shift(pair.a), b: shift(pair.b) }, two_view.clone())
    });
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let pairs =
        one.graph.pairs().iter().map(|(pair, two_view)| (*pair, two_view.clone())).chain(shifted);
    let graph = CorrespondenceGraph::new(&counts, pairs);
    let options = MapperOptions { refine: RefineIntrinsics::NONE, ..Default::default() };
    let models = Mapper::new(&graph, &scene).run(&options).unwrap();
    assert_eq!(
        models.iter().map(|model| model.reconstruction.num_registered()).collect::<Vec<_>>(),
        [NUM_IMAGES, NUM_IMAGES]
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let truth = truth(7, 1100.0, false);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&truth, &MapperOptions::default()))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn the_callback_stops_the_mapper() {
    let truth = truth(8, FOCAL_PX, true);
    let mut stop = |_: &Event| ControlFlow::Break(());
    let mapper = Mapper::new(&truth.graph, &truth.scene).watch(&mut stop);
    let error = mapper.run(&MapperOptions::default());
    assert!(matches!(error, Err(tiepoint_sfm::Error::Cancelled)));
}

/// Noise of the keypoints. A fraction of them has a larger error in a random direction, below the
/// threshold of the filters.
const FINE_NOISE_PX: f64 = 0.1;
const OFF_PX: f64 = 2.5;
const OFF_SHARE: f64 = 0.3;
/// Three seeds give 2.3e-4 to 3.3e-4; with a loss of fixed scale 5.6e-4 to 8.9e-4.
const MAX_SHAPE_ERROR_OFF: f64 = 4.5e-4;

#[test]
fn outlier_keypoints_have_little_weight() {
    for &seed in sample(&[20, 21, 22]) {
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, FOCAL_PX, 1000, 750);
        let mut truth = truth_of(seed, &intrinsics, FINE_NOISE_PX, FOCAL_PX, true);
        let mut rng = Rng::stream(seed, &[1]);
        let mut scene = Reconstruction::default();
        scene.add_camera(*truth.scene.camera_of(ImageId(0)));
        for (_, image) in truth.scene.images() {
            let displaced = |keypoint: &Keypoint| {
                let off_px = if rng.uniform() < OFF_SHARE { OFF_PX } else { 0.0 };
                let angle = 2.0 * std::f64::consts::PI * rng.uniform();
                let pixel = keypoint.pixel + Vector2::new(angle.cos(), angle.sin()) * off_px;
                Keypoint { pixel, ..*keypoint }
            };
            let keypoints = image.keypoints.iter().map(displaced).collect();
            scene.add_image(Image::new(image.name.clone(), image.camera, keypoints));
        }
        truth.scene = scene;
        let model =
            run(&truth, &MapperOptions { refine: RefineIntrinsics::NONE, ..Default::default() });
        let error = shape_error(&model, &truth.poses);
        assert!(error < MAX_SHAPE_ERROR_OFF, "{error}");
    }
}

/// One in so many points is withheld from the mapper.
const HELD_OUT_ONE_IN: usize = 5;
/// Exceeded by chance once in fifteen thousand.
const MAX_DEVIATIONS: f64 = 4.0;
/// Initial position of held-out points, which must have no influence: an error of a quarter of the
/// box, some 100 px.
const NOWHERE: Vector3<f64> = Vector3::new(0.5, 0.5, 0.5);

/// The mapper never sees the matches of the points that test its poses.
#[test]
fn held_out_tracks_take_no_part_and_have_the_expected_error() {
    let truth = truth(9, FOCAL_PX, true);
    let is_held_out = |point: usize| point.is_multiple_of(HELD_OUT_ONE_IN);
    let without = truth.graph.pairs().iter().map(|(pair, two_view)| {
        let shows = |image: ImageId, keypoint: u32| truth.seen[image.index()][keypoint as usize];
        let mut two_view = two_view.clone();
        two_view
            .matches
            .retain(|m| !is_held_out(shows(pair.a, m.a)) && !is_held_out(shows(pair.b, m.b)));
        (*pair, two_view)
    });
    let counts: Vec<usize> = truth.scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let truth = Truth { graph: CorrespondenceGraph::new(&counts, without), ..truth };
    let mut model =
        run(&truth, &MapperOptions { refine: RefineIntrinsics::NONE, ..Default::default() });
    assert_eq!(model.num_registered(), NUM_IMAGES);

    let (mut held_out, mut num_observations, mut degrees_of_freedom) = (Vec::new(), 0, 0);
    for point in (0..NUM_POINTS).filter(|point| is_held_out(*point)) {
        let observe = |(image, id): (usize, ImageId)| {
            let keypoint = truth.seen[image].binary_search(&point).ok()? as u32;
            Some(Observation { image: id, keypoint })
        };
        let ids = model.images().map(|(id, _)| id).enumerate();
        let observations: Vec<Observation> = ids.filter_map(observe).collect();
        if observations.len() < 3 {
            continue;
        }
        let ray = |o: &Observation| {
            let image = model.image(o.image);
            let (pose, intrinsics) =
                (image.cam_from_world().unwrap(), &model.camera_of(o.image).intrinsics);
            ViewRay::new(pose, intrinsics, image.keypoints[o.keypoint as usize].pixel).unwrap()
        };
        let rays: Vec<ViewRay> = observations.iter().map(ray).collect();
        num_observations += observations.len();
        degrees_of_freedom += 2 * observations.len() - 3;
        let xyz = nearest_to_rays(rays.iter()).unwrap();
        let track = Track { is_held_out: true, ..Track::new(xyz, observations) };
        held_out.push(model.add_track(track));
    }
    // Each observation has two coordinates with noise NOISE_PX, and each point takes three degrees
    // of freedom. The poses, from four times as many points, add less than half a percent.
    let rms_px = tiepoint_sfm::tracks::held_out_rms_px(&model).unwrap();
    let expected_px = NOISE_PX * (degrees_of_freedom as f64 / num_observations as f64).sqrt();
    let max_share = MAX_DEVIATIONS / (2.0 * degrees_of_freedom as f64).sqrt();
    assert!((rms_px / expected_px - 1.0).abs() < max_share, "{rms_px} px, expected {expected_px}");

    let adjusted = |offset: Vector3<f64>| {
        let mut model = model.clone();
        for point in &held_out {
            model.track_mut(*point).unwrap().xyz += offset;
        }
        let options = AdjustOptions { refine: RefineIntrinsics::NONE, ..Default::default() };
        adjust(&mut model, &Scope::Global, &options, &mut [], &mut |_| ControlFlow::Continue(()))
            .unwrap();
        model
    };
    // No pose depends on the held-out points. Finally they are triangulated from the poses,
    // wherever they were.
    assert_eq!(adjusted(Vector3::zeros()), adjusted(NOWHERE));
}

#[test]
fn a_fraction_of_the_tracks_is_held_out_and_restored() {
    let mut model = run(&truth(9, FOCAL_PX, true), &MapperOptions::default());
    let num_tracks = model.num_tracks() as f64;
    let held_out = tiepoint_sfm::tracks::hold_out_tracks(&mut model, 0.2, 1);
    assert_eq!(model.tracks().filter(|(_, track)| track.is_held_out).count(), held_out);
    // Each track is drawn independently: a binomial number.
    let deviation = (0.2 * 0.8 / num_tracks).sqrt();
    assert!(
        (held_out as f64 / num_tracks - 0.2).abs() < MAX_DEVIATIONS * deviation,
        "{held_out} of {num_tracks}"
    );
    assert_eq!(tiepoint_sfm::tracks::hold_out_tracks(&mut model, 0.0, 1), 0);
    assert!(model.tracks().all(|(_, track)| !track.is_held_out));
}
