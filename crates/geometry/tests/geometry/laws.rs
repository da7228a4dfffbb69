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
            "o" => 0.001..1.5,
            "a" => 0.0..0.9,
            "b" => 0.5..2.0,
            "w" | "h" => 500.0..8000.0,
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
    full_opencv: FullOpencv;
    fov: Fov;
    simple_radial_fisheye: SimpleRadialFisheye;
    radial_fisheye: RadialFisheye;
    thin_prism_fisheye: ThinPrismFisheye;
    rad_tan_thin_prism_fisheye: RadTanThinPrismFisheye;
    simple_division: SimpleDivision;
    division: Division;
    simple_fisheye: SimpleFisheye;
    fisheye: Fisheye;
    eucm: Eucm;
    equirectangular: Equirectangular;
}

/// The laws hold also for rays behind the image plane, up to an angle at which no distortion folds.
macro_rules! cameras_that_see_backwards { ($($name:ident: $kind:ident $max_angle:literal;)*) => {
    proptest! { $(
        #[test]
        fn $name(
            camera in camera(CameraModelKind::$kind), point in point_in_cam($max_angle),
        ) {
            let mut camera = camera;
            // Values that make the angle visible. They are large against the step of the numeric
            // derivative.
            let distortion = camera.params().len() - 1;
            match camera.kind() {
                CameraModelKind::SimpleDivision | CameraModelKind::Division => {
                    camera.params_mut()[distortion] -= 0.3;
                }
                CameraModelKind::Fov => camera.params_mut()[distortion] += 0.5,
                CameraModelKind::Eucm => camera.params_mut()[4] = 0.4 + 0.2 * camera.params()[4],
                _ => {}
            }
            prop_assert_eq!(camera_laws(&camera, &point), Ok(()));
        }
    )* }
} }

cameras_that_see_backwards! {
    fov_backwards: Fov 2.5;
    simple_division_backwards: SimpleDivision 2.5;
    division_backwards: Division 2.5;
    simple_fisheye_backwards: SimpleFisheye 3.0;
    fisheye_backwards: Fisheye 3.0;
    eucm_backwards: Eucm 1.8;
}

/// With a negative beta, the equation of the ray has a solution that projects elsewhere.
#[test]
fn eucm_has_no_ray_on_another_branch() {
    let params = [800.0, 800.0, 500.0, 500.0, 0.4315570951707751, -0.250204371915503];
    let camera = Intrinsics::new(CameraModelKind::Eucm, &params).expect("six parameters");
    assert_eq!(camera.unproject(&Vector2::new(-1889.066945562402, -1575.8207054615723)), None);
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
        distortion in prop::collection::vec(-3.0..3.0, 12),
        pixel in vector::<2>(2000.0),
    ) {
        let mut camera = Intrinsics::centred(kind, 800.0, 1000, 1000);
        let first_distortion = 1 + kind
            .focal_indices()
            .iter()
            .chain(kind.principal_point_indices())
            .chain(kind.metadata_indices())
            .max()
            .expect("a parameter");
        for (param, value) in camera.params_mut()[first_distortion..].iter_mut().zip(distortion) {
            *param = value;
        }
        let pixel: Vector2<f64> = pixel;
        if let Some(ray) = camera.unproject(&pixel) {
            let back = camera.project(&ray).expect("the ray projects");
            prop_assert!(
                camera.displacement(&back, &pixel).norm() < 1e-6 * (1.0 + pixel.norm()),
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
fn points_behind_the_camera_project_into_models_that_see_them() {
    for &kind in CameraModelKind::ALL {
        let mut camera = Intrinsics::centred(kind, 800.0, 1000, 800);
        // Barrel distortion: without it, these models are pinholes.
        match kind.name() {
            "SIMPLE_DIVISION" | "DIVISION" => *camera.params_mut().last_mut().unwrap() = -0.1,
            "EUCM" => camera.params_mut()[4] = 0.5,
            _ => {}
        }
        let sees_backwards = kind.name().contains("FISHEYE")
            || ["FOV", "SIMPLE_DIVISION", "DIVISION", "EUCM"].contains(&kind.name());
        let is_spherical = kind == CameraModelKind::Equirectangular;
        let on_axis = camera.project(&Vector3::new(0.0, 0.0, -1.0));
        assert_eq!(on_axis.is_some(), is_spherical, "{kind:?}");
        assert_eq!(camera.project(&Vector3::zeros()), None, "{kind:?}");
        let behind = camera.project(&Vector3::new(0.1, 0.0, -1.0));
        assert_eq!(behind.is_some(), sees_backwards || is_spherical, "{kind:?}");
    }
}

proptest! {
    /// All directions of a panorama, but for those so near to the seam or a pole that a step of the
    /// numeric derivative crosses it.
    #[test]
    fn equirectangular_all_around(
        camera in camera(CameraModelKind::Equirectangular),
        azimuth in -3.1..3.1,
        elevation in -1.2..1.2,
        distance in 0.01..100.0,
    ) {
        let (azimuth, elevation): (f64, f64) = (azimuth, elevation);
        let flat = elevation.cos();
        let ray = Vector3::new(flat * azimuth.sin(), -elevation.sin(), flat * azimuth.cos());
        prop_assert_eq!(camera_laws(&camera, &(ray * distance)), Ok(()));
    }
}

/// On either side of the seam of a panorama, a residual goes the shorter way, and an error is the
/// angle in pixels at the equator.
#[test]
fn residuals_of_a_panorama_cross_the_seam() {
    let camera = Intrinsics::from_name("EQUIRECTANGULAR", &[1000.0, 500.0]).unwrap();
    let (left, right) = (Vector2::new(1.0, 250.0), Vector2::new(997.0, 250.0));
    assert_eq!(camera.displacement(&left, &right), Vector2::new(4.0, 0.0));
    assert_eq!(camera.displacement(&right, &left), Vector2::new(-4.0, 0.0));
    let point = camera.unproject(&left).unwrap() * 3.0;
    let error = camera.squared_error_px2(&point, &right).unwrap().sqrt();
    assert!((error - 4.0).abs() < 1e-9, "{error}");
    // 60 degrees above the equator, ten columns are five pixels of it.
    let (high, beside) =
        (Vector2::new(500.0, 250.0 - 500.0 / 3.0), Vector2::new(510.0, 250.0 - 500.0 / 3.0));
    let error =
        camera.squared_error_px2(&camera.unproject(&high).unwrap(), &beside).unwrap().sqrt();
    assert!((error - 5.0).abs() < 1e-2, "{error}");
}
