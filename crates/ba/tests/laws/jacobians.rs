//! The Jacobian of every factor is the derivative of its residual.

use proptest::prelude::*;
use tiepoint_ba::Factor;
use tiepoint_ba::factors::{
    Between, Centre, FieldReprojection, LensField, Prior, Reprojection, RigCentre, RigReprojection,
    ShiftedReprojection,
};
use tiepoint_ba::nalgebra::{SVector, UnitQuaternion, Vector1, Vector2, Vector3};
use tiepoint_ba::testing::check_jacobians;
use tiepoint_geometry::cameras::{Opencv, OpencvFisheye, Pinhole, SimpleRadial};
use tiepoint_geometry::{CameraModel, Manifold, Rigid3, Sim3, so3};

/// The numeric derivative has an error of 1e-12 of the *third* derivatives, which strong distortion
/// at steep angles makes a few thousand times larger than the first.
const TOLERANCE: f64 = 1e-7;
/// Angles below this keep the logarithm of the relative rotation away from its cut at π.
const MAX_ANGLE_RAD: f64 = 1.0;

fn vector(max: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-max..max).prop_map(Vector3::from)
}

fn rigid(max_angle_rad: f64) -> impl Strategy<Value = Rigid3> {
    (vector(max_angle_rad), vector(2.0))
        .prop_map(|(turn, shift)| Rigid3::new(so3::exp(&turn), shift))
}

/// A point in the camera frame, up to 45 degrees off the optical axis.
fn in_view() -> impl Strategy<Value = Vector3<f64>> {
    (-1.0..1.0, -1.0..1.0, 2.0..20.0)
        .prop_map(|(x, y, z): (f64, f64, f64)| Vector3::new(x * z, y * z, z))
}

fn similarity(rigid: Rigid3, scale: f64) -> Sim3 {
    Sim3 { rotation: rigid.rotation, translation: rigid.translation, scale }
}

fn check_reprojections<M: CameraModel>(
    params: M::Params,
    cam_from_rig: Rigid3,
    rig_from_world: Rigid3,
    in_cam: Vector3<f64>,
) -> Result<(), String> {
    let pixel = Vector2::new(310.0, 255.0);
    let point = (cam_from_rig * rig_from_world).inverse() * in_cam;
    check_jacobians(
        &Reprojection::<M>::new(pixel, 0.7),
        (params, cam_from_rig * rig_from_world, point),
        TOLERANCE,
    )?;
    check_jacobians(
        &RigReprojection::<M>::new(pixel, 0.7),
        (params, cam_from_rig, rig_from_world, point),
        TOLERANCE,
    )?;
    check_jacobians(
        &ShiftedReprojection {
            unshifted: Reprojection::<M>::new(pixel, 0.7),
            shift: Vector2::new(-3.0, 20.0),
        },
        (params, cam_from_rig * rig_from_world, Vector1::new(0.1), point),
        TOLERANCE,
    )
}

proptest! {
    #[test]
    fn reprojections(
        cam_from_rig in rigid(MAX_ANGLE_RAD),
        rig_from_world in rigid(3.0),
        in_cam in in_view(),
        k in -0.05..0.05f64,
    ) {
        let law = [
            check_reprojections::<Pinhole>(
                [800.0, 790.0, 320.0, 240.0].into(),
                cam_from_rig,
                rig_from_world,
                in_cam,
            ),
            check_reprojections::<SimpleRadial>(
                [800.0, 320.0, 240.0, k].into(),
                cam_from_rig,
                rig_from_world,
                in_cam,
            ),
            check_reprojections::<Opencv>(
                [800.0, 790.0, 320.0, 240.0, k, 0.3 * k, 0.001, -0.002].into(),
                cam_from_rig,
                rig_from_world,
                in_cam,
            ),
            check_reprojections::<OpencvFisheye>(
                [800.0, 790.0, 320.0, 240.0, k, 0.3 * k, 0.001, -0.002].into(),
                cam_from_rig,
                rig_from_world,
                in_cam,
            ),
        ];
        for law in law {
            prop_assert_eq!(law, Ok(()));
        }
    }

    #[test]
    fn relative_poses(a in rigid(3.0), b_from_a in rigid(2.0), error in rigid(MAX_ANGLE_RAD)) {
        let factor = Between::new(b_from_a, &[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]).unwrap();
        prop_assert_eq!(check_jacobians(&factor, (a, error * b_from_a * a), TOLERANCE), Ok(()));
    }

    #[test]
    fn centres(
        cam_from_rig in rigid(3.0),
        rig_from_world in rigid(3.0),
        in_camera in in_view(),
    ) {
        let centre = Centre::new(Vector3::new(1.0, -2.0, 3.0), &[0.1, 0.2, f64::INFINITY]).unwrap();
        let antenna = Centre { in_camera, ..centre };
        for factor in [centre, antenna] {
            let pose = cam_from_rig * rig_from_world;
            prop_assert_eq!(check_jacobians(&factor, (pose,), TOLERANCE), Ok(()));
            let poses = (cam_from_rig, rig_from_world);
            prop_assert_eq!(check_jacobians(&RigCentre(factor), poses, TOLERANCE), Ok(()));
        }
        let at_measured = Rigid3::new(rig_from_world.rotation, Vector3::zeros())
            * Rigid3::new(UnitQuaternion::identity(), -centre.measured);
        prop_assert!(centre.residual((&at_measured,)).unwrap().norm() < 1e-12);
    }

    #[test]
    fn relative_similarities(
        (a, b_from_a) in (rigid(3.0), rigid(2.0)),
        error in rigid(MAX_ANGLE_RAD),
        [scale_of_a, scale_of_b, scale_error] in prop::array::uniform3(0.5..2.0f64),
    ) {
        let (a, b_from_a) = (similarity(a, scale_of_a), similarity(b_from_a, scale_of_b));
        let factor = Between::new(b_from_a, &[0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.1]).unwrap();
        prop_assert_eq!(
            check_jacobians(&factor, (a, similarity(error, scale_error) * b_from_a * a), TOLERANCE),
            Ok(())
        );
    }

    #[test]
    fn priors(mean in rigid(3.0), error in rigid(MAX_ANGLE_RAD), scale in 0.5..2.0f64) {
        let pose = Prior::new(mean, &[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]).unwrap();
        prop_assert_eq!(check_jacobians(&pose, (error * mean,), TOLERANCE), Ok(()));
        let rotation =
            Prior::<UnitQuaternion<f64>, 3>::new(mean.rotation, &[0.1, f64::INFINITY, 0.3])
                .unwrap();
        prop_assert_eq!(
            check_jacobians(&rotation, (error.rotation * mean.rotation,), TOLERANCE),
            Ok(())
        );
        let vector = Prior::<SVector<f64, 3>, 3>::new(mean.translation, &[1.0, 2.0, 0.5]).unwrap();
        prop_assert_eq!(check_jacobians(&vector, (error.translation,), TOLERANCE), Ok(()));
        let prior =
            Prior::<Sim3, 7>::new(similarity(mean, 1.0), &[0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.1])
                .unwrap();
        prop_assert_eq!(
            check_jacobians(&prior, (similarity(error * mean, scale),), TOLERANCE),
            Ok(())
        );
    }

    #[test]
    fn reprojections_with_a_field(
        cam_from_world in rigid(3.0),
        in_cam in in_view(),
        pixel in (-50.0..700.0_f64, -50.0..600.0_f64),
        k in -0.05..0.05f64,
        coefficients in prop::collection::vec(-2.0..2.0_f64, LensField::DOF),
        shift in (-2.0..2.0_f64, -2.0..2.0_f64),
    ) {
        let (pixel, shift) = (Vector2::new(pixel.0, pixel.1), Vector2::new(shift.0, shift.1));
        let factor = FieldReprojection::<Opencv>::new(pixel, 0.7, [640, 480]);
        let params = [800.0, 790.0, 320.0, 240.0, k, 0.3 * k, 0.001, -0.002].into();
        let point = cam_from_world.inverse() * in_cam;
        let field = LensField::from_vec(coefficients);
        let values = (params, cam_from_world, field, point);
        prop_assert_eq!(check_jacobians(&factor, values, TOLERANCE), Ok(()));
        // Equal coefficients are a shift.
        let half = LensField::DOF / 2;
        let field = LensField::from_fn(|i, _| if i < half { shift.x } else { shift.y });
        let residual = |field| factor.residual((&params, &cam_from_world, field, &point));
        let found = residual(&field).unwrap() - residual(&LensField::zeros()).unwrap();
        prop_assert!((found * 0.7 - shift).norm() < TOLERANCE);
    }
}
