//! Relative pose of two synthetic images from matches of which a third are outliers, and
//! triangulation of the points.
//!
//! `cargo run --release -p tiepoint-geometry --example relative_pose`

use nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{
    CameraModelKind, Intrinsics, RansacOptions, Rigid3, Rng, estimate, triangulate,
};

const NOISE_PX: f64 = 0.5;

#[allow(clippy::print_stdout)] // A program.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut rng = Rng::stream(1, &[]);
    let camera = Intrinsics::new(CameraModelKind::SimpleRadial, &[800.0, 640.0, 480.0, -0.1])?;
    let truth = Rigid3::from_axis_angle(
        Vector3::new(0.02, -0.15, 0.01),
        Vector3::new(-1.0, 0.0, 0.1).normalize(),
    );

    let (mut points, mut pixels1, mut pixels2) = (Vec::new(), Vec::new(), Vec::new());
    while points.len() < 300 {
        let depth = 4.0 + 4.0 * rng.uniform();
        let point = Vector3::new(rng.uniform() - 0.5, rng.uniform() - 0.5, 1.0) * depth;
        let seen = [camera.project(&point), camera.project(&(truth * point))];
        let [Some(pixel1), Some(mut pixel2)] = seen else { continue };
        if points.len() % 3 == 0 {
            pixel2 = Vector2::new(1280.0 * rng.uniform(), 960.0 * rng.uniform());
        }
        let mut noise = || Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
        pixels1.push(pixel1 + noise());
        pixels2.push(pixel2 + noise());
        points.push(point);
    }

    let options = RansacOptions { max_error: 4.0 * NOISE_PX, ..RansacOptions::default() };
    let report = estimate::relative_pose(&pixels1, &pixels2, &camera, &camera, &options)
        .ok_or("no relative pose with enough inliers")?;
    let pose = report.model;
    println!(
        "{} of {} matches are inliers after {} samples",
        report.num_inliers,
        points.len(),
        report.iterations
    );
    println!("rotation error {:.4} degrees", pose.rotation.angle_to(&truth.rotation).to_degrees());
    println!(
        "direction error {:.4} degrees",
        pose.translation.angle(&truth.translation).to_degrees()
    );

    // The scale of the pose is arbitrary. The true baseline has length one, so the points are in
    // the unit of the scene.
    let mut errors = Vec::new();
    for i in (0..points.len()).filter(|&i| report.inliers[i]) {
        let (Some(ray1), Some(ray2)) =
            (camera.unproject(&pixels1[i]), camera.unproject(&pixels2[i]))
        else {
            continue;
        };
        errors.extend(
            triangulate::triangulate_two_view(&ray1, &ray2, &pose)
                .map(|point| (point - points[i]).norm()),
        );
    }
    errors.sort_by(f64::total_cmp);
    println!("{} points, median error {:.3} baselines", errors.len(), errors[errors.len() / 2]);
    Ok(())
}
