//! The file `transforms.json` of nerfstudio: poses and intrinsics for neural radiance fields and
//! Gaussian splatting.
//!
//! Poses are world_from_cam of a camera that looks along −z with y up: our y and z axes with the
//! opposite sign. Each frame has its own intrinsics, so that any number of cameras is possible; but
//! nerfstudio reads one `camera_model` for all: OPENCV or OPENCV_FISHEYE.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use serde_json::{Map, Value, json};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix4, Vector3, Vector4};
use tiepoint_scene::{Camera, ImageId, Reconstruction};

use crate::atomic::write_atomic;
use crate::{Error, Result};

/// Writes the registered images. `image_folder`, the path from the folder of the file to the folder
/// of the images, is prepended to the names of the images. `cloud` is the path of a PLY file with
/// the points, which initialise splats.
///
/// # Errors
///
/// If the model is not valid, if nerfstudio lacks a camera model (it has FULL_OPENCV without k4, k5
/// and k6) or the models are of both kinds, and if the file cannot be written.
pub fn write(
    path: &Path,
    model: &Reconstruction,
    image_folder: &str,
    cloud: Option<&str>,
) -> Result<()> {
    write_with_motion(path, model, image_folder, cloud, &BTreeMap::new())
}

/// The motion of a rolling-shutter camera during the exposure of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Velocity of the centre in the world, in units of the model a second.
    pub velocity_in_world: Vector3<f64>,
    /// Angular velocity ω in the camera, in radians a second: after a time t the rotation of
    /// cam_from_world is Exp(t ω) R.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Time from the first row to the last one, in seconds; negative if the last row comes first.
    pub readout_s: f64,
}

/// [`write()`] with the keys of 3dgs-deblur. Its file has one `rolling_shutter_time`, which is the
/// mean of the images' here. Velocities are those that give the true motion in that time. Poses are
/// those of the middle rows. An image without a motion has the velocity 0.
///
/// # Errors
///
/// Those of [`write()`].
pub fn write_with_motion(
    path: &Path,
    model: &Reconstruction,
    image_folder: &str,
    cloud: Option<&str>,
    motions: &BTreeMap<ImageId, Motion>,
) -> Result<()> {
    let readouts: Vec<f64> = motions.values().map(|motion| motion.readout_s.abs()).collect();
    let readout_s = readouts.iter().sum::<f64>() / readouts.len().max(1) as f64;
    model.validate().map_err(|cause| Error::Model { path: path.to_owned(), cause })?;
    let mut common_model = None;
    let mut frames = Vec::new();
    for (id, image, cam_from_world) in model.registered() {
        let camera = model.camera(image.camera);
        let name = match camera.intrinsics.kind().name() {
            "OPENCV_FISHEYE" => "OPENCV_FISHEYE",
            "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" => "OPENCV",
            // nerfstudio has k3, and no denominator.
            "FULL_OPENCV" if camera.intrinsics.params()[9..] == [0.0; 3] => "OPENCV",
            other => {
                let remedy = if camera.intrinsics.kind().focal_indices().is_empty() {
                    "cut the panoramas into perspective views first"
                } else {
                    "undistort the images first, which gives PINHOLE cameras"
                };
                let what = format!(
                    "nerfstudio knows no camera model {other}, which {} was taken with: {remedy}",
                    image.name
                );
                return Err(Error::content(path, what));
            }
        };
        if *common_model.get_or_insert(name) != name {
            let what = "nerfstudio takes perspective or fisheye cameras, but not both in one file";
            return Err(Error::content(path, what));
        }
        let separator = if image_folder.is_empty() { "" } else { "/" };
        let mut frame = Map::new();
        frame.insert(
            "file_path".to_owned(),
            json!(format!("{image_folder}{separator}{}", image.name)),
        );
        frame.insert("transform_matrix".to_owned(), matrix(cam_from_world));
        intrinsics(camera, &mut frame);
        if let Some(time_s) = image.time_s {
            frame.insert("time".to_owned(), json!(time_s));
        }
        if !motions.is_empty() {
            let [linear, angular] = motions.get(&id).map_or([Vector3::zeros(); 2], |motion| {
                let in_camera = cam_from_world.rotation * motion.velocity_in_world;
                // The camera turns by the inverse of cam_from_world's rotation.
                [in_camera, -motion.angular_velocity_rad_s]
                    .map(|v| v * (motion.readout_s / readout_s))
            });
            for (key, value) in
                [("camera_linear_velocity", linear), ("camera_angular_velocity", angular)]
            {
                frame.insert(key.to_owned(), json!([value.x, -value.y, -value.z]));
            }
        }
        frames.push(Value::Object(frame));
    }
    let mut root = json!({ "camera_model": common_model.unwrap_or("OPENCV"), "frames": frames });
    if !motions.is_empty() {
        root["rolling_shutter_time"] = json!(readout_s);
        // Not known, and 0 models no blur.
        root["exposure_time"] = json!(0.0);
        // The poses stay as they are, as the velocities do not follow a change of the axes.
        root["orientation_override"] = json!("none");
    }
    if let Some(cloud) = cloud {
        root["ply_file_path"] = json!(cloud);
    }
    write_atomic(path, |file| {
        serde_json::to_writer_pretty(&mut *file, &root)?;
        writeln!(file)
    })
}

fn matrix(cam_from_world: &Rigid3) -> Value {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 4>(0, 0).copy_from(&cam_from_world.inverse().to_matrix());
    let matrix = matrix * Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, -1.0, 1.0));
    let row = |row: usize| {
        json!([matrix[(row, 0)], matrix[(row, 1)], matrix[(row, 2)], matrix[(row, 3)]])
    };
    json!([row(0), row(1), row(2), row(3)])
}

fn intrinsics(camera: &Camera, frame: &mut Map<String, Value>) {
    let [fx, fy] = camera.intrinsics.focal_lengths_px();
    let centre = camera.intrinsics.principal_point();
    let [w, h] = [camera.width, camera.height].map(|side| json!(side));
    let numbers = [("fl_x", fx), ("fl_y", fy), ("cx", centre.x), ("cy", centre.y)];
    frame.extend([("w".to_owned(), w), ("h".to_owned(), h)]);
    frame.extend(numbers.map(|(name, value)| (name.to_owned(), json!(value))));
    // nerfstudio uses the names of OpenCV for the distortion coefficients; SIMPLE_RADIAL calls its
    // coefficient `k`.
    let names = camera.intrinsics.kind().param_names();
    for (name, value) in names.iter().zip(camera.intrinsics.params()) {
        match *name {
            "k" => frame.insert("k1".to_owned(), json!(value)),
            "k1" | "k2" | "k3" | "k4" | "p1" | "p2" => {
                frame.insert((*name).to_owned(), json!(value))
            }
            _ => None,
        };
    }
}
