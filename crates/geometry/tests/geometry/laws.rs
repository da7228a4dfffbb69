//! The invariants of `testing` over random values of all manifolds, camera models and losses.

use nalgebra::{SVector, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;
use tiepoint_geometry::testing::{camera_laws, loss_laws, manifold_laws};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Loss, Manifold, Rigid3, Sim3, so3};

fn vector<const N: usize>(size: f64) -> impl Strategy<Value = SVector<f64, N>> {
    prop::array::uniform(-size..size).prop_map(SVector::from)
}

/// Random rotations, with angles near zero and near π more often.
fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    let angle = prop_oneof![0.0..3.1, 0.0..1e-3, 3.1..std::f64::consts::PI, Just(0.0)];
    (vector::<3>(1.0), angle).prop_filter_map("no axis", |(axis, angle)| {
        Some(so3::exp(&(axis.try_normalize(1e-3)? * angle)))
    })
}

fn rigid() -> impl Strategy<Value = Rigid3> {
    (rotation(), vector::<3>(10.0))
        .prop_map(|(rotation, translation)| Rigid3 { rotation, translation })
}

fn similarity() -> impl Strategy<Value = Sim3> {
    (0.1..10.0, rotation(), vector::<3>(10.0)).prop_map(|(scale, rotation, translation)| Sim3 {
        scale,
        rotation,
        translation,
    })
}

macro_rules! manifolds { ($($name:ident: $strategy:expr, $dof:literal;)*) => { proptest! { $(
    #[test]
    fn $name(x in $strategy, y in $strategy, delta in vector::<$dof>(1.0)) {
        prop_assert_eq!(manifold_laws(&x, &y, &delta), Ok(()));
    }
)* } } }

manifolds! {
    vectors: vector::<4>(10.0), 4;
    scalars: -10.0..10.0f64, 1;
    rotations: rotation(), 3;
    rigid_transforms: rigid(), 6;
    similarities: similarity(), 7;
}

proptest! {
    /// The tangent (δ, τ) of a pose: δ does not move the centre, τ moves it along the camera axes.
    #[test]
    fn pose_perturbation_rotates_about_the_camera_centre(
        pose in rigid(),
        rotation in vector::<3>(3.0),
        shift in vector::<3>(10.0),
    ) {
        let tangent = |shift: Vector3<f64>| {
            SVector::<f64, 6>::from_fn(|i, _| if i < 3 { rotation[i] } else { shift[i - 3] })
        };
        let rotated = pose.plus(&tangent(Vector3::zeros()));
        prop_assert!((rotated.origin_in_a() - pose.origin_in_a()).norm() < 1e-13);
        let moved = pose.plus(&tangent(shift));
        prop_assert_eq!(moved.rotation, rotated.rotation);
        let in_cam = moved.rotation * (moved.origin_in_a() - pose.origin_in_a());
        prop_assert!((in_cam + shift).norm() < 1e-13);
    }
}

/// Random intrinsics. The distortion coefficients are so small that the distortion does not fold in
/// the fields of view below.
fn camera(kind: CameraModelKind) -> impl Strategy<Value = Intrinsics> {
    let ranges: Vec<_> = kind
        .param_names()
        .iter()
        .map(|name| match &name[..1] {
            "f" => 200.0..4000.0,
            "c" => 100.0..3000.0,
            "k" => -0.05..0.05,
            "p" | "s" => -0.005..0.005,
            other => panic!("no range for parameters that start with {other}"),
        })
        .collect();
    ranges.prop_map(move |params| Intrinsics::new(kind, &params).expect("in range"))
}

/// A random point up to `max_angle` from the optical axis. Tests use 45 degrees for a perspective
/// lens (r = 1, where |k1| + |k2| ≤ 0.1 cannot fold) and 115 for a fisheye with smaller
/// coefficients.
fn point_in_cam(max_angle: f64) -> impl Strategy<Value = Vector3<f64>> {
    let angle = prop_oneof![0.0..max_angle, 0.0..1e-3, Just(0.0)];
    (angle, 0.0..std::f64::consts::TAU, 0.01..100.0).prop_map(|(angle, azimuth, distance)| {
        Vector3::new(angle.sin() * azimuth.cos(), angle.sin() * azimuth.sin(), angle.cos())
            * distance
    })
}

macro_rules! perspective_cameras { ($($name:ident: $kind:ident;)*) => { proptest! { $(
    #[test]
    fn $name(camera in camera(CameraModelKind::$kind), point in point_in_cam(0.78)) {
        prop_assert_eq!(camera_laws(&camera, &point), Ok(()));
    }
)* } } }

perspective_cameras! {
    simple_pinhole: SimplePinhole;
    pinhole: Pinhole;
    simple_radial: SimpleRadial;
    radial: Radial;
    opencv: Opencv;
    opencv_fisheye: OpencvFisheye;
    thin_prism_fisheye: ThinPrismFisheye;
}

proptest! {
    /// Points behind the image plane. A coefficient of θ^(2n+1) is divided by 4ⁿ so that θ_d
    /// increases up to 2 rad.
    #[test]
    fn opencv_fisheye_beyond_the_hemisphere(
        camera in camera(CameraModelKind::OpencvFisheye), point in point_in_cam(2.0),
    ) {
        let mut camera = camera;
        for (n, k) in camera.params_mut()[4..].iter_mut().enumerate() {
            *k /= 4f64.powi(n as i32 + 1);
        }
        prop_assert_eq!(camera_laws(&camera, &point), Ok(()));
    }

    /// For any intrinsics and pixel, `unproject` returns a ray that projects to the pixel, or
    /// `None`.
    #[test]
    fn unproject_inverts_project_or_is_none(
        kind in prop::sample::select(CameraModelKind::ALL),
        distortion in prop::collection::vec(-3.0..3.0, 8),
        pixel in vector::<2>(2000.0),
    ) {
        let mut camera = Intrinsics::centred(kind, 800.0, 1000, 1000);
        let first_distortion = 1 + kind
            .focal_indices()
            .iter()
            .chain(&kind.principal_point_indices())
            .max()
            .expect("a focal length");
        for (param, value) in camera.params_mut()[first_distortion..].iter_mut().zip(distortion) {
            *param = value;
        }
        let pixel: Vector2<f64> = pixel;
        if let Some(ray) = camera.unproject(&pixel) {
            let back = camera.project(&ray).expect("the ray projects");
            prop_assert!(
                (back - pixel).norm() < 1e-6 * (1.0 + pixel.norm()),
                "{camera:?}: {pixel:?} reprojects to {back:?}"
            );
        }
    }

    /// `s` differs from a² by at least 1 %, because Huber, Tukey and the truncated loss have a kink
    /// there.
    #[test]
    fn losses(scale in 0.1..10.0, ratio in prop_oneof![0.01..0.99, 1.01..100.0]) {
        for loss in [
            Loss::Trivial,
            Loss::Huber(scale),
            Loss::SoftL1(scale),
            Loss::Cauchy(scale),
            Loss::GemanMcClure(scale),
            Loss::Tukey(scale),
            Loss::Truncated(scale),
        ] {
            prop_assert_eq!(loss_laws(&loss, ratio * scale * scale), Ok(()));
        }
    }
}

/// A pixel beyond the fold of a barrel distortion has no ray: r (1 − 0.3 r²) is at most 0.7027, at
/// r = 1/√0.9.
#[test]
fn unproject_is_none_beyond_the_fold() {
    let camera =
        Intrinsics::from_name("SIMPLE_RADIAL", &[300.0, 500.0, 400.0, -0.3]).expect("valid");
    assert!(camera.unproject(&Vector2::new(500.0 + 300.0 * 0.702, 400.0)).is_some());
    assert_eq!(camera.unproject(&Vector2::new(500.0 + 300.0 * 0.703, 400.0)), None);
}

#[test]
fn points_behind_the_camera_do_not_project() {
    for &kind in CameraModelKind::ALL {
        let camera = Intrinsics::centred(kind, 800.0, 1000, 800);
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, -1.0)), None, "{kind:?}");
        assert_eq!(camera.project(&Vector3::zeros()), None, "{kind:?}");
        let behind = camera.project(&Vector3::new(0.1, 0.0, -1.0));
        let is_fisheye =
            [CameraModelKind::OpencvFisheye, CameraModelKind::ThinPrismFisheye].contains(&kind);
        assert_eq!(behind.is_some(), is_fisheye, "{kind:?}");
    }
}
