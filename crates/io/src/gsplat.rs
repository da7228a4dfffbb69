//! `rolling_shutter.json`: the arguments of gsplat's `rasterization` for rolling-shutter images.
//!
//! gsplat has no file format of its own. The keys are the names of its arguments, the values the
//! entries of one image: with `with_ut=True`, `viewmats` is the pose at the first row and
//! `viewmats_rs` that at the last one, both cam_from_world.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use serde_json::{Map, Value, json};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Matrix4;
use tiepoint_scene::{Camera, ImageId, Reconstruction};

use crate::atomic::write_atomic;
use crate::nerfstudio::Motion;
use crate::{Error, Result};

/// The poses of an image's first and last row, and the motion between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPoses {
    /// cam_from_world at the first row.
    pub first: Rigid3,
    /// cam_from_world at the last row.
    pub last: Rigid3,
    /// The motion.
    pub motion: Motion,
}

/// Writes the registered images. `image_folder` is prepended to the names of the images. An image
/// without row poses has its one pose twice, and is marked as GLOBAL.
///
/// # Errors
///
/// If gsplat lacks a camera model, and if the file cannot be written.
pub fn write(
    path: &Path,
    model: &Reconstruction,
    image_folder: &str,
    rows: &BTreeMap<ImageId, RowPoses>,
) -> Result<()> {
    let mut frames = Vec::new();
    for (id, image, cam_from_world) in model.registered() {
        let camera = model.camera(image.camera);
        let mut frame = Map::new();
        let mut put = |key: &str, value: Value| drop(frame.insert(key.to_owned(), value));
        put("file_path", json!(format!("{image_folder}/{}", image.name)));
        put("image_name", json!(image.name));
        put("camera_id", json!(model.original_ids.camera(image.camera)));
        put("width", json!(camera.width));
        put("height", json!(camera.height));
        for (key, value) in camera_arguments(camera, &image.name, path)? {
            put(key, value);
        }
        let rows = rows.get(&id);
        let kind = if rows.is_some() { "ROLLING_TOP_TO_BOTTOM" } else { "GLOBAL" };
        put("rolling_shutter", json!(kind));
        let [first, last] = rows.map_or([*cam_from_world; 2], |rows| [rows.first, rows.last]);
        put("viewmats", matrix(&first));
        put("viewmats_rs", matrix(&last));
        put("viewmat_middle_row", matrix(cam_from_world));
        if let Some(RowPoses { motion, .. }) = rows {
            put("readout_s", json!(motion.readout_s));
            put("velocity_in_world", json!(motion.velocity_in_world.as_slice()));
            put("angular_velocity_in_camera", json!(motion.angular_velocity_rad_s.as_slice()));
        }
        if let Some(time_s) = image.time_s {
            put("time_s", json!(time_s));
        }
        frames.push(Value::Object(frame));
    }
    let root = json!({ "version": 1, "frames": frames });
    write_atomic(path, |file| {
        serde_json::to_writer_pretty(&mut *file, &root)?;
        writeln!(file)
    })
}

fn matrix(cam_from_world: &Rigid3) -> Value {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 4>(0, 0).copy_from(&cam_from_world.to_matrix());
    let row = |row: usize| json!(matrix.row(row).iter().copied().collect::<Vec<f64>>());
    json!([row(0), row(1), row(2), row(3)])
}

/// `Ks`, `camera_model` and the coefficients of the distortion: six radial ones of OpenCV's
/// rational model, or four of its fisheye model, and two tangential ones.
fn camera_arguments(
    camera: &Camera,
    image: &str,
    path: &Path,
) -> Result<Vec<(&'static str, Value)>> {
    let k = camera.intrinsics.calibration_matrix();
    let row = |row: usize| json!(k.row(row).iter().copied().collect::<Vec<f64>>());
    let mut arguments = vec![("Ks", json!([row(0), row(1), row(2)]))];
    let name = camera.intrinsics.kind().name();
    // After the focal lengths and the principal point.
    let params = camera.intrinsics.params();
    let (camera_model, radial, tangential): (_, Vec<f64>, Option<[f64; 2]>) = match name {
        "SIMPLE_PINHOLE" | "PINHOLE" => ("pinhole", vec![], None),
        "SIMPLE_RADIAL" => ("pinhole", vec![params[3]], None),
        "RADIAL" => ("pinhole", params[3..5].to_vec(), None),
        "OPENCV" => ("pinhole", params[4..6].to_vec(), Some([params[6], params[7]])),
        "FULL_OPENCV" => {
            ("pinhole", [&params[4..6], &params[8..12]].concat(), Some([params[6], params[7]]))
        }
        "SIMPLE_FISHEYE" | "FISHEYE" => ("fisheye", vec![], None),
        "OPENCV_FISHEYE" => ("fisheye", params[4..8].to_vec(), None),
        "SIMPLE_RADIAL_FISHEYE" => ("fisheye", vec![params[3]], None),
        "RADIAL_FISHEYE" => ("fisheye", params[3..5].to_vec(), None),
        other => {
            let what = format!(
                "gsplat knows no camera model {other}, which {image} was taken with: \
                    undistort the images first, which gives PINHOLE cameras"
            );
            return Err(Error::content(path, what));
        }
    };
    arguments.push(("camera_model", json!(camera_model)));
    if !radial.is_empty() {
        let count = if camera_model == "fisheye" { 4 } else { 6 };
        let mut radial = radial;
        radial.resize(count, 0.0);
        arguments.push(("radial_coeffs", json!(radial)));
    }
    if let Some(tangential) = tangential {
        arguments.push(("tangential_coeffs", json!(tangential)));
    }
    Ok(arguments)
}
