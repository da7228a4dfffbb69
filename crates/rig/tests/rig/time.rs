//! Interpolation, clocks and the mounting between images of different instants, against numbers and
//! against a vehicle that was integrated at 1 kHz.

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

/// Four poses, each a motion of up to `angle` and some metres from the one before.
fn knots(angle: f64) -> impl Strategy<Value = [Rigid3; 4]> {
    let motion =
        move || (vector(angle), vector(2.0)).prop_map(|(w, t)| Rigid3::from_axis_angle(w, t));
    (pose(), motion(), motion(), motion()).prop_map(|(a, ab, bc, cd)| {
        let (b, c) = (ab * a, bc * ab * a);
        [a, b, c, cd * c]
    })
}

fn all(poses: &[Rigid3; 4]) -> Knots<'_> {
    Knots { poses: std::array::from_fn(|k| &poses[k]), times_s: TIMES_S }
}

fn distance(a: &Rigid3, b: &Rigid3) -> (f64, f64) {
    ((a.origin_in_a() - b.origin_in_a()).norm(), a.rotation.angle_to(&b.rotation))
}

const MOUNTED: SynchronousExtrinsics = SynchronousExtrinsics {
    sigma_translation: 0.05,
    sigma_rotation_rad: 0.02,
    assumed_baseline: None,
};

fn check(knots: [Rigid3; 4], mount: Rigid3, play: (Vector3<f64>, Vector3<f64>), time_s: f64) {
    let clock = Clock { offset_s: 0.3, drift: 0.01, pivot_s: 2.0 };
    let right_time_s = time_s - 0.3;
    let left = all(&knots).at(clock.reference_time_s(right_time_s));
    let pose_perturbations =
        [0.01, 0.1].map(|s| Rigid3::from_axis_angle(Vector3::x() * 0.5 * s, Vector3::z() * s));
    let whitening = InterpolatedExtrinsics::whitening(&MOUNTED, &left, &mount, &pose_perturbations);
    let factor =
        InterpolatedExtrinsics { mounted: MOUNTED, left_times_s: TIMES_S, right_time_s, whitening };
    let right_from_left =
        Rigid3::new(so3::exp(&play.0) * mount.rotation, mount.translation + play.1);
    let [a, b, c, d] = knots;
    let values = (a, b, c, d, right_from_left * left, mount, clock);
    if let Err(difference) = check_jacobians(&factor, values, JACOBIAN_TOLERANCE) {
        panic!("{difference}");
    }
}

fn mount(rotation: impl Strategy<Value = Vector3<f64>>) -> impl Strategy<Value = Rigid3> {
    (rotation, vector(1.0)).prop_filter_map("a baseline", |(w, t)| {
        (t.norm() > 0.2).then(|| Rigid3::from_axis_angle(w, t))
    })
}

fn play() -> impl Strategy<Value = (Vector3<f64>, Vector3<f64>)> {
    (vector(0.2), vector(0.2))
}

proptest! {
    #[test]
    fn jacobian_for_any_mounting(
        k in knots(0.3),
        m in mount(vector(1.5)),
        p in play(),
        t in 0.0..1.3,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn jacobian_for_cameras_that_look_in_opposite_directions(
        k in knots(0.3),
        m in mount(near_pi()),
        p in play(),
        t in 0.4..0.9,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn jacobian_for_cameras_that_look_in_one_direction(
        k in knots(1e-9),
        m in mount(vector(1e-9)),
        p in play(),
        t in 0.4..0.9,
    ) {
        check(k, m, p, t);
    }

    #[test]
    fn the_cubic_passes_through_its_knots(knots in knots(0.8)) {
        for (time_s, knot) in TIMES_S.iter().zip(&knots) {
            let (metres, radians) = distance(&all(&knots).at(*time_s), knot);
            prop_assert!(metres < ZERO && radians < 1e-7);
        }
    }

    /// Straight on or around a bend, at any times.
    #[test]
    fn a_constant_twist_is_reproduced(
        start in pose(),
        w in vector(0.5),
        v in vector(10.0),
        t in 0.0..1.3,
    ) {
        // Exp(w t) turns about an axis that is fixed in the body; `point` lies on it.
        let (axis, rate) = (w.normalize(), w.norm());
        prop_assume!(rate > 0.05);
        let point = axis.cross(&v) / rate;
        let at = |time_s: f64| {
            let rotation = so3::exp(&(w * time_s));
            let along = axis * axis.dot(&v) * time_s;
            Rigid3::new(rotation, point - rotation * point + along) * start
        };
        let poses = TIMES_S.map(at);
        let (metres, radians) = distance(&all(&poses).at(t), &at(t));
        prop_assert!(metres < 1e-8 && radians < 1e-7, "{metres} m, {radians} rad");
    }

    /// At an instant at which there is a left image, both factors say the same.
    #[test]
    fn images_of_one_instant_are_the_special_case(
        k in knots(0.3),
        right in pose(),
        m in mount(vector(1.5)),
        which in 0usize..4,
    ) {
        let factor = InterpolatedExtrinsics {
            mounted: MOUNTED,
            left_times_s: TIMES_S,
            right_time_s: TIMES_S[which],
            whitening: InterpolatedExtrinsics::whitening(&MOUNTED, &k[which], &m, &[]),
        };
        let [a, b, c, d] = &k;
        let general = factor.residual((a, b, c, d, &right, &m, &Clock::default())).unwrap();
        let special = MOUNTED.residual((&k[which], &right, &m)).unwrap();
        prop_assert!((general - special).norm() < 1e-6 * (1.0 + special.norm()));
    }
}

/// Ten images a second of a car that goes around a block, with springs and an engine that shakes.
fn drive(effects: &str, rate_hz: f64) -> Drive {
    let effects: Effects = effects.parse().expect("known effects");
    Drive::new(&DriveOptions { effects, rate_hz, ..DriveOptions::default() })
        .expect("a street of 200 m")
}

/// Root mean square error between the samples, of the cubic and of straight lines.
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

/// On a vehicle that does not shake, the cubic's error over that of straight lines.
#[test]
fn the_cubic_beats_straight_lines_on_a_vehicle() {
    for (rate_hz, share) in [(10.0, 0.1), (2.5, 0.5)] {
        let [cubic, linear] = errors(&drive("none", rate_hz), rate_hz);
        assert!(cubic.0 < share * linear.0, "{rate_hz} Hz: {cubic:?} against {linear:?} m");
        assert!(cubic.1 < share * linear.1, "{rate_hz} Hz: {cubic:?} against {linear:?} degrees");
    }
}

/// An engine that shakes at 12 Hz moves between samples at 10 Hz in a way that no interpolation
/// knows. Of a sine, the straight line has cos(π f/r) in the middle of two samples, and the cubic
/// (weights −1/16, 9/16, 9/16, −1/16) has 9/8 cos(π f/r) − 1/8 cos(3π f/r): at 12 Hz both err by
/// more than the sine itself, the cubic by 1.077 times what the line errs.
#[test]
fn a_vibration_between_the_samples_costs_the_cubic_what_a_sine_costs() {
    const VIBRATION_HZ: f64 = 12.0;
    const RATE_HZ: f64 = 10.0;
    // Of root mean squares over two hundred samples, through the beat of the vibration's strength.
    const TOLERANCE: f64 = 0.01;
    let angle = std::f64::consts::PI * VIBRATION_HZ / RATE_HZ;
    let of_line = 1.0 - angle.cos();
    let of_cubic = 1.0 - (9.0 * angle.cos() - (3.0 * angle).cos()) / 8.0;
    let [steady, shaken] =
        ["none", "vibration"].map(|effects| errors(&drive(effects, RATE_HZ), RATE_HZ));
    // The vibration has nothing to do with the rest of the motion: squares add up.
    let [cubic, line] = [0, 1].map(|k| (shaken[k].1.powi(2) - steady[k].1.powi(2)).sqrt());
    let share = (cubic / line) / (of_cubic / of_line);
    assert!((share - 1.0).abs() < TOLERANCE, "{cubic} and {line} degrees: {share}");
    // A camera's centre moves with the vehicle's turns, and here the rest of the motion weighs
    // more.
    assert!(shaken[0].0 < shaken[1].0, "{shaken:?} m");
}

#[test]
fn nothing_is_interpolated_where_images_are_missing() {
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
        // From 8 to 14 one of the four intervals is that of four seconds.
        assert_eq!(trajectory.knots_around(time_s), first, "{time_s}");
    }
    assert_eq!(
        Trajectory::new([at(0.0), at(1.0), at(2.0)]).at(1.0),
        None,
        "a cubic has four knots"
    );
}

/// Whitened errors of the interpolated pose are no longer many standard deviations of a firm
/// mounting; a 12 Hz vibration seen ten times a second is more than its neighbours tell.
#[test]
fn doubts_cover_what_interpolation_and_stamps_are_off() {
    /// Of a camera's stamps, in seconds.
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
        let mount = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-0.5, 0.0, 0.0));
        let mounted = SynchronousExtrinsics {
            sigma_translation: 0.0005,
            sigma_rotation_rad: 5e-5,
            assumed_baseline: None,
        };
        let (mut raw, mut white) = (0.0, 0.0);
        for pair in times.windows(2) {
            let time_s = pair[0] + rng.uniform() * (pair[1] - pair[0]);
            let Some(first) = trajectory.knots_around(time_s) else { continue };
            let (left, truth) = (trajectory.knots(first).at(time_s), at(time_s));
            let right = mount * truth;
            let residual = mounted.residual((&left, &right, &mount)).expect("there is a baseline");
            let pose_perturbations = trajectory.pose_perturbations(first, time_s, jitter);
            let whitening =
                InterpolatedExtrinsics::whitening(&mounted, &left, &mount, &pose_perturbations);
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

/// Noise of poses as a reconstruction of pictures has it: metres and radians.
const NOISE: (f64, f64) = (0.01, 0.0005);
/// What ten images a second with that noise leave of an offset, from 200 images with two stops and
/// four turns.
const MAX_OFFSET_ERROR_S: f64 = 0.004;

#[test]
fn the_offset_of_a_clock_is_in_the_motion() {
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
        // Fewer images a second, one in ten of them from elsewhere.
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
