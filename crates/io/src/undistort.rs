//! Undistortion: images and models with PINHOLE cameras, which dense reconstruction and Gaussian
//! splatting expect.

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{Camera, Image, Observation, Reconstruction, Track};

use crate::Rgb;

/// The PINHOLE camera of the same size, focal lengths and principal point.
pub fn pinhole_of(camera: &Camera) -> Camera {
    let [fx, fy] = camera.intrinsics.focal_lengths_px();
    let centre = camera.intrinsics.principal_point();
    let params = Intrinsics::new(CameraModelKind::Pinhole, &[fx, fy, centre.x, centre.y]);
    // Valid parameters give a valid pinhole; an invalid camera is returned unchanged.
    Camera { intrinsics: params.unwrap_or(camera.intrinsics), ..*camera }
}

/// Resamples the image of camera `from` to camera `to`, bilinearly. Pixels whose ray `from` does
/// not image are black.
pub fn undistort_image(image: &Rgb, from: &Camera, to: &Camera) -> Rgb {
    let mut data = Vec::with_capacity(3 * to.width as usize * to.height as usize);
    for row in 0..to.height {
        for column in 0..to.width {
            let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let source =
                to.intrinsics.unproject(&pixel).and_then(|ray| from.intrinsics.project(&ray));
            data.extend(source.and_then(|source| interpolate(image, &source)).unwrap_or_default());
        }
    }
    Rgb { width: to.width, height: to.height, data }
}

/// The colour at a pixel, bilinear between pixel centres; within half a pixel of the border, the
/// colour of the border. `None` outside of the image.
fn interpolate(image: &Rgb, pixel: &Vector2<f64>) -> Option<[u8; 3]> {
    let (width, height) = (f64::from(image.width), f64::from(image.height));
    if !(0.0..=width).contains(&pixel.x) || !(0.0..=height).contains(&pixel.y) {
        return None;
    }
    let (x, y) =
        ((pixel.x - 0.5).clamp(0.0, width - 1.0), (pixel.y - 0.5).clamp(0.0, height - 1.0));
    let (x0, y0) = (x as u32, y as u32);
    let (x1, y1) = ((x0 + 1).min(image.width - 1), (y0 + 1).min(image.height - 1));
    let (u, v) = (x - f64::from(x0), y - f64::from(y0));
    let corners = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| image.pixel(x, y));
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    Some(std::array::from_fn(|channel| {
        let sum: f64 = corners
            .iter()
            .zip(weights)
            .map(|(corner, weight)| weight * f64::from(corner[channel]))
            .sum();
        sum.round() as u8
    }))
}

/// The model with PINHOLE cameras and undistorted keypoints. A keypoint whose ray the pinhole
/// cannot image stays at its place but loses its observation.
pub fn undistort_model(model: &Reconstruction) -> Reconstruction {
    let mut new = Reconstruction::default();
    for (_, camera) in model.cameras() {
        new.add_camera(pinhole_of(camera));
    }
    let mut is_seen: Vec<Vec<bool>> = Vec::new();
    for (_, image) in model.images() {
        let (from, to) =
            (&model.camera(image.camera).intrinsics, new.camera(image.camera).intrinsics);
        let mut keypoints = image.keypoints.to_vec();
        let mut seen = vec![true; keypoints.len()];
        for (keypoint, seen) in keypoints.iter_mut().zip(&mut seen) {
            match from.unproject(&keypoint.pixel).and_then(|ray| to.project(&ray)) {
                Some(pixel) => keypoint.pixel = pixel,
                None => *seen = false,
            }
        }
        is_seen.push(seen);
        let id = new.add_image(Image::new(image.name.clone(), image.camera, keypoints));
        new.set_time(id, image.time_s);
        if let Some(pose) = image.cam_from_world() {
            new.register(id, *pose);
        }
    }
    new.rigs.clone_from(&model.rigs);
    new.frames.clone_from(&model.frames);
    for (_, track) in model.tracks() {
        let seen = |o: &&Observation| is_seen[o.image.index()][o.keypoint as usize];
        let observations: Vec<_> = track.observations.iter().filter(seen).copied().collect();
        if !observations.is_empty() {
            new.add_track(Track { observations, ..track.clone() });
        }
    }
    new
}
