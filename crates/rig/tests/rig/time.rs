//! Interpolation, clocks and rig extrinsics between images of different times, checked numerically
//! and against a vehicle simulation with steps of 1 ms.

use proptest::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, Rng, so3};
use tiepoint_rig::ba::Factor;
use tiepoint_rig::ba::testing::check_jacobians;
use tiepoint_rig::{
    Clock, InterpolatedExtrinsics, Knots, SynchronousExtrinsics, Trajectory, find_offset,
    timestamp_jitter_s,
};
use tiepoint_synth::{Drive, DriveOptions, Effects};

/// Numeric differentiation with steps of 1e-3 extrapolated once, on logarithms of numbers up to
/// about 10.
const JACOBIAN_TOLERANCE: f64 = 1e-5;
const TIMES_S: [f64; 4] = [0.0, 0.4, 0.9, 1.3];
/// Rounding of numbers up to 100.
const ZERO: f64 = 1e-9;

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-limit..limit, -limit..limit, -limit..limit].prop_map(|[x, y, z]| Vector3::new(x, y, z))
}

fn near_pi() -> impl Strategy<Value = Vector3<f64>> {
    (vector(1.0), -0.02..0.02).prop_filter_map("an axis", |(axis, off)| {
        let axis = axis.try_normalize(0.1)?;
        Some(axis * (std::f64::consts::PI + off))
    })
}

fn pose() -> impl Strategy<Value = Rigid3> {
    (vector(1.8), vector(5.0)).prop_map(|(w, t)| Rigid3::from_axis_angle(w, t))
}

/// Four poses, each moved by an angle up to `angle` and some metres from the one before.
fn knots(angle: f64) -> impl Strategy<Value = [Rigid3; 4]> {
    let motion =
        move || (vector(angle), vector(2.0)).prop_map(|(w, t)| Rigid3::from_axis_angle(w, t));
    (pose(), motion(), motion(), motion()).prop_map(|(a, ab, bc, cd)| {
        let (b, c) = (ab * a, bc * ab * a);
        [a, b, c, cd * c]
    })
}

fn knots_of(poses: &[Rigid3; 4]) -> Knots<'_> {
    Knots { poses: std::array::from_fn(|k| &poses[k]), times_s: TIMES_S }
}

fn distance(a: &Rigid3, b: &Rigid3) -> (f64, f64) {
    ((a.origin_in_a() - b.origin_in_a()).norm(), a.rotation.angle_to(&b.rotation))
}

const EXTRINSICS: SynchronousExtrinsics = SynchronousExtrinsics {
    sigma_translation: 0.05,
    sigma_rotation_rad: 0.02,
    assumed_baseline: None,
};

fn check(
    knots: [Rigid3; 4],
    extrinsics: Rigid3,
    perturbation: (Vector3<f64>, Vector3<f64>),
    time_s: f64,
) {
    let clock = Clock { offset_s: 0.3, drift: 0.01, pivot_s: 2.0 };
    let image_time_s = time_s - 0.3;
    let left = knots_of(&knots).at(clock.reference_time_s(image_time_s));
    let pose_perturbations =
        [0.01, 0.1].map(|s| Rigid3::from_axis_angle(Vector3::x() * 0.5 * s, Vector3::z() * s));
    let whitening =
        InterpolatedExtrinsics::whitening(&EXTRINSICS, &left, &extrinsics, &pose_perturbations);
    let factor = InterpolatedExtrinsics {
        extrinsics: EXTRINSICS,
        reference_times_s: TIMES_S,
        image_time_s,
        whitening,
    };
    let cam_from_rig = Rigid3::new(
        so3::exp(&perturbation.0) * extrinsics.rotation,
        extrinsics.translation + perturbation.1,
    );
    let [a, b, c, d] = knots;
    let values = (a, b, c, d, cam_from_rig * left, extrinsics, clock);
    if let Err(difference) = check_jacobians(&factor, values, JACOBIAN_TOLERANCE) {
        panic!("{difference}");
    }
}

fn extrinsics(rotation: impl Strategy<Value = Vector3<f64>>) -> impl Strategy<Value = Rigid3> {
    (rotation, vector(1.0)).prop_filter_map("a baseline", |(w, t)| {
        (t.norm() > 0.2).then(|| Rigid3::from_axis_angle(w, t))
    })
}

fn perturbation() -> impl Strategy<Value = (Vector3<f64>, Vector3<f64>)> {
    (vector(0.2), vector(0.2))
}

proptest! {
    #[test]
    fn extrinsics_jacobian(
        k in knots(0.3),
        m in extrinsics(vector(1.5)),
        p in perturbation(),
        t in 0.0..1.3,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn extrinsics_jacobian_for_opposite_directions(
        k in knots(0.3),
        m in extrinsics(near_pi()),
        p in perturbation(),
        t in 0.4..0.9,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn extrinsics_jacobian_for_equal_directions(
        k in knots(1e-9),
        m in extrinsics(vector(1e-9)),
        p in perturbation(),
        t in 0.4..0.9,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn the_cubic_passes_through_its_knots(knots in knots(0.8)) {
        for (time_s, knot) in TIMES_S.iter().zip(&knots) {
            let (metres, radians) = distance(&knots_of(&knots).at(*time_s), knot);
            prop_assert!(metres < ZERO && radians < 1e-7);
        }
    }

    /// Along a line or a circle, at any times.
    #[test]
    fn a_constant_twist_is_reproduced(
        start in pose(),
        w in vector(0.5),
        v in vector(10.0),
        t in 0.0..1.3,
    ) {
        // Exp(w t) rotates about an axis that is fixed in the body; `point` lies on it.
        let (axis, rate) = (w.normalize(), w.norm());
        prop_assume!(rate > 0.05);
        let point = axis.cross(&v) / rate;
        let at = |time_s: f64| {
            let rotation = so3::exp(&(w * time_s));
            let along = axis * axis.dot(&v) * time_s;
            Rigid3::new(rotation, point - rotation * point + along) * start
        };
        let poses = TIMES_S.map(at);
        let (metres, radians) = distance(&knots_of(&poses).at(t), &at(t));
        prop_assert!(metres < 1e-8 && radians < 1e-7, "{metres} m, {radians} rad");
    }

    /// At the time of a left image, both factors have the same residual.
    #[test]
    fn synchronous_images_are_the_special_case(
        k in knots(0.3),
        right in pose(),
        m in extrinsics(vector(1.5)),
        which in 0usize..4,
    ) {
        let factor = InterpolatedExtrinsics {
            extrinsics: EXTRINSICS,
            reference_times_s: TIMES_S,
            image_time_s: TIMES_S[which],
            whitening: InterpolatedExtrinsics::whitening(&EXTRINSICS, &k[which], &m, &[]),
        };
        let [a, b, c, d] = &k;
        let general = factor.residual((a, b, c, d, &right, &m, &Clock::default())).unwrap();
        let special = EXTRINSICS.residual((&k[which], &right, &m)).unwrap();
        prop_assert!((general - special).norm() < 1e-6 * (1.0 + special.norm()));
    }
}

/// A drive around a block, with suspension and engine vibration by `effects`.
fn drive(effects: &str, rate_hz: f64) -> Drive {
    let effects: Effects = effects.parse().expect("known effects");
    Drive::new(&DriveOptions { effects, rate_hz, ..DriveOptions::default() })
        .expect("a street of 200 m")
}

/// Root mean square errors between the samples, of the cubic and of linear interpolation.
fn errors(drive: &Drive, rate_hz: f64) -> [(f64, f64); 2] {
    let at = |time_s: f64| drive.cam_from_world(0, time_s);
    let count = (drive.trajectory().duration_s() * rate_hz) as usize;
    let samples: Vec<(f64, Rigid3)> =
        (0..count).map(|k| k as f64 / rate_hz).map(|t| (t, at(t))).collect();
    let trajectory = Trajectory::new(samples.clone());
    let (mut cubic, mut linear) = ((0.0, 0.0), (0.0, 0.0));
    for pair in samples.windows(2) {
        let (middle_s, (a, b)) = (0.5 * (pair[0].0 + pair[1].0), (pair[0].1, pair[1].1));
        let truth = at(middle_s);
        let centre = 0.5 * (a.origin_in_a() + b.origin_in_a());
        let rotation = a.rotation.slerp(&b.rotation, 0.5);
        let line = Rigid3::new(rotation, -(rotation * centre));
        let add = |sum: &mut (f64, f64), pose: &Rigid3| {
            let (metres, radians) = distance(pose, &truth);
            sum.0 += metres * metres / count as f64;
            sum.1 += radians * radians / count as f64;
        };
        add(&mut cubic, &trajectory.at(middle_s).expect("no gaps"));
        add(&mut linear, &line);
    }
    [cubic, linear].map(|(m, r)| (m.sqrt(), r.sqrt().to_degrees()))
}

/// On a vehicle without vibration, the error of the cubic is a fraction of that of linear
/// interpolation.
#[test]
fn the_cubic_beats_linear_interpolation_on_a_vehicle() {
    for (rate_hz, max_ratio) in [(10.0, 0.1), (2.5, 0.5)] {
        let [cubic, linear] = errors(&drive("none", rate_hz), rate_hz);
        assert!(cubic.0 < max_ratio * linear.0, "{rate_hz} Hz: {cubic:?} against {linear:?} m");
        assert!(
            cubic.1 < max_ratio * linear.1,
            "{rate_hz} Hz: {cubic:?} against {linear:?} degrees"
        );
    }
}

/// An engine vibration of 12 Hz is undersampled at 10 Hz, and no interpolation recovers it. Half
/// way between two samples of a sine, linear interpolation has the factor cos(π f/r), and the cubic
/// (weights −1/16, 9/16, 9/16, −1/16) has 9/8 cos(π f/r) − 1/8 cos(3π f/r). At 12 Hz the errors of
/// both are larger than the sine itself, and that of the cubic is 1.077 times that of linear
/// interpolation.
#[test]
fn errors_of_an_undersampled_vibration_match_theory() {
    const VIBRATION_HZ: f64 = 12.0;
    const RATE_HZ: f64 = 10.0;
    // Root mean squares over two hundred samples of a vibration with varying amplitude.
    const TOLERANCE: f64 = 0.01;
    let angle = std::f64::consts::PI * VIBRATION_HZ / RATE_HZ;
    let linear_theory = 1.0 - angle.cos();
    let cubic_theory = 1.0 - (9.0 * angle.cos() - (3.0 * angle).cos()) / 8.0;
    let [steady, vibrating] =
        ["none", "vibration"].map(|effects| errors(&drive(effects, RATE_HZ), RATE_HZ));
    // The vibration is independent of the remaining motion, so squared errors add up.
    let [cubic, line] = [0, 1].map(|k| (vibrating[k].1.powi(2) - steady[k].1.powi(2)).sqrt());
    let ratio = (cubic / line) / (cubic_theory / linear_theory);
    assert!((ratio - 1.0).abs() < TOLERANCE, "{cubic} and {line} degrees: {ratio}");
    // A camera's centre also moves with the rotation of the vehicle, and there the remaining motion
    // dominates.
    assert!(vibrating[0].0 < vibrating[1].0, "{vibrating:?} m");
}

#[test]
fn gaps_are_not_interpolated() {
    let at =
        |time_s: f64| (time_s, Rigid3::new(so3::exp(&Vector3::zeros()), Vector3::x() * time_s));
    let times = (0..20).map(f64::from).filter(|t| !(10.0..13.0).contains(t));
    let trajectory = Trajectory::new(times.map(at));
    for (time_s, first) in [
        (-0.1, None),
        (0.5, Some(0)),
        (7.0, Some(6)),
        (9.5, None),
        (11.0, None),
        (14.5, Some(10)),
        (19.1, None),
    ] {
        // From 8 to 14, one of the four intervals has four seconds.
        assert_eq!(trajectory.knots_around(time_s), first, "{time_s}");
    }
    assert_eq!(
        Trajectory::new([at(0.0), at(1.0), at(2.0)]).at(1.0),
        None,
        "a cubic has four knots"
    );
}

/// With tight extrinsics, raw errors of the interpolated pose are many standard deviations, and
/// whitened errors are not. A 12 Hz vibration at ten images per second is underestimated by the
/// residuals of neighbours.
#[test]
fn pose_perturbations_cover_interpolation_and_timestamp_errors() {
    /// Standard deviation of timestamps in seconds.
    const JITTER_S: f64 = 0.002;
    for (effects, rate_hz, most) in
        [("none", 10.0, 1.0), ("none", 2.5, 1.0), ("vibration", 10.0, 5.0)]
    {
        let drive = drive(effects, rate_hz);
        let mut rng = Rng::stream(5, &[]);
        let at = |time_s: f64| drive.cam_from_world(0, time_s);
        let count = (drive.trajectory().duration_s() * rate_hz) as usize;
        let samples: Vec<(f64, Rigid3)> = (0..count)
            .map(|k| k as f64 / rate_hz)
            .map(|t| (t + JITTER_S * rng.normal(), at(t)))
            .collect();
        let times: Vec<f64> = samples.iter().map(|(time_s, _)| *time_s).collect();
        let jitter = timestamp_jitter_s(&times);
        assert!((jitter / JITTER_S - 1.0).abs() < 0.3, "{jitter} s");
        let trajectory = Trajectory::new(samples);
        let cam_from_rig = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-0.5, 0.0, 0.0));
        let extrinsics = SynchronousExtrinsics {
            sigma_translation: 0.0005,
            sigma_rotation_rad: 5e-5,
            assumed_baseline: None,
        };
        let (mut raw, mut white) = (0.0, 0.0);
        for pair in times.windows(2) {
            let time_s = pair[0] + rng.uniform() * (pair[1] - pair[0]);
            let Some(first) = trajectory.knots_around(time_s) else { continue };
            let (left, truth) = (trajectory.knots(first).at(time_s), at(time_s));
            let right = cam_from_rig * truth;
            let residual =
                extrinsics.residual((&left, &right, &cam_from_rig)).expect("there is a baseline");
            let pose_perturbations = trajectory.pose_perturbations(first, time_s, jitter);
            let whitening = InterpolatedExtrinsics::whitening(
                &extrinsics,
                &left,
                &cam_from_rig,
                &pose_perturbations,
            );
            raw += residual.norm_squared() / (6 * count) as f64;
            white += (whitening * residual).norm_squared() / (6 * count) as f64;
        }
        eprintln!(
            "{effects} at {rate_hz} Hz: {:.2} standard deviations, {:.2} whitened",
            raw.sqrt(),
            white.sqrt()
        );
        assert!(
            raw.sqrt() > 15.0 && white.sqrt() < most,
            "{effects} at {rate_hz} Hz: {raw} {white}"
        );
    }
}

/// Noise of reconstructed poses, in metres and radians.
const NOISE: (f64, f64) = (0.01, 0.0005);
/// Error of the offset with this noise at ten images per second, from 200 images with two stops and
/// four turns.
const MAX_OFFSET_ERROR_S: f64 = 0.004;

#[test]
fn the_time_offset_is_found_from_the_motion() {
    let drive = drive("none", 10.0);
    let noise =
        |rng: &mut Rng, size: f64| Vector3::new(rng.normal(), rng.normal(), rng.normal()) * size;
    for (seed, offset_s) in [(1, 0.0), (2, 0.3), (3, -0.987), (4, 1234.5)] {
        let mut rng = Rng::stream(seed, &[]);
        let mut noisy = |camera: usize, time_s: f64| {
            let pose = drive.cam_from_world(camera, time_s);
            let turn = so3::exp(&noise(&mut rng, NOISE.1));
            Rigid3::new(turn * pose.rotation, turn * pose.translation + noise(&mut rng, NOISE.0))
        };
        let left = Trajectory::new((0..200).map(|k| 0.1 * f64::from(k)).map(|t| (t, noisy(0, t))));
        // Fewer images per second, one in ten of them a gross outlier.
        let right: Vec<(f64, Rigid3)> = (0..150)
            .map(|k| (k, 0.033 + 0.13 * f64::from(k)))
            .map(|(k, t)| (t - offset_s, noisy(1, if k % 10 == 3 { t + 5.0 } else { t })))
            .collect();
        let found = find_offset(&left, &right).unwrap();
        assert!((found.offset_s - offset_s).abs() < MAX_OFFSET_ERROR_S, "{offset_s}: {found:?}");
        assert!(offset_s == 0.0 || found.gain > 10.0, "{found:?}");
        assert!(offset_s != 0.0 || found.gain < 10.0, "{found:?}");
    }
    assert_eq!(find_offset(&Trajectory::new([]), &[]), None);
}
