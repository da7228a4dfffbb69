//! Scenes of OpenMVS, version 7 of `libs/MVS/Interface.h`: the input of DensifyPointCloud and the
//! other programs.
//!
//! A platform of OpenMVS is a rig with its poses. Each rig with frames becomes a platform; each
//! camera with images in no frame becomes a platform of one camera. The centre of the top-left
//! pixel is (0, 0), so that half a pixel is subtracted from the principal points. Matrices are
//! stored by rows, colours as blue, green, red.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use tiepoint_geometry::nalgebra::{Matrix3, Matrix4, Vector3};
use tiepoint_geometry::{CameraModelKind, Rigid3};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::atomic::write_atomic;
use crate::binary::WriteLe;
use crate::{Error, Result};

const MAGIC: &[u8; 4] = b"MVSI";
const VERSION: u32 = 7;

/// A platform: cameras with cam_from_rig, and the poses of the platform.
struct Platform {
    name: String,
    cameras: Vec<(CameraId, Rigid3)>,
    /// rig_from_world of each pose.
    poses: Vec<Rigid3>,
}

/// Indices of an image: the platform, the camera on the platform, the pose of the platform.
#[derive(Clone, Copy)]
struct PlatformIndices([u32; 3]);

/// Writes the registered images and the points. `image_folder`, the path from the folder of the
/// scene to the folder of the images, is prepended to the names of the images.
///
/// OpenMVS expects images without distortion: the cameras must be pinholes, as those of
/// `tiepoint_dense::undistort`.
///
/// # Errors
///
/// If the model is not valid, if a camera has distortion, if the camera of an image in a frame has
/// no pose in the rig, and if the file cannot be written.
pub fn write(path: &Path, model: &Reconstruction, image_folder: &str) -> Result<()> {
    model.validate().map_err(|cause| Error::Model { path: path.to_owned(), cause })?;
    for (_, image, _) in model.registered() {
        let kind = model.camera(image.camera).intrinsics.kind();
        if !matches!(kind, CameraModelKind::SimplePinhole | CameraModelKind::Pinhole) {
            let what = format!(
                "OpenMVS needs images without distortion, but the camera of {} is a {}: undistort \
                first",
                image.name,
                kind.name()
            );
            return Err(Error::content(path, what));
        }
    }
    let (platforms, places) = platforms(path, model)?;
    write_atomic(path, |out| {
        out.write_all(MAGIC)?;
        out.u32(VERSION)?;
        out.u32(0)?;
        out.u64(platforms.len() as u64)?;
        platforms.iter().try_for_each(|platform| write_platform(out, model, platform))?;
        // Only registered images are written; they get consecutive numbers.
        let mut number_of = BTreeMap::new();
        out.u64(places.len() as u64)?;
        for (number, (id, PlatformIndices(place))) in (0u32..).zip(&places) {
            number_of.insert(*id, number);
            let name = &model.image(*id).name;
            string(
                out,
                &if image_folder.is_empty() {
                    name.clone()
                } else {
                    format!("{image_folder}/{name}")
                },
            )?;
            string(out, "")?; // mask
            place.iter().try_for_each(|index| out.u32(*index))?;
            out.u32(id.0)?;
            out.write_all(&[0; 12])?; // depths: unknown
            out.u64(0)?; // scores of neighbours: OpenMVS works them out
        }
        write_points(out, model, &number_of)?;
        (0..3).try_for_each(|_| out.u64(0))?; // lines, their normals and colours
        out.f64s(Matrix4::identity().as_slice())?;
        out.f64s(Matrix3::identity().as_slice())?; // bounding box: an empty one means none
        out.f64s(&[0.0; 6])
    })
}

/// The platforms, and the indices of each registered image.
fn platforms(
    path: &Path,
    model: &Reconstruction,
) -> Result<(Vec<Platform>, BTreeMap<ImageId, PlatformIndices>)> {
    let mut platforms: Vec<Platform> = Vec::new();
    let mut places = BTreeMap::new();
    for (index, rig) in model.rigs.iter().enumerate() {
        let frames: Vec<_> =
            model.frames.iter().filter(|frame| frame.rig.index() == index).collect();
        if frames.is_empty() {
            continue;
        }
        let on_rig = rig.sensors.iter().map(|sensor| sensor.camera);
        let cameras: Vec<_> =
            on_rig.filter_map(|camera| Some((camera, rig.cam_from_rig(camera)?))).collect();
        for (pose, frame) in frames.iter().enumerate() {
            for image in &frame.images {
                let camera = model.image(*image).camera;
                let camera =
                    cameras.iter().position(|(on_rig, _)| *on_rig == camera).ok_or_else(|| {
                        let name = &model.image(*image).name;
                        Error::content(
                            path,
                            format!("the camera of {name} has no pose on the rig of its frame"),
                        )
                    })?;
                places.insert(
                    *image,
                    PlatformIndices([platforms.len() as u32, camera as u32, pose as u32]),
                );
            }
        }
        let poses = frames.iter().map(|frame| frame.rig_from_world).collect();
        platforms.push(Platform { name: format!("rig {index}"), cameras, poses });
    }
    for (camera, _) in model.cameras() {
        let alone: Vec<_> = model
            .registered()
            .filter(|(id, image, _)| image.camera == camera && !places.contains_key(id))
            .collect();
        if alone.is_empty() {
            continue;
        }
        for (pose, (id, ..)) in alone.iter().enumerate() {
            places.insert(*id, PlatformIndices([platforms.len() as u32, 0, pose as u32]));
        }
        let poses = alone.iter().map(|(.., pose)| **pose).collect();
        let name = format!("camera {}", camera.0);
        platforms.push(Platform { name, cameras: vec![(camera, Rigid3::identity())], poses });
    }
    Ok((platforms, places))
}

fn string(out: &mut impl Write, text: &str) -> io::Result<()> {
    out.u64(text.len() as u64)?;
    out.write_all(text.as_bytes())
}

/// Rotation, row by row, and the origin in the outer frame.
fn pose(out: &mut impl Write, pose: &Rigid3) -> io::Result<()> {
    out.f64s(pose.rotation.to_rotation_matrix().matrix().transpose().as_slice())?;
    out.f64s(pose.origin_in_a().as_slice())
}

fn write_platform(
    out: &mut impl Write,
    model: &Reconstruction,
    platform: &Platform,
) -> io::Result<()> {
    string(out, &platform.name)?;
    out.u64(platform.cameras.len() as u64)?;
    for (id, cam_from_rig) in &platform.cameras {
        let camera = model.camera(*id);
        string(out, &format!("camera {}", id.0))?;
        string(out, "")?; // band
        out.u32(camera.width)?;
        out.u32(camera.height)?;
        let mut k = camera.intrinsics.calibration_matrix();
        k[(0, 2)] -= 0.5;
        k[(1, 2)] -= 0.5;
        out.f64s(k.transpose().as_slice())?;
        pose(out, cam_from_rig)?;
    }
    out.u64(platform.poses.len() as u64)?;
    platform.poses.iter().try_for_each(|rig_from_world| pose(out, rig_from_world))
}

fn write_points(
    out: &mut impl Write,
    model: &Reconstruction,
    number_of: &BTreeMap<ImageId, u32>,
) -> io::Result<()> {
    let single = |out: &mut dyn Write, xyz: &Vector3<f64>| {
        xyz.iter().try_for_each(|value| out.write_all(&(*value as f32).to_le_bytes()))
    };
    out.u64(model.num_tracks() as u64)?;
    for (_, track) in model.tracks() {
        single(out, &track.xyz)?;
        let mut views: Vec<u32> = track.observations.iter().map(|o| number_of[&o.image]).collect();
        views.sort_unstable();
        views.dedup();
        out.u64(views.len() as u64)?;
        for view in views {
            out.u32(view)?;
            out.u32(0)?; // confidence as f32: unknown
        }
    }
    out.u64(0)?; // normals
    out.u64(model.num_tracks() as u64)?;
    model.tracks().try_for_each(|(_, track)| {
        let [r, g, b] = track.color;
        out.write_all(&[b, g, r])
    })
}
