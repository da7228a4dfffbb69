//! Priors on intrinsics, and two cameras that are one lens in portrait and landscape format.

use tiepoint_adjust::{
    AdjustOptions, RefineIntrinsics, Scope, adjust, better_camera_models, keep_going,
};
use tiepoint_ba::testing::check_jacobians;
use tiepoint_geometry::nalgebra::SVector;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{CameraId, IntrinsicsPrior, Reconstruction, nearest_intrinsics};

use crate::common::{camera, scene};
use crate::shared_lens::shared_lens;

const EVERYTHING: RefineIntrinsics = RefineIntrinsics { aspect: true, ..RefineIntrinsics::ALL };

fn adjusted(mut model: Reconstruction, options: &AdjustOptions) -> Reconstruction {
    adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going).unwrap();
    model
}

/// Standard deviation that holds a parameter against some thousand keypoints, and the tolerance
/// of what it holds, relative to 1 or to the parameter if that is larger.
const FIRM: f64 = 1e-6;
const HELD: f64 = 1e-3;

#[test]
fn the_prior_of_an_uncalibrated_camera_is_around_the_image_centre() {
    let kind = CameraModelKind::Opencv;
    let current = camera(kind, &[500.0, 505.0, 321.0, 239.0, 0.1, 0.02, 0.01, 0.02], [640, 480]);
    let mut model = scene(&[current], 6, 0.5);
    let options = AdjustOptions {
        refine: EVERYTHING,
        principal_point_sigma: FIRM,
        distortion_sigma: FIRM,
        ..AdjustOptions::default()
    };
    // Without priors on focal lengths, these are free.
    let at_the_centre = [320.0, 240.0, 0.0, 0.0, 0.0, 0.0];
    let found = adjusted(model.clone(), &options).camera(CameraId(0)).intrinsics;
    assert_held(&found.params()[2..], &at_the_centre);
    // A calibration of another camera model says nothing.
    let pinhole = Intrinsics::centred(CameraModelKind::Pinhole, 400.0, 640, 480);
    let prior = IntrinsicsPrior { mean: pinhole, sigmas: vec![FIRM; 4] };
    model.intrinsics_priors.insert(CameraId(0), prior);
    assert_eq!(adjusted(model, &options).camera(CameraId(0)).intrinsics, found);
}

fn assert_held(found: &[f64], wanted: &[f64]) {
    for (value, wanted) in found.iter().zip(wanted) {
        let error = (value - wanted).abs();
        assert!(error < HELD * wanted.abs().max(1.0), "{found:?}: not {wanted}");
    }
}

#[test]
fn the_prior_of_a_calibrated_camera_is_its_calibration() {
    let kind = CameraModelKind::Opencv;
    let truth = camera(kind, &[500.0, 500.0, 321.0, 239.0, 0.1, 0.02, 0.001, 0.002], [640, 480]);
    let calibrated = [490.0, 490.0, 300.0, 250.0, -0.1, 0.05, 0.001, 0.002];
    let mean = Intrinsics::new(kind, &calibrated).unwrap();
    let with = |sigmas: Vec<f64>, refine, refine_calibrated| {
        let mut model = scene(&[truth], 6, 0.5);
        model.intrinsics_priors.insert(CameraId(0), IntrinsicsPrior { mean, sigmas });
        let options = AdjustOptions { refine, refine_calibrated, ..AdjustOptions::default() };
        adjusted(model, &options).camera(CameraId(0)).intrinsics
    };
    // It holds all parameters, focal lengths included, and gives way where it is wide.
    assert_held(with(vec![FIRM; 8], EVERYTHING, None).params(), &calibrated);
    let wide = IntrinsicsPrior::new(mean, 640, 480, 100.0).sigmas;
    let found = with(wide, EVERYTHING, None);
    assert!((found.params()[0] - 500.0).abs() < 1.0, "{found:?}");
    assert!((found.params()[4] - 0.1).abs() < 0.01, "{found:?}");
    // What is refined of calibrated cameras may differ from what is of others.
    let kept = with(vec![FIRM; 8], EVERYTHING, Some(RefineIntrinsics::NONE));
    assert_eq!(kept, truth.intrinsics);
}

/// Parameters of a landscape camera, and those that its portrait camera shares: index of the one,
/// and of the other.
type Shared = (CameraModelKind, &'static [f64], &'static [(usize, usize)]);
const SHARED: [Shared; 4] = [
    (CameraModelKind::SimpleRadial, &[500.0, 320.0, 240.0, 0.05], &[(0, 0), (3, 3)]),
    (
        CameraModelKind::Opencv,
        &[500.0, 510.0, 320.0, 240.0, 0.05, -0.02, 0.001, 0.002],
        &[(0, 1), (1, 0), (4, 4), (5, 5)],
    ),
    (
        CameraModelKind::OpencvFisheye,
        &[500.0, 510.0, 320.0, 240.0, 0.05, -0.02, 0.001, 0.002],
        &[(0, 1), (1, 0), (4, 4), (5, 5), (6, 6), (7, 7)],
    ),
    (
        CameraModelKind::Eucm,
        &[500.0, 510.0, 320.0, 240.0, 0.6, 1.1],
        &[(0, 1), (1, 0), (4, 4), (5, 5)],
    ),
];

/// Focal lengths change places, and radial coefficients stay.
#[test]
fn an_unused_camera_follows_the_used_one() {
    for (kind, params, shared) in SHARED {
        let one = camera(kind, params, [640, 480]);
        let mut model = scene(&[one], 4, 0.5);
        let other = Intrinsics::centred(kind, 450.0, 480, 640);
        let other = model.add_camera(camera(kind, other.params(), [480, 640]));
        model.portrait_landscape_pairs.push([CameraId(0), other]);
        let mut expected = model.camera(other).intrinsics.params().to_vec();
        let options = AdjustOptions { refine: EVERYTHING, ..AdjustOptions::default() };
        let model = adjusted(model, &options);
        let found = model.camera(CameraId(0)).intrinsics;
        for &(i, j) in shared {
            assert_ne!(found.params()[i], params[i], "{kind:?} was refined");
            expected[j] = found.params()[i];
        }
        assert_eq!(model.camera(other).intrinsics.params(), expected, "{kind:?}");
    }
}

/// Noise by which the cameras' own estimates differ, in pixels, and the largest difference of
/// shared parameters, relative to 1 or to the parameter if that is larger: ten standard deviations
/// of the relation, and a difference that shows that it has an effect.
const NOISE_PX: f64 = 2.0;
const MAX_DIFFERENCE: f64 = 1e-5;
const MIN_EFFECT: f64 = 1e-4;

#[test]
fn two_used_cameras_share_their_lens() {
    for (kind, params, shared) in SHARED {
        let mut turned = params.to_vec();
        shared.iter().for_each(|&(i, j)| turned[j] = params[i]);
        turned.swap(kind.principal_point_indices()[0], kind.principal_point_indices()[1]);
        let cameras = [camera(kind, params, [640, 480]), camera(kind, &turned, [480, 640])];
        let model = scene(&cameras, 3, NOISE_PX);
        let differences = |pairs: &[[CameraId; 2]]| -> Vec<f64> {
            let mut model = model.clone();
            model.portrait_landscape_pairs = pairs.to_vec();
            let options = AdjustOptions { refine: EVERYTHING, ..AdjustOptions::default() };
            let model = adjusted(model, &options);
            let [one, other] = [0, 1].map(|id| model.camera(CameraId(id)).intrinsics);
            let of = |&(i, j): &(usize, usize)| {
                let (a, b) = (one.params()[i], other.params()[j]);
                (a - b).abs() / a.abs().max(1.0)
            };
            shared.iter().map(of).collect()
        };
        let apart = differences(&[]);
        assert!(apart.iter().all(|difference| *difference > MIN_EFFECT), "{kind:?}: {apart:?}");
        let together = differences(&[[CameraId(0), CameraId(1)]]);
        assert!(together.iter().all(|d| *d < MAX_DIFFERENCE), "{kind:?}: {together:?}");
    }
}

#[test]
fn jacobians_of_the_shared_lens() {
    let params = [500.0, 510.0, 320.0, 240.0, 0.1, -0.2, 0.01, 0.02];
    let intrinsics = Intrinsics::new(CameraModelKind::Opencv, &params).unwrap();
    let one = SVector::<f64, 8>::from(params);
    let other = one.map(|param| 1.1 * param + 0.1);
    // Large weights would hide errors behind rounding.
    let mut factor = shared_lens(&intrinsics, &one);
    factor.weights.fill(2.0);
    check_jacobians(&factor, (one, other), 1e-6).unwrap();
}

/// Camera models in ascending order, and lenses with the ones that describe them.
const MODELS: [CameraModelKind; 4] = [
    CameraModelKind::SimpleRadial,
    CameraModelKind::Radial,
    CameraModelKind::Opencv,
    CameraModelKind::OpencvFisheye,
];
const LENSES: [(CameraModelKind, &[f64]); 3] = [
    (CameraModelKind::SimpleRadial, &[300.0, 320.0, 240.0, -0.05]),
    (CameraModelKind::Radial, &[300.0, 320.0, 240.0, -0.2, 0.06]),
    (CameraModelKind::OpencvFisheye, &[300.0, 300.0, 320.0, 240.0, -0.05, -0.03, 0.0, 0.0]),
];
/// Very strong evidence (Kass and Raftery 1995, section 3.2).
const VERY_STRONG: f64 = 5.0;
/// Noise of keypoints, and the largest error of the first distortion parameter.
const KEYPOINT_NOISE_PX: f64 = 0.5;
const MAX_DISTORTION_ERROR: f64 = 0.02;

#[test]
fn the_camera_model_of_a_lens_is_found() {
    let id = CameraId(0);
    for (kind, params) in LENSES {
        let truth = camera(kind, params, [640, 480]);
        let mut model = scene(&[truth], 8, KEYPOINT_NOISE_PX);
        model.camera_mut(id).intrinsics =
            nearest_intrinsics(&truth.intrinsics, MODELS[0], 640, 480).expect("a lens");
        let options = AdjustOptions { noise: KEYPOINT_NOISE_PX, ..AdjustOptions::default() };
        let model = adjusted(model, &options);
        let found = better_camera_models(&model, &[id], &MODELS, VERY_STRONG, &options);
        let found = found.expect("a model");
        if kind == MODELS[0] {
            assert_eq!(found, []);
            continue;
        }
        assert_eq!(found.len(), 1, "{kind:?}");
        assert_eq!(found[0].intrinsics.kind(), kind);
        // Those of higher order are hardly determined.
        let first = kind.principal_point_indices()[1] + 1;
        let error = found[0].intrinsics.params()[first] - params[first];
        assert!(error.abs() < MAX_DISTORTION_ERROR, "{:?}", found[0]);
    }
}
