//! The mapper on cameras that see behind themselves: a panorama and a fisheye of 200 degrees, on a
//! path through a cloud of points on all sides.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Reconstruction,
    TwoView,
};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};
use tiepoint_sfm::{Mapper, MapperOptions};

/// Standard deviation of a keypoint's position, in pixels.
const NOISE_PX: f64 = 0.5;
/// Fraction of matches between random keypoints.
const WRONG_SHARE: f64 = 0.2;
const NUM_IMAGES: usize = 8;
const NUM_POINTS: usize = 500;
/// Distance between images in metres; points are at 2 to 8 m.
const STEP: f64 = 0.3;
/// Images of up to this difference of numbers are matched.
const WINDOW: usize = 4;

/// Images of a camera on a path that turns by 150 degrees, with their true poses.
fn scene(camera: Camera, lens: &Intrinsics) -> (Reconstruction, CorrespondenceGraph, Vec<Rigid3>) {
    let mut rng = Rng::stream(27, &[]);
    let mut model = Reconstruction::default();
    let camera = model.add_camera(camera);
    let points: Vec<Vector3<f64>> = (0..NUM_POINTS)
        .map(|_| {
            let direction = Vector3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            direction * (2.0 + 6.0 * rng.uniform())
        })
        .collect();
    let (mut poses, mut seen): (Vec<Rigid3>, Vec<Vec<usize>>) = (Vec::new(), Vec::new());
    for index in 0..NUM_IMAGES {
        let turn = 2.6 * index as f64 / NUM_IMAGES as f64;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, turn, 0.05));
        let along = STEP * (index as f64 - NUM_IMAGES as f64 / 2.0);
        let centre = Vector3::new(along, 0.1 * (2.0 * along).sin(), 0.3 * along * along);
        let pose = Rigid3::new(rotation, -(rotation * centre));
        let (mut keypoints, mut which) = (Vec::new(), Vec::new());
        for (point, xyz) in points.iter().enumerate() {
            let Some(pixel) = lens.project(&(pose * *xyz)) else { continue };
            let pixel = pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
            if model.camera(camera).contains(&pixel) {
                keypoints.push(Keypoint { pixel, scale_px: 2.0 });
                which.push(point);
            }
        }
        model.add_image(Image::new(format!("{index:03}.png"), camera, keypoints));
        poses.push(pose);
        seen.push(which);
    }
    let mut two_views: Vec<(ImagePair, TwoView)> = Vec::new();
    for a in 0..NUM_IMAGES {
        for b in a + 1..(a + 1 + WINDOW).min(NUM_IMAGES) {
            let mut matches: Vec<Match> = Vec::new();
            for (i, point) in seen[a].iter().enumerate() {
                if let Ok(j) = seen[b].binary_search(point) {
                    let j = if rng.uniform() < WRONG_SHARE { rng.below(seen[b].len()) } else { j };
                    matches.push(Match { a: i as u32, b: j as u32 });
                }
            }
            let pair = ImagePair::new(ImageId(a as u32), ImageId(b as u32)).expect("two images");
            let view = |id| ImageObservations::new(&model, id);
            let options = VerifyOptions::default();
            two_views.push((pair, verify_pair(view(pair.a), view(pair.b), &matches, &options, 0)));
        }
    }
    let counts: Vec<usize> = model.images().map(|(_, image)| image.keypoints.len()).collect();
    (model, CorrespondenceGraph::new(&counts, two_views), poses)
}

/// Maps the scene, and asserts that all images have their true poses up to a similarity.
fn assert_mapped(camera: Camera, lens: &Intrinsics) {
    let kind = lens.kind();
    let (blank, graph, poses) = scene(camera, lens);
    let models = Mapper::new(&graph, &blank).run(&MapperOptions::default()).expect("a model");
    let model = &models[0].reconstruction;
    assert_eq!(model.num_registered(), NUM_IMAGES, "{kind:?}");
    let (found, truth): (Vec<_>, Vec<_>) = model
        .registered()
        .map(|(id, _, pose)| (pose.origin_in_a(), poses[id.index()].origin_in_a()))
        .unzip();
    let truth_from_model = umeyama(&found, &truth, true).expect("centres on a curve");
    for (from, to) in found.iter().zip(&truth) {
        let error = (truth_from_model * *from - to).norm();
        // A centre among hundreds of points at 5 m is known to NOISE_PX / f · 5 m / √(100) or so.
        assert!(error < 0.01, "{kind:?}: {error} m");
    }
    let behind = model.registered().flat_map(|(_, image, pose)| {
        let points = image.points().iter().flatten();
        points.map(|point| (*pose * model.track(*point).expect("not deleted").xyz).z < 0.0)
    });
    let (num_behind, num_all) =
        behind.fold((0, 0), |(behind, all), is_behind| (behind + usize::from(is_behind), all + 1));
    // The fisheye's part of the sphere behind the image plane is 17 % of the half in front.
    assert!(num_behind * 10 > num_all, "{kind:?}: {num_behind} of {num_all} behind");
    assert!(model.mean_reprojection_error_px() < 1.5 * NOISE_PX, "{kind:?}");
}

#[test]
fn a_panorama_is_mapped_with_the_points_behind_it_and_across_its_seam() {
    let (width, height) = (2000, 1000);
    let intrinsics = Intrinsics::centred(CameraModelKind::Equirectangular, 1.0, width, height);
    assert_mapped(Camera { intrinsics, width, height, has_focal_prior: false }, &intrinsics);
}

/// A view of 200 degrees across the image of 1000 pixels.
const FISHEYE_PX: f64 = 286.0;
const SIDE_PX: u32 = 1000;

fn fisheye(focal_px: f64) -> Intrinsics {
    Intrinsics::centred(CameraModelKind::OpencvFisheye, focal_px, SIDE_PX, SIDE_PX)
}

#[test]
fn a_fisheye_is_mapped_with_the_points_behind_its_image_plane() {
    let (width, height) = (SIDE_PX, SIDE_PX);
    let intrinsics = fisheye(FISHEYE_PX);
    assert_mapped(Camera { intrinsics, width, height, has_focal_prior: true }, &intrinsics);
}

#[test]
fn a_fisheye_starts_from_an_unknown_focal_length() {
    let (width, height) = (SIDE_PX, SIDE_PX);
    // The guess is wrong by 40 %.
    let intrinsics = fisheye(1.4 * FISHEYE_PX);
    let camera = Camera { intrinsics, width, height, has_focal_prior: false };
    assert_mapped(camera, &fisheye(FISHEYE_PX));
}
