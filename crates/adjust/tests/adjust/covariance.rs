//! Deviations of poses and focal lengths, compared with their errors.

use std::ops::Range;

use tiepoint_adjust::ba::AnyKey;
use tiepoint_adjust::{
    AdjustOptions, FitNoise, RefineIntrinsics, Scope, adjust, build_problem, covariance_of_fit,
    keep_going,
};
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModelKind, Loss, Manifold, Rng};
use tiepoint_scene::{ImageId, Reconstruction};
use tiepoint_synth::LensField;

use crate::common::{camera, scene};

const FOCAL_PX: f64 = 500.0;
const NOISE_PX: f64 = 0.2;
const DRAWS: u64 = 30;

/// Sum of the squares of normalised errors, with the clustered covariance and with that of
/// independent residuals.
#[derive(Default)]
struct Squares {
    clustered: f64,
    independent: f64,
    count: f64,
}

impl Squares {
    /// Normalised root mean squares.
    fn rms(&self) -> [f64; 2] {
        [self.clustered, self.independent].map(|sum| (sum / self.count).sqrt())
    }
}

/// Normalised errors of the focal lengths of two cameras and of the pose of the last image.
/// Keypoints have independent noise and a lens field.
fn errors(truth: &Reconstruction, lens_field_px: f64) -> [Squares; 2] {
    let [mut of_focal, mut of_pose] = [Squares::default(), Squares::default()];
    for draw in 0..DRAWS {
        let (mut model, mut noise) = (truth.clone(), Rng::stream(draw, &[2]));
        LensField::displace_keypoints(&mut model, lens_field_px, draw);
        let images: Vec<ImageId> = model.images().map(|(id, _)| id).collect();
        for image in images {
            let pixels = model.image(image).keypoints.iter().map(|keypoint| keypoint.pixel);
            let error = |pixel| pixel + Vector2::new(noise.normal(), noise.normal()) * NOISE_PX;
            let pixels: Vec<Vector2<f64>> = pixels.map(error).collect();
            model.move_keypoints(image, &pixels);
        }
        let refine = RefineIntrinsics { focal: true, ..RefineIntrinsics::NONE };
        let loss = Loss::Cauchy(2.385 * NOISE_PX);
        let options =
            AdjustOptions { refine, loss, function_tolerance: 1e-12, ..AdjustOptions::default() };
        adjust(&mut model, &Scope::Global, &options, &mut [], &mut keep_going).unwrap();
        let noise = FitNoise::of(&model, &loss);
        let options = AdjustOptions { noise: noise.sigma, ..options };
        let variables = build_problem(&model, &Scope::Global, &options, &mut []).unwrap();
        let add = |squares: &mut Squares, key: AnyKey, error: &[f64]| {
            let clustered = covariance_of_fit(&model, &variables, &noise, &[key]).unwrap();
            let independent = variables.problem().covariance(&[key]).unwrap();
            for (k, error) in error.iter().enumerate() {
                squares.clustered += error * error / clustered[(k, k)];
                squares.independent +=
                    error * error / (independent.matrix()[(k, k)] * noise.sigma.powi(2));
                squares.count += 1.0;
            }
        };
        for (id, key) in variables.intrinsics() {
            let error = model.camera(id).intrinsics.params()[0] - FOCAL_PX;
            add(&mut of_focal, key, &[error]);
        }
        // The gauge holds other poses.
        let (last, key) = *variables.poses().last().unwrap();
        let pose = |model: &Reconstruction| *model.image(last).cam_from_world().unwrap();
        add(&mut of_pose, key.into(), pose(&model).minus(&pose(truth)).as_slice());
    }
    [of_focal, of_pose]
}

/// The mean square of 60 numbers, two for each draw, is 1 ± 0.18: within four standard deviations.
const NORMALISED_RMS: Range<f64> = 0.5..1.32;
/// In this scene neighbouring images see a point through nearly the same part of the lens. The
/// point follows the part of the field that they have in common, which no residual shows.
const NORMALISED_RMS_WITH_FIELD: Range<f64> = 0.7..2.0;

#[test]
fn deviations_hold_with_and_without_a_lens_field() {
    let lens = camera(CameraModelKind::SimplePinhole, &[FOCAL_PX, 320.0, 240.0], [640, 480]);
    let truth = scene(&[lens, lens], 4, 0.0);
    for (lens_field_px, range) in [(0.0, NORMALISED_RMS), (0.28, NORMALISED_RMS_WITH_FIELD)] {
        for (name, errors) in ["focal length", "pose"].iter().zip(errors(&truth, lens_field_px)) {
            let [clustered, independent] = errors.rms();
            eprintln!(
                "lens field {lens_field_px} px, {name}: normalised rms {clustered:.2}, for \
                independent residuals {independent:.2}"
            );
            assert!(range.contains(&clustered), "{clustered}");
            assert!(lens_field_px == 0.0 || independent > 1.5 * clustered, "{independent}");
        }
    }
}
