//! Two-view geometry and triangulation: round trips and degenerate input.

use nalgebra::{Matrix3, Vector2, Vector3};
use proptest::prelude::*;
use tiepoint_geometry::epipolar::*;
use tiepoint_geometry::triangulate::*;
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};

const ROUNDING: f64 = 1e-9;

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-1.0..1.0f64).prop_map(Vector3::from)
}

fn motion() -> impl Strategy<Value = Rigid3> {
    (vector(), vector()).prop_filter_map("no baseline", |(rotation, translation)| {
        Some(Rigid3::from_axis_angle(rotation, translation.try_normalize(1e-2)?))
    })
}

/// In front of the first camera.
fn point() -> impl Strategy<Value = Vector3<f64>> {
    (vector(), 2.0..20.0).prop_map(|(v, depth)| Vector3::new(v.x, v.y, 1.0) * depth)
}

/// The strategies often give too little parallax, so the limit on rejected cases is higher than
/// proptest's default.
fn config() -> ProptestConfig {
    ProptestConfig { max_global_rejects: 100_000, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn decomposition_recovers_the_pose(
        motion in motion(),
        scale in prop_oneof![-9.0..-0.1, 0.1..9.0f64],
    ) {
        let poses =
            decompose_essential(&(essential_from_pose(&motion) * scale)).expect("of rank two");
        let same = |pose: &&Rigid3| {
            pose.rotation.angle_to(&motion.rotation) < 1e-7
                && (pose.translation - motion.translation).norm() < 1e-7
        };
        prop_assert_eq!(poses.iter().filter(same).count(), 1, "{:?}", poses);
    }

    #[test]
    fn cheirality_selects_the_pose(
        motion in motion(),
        points in prop::collection::vec(point(), 5..20),
    ) {
        let seen: Vec<_> = points.iter().filter(|p| (motion * **p).z > 0.1).collect();
        prop_assume!(seen.len() >= 5);
        let rays1: Vec<_> = seen.iter().map(|p| p.normalize()).collect();
        let rays2: Vec<_> = seen.iter().map(|p| (motion * **p).normalize()).collect();
        let (pose, votes) = pose_from_essential(&essential_from_pose(&motion), &rays1, &rays2)
            .expect("of rank two");
        prop_assert_eq!(votes, seen.len());
        prop_assert!(pose.rotation.angle_to(&motion.rotation) < 1e-7);
    }

    #[test]
    fn essential_and_fundamental(motion in motion(), x1 in vector(), x2 in vector()) {
        let k1 =
            Intrinsics::centred(CameraModelKind::Pinhole, 700.0, 640, 480).calibration_matrix();
        let k2 =
            Intrinsics::centred(CameraModelKind::Pinhole, 900.0, 1000, 800).calibration_matrix();
        let essential = essential_from_pose(&motion);
        let fundamental = fundamental_from_essential(&essential, &k1, &k2).expect("regular");
        prop_assert!(
            (essential_from_fundamental(&fundamental, &k1, &k2) - essential).norm() < ROUNDING
        );
        if let Some([first, second]) = epipoles(&fundamental) {
            // Each is the image of the other camera's centre.
            prop_assert!((fundamental * first.push(1.0)).norm() < ROUNDING * first.norm());
            prop_assert!((fundamental.tr_mul(&second.push(1.0))).norm() < ROUNDING * second.norm());
        }
        let (y1, y2) = (x1.xy().push(1.0), x2.xy().push(1.0));
        let product = (k2 * y2).dot(&(fundamental * k1 * y1));
        prop_assert!((product - y2.dot(&(essential * y1))).abs() < ROUNDING);
    }

    /// The Sampson error of a correspondence that is perturbed by a small step is at most the
    /// squared length of the step.
    #[test]
    fn sampson_error_approximates_the_squared_distance(
        motion in motion(),
        point in point(),
        step in prop::array::uniform4(-1e-4..1e-4f64),
    ) {
        let in_cam2 = motion * point;
        prop_assume!(in_cam2.z > 0.5);
        let x1 = point.xy() / point.z + Vector2::new(step[0], step[1]);
        let x2 = in_cam2.xy() / in_cam2.z + Vector2::new(step[2], step[3]);
        let error = squared_sampson_error(&essential_from_pose(&motion), &x1, &x2);
        let squared_step: f64 = step.iter().map(|v| v * v).sum();
        prop_assert!(error <= 1.05 * squared_step, "{error} {squared_step}");
    }

    #[test]
    fn triangulation_recovers_the_point(motion in motion(), point in point(), third in motion()) {
        prop_assume!(triangulation_angle(&Vector3::zeros(), &motion.origin_in_a(), &point) > 1e-3);
        let ray = motion * point;
        let two = triangulate_two_view(&point, &ray, &motion).expect("in front");
        prop_assert!((two - point).norm() < 1e-6 * point.norm());
        // With a reversed ray, the point is behind the camera.
        prop_assert_eq!(triangulate_two_view(&-point, &ray, &motion), None);

        // A panorama has a pixel for each ray.
        let camera = Intrinsics::centred(CameraModelKind::Equirectangular, 800.0, 1600, 800);
        let poses = [Rigid3::identity(), motion, third];
        let rays_towards = |signs: [f64; 3]| {
            [0, 1, 2].map(|i| {
                let pixel = camera.project(&(poses[i] * point * signs[i])).expect("a pixel");
                ViewRay::new(&poses[i], &camera, pixel).expect("a ray")
            })
        };
        let rays = rays_towards([1.0; 3]);
        let all = nearest_to_rays(rays.iter()).expect("determined");
        prop_assert!((all - point).norm() < 1e-6 * point.norm());
        let found = triangulate(&rays, 1.0, 5e-4).expect("in front");
        prop_assert!((found.xyz - point).norm() < 1e-6 * point.norm());
        prop_assert_eq!(found.inliers, [0, 1, 2]);
        // The third camera contradicts the other two.
        let found = triangulate(&rays_towards([1.0, 1.0, -1.0]), 1.0, 5e-4).expect("of two");
        prop_assert!((found.xyz - point).norm() < 1e-6 * point.norm());
        prop_assert_eq!(found.inliers, [0, 1]);
    }

    /// The angular cost of the triangulated point of noisy rays is a local minimum.
    #[test]
    fn two_view_triangulation_is_optimal(
        motion in motion(),
        point in point(),
        noise in prop::array::uniform4(-1e-3..1e-3f64),
    ) {
        prop_assume!(triangulation_angle(&Vector3::zeros(), &motion.origin_in_a(), &point) > 0.05);
        let ray1 = point.normalize() + Vector3::new(noise[0], noise[1], 0.0);
        let ray2 = (motion * point).normalize() + Vector3::new(noise[2], noise[3], 0.0);
        let Some(found) = triangulate_two_view(&ray1, &ray2, &motion) else { return Ok(()) };
        let cost = |p: Vector3<f64>| ray1.angle(&p).powi(2) + ray2.angle(&(motion * p)).powi(2);
        let min_cost = cost(found);
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            for step in [-1e-3, 1e-3] {
                prop_assert!(
                    cost(found + axis * (step * found.norm())) >= min_cost * (1.0 - 1e-3) - 1e-12
                );
            }
        }
    }

    #[test]
    fn decomposition_recovers_the_plane_motion(
        motion in motion(),
        normal in vector(),
        distance in 1.0..10.0f64,
    ) {
        let normal = (normal * 0.4 + Vector3::z()).normalize();
        let h = motion.rotation.to_rotation_matrix().matrix()
            + motion.translation * normal.transpose() / distance;
        // Both cameras are on the same side of the plane.
        prop_assume!(h.determinant() > 0.05);
        let found = decompose_homography(&h)
            .into_iter()
            .map(|m| {
                m.cam2_from_cam1.rotation.angle_to(&motion.rotation)
                    + (m.cam2_from_cam1.translation * distance - motion.translation).norm()
                    + (m.normal_in_cam1 - normal).norm()
            })
            .fold(f64::INFINITY, f64::min);
        prop_assert!(found < 1e-4, "{found}");
    }
}

#[test]
fn parallel_rays_have_no_point() {
    let motion = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::x());
    assert_eq!(triangulate_two_view(&Vector3::z(), &Vector3::z(), &motion), None);
    let camera = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
    let centre = Vector2::new(320.0, 240.0);
    let pose = Rigid3::identity();
    let rays = [&pose, &motion].map(|pose| ViewRay::new(pose, &camera, centre).unwrap());
    for rays in [&rays[..], &rays[..1], &[]] {
        assert!(triangulate(rays, 1.0, 0.0).is_none());
        assert_eq!(nearest_to_rays(rays.iter()), None);
    }
}

#[test]
fn matrices_of_low_rank_have_no_pose() {
    assert_eq!(decompose_essential(&Matrix3::zeros()), None);
    assert_eq!(decompose_essential(&(Vector3::x() * Vector3::y().transpose())), None);
    assert_eq!(decompose_essential(&Matrix3::repeat(f64::NAN)), None);
    assert!(decompose_homography(&Matrix3::zeros()).is_empty());
}

#[test]
fn rotation_homography_has_one_decomposition() {
    let rotation = Rigid3::from_axis_angle(Vector3::new(0.1, 0.2, 0.3), Vector3::zeros());
    let motions = decompose_homography(&(rotation.rotation.to_rotation_matrix().matrix() * 2.0));
    assert_eq!(motions.len(), 1);
    assert!(motions[0].cam2_from_cam1.rotation.angle_to(&rotation.rotation) < 1e-12);
    assert_eq!(motions[0].cam2_from_cam1.translation, Vector3::zeros());
}
