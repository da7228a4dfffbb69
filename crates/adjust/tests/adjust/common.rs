//! A scene with truth: images of some cameras, and points that they observe.

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{Camera, Image, Keypoint, Observation, Reconstruction, Track};

const SEED: u64 = 1;
const NUM_POINTS: usize = 400;
/// Scale of all keypoints, in pixels.
const SCALE_PX: f32 = 2.0;
/// Distances of the points, and half the side of the box of the points and that of the cameras, in
/// metres.
const DEPTHS_M: [f64; 2] = [4.0, 8.0];
const HALF_WIDTH_M: f64 = 2.5;
const CAMERAS_M: f64 = 1.0;
/// Largest rotation about each axis.
const ROTATION_RAD: f64 = 0.1;

/// A camera with parameters in the order of its model.
pub(crate) fn camera(kind: CameraModelKind, params: &[f64], size: [u32; 2]) -> Camera {
    let intrinsics = Intrinsics::new(kind, params).unwrap();
    Camera { intrinsics, width: size[0], height: size[1], has_focal_prior: true }
}

/// Images of each camera, with true poses and points. `noise_px` is the standard deviation of the
/// keypoints along each axis.
pub(crate) fn scene(cameras: &[Camera], images_each: usize, noise_px: f64) -> Reconstruction {
    let mut rng = Rng::stream(SEED, &[]);
    let mut within = move |half: f64| half * (2.0 * rng.uniform() - 1.0);
    let points: Vec<Vector3<f64>> = (0..NUM_POINTS)
        .map(|_| {
            let [near, far] = DEPTHS_M;
            let (x, y) = (within(HALF_WIDTH_M), within(HALF_WIDTH_M));
            Vector3::new(x, y, 0.5 * (near + far) + within(0.5 * (far - near)))
        })
        .collect();
    let mut noise = Rng::stream(SEED, &[1]);
    let mut model = Reconstruction::default();
    let mut observations: Vec<Vec<Observation>> = vec![Vec::new(); NUM_POINTS];
    for camera in cameras {
        let id = model.add_camera(*camera);
        for _ in 0..images_each {
            let turn = Vector3::from_fn(|_, _| within(ROTATION_RAD));
            let pose = Rigid3::from_axis_angle(turn, Vector3::from_fn(|_, _| within(CAMERAS_M)));
            let mut keypoints = Vec::new();
            let mut seen = Vec::new();
            for (index, point) in points.iter().enumerate() {
                let pixel = camera.intrinsics.project(&(pose * *point));
                if let Some(pixel) = pixel.filter(|pixel| camera.contains(pixel)) {
                    let error = Vector2::from_fn(|_, _| noise_px * noise.normal());
                    keypoints.push(Keypoint { pixel: pixel + error, scale_px: SCALE_PX });
                    seen.push(index);
                }
            }
            let name = format!("{}.png", model.num_images());
            let image = model.add_image(Image::new(name, id, keypoints));
            model.register(image, pose);
            for (keypoint, index) in seen.into_iter().enumerate() {
                observations[index].push(Observation { image, keypoint: keypoint as u32 });
            }
        }
    }
    for (xyz, observations) in points.into_iter().zip(observations) {
        if observations.len() > 1 {
            model.add_track(Track::new(xyz, observations));
        }
    }
    model
}
