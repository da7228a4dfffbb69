//! Images without a pose, one for each reason.

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Observation,
    Reconstruction, Track, TwoView, TwoViewKind,
};
use tiepoint_sfm::diagnostics::{
    UnregisteredImage, UnregisteredReason, nearest_pair, unregistered_images,
};
use tiepoint_sfm::register::RegisterOptions;

const NUM_POINTS: u32 = 200;
/// Images of the model, and of a second model.
const MODEL: [u32; 2] = [0, 1];
const OTHER_MODEL: [u32; 2] = [2, 3];
/// Images without a pose.
const ALONE: u32 = 4;
const APART: [u32; 2] = [5, 6];
const FEW_POINTS: u32 = 7;
const FEW_INLIERS: u32 = 8;
const LATE: u32 = 9;
const CONTRADICTED: u32 = 10;
const NUM_IMAGES: u32 = 11;

/// What a pose needs by default.
const REQUIRED: usize = 30;
/// Matches below that, and above.
const FEW: u32 = 20;
const ENOUGH: u32 = 60;

/// Images 0.2 m apart before points 4 m to 8 m away. Keypoint k of each image shows point k. Image
/// k + NUM_POINTS is clutter, of which matches agree with no pose.
fn scene() -> Reconstruction {
    let intrinsics =
        Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 320.0, 240.0]).unwrap();
    let mut scene = Reconstruction::default();
    let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
    let camera = scene.add_camera(camera);
    let mut rng = Rng::stream(3, &[]);
    let points: Vec<Vector3<f64>> = (0..NUM_POINTS)
        .map(|_| {
            let [x, y, z] = [0; 3].map(|_| rng.uniform());
            Vector3::new(5.0 * x - 2.0, 4.0 * y - 2.0, 4.0 + 4.0 * z)
        })
        .collect();
    for index in 0..NUM_IMAGES {
        let pose = pose(index);
        let shown = points.iter().map(|point| intrinsics.project(&(pose * *point)).unwrap());
        let clutter = (0..NUM_POINTS)
            .map(|_| Vector2::new(640.0 * rng.uniform(), 480.0 * rng.uniform()))
            .collect::<Vec<_>>();
        let keypoints = shown.chain(clutter).map(|pixel| Keypoint { pixel, scale_px: 1.0 });
        scene.add_image(Image::new(format!("{index}.png"), camera, keypoints.collect()));
    }
    for xyz in points {
        scene.add_track(Track::new(xyz, Vec::new()));
    }
    scene
}

fn pose(index: u32) -> Rigid3 {
    Rigid3 { translation: Vector3::x() * (-0.2 * f64::from(index)), ..Rigid3::identity() }
}

/// A model of two images with all points.
fn model(of: [u32; 2]) -> Reconstruction {
    let mut model = scene();
    of.iter().for_each(|&image| model.register(ImageId(image), pose(image)));
    let points: Vec<_> = model.tracks().map(|(id, _)| id).collect();
    for (keypoint, point) in (0..).zip(points) {
        for image in of.map(ImageId) {
            model.add_observation(point, Observation { image, keypoint });
        }
    }
    model
}

fn graph() -> CorrespondenceGraph {
    let shown = |count: u32| (0..count).map(|k| Match { a: k, b: k }).collect::<Vec<_>>();
    let wrong = |from: u32, count: u32| {
        (from..from + count).map(|k| Match { a: k, b: NUM_POINTS + k }).collect::<Vec<_>>()
    };
    let clutter = |count: u32| {
        (NUM_POINTS..NUM_POINTS + count).map(|k| Match { a: k, b: k }).collect::<Vec<_>>()
    };
    let pairs = [
        (MODEL, shown(NUM_POINTS)),
        (OTHER_MODEL, shown(NUM_POINTS)),
        // The second model shares matches with the first, but few points.
        ([MODEL[0], OTHER_MODEL[1]], shown(FEW)),
        ([MODEL[1], OTHER_MODEL[1]], shown(FEW + 1)),
        (APART, shown(ENOUGH)),
        ([MODEL[0], FEW_POINTS], shown(FEW)),
        ([OTHER_MODEL[0], FEW_POINTS], shown(FEW - 1)),
        ([MODEL[0], FEW_INLIERS], [shown(FEW), wrong(FEW, ENOUGH)].concat()),
        ([MODEL[1], LATE], shown(ENOUGH)),
        ([MODEL[0], CONTRADICTED], shown(ENOUGH)),
        ([MODEL[1], CONTRADICTED], clutter(2 * ENOUGH)),
    ];
    let two_views = pairs.into_iter().map(|([a, b], matches)| {
        let pair = ImagePair::new(ImageId(a), ImageId(b)).unwrap();
        (pair, TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() })
    });
    CorrespondenceGraph::new(&[2 * NUM_POINTS as usize; NUM_IMAGES as usize], two_views)
}

#[test]
fn each_image_without_a_pose_has_its_reason() {
    let models = [model(MODEL), model(OTHER_MODEL)];
    let found = unregistered_images(&graph(), &models.each_ref(), &RegisterOptions::default(), 0);
    let of = |image: u32| *found.iter().find(|found| found.image == ImageId(image)).unwrap();
    assert_eq!(found.len() as u32, NUM_IMAGES - 2);
    let few = FEW as usize;
    let enough = ENOUGH as usize;

    let UnregisteredImage { posed_in, model, reason, nearest, .. } = of(ALONE);
    assert_eq!((posed_in, model), (None, 0));
    assert_eq!((reason, nearest), (UnregisteredReason::NoPair, None));
    for apart in APART {
        assert_eq!(of(apart).reason, UnregisteredReason::NoPairWithModel { pairs: 1 });
        assert_eq!(of(apart).nearest, None);
    }
    // The reason is about the model of the image with most matches.
    assert_eq!(of(FEW_POINTS).model, 0);
    assert_eq!(of(FEW_POINTS).nearest, Some((ImageId(MODEL[0]), few)));
    assert_eq!(
        of(FEW_POINTS).reason,
        UnregisteredReason::FewPoints { correspondences: few, required: REQUIRED }
    );
    let UnregisteredReason::FewInliers { correspondences, inliers, required } =
        of(FEW_INLIERS).reason
    else {
        panic!("{:?}", of(FEW_INLIERS));
    };
    // A few wrong matches agree by chance.
    assert_eq!((correspondences, required), (few + enough, REQUIRED));
    assert!((few..REQUIRED).contains(&inliers), "{inliers}");
    assert_eq!(
        of(LATE).reason,
        UnregisteredReason::Late { correspondences: enough, inliers: enough }
    );
    assert_eq!(
        of(CONTRADICTED).reason,
        UnregisteredReason::Contradiction { correspondences: enough, inliers: enough }
    );
    assert_eq!(of(CONTRADICTED).nearest, Some((ImageId(MODEL[1]), 2 * enough)));
    // An image of the second model is compared with the first.
    let other = of(OTHER_MODEL[1]);
    assert_eq!((other.posed_in, other.model), (Some(1), 0));
    assert_eq!(
        other.reason,
        // Keypoints of both images of the model match.
        UnregisteredReason::FewPoints { correspondences: few + 1, required: REQUIRED }
    );
}

#[test]
fn the_pair_with_most_matches_nearly_connects_two_models() {
    let [one, other] = [model(MODEL), model(OTHER_MODEL)];
    let images = [MODEL[1], OTHER_MODEL[1]].map(ImageId);
    assert_eq!(nearest_pair(&graph(), &one, &other), Some((images, FEW as usize + 1)));
    let [a, b] = images;
    assert_eq!(nearest_pair(&graph(), &other, &one), Some(([b, a], FEW as usize + 1)));
    assert_eq!(nearest_pair(&graph(), &one, &one), None);
}

/// The matches place an image two metres from the one that the camera made a tenth of a second
/// before, at a speed of two metres a second.
#[test]
fn an_image_out_of_reach_of_its_camera_has_that_reason() {
    const NUM_BEFORE: u32 = 12;
    let mut model = model(MODEL);
    let camera = model.image(ImageId(LATE)).camera;
    model.set_time(ImageId(LATE), Some(0.0));
    for before in 1..=NUM_BEFORE {
        let image = model.add_image(Image::new(format!("before {before}"), camera, Vec::new()));
        model.set_time(image, Some(-0.1 * f64::from(before)));
        model.register(image, pose(LATE + 9 + before));
    }
    let found = unregistered_images(&graph(), &[&model], &RegisterOptions::default(), 0);
    let late = found.iter().find(|found| found.image == ImageId(LATE)).unwrap();
    let enough = ENOUGH as usize;
    assert_eq!(
        late.reason,
        UnregisteredReason::OutOfReach { correspondences: enough, inliers: enough }
    );
}
