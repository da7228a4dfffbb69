//! Robust estimation on synthetic scenes with noise and outliers.

use nalgebra::{Matrix3, Vector2, Vector3};
use proptest::prelude::*;
use tiepoint_geometry::triangulate::{ViewRay, triangulate};
use tiepoint_geometry::{
    CameraModelKind, Estimator, Intrinsics, Loss, RansacOptions, Rigid3, Rng, Sim3, epipolar,
    estimate, ransac,
};

const NOISE_PX: f64 = 0.5;
/// One degree: the smallest triangulation angle.
const MIN_ANGLE_RAD: f64 = std::f64::consts::PI / 180.0;
const POINTS: usize = 400;
/// A third of the data are outliers.
const OUTLIERS: usize = POINTS / 3;
/// Eight standard deviations of the noise.
const OPTIONS: RansacOptions = RansacOptions {
    max_error: 4.0,
    confidence: 0.9999,
    min_iterations: 100,
    max_iterations: 10_000,
    min_inlier_ratio: 0.0,
    seed: 7,
};

/// With 266 inliers of 0.5 px noise at a focal length of 800 px, the standard deviation of a
/// rotation is about 0.5 / 800 / √266 = 4e-5 rad. The direction of a baseline of length one at
/// depths around 8 has ten times this standard deviation, or more for forward motion. The bounds
/// have a margin for unfavourable scenes.
const MAX_ROTATION_RAD: f64 = 2e-3;
const MAX_DIRECTION_RAD: f64 = 6e-2;

/// Bound on the ratio of the score to the score of the true model. The ratio should be below one.
/// Local optima of 2000 random problems have ratios below 1.005.
const MAX_EXCESS: f64 = 1.01;

fn camera(kind: CameraModelKind) -> Intrinsics {
    let mut camera = Intrinsics::centred(kind, 800.0, 1600, 1200);
    let distortion: &[f64] = match kind {
        CameraModelKind::SimplePinhole | CameraModelKind::Pinhole => &[],
        CameraModelKind::SimpleRadial => &[-0.1],
        CameraModelKind::Radial => &[-0.1, 0.02],
        CameraModelKind::Opencv => &[-0.1, 0.02, 0.001, -0.002],
        CameraModelKind::OpencvFisheye => &[0.02, -0.01, 0.005, -0.001],
        CameraModelKind::FullOpencv => &[-0.1, 0.02, 0.001, -0.002, 0.01, 0.05, 0.01, -0.005],
        CameraModelKind::Fov => &[0.8],
        CameraModelKind::SimpleRadialFisheye => &[0.02],
        CameraModelKind::RadialFisheye => &[0.02, -0.01],
        CameraModelKind::ThinPrismFisheye => {
            &[0.02, -0.01, 0.001, -0.002, 0.005, -0.001, 0.001, -0.001]
        }
        CameraModelKind::RadTanThinPrismFisheye => &[
            0.02, -0.01, 0.005, -0.001, 0.001, -0.001, 0.001, -0.002, 0.001, -0.001, 0.001, -0.001,
        ],
        CameraModelKind::SimpleDivision | CameraModelKind::Division => &[-0.2],
        CameraModelKind::SimpleFisheye | CameraModelKind::Fisheye => &[],
        CameraModelKind::Eucm => &[0.6, 1.1],
        // The scale at the equator is that of the other cameras.
        CameraModelKind::Equirectangular => &[5026.5, 2513.25],
    };
    let first = camera.params().len() - distortion.len();
    camera.params_mut()[first..].copy_from_slice(distortion);
    camera
}

fn uniform(rng: &mut Rng) -> f64 {
    2.0 * rng.uniform() - 1.0
}

fn noisy(pixel: Vector2<f64>, rng: &mut Rng) -> Vector2<f64> {
    pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX
}

fn random_pixel(rng: &mut Rng) -> Vector2<f64> {
    Vector2::new(1600.0 * rng.uniform(), 1200.0 * rng.uniform())
}

/// Random points at depths of 4 to 12 in front of the first camera, within 45 degrees of its axis.
fn cloud(rng: &mut Rng) -> Vec<Vector3<f64>> {
    (0..POINTS)
        .map(|_| {
            let depth = 4.0 + 8.0 * rng.uniform();
            Vector3::new(0.8 * uniform(rng) * depth, 0.6 * uniform(rng) * depth, depth)
        })
        .collect()
}

/// A motion of length one and at most a third of a radian.
fn motion(rng: &mut Rng) -> Rigid3 {
    let mut vector = || Vector3::new(uniform(rng), uniform(rng), uniform(rng));
    Rigid3::from_axis_angle(vector() * 0.2, vector().normalize())
}

fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// Corresponding pixels of two cameras. The first `OUTLIERS` are random.
fn correspondences(
    points: &[Vector3<f64>],
    cam2_from_cam1: &Rigid3,
    camera: &Intrinsics,
    rng: &mut Rng,
) -> [Vec<Vector2<f64>>; 2] {
    let mut pixels = [Vec::new(), Vec::new()];
    for (i, point) in points.iter().enumerate() {
        for (pixels, pose) in pixels.iter_mut().zip([Rigid3::identity(), *cam2_from_cam1]) {
            let seen = camera.project(&(pose * *point)).filter(|_| i >= OUTLIERS);
            pixels.push(match seen {
                Some(pixel) => noisy(pixel, rng),
                None => random_pixel(rng),
            });
        }
    }
    pixels
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn absolute_pose(seed: u64, kind in prop::sample::select(CameraModelKind::ALL)) {
        let mut rng = Rng::stream(seed, &[]);
        let (points, truth, camera) = (cloud(&mut rng), motion(&mut rng), camera(kind));
        let [_, pixels] = correspondences(&points, &truth, &camera, &mut rng);
        let report = estimate::absolute_pose(&pixels, &points, &camera, &OPTIONS).expect("a pose");
        prop_assert!(
            report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100,
            "{} inliers",
            report.num_inliers
        );
        prop_assert!(
            report.model.rotation.angle_to(&truth.rotation) < MAX_ROTATION_RAD,
            "{:?} {truth:?}",
            report.model
        );
        prop_assert!(
            (report.model.translation - truth.translation).norm() < 0.02,
            "{:?} {truth:?}",
            report.model
        );

        let good: Vec<usize> = (OUTLIERS..POINTS).collect();
        let pixels: Vec<_> = good.iter().map(|&i| pixels[i]).collect();
        let points: Vec<_> = good.iter().map(|&i| points[i]).collect();
        let refined = estimate::refine_absolute_pose(
            &pixels,
            &points,
            &camera,
            &report.model,
            Loss::Cauchy(1.0),
        );
        prop_assert!(refined.rotation.angle_to(&truth.rotation) < MAX_ROTATION_RAD);
    }

    #[test]
    fn absolute_pose_focal(
        seed: u64,
        kind in prop::sample::select(CameraModelKind::ALL),
        factor in 0.4..2.5,
    ) {
        let mut rng = Rng::stream(seed, &[]);
        let (points, truth, camera) = (cloud(&mut rng), motion(&mut rng), camera(kind));
        let [_, pixels] = correspondences(&points, &truth, &camera, &mut rng);
        let mut guess = camera;
        for &index in kind.focal_indices() {
            guess.params_mut()[index] *= factor;
        }
        let report =
            estimate::absolute_pose_focal(&pixels, &points, &guess, &OPTIONS).expect("a pose");
        let (pose, found) = report.model;
        prop_assert!(
            report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100,
            "{} inliers",
            report.num_inliers
        );
        prop_assert!(
            (found.mean_focal_px() / camera.mean_focal_px() - 1.0).abs() < 0.01,
            "{found:?}"
        );
        prop_assert!(
            pose.rotation.angle_to(&truth.rotation) < 5.0 * MAX_ROTATION_RAD,
            "{pose:?} {truth:?}"
        );
    }

    #[test]
    fn relative_pose(seed: u64, kind in prop::sample::select(CameraModelKind::ALL)) {
        let mut rng = Rng::stream(seed, &[]);
        let (points, truth, camera) = (cloud(&mut rng), motion(&mut rng), camera(kind));
        let [pixels1, pixels2] = correspondences(&points, &truth, &camera, &mut rng);
        let report = estimate::relative_pose(&pixels1, &pixels2, &camera, &camera, &OPTIONS)
            .expect("a pose");
        prop_assert!(
            report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100,
            "{} inliers",
            report.num_inliers
        );
        prop_assert!(
            report.model.rotation.angle_to(&truth.rotation) < 4.0 * MAX_ROTATION_RAD,
            "{:?} {truth:?}",
            report.model
        );
        prop_assert!(
            angle_between(&report.model.translation, &truth.translation) < MAX_DIRECTION_RAD,
            "{:?} {truth:?}",
            report.model
        );

        let again =
            estimate::essential(&pixels1, &pixels2, &camera, &camera, &OPTIONS).expect("a matrix");
        prop_assert_eq!(&again.inliers, &report.inliers);
        let rays = [&pixels1, &pixels2].map(|pixels| {
            let inliers = pixels.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier);
            inliers.map(|(pixel, _)| camera.unproject(pixel).expect("seen")).collect::<Vec<_>>()
        });
        let (pose, votes) =
            epipolar::pose_from_essential(&again.model, &rays[0], &rays[1]).expect("a pose");
        prop_assert!(votes >= report.num_inliers * 95 / 100);
        prop_assert!(pose.rotation.angle_to(&report.model.rotation) < 1e-9);
        prop_assert!(angle_between(&pose.translation, &report.model.translation) < 1e-9);
    }

    #[test]
    fn fundamental(seed: u64) {
        let mut rng = Rng::stream(seed, &[]);
        let (points, truth, camera) =
            (cloud(&mut rng), motion(&mut rng), camera(CameraModelKind::Pinhole));
        let [pixels1, pixels2] = correspondences(&points, &truth, &camera, &mut rng);
        let report = estimate::fundamental(&pixels1, &pixels2, &OPTIONS).expect("a matrix");
        prop_assert!(
            report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100,
            "{} inliers",
            report.num_inliers
        );
        // The Sampson errors of the true correspondences without noise are small.
        let errors = points[OUTLIERS..].iter().map(|point| {
            let [x1, x2] = [*point, truth * *point].map(|p| camera.project(&p).expect("in front"));
            epipolar::squared_sampson_error(&report.model, &x1, &x2)
        });
        let rms = (errors.sum::<f64>() / (POINTS - OUTLIERS) as f64).sqrt();
        prop_assert!(rms < 1.0, "{rms} px");
        // The reported score is the sum of truncated squared errors in pixels, and not worse than
        // that of the true matrix.
        let score = |f: &Matrix3<f64>| -> f64 {
            let error = |(x1, x2)| epipolar::squared_sampson_error(f, x1, x2);
            let truncated = |s| Loss::Truncated(OPTIONS.max_error).evaluate(s)[0];
            pixels1.iter().zip(&pixels2).map(error).map(truncated).sum()
        };
        prop_assert!(
            (score(&report.model) - report.score).abs() < 1e-6 * report.score,
            "{}",
            report.score
        );
        let k = camera.calibration_matrix();
        let true_f =
            epipolar::fundamental_from_essential(&epipolar::essential_from_pose(&truth), &k, &k);
        let true_score = score(&true_f.expect("regular"));
        prop_assert!(report.score <= MAX_EXCESS * true_score, "{} {true_score}", report.score);
    }

    #[test]
    fn homography(seed: u64) {
        let mut rng = Rng::stream(seed, &[]);
        let (mut points, truth, camera) =
            (cloud(&mut rng), motion(&mut rng), camera(CameraModelKind::Pinhole));
        let normal =
            Vector3::new(0.3 * uniform(&mut rng), 0.3 * uniform(&mut rng), 1.0).normalize() / 6.0;
        points.iter_mut().for_each(|point| *point /= normal.dot(point));
        let [pixels1, pixels2] = correspondences(&points, &truth, &camera, &mut rng);
        let report = estimate::homography(&pixels1, &pixels2, &OPTIONS).expect("a matrix");
        prop_assert!(
            report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100,
            "{} inliers",
            report.num_inliers
        );
        for point in &points[OUTLIERS..] {
            let [x1, x2] = [*point, truth * *point].map(|p| camera.project(&p).expect("in front"));
            let y = report.model * x1.push(1.0);
            let in_image = x2.x > 0.0 && x2.x < 1600.0 && x2.y > 0.0 && x2.y < 1200.0;
            prop_assert!(!in_image || (y.xy() / y.z - x2).norm() < 1.5, "{x2:?} {y:?}");
        }
        let k = camera.calibration_matrix();
        let calibrated = k.try_inverse().expect("regular") * report.model * k;
        // The true motion is among the decompositions, up to noise.
        let expected = truth.translation * normal.norm();
        let nearest = epipolar::decompose_homography(&calibrated)
            .into_iter()
            .map(|motion| {
                let error = motion.cam2_from_cam1.rotation.angle_to(&truth.rotation);
                error
                    + (motion.cam2_from_cam1.translation - expected).norm()
                    + angle_between(&motion.normal_in_cam1, &normal)
            })
            .fold(f64::INFINITY, f64::min);
        prop_assert!(nearest < 0.1, "{nearest}");
    }

    #[test]
    fn similarity(seed: u64, scale in 0.1..10.0) {
        let mut rng = Rng::stream(seed, &[]);
        let pose = motion(&mut rng);
        let truth = Sim3 { scale, rotation: pose.rotation, translation: pose.translation };
        let from = cloud(&mut rng);
        let to: Vec<_> = from.iter().enumerate().map(|(i, point)| {
            let noise = Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 1e-3;
            if i < OUTLIERS { noise * 1e4 } else { truth * *point + noise }
        }).collect();
        let options = RansacOptions { max_error: 5e-3, ..OPTIONS };
        let report = estimate::similarity(&from, &to, true, &options).expect("a similarity");
        prop_assert!(report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100);
        prop_assert!((report.model.scale / scale - 1.0).abs() < 1e-3 / scale);
        prop_assert!(report.model.rotation.angle_to(&truth.rotation) < 1e-3 / scale);
    }

    #[test]
    fn triangulation(seed: u64, views in 3usize..40, wrong in 0usize..10) {
        let wrong = wrong.min(views / 3);
        let mut rng = Rng::stream(seed, &[]);
        let camera = camera(CameraModelKind::Opencv);
        let truth = cloud(&mut rng)[0];
        let poses: Vec<Rigid3> = (0..views).map(|_| motion(&mut rng)).collect();
        let rays: Vec<ViewRay> = poses
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let pixel = camera.project(&(*pose * truth)).expect("in front");
                let pixel = if i < wrong {
                    pixel + Vector2::new(40.0 + 100.0 * rng.uniform(), 60.0)
                } else {
                    noisy(pixel, &mut rng)
                };
                ViewRay::new(pose, &camera, pixel).expect("a ray")
            })
            .collect();
        let Some(found) = triangulate(&rays, OPTIONS.max_error, MIN_ANGLE_RAD) else {
            // The centres of three cameras can be nearly collinear with the point.
            prop_assert!(views < 6);
            return Ok(());
        };
        if views - wrong >= 5 {
            prop_assert!((found.xyz - truth).norm() < 0.05 * truth.norm(), "{found:?} {truth:?}");
            let good = found.inliers.iter().filter(|index| **index >= wrong).count();
            prop_assert!(good >= (views - wrong) * 9 / 10);
            prop_assert!(found.inliers.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }
}

/// Fits lines y = ax + b: a small problem for tests of the RANSAC loop.
struct Line(Vec<[f64; 2]>);

impl Estimator for Line {
    type Model = [f64; 2];
    const SAMPLE_SIZE: usize = 2;

    fn num_data(&self) -> usize {
        self.0.len()
    }
    fn models(&self, sample: &[usize], models: &mut Vec<[f64; 2]>) {
        assert_ne!(sample[0], sample[1]);
        let [[x0, y0], [x1, y1]] = [self.0[sample[0]], self.0[sample[1]]];
        if x0 != x1 {
            let a = (y1 - y0) / (x1 - x0);
            models.push([a, y0 - a * x0]);
        }
    }
    fn squared_residuals(
        &self,
        [a, b]: &[f64; 2],
        range: std::ops::Range<usize>,
        squared: &mut [f64],
    ) {
        for (squared, [x, y]) in squared.iter_mut().zip(&self.0[range]) {
            *squared = (a * x + b - y).powi(2);
        }
    }
    fn refine(&self, _: &[f64; 2], data: &[usize], _: Loss) -> Option<[f64; 2]> {
        let n = data.len() as f64;
        let sum = |f: &dyn Fn([f64; 2]) -> f64| data.iter().map(|&i| f(self.0[i])).sum::<f64>();
        let (x, y) = (sum(&|p| p[0]) / n, sum(&|p| p[1]) / n);
        let a = sum(&|p| (p[0] - x) * (p[1] - y)) / sum(&|p| (p[0] - x).powi(2));
        Some([a, y - a * x])
    }
}

fn line(inliers: usize, outliers: usize) -> Line {
    let mut rng = Rng::stream(1, &[]);
    let good = (0..inliers)
        .map(|i| [i as f64, 2.0 * i as f64 + 1.0 + 0.01 * rng.normal()])
        .collect::<Vec<_>>();
    Line(good.into_iter().chain((0..outliers).map(|i| [i as f64, 1e3 + (i * i) as f64])).collect())
}

const LINE_OPTIONS: RansacOptions = RansacOptions {
    max_error: 0.05,
    confidence: 0.9999,
    min_iterations: 1,
    max_iterations: 10_000,
    min_inlier_ratio: 0.0,
    seed: 0,
};

#[test]
fn stops_at_the_given_confidence() {
    // With an inlier ratio of one half, ln(1e-4)/ln(1 − 1/4) = 32.02 samples are enough.
    let report = ransac(&line(100, 100), &LINE_OPTIONS).expect("a line");
    assert_eq!(report.num_inliers, 100);
    assert!(report.iterations <= 33, "{}", report.iterations);
    assert_eq!(report.inliers, [[true; 100], [false; 100]].concat());
    let [a, b] = report.model;
    assert!((a - 2.0).abs() < 1e-3 && (b - 1.0).abs() < 0.01, "{a} {b}");
}

#[test]
fn enumerates_all_samples_of_few_data() {
    let options = RansacOptions { min_iterations: 100, ..LINE_OPTIONS };
    let report = ransac(&line(3, 7), &options).expect("a line");
    assert_eq!((report.iterations, report.num_inliers), (45, 3));
}

#[test]
fn no_model_below_the_minimum_inlier_ratio() {
    let options = |min_inlier_ratio| RansacOptions { min_inlier_ratio, ..LINE_OPTIONS };
    let free = ransac(&line(100, 100), &LINE_OPTIONS).expect("a line");
    let asked = ransac(&line(100, 100), &options(0.5)).expect("a line");
    assert_eq!(asked.inliers, free.inliers);
    assert_eq!(ransac(&line(100, 100), &options(0.51)), None);
}

#[test]
fn degenerate_data_give_no_model() {
    assert_eq!(ransac(&line(1, 0), &LINE_OPTIONS), None);
    assert_eq!(ransac(&Line(vec![[0.0, 0.0]; 5]), &LINE_OPTIONS), None);
    assert_eq!(ransac(&Line(vec![[f64::NAN, 0.0]; 5]), &LINE_OPTIONS), None);
}

#[test]
fn results_are_deterministic_per_seed() {
    let options = RansacOptions { max_iterations: 1, ..LINE_OPTIONS };
    let run = |seed| ransac(&line(40, 160), &RansacOptions { seed, ..options }).expect("a line");
    assert_eq!(run(3), run(3));
    assert_ne!(run(3).model, run(4).model);
}

/// Random points on all sides of both cameras, at distances of 4 to 12.
fn cloud_all_around(rng: &mut Rng) -> Vec<Vector3<f64>> {
    (0..POINTS)
        .map(|_| {
            let direction = Vector3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            direction * (4.0 + 8.0 * rng.uniform())
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// Half of the points are behind the camera of a panorama, and some cross its seam.
    #[test]
    fn poses_and_points_of_a_panorama(seed: u64) {
        let mut rng = Rng::stream(seed, &[]);
        let camera = camera(CameraModelKind::Equirectangular);
        let (points, truth) = (cloud_all_around(&mut rng), motion(&mut rng));
        let [pixels1, pixels2] = correspondences(&points, &truth, &camera, &mut rng);
        let report = estimate::relative_pose(&pixels1, &pixels2, &camera, &camera, &OPTIONS)
            .expect("a pose");
        prop_assert!(report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100);
        prop_assert!(report.model.rotation.angle_to(&truth.rotation) < MAX_ROTATION_RAD);
        prop_assert!(
            angle_between(&report.model.translation, &truth.translation) < MAX_DIRECTION_RAD
        );

        let report =
            estimate::absolute_pose(&pixels2, &points, &camera, &OPTIONS).expect("a pose");
        prop_assert!(report.num_inliers >= (POINTS - OUTLIERS) * 95 / 100);
        prop_assert!(report.model.rotation.angle_to(&truth.rotation) < MAX_ROTATION_RAD);
        prop_assert!((report.model.translation - truth.translation).norm() < 0.02);

        let identity = Rigid3::identity();
        let num_behind = (OUTLIERS..POINTS).filter(|&i| points[i].z < 0.0).count();
        prop_assert!(num_behind > 0);
        for i in OUTLIERS..POINTS {
            let ray = |pose, pixel| ViewRay::new(pose, &camera, pixel).expect("a ray");
            let rays = [ray(&identity, pixels1[i]), ray(&truth, pixels2[i])];
            // Points near the baseline have a small angle and are not determined.
            if let Some(found) = triangulate(&rays, OPTIONS.max_error, MIN_ANGLE_RAD) {
                let angle = angle_between(&found.xyz, &points[i]);
                prop_assert!(angle < 0.01, "{angle} rad at {}", points[i]);
            }
        }
    }
}

/// A confidence of 0 or 1 and negative or undefined thresholds are refused by name.
#[test]
fn wrong_options_of_ransac_are_refused_by_name() {
    RansacOptions::default().validate().unwrap();
    let default = RansacOptions::default();
    for value in [-1.0, f64::NAN, f64::INFINITY] {
        for (name, options) in [
            ("max_error", RansacOptions { max_error: value, ..default }),
            ("confidence", RansacOptions { confidence: value, ..default }),
            ("min_inlier_ratio", RansacOptions { min_inlier_ratio: value, ..default }),
        ] {
            assert_eq!(options.validate().unwrap_err().name, name, "{value}");
        }
    }
    for options in [
        RansacOptions { confidence: 0.0, ..default },
        RansacOptions { confidence: 1.0, ..default },
        RansacOptions { max_iterations: 0, min_iterations: 0, ..default },
        RansacOptions { max_iterations: 5, min_iterations: 6, ..default },
    ] {
        options.validate().unwrap_err();
    }
}
