//! Pixel-centre, axis and matrix conventions against numbers computed by OpenCV and COLMAP
//! (`data/make_opencv.py`).

use nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::triangulate::ViewRay;
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, epipolar, triangulate};

const REFERENCE: &str = include_str!("../data/opencv.txt");

/// Relative rounding error: both programs evaluate the same formulas in double precision.
const ROUNDING: f64 = 1e-9;

/// The values of the rows with a tag.
fn rows(tag: &str) -> Vec<Vec<f64>> {
    let rows = REFERENCE.lines().filter_map(|line| line.strip_prefix(tag)?.strip_prefix(' '));
    let rows: Vec<_> =
        rows.map(|row| row.split(' ').map(|v| v.parse().expect("a number")).collect()).collect();
    assert!(!rows.is_empty(), "no row {tag}");
    rows
}

fn vector3(row: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(row)
}

fn pose(row: &[f64]) -> Rigid3 {
    Rigid3::from_axis_angle(vector3(&row[..3]), vector3(&row[3..6]))
}

#[test]
fn projection() {
    // The other models are not OpenCV's: `colmap_cameras.rs` and `laws.rs` test them.
    for kind in [
        CameraModelKind::Pinhole,
        CameraModelKind::SimpleRadial,
        CameraModelKind::Radial,
        CameraModelKind::Opencv,
        CameraModelKind::OpencvFisheye,
        CameraModelKind::ThinPrismFisheye,
    ] {
        for row in rows(&format!("project {}", kind.name())) {
            let (params, row) = row.split_at(kind.num_params());
            let camera = Intrinsics::new(kind, params).expect("valid");
            let (cam_from_world, point, pixel) =
                (pose(row), vector3(&row[6..9]), Vector2::new(row[9], row[10]));
            let point_in_cam = cam_from_world * point;
            let projected = camera.project(&point_in_cam).expect("seen");
            assert!(
                (projected - pixel).norm() < ROUNDING * pixel.norm(),
                "{kind:?}: {projected} {pixel}"
            );
            let ray = camera.unproject(&pixel).expect("a ray");
            assert!(
                (ray - point_in_cam.normalize()).norm() < ROUNDING,
                "{kind:?}: {ray} {point_in_cam}"
            );
        }
    }
}

#[test]
fn two_views() {
    let found = Matrix3::from_row_slice(&rows("essential")[0]);
    let found_pose = pose(&rows("pose")[0]);
    let motions = rows("motion");
    let cam2_from_cam1 = pose(&motions[0]);
    let essential = epipolar::essential_from_pose(&cam2_from_cam1);
    let (a, b) = (essential.normalize(), found.normalize());
    assert!((a - b).norm().min((a + b).norm()) < 1e-6, "{a} {b}");

    let identity = Rigid3::identity();
    // Its pixels are normalised image coordinates.
    let camera = Intrinsics::new(CameraModelKind::Pinhole, &[1.0, 1.0, 0.0, 0.0]).expect("a lens");
    let (mut rays1, mut rays2) = (Vec::new(), Vec::new());
    for row in &motions {
        let (point, x1, x2) =
            (vector3(&row[6..9]), Vector2::new(row[9], row[10]), Vector2::new(row[11], row[12]));
        assert!(epipolar::squared_sampson_error(&essential, &x1, &x2) < ROUNDING * ROUNDING);
        let (ray1, ray2) = (x1.push(1.0), x2.push(1.0));
        assert!(epipolar::rays_meet_in_front(&ray1, &ray2, &cam2_from_cam1));
        let two_view =
            triangulate::triangulate_two_view(&ray1, &ray2, &cam2_from_cam1).expect("a point");
        assert!((two_view - point).norm() < 1e-8 * point.norm(), "{two_view} {point}");
        let views = [(&identity, x1), (&cam2_from_cam1, x2)]
            .map(|(pose, pixel)| ViewRay::new(pose, &camera, pixel).expect("a ray"));
        let robust = triangulate::triangulate(&views, 1e-6, 0.0).expect("a point").xyz;
        assert!((robust - point).norm() < 1e-8 * point.norm(), "{robust} {point}");
        rays1.push(ray1);
        rays2.push(ray2);
    }
    let (pose, votes) = epipolar::pose_from_essential(&found, &rays1, &rays2).expect("a pose");
    assert_eq!(votes, motions.len());
    assert!(pose.rotation.angle_to(&found_pose.rotation) < 1e-6);
    assert!((pose.translation - found_pose.translation).norm() < 1e-6);
}

#[test]
fn homography_decomposition() {
    let row = &rows("homography")[0];
    let h = Matrix3::from_row_slice(&row[..9]);
    // The decomposition does not depend on the scale and sign of the homography.
    for factor in [1.0, 3.0, -0.5] {
        let ours = epipolar::decompose_homography(&(h * factor));
        assert_eq!(ours.len(), 4);
        for expected in row[9..].chunks(9) {
            let (motion, normal) = (pose(expected), vector3(&expected[6..9]));
            let distance = |m: &epipolar::PlaneMotion| {
                m.cam2_from_cam1.rotation.angle_to(&motion.rotation)
                    + (m.cam2_from_cam1.translation - motion.translation).norm()
                    + (m.normal_in_cam1 - normal).norm()
            };
            let nearest = ours.iter().map(distance).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-6, "{expected:?} is not among {ours:?}");
        }
    }
}
