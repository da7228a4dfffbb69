//! The binary files: a count and that many records, little-endian, without a header.

use std::io::{self, Read, Write};
use std::path::Path;

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{Camera, Keypoint, Reconstruction};

use super::file_ids::{FileIds, NO_POINT};
use super::file_names::{CAMERAS, FRAMES, IMAGES, POINTS, RIGS};
use super::rig_tables::{FrameRow, RigRow, RigTables};
use super::tables::{ImageRow, PointRow, Tables, UNKNOWN_SCALE_PX};

use crate::binary::{Reader, WriteLe, pose_numbers};
use crate::{Error, Result};

/// COLMAP's `SensorType::CAMERA`.
const SENSOR_CAMERA: i32 = 0;
/// Sizes of records in the files, or the least sizes of those of variable length: a count that
/// needs more bytes than the file has is an error, found before memory is allocated.
const POSE_BYTES: u64 = 7 * 8;
/// EQUIRECTANGULAR has the fewest parameters: width and height.
const MIN_CAMERA_BYTES: u64 = 4 + 4 + 8 + 8 + 2 * 8;
const MIN_RIG_BYTES: u64 = 4 + 4;
const MIN_SENSOR_BYTES: u64 = 4 + 4 + 1;
const MIN_FRAME_BYTES: u64 = 4 + 4 + POSE_BYTES + 4;
const DATA_BYTES: u64 = 4 + 4 + 8;
const MIN_IMAGE_BYTES: u64 = 4 + POSE_BYTES + 4 + 1 + 8;
const KEYPOINT_BYTES: u64 = 8 + 8 + 8;
const MIN_POINT_BYTES: u64 = 8 + 3 * 8 + 3 + 8 + 8;
const OBSERVATION_BYTES: u64 = 4 + 4;

pub(super) fn write(
    name: &str,
    model: &Reconstruction,
    ids: &FileIds,
    rig_tables: &RigTables,
    out: &mut impl Write,
) -> io::Result<()> {
    match name {
        CAMERAS => write_cameras(model, ids, out),
        RIGS => write_rigs(rig_tables, out),
        FRAMES => write_frames(rig_tables, out),
        IMAGES => write_images(model, ids, out),
        _ => write_points(model, ids, out),
    }
}

fn write_cameras(model: &Reconstruction, ids: &FileIds, out: &mut impl Write) -> io::Result<()> {
    out.u64(model.cameras().count() as u64)?;
    for (id, camera) in model.cameras() {
        out.u32(ids.camera(id))?;
        out.i32(camera.intrinsics.kind().colmap_id())?;
        out.u64(u64::from(camera.width))?;
        out.u64(u64::from(camera.height))?;
        out.f64s(camera.intrinsics.params())?;
    }
    Ok(())
}

fn write_rigs(rig_tables: &RigTables, out: &mut impl Write) -> io::Result<()> {
    out.u64(rig_tables.rigs.len() as u64)?;
    for rig in &rig_tables.rigs {
        out.u32(rig.id)?;
        out.u32(rig.cameras.len() as u32)?;
        for (k, (camera, cam_from_rig)) in rig.cameras.iter().enumerate() {
            out.i32(SENSOR_CAMERA)?;
            out.u32(*camera)?;
            if k > 0 {
                out.u8(u8::from(cam_from_rig.is_some()))?;
                out.f64s(&cam_from_rig.iter().flat_map(pose_numbers).collect::<Vec<_>>())?;
            }
        }
    }
    Ok(())
}

fn write_frames(rig_tables: &RigTables, out: &mut impl Write) -> io::Result<()> {
    out.u64(rig_tables.frames.len() as u64)?;
    for frame in &rig_tables.frames {
        out.u32(frame.id)?;
        out.u32(frame.rig)?;
        out.f64s(&pose_numbers(&frame.rig_from_world))?;
        out.u32(frame.images.len() as u32)?;
        for (camera, image) in &frame.images {
            out.i32(SENSOR_CAMERA)?;
            out.u32(*camera)?;
            out.u64(u64::from(*image))?;
        }
    }
    Ok(())
}

fn write_images(model: &Reconstruction, ids: &FileIds, out: &mut impl Write) -> io::Result<()> {
    out.u64(model.num_registered() as u64)?;
    for (id, image, cam_from_world) in model.registered() {
        out.u32(ids.image(id))?;
        out.f64s(&pose_numbers(cam_from_world))?;
        out.u32(ids.camera(image.camera))?;
        if image.name.contains('\0') {
            let what = format!(
                "the name {:?} holds a zero byte, which ends names in this format",
                image.name
            );
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        out.write_all(image.name.as_bytes())?;
        out.u8(0)?;
        out.u64(image.keypoints.len() as u64)?;
        for (keypoint, point) in image.keypoints.iter().zip(image.points()) {
            out.f64s(keypoint.pixel.as_slice())?;
            out.u64(point.map_or(NO_POINT, |point| ids.point(point)))?;
        }
    }
    Ok(())
}

fn write_points(model: &Reconstruction, ids: &FileIds, out: &mut impl Write) -> io::Result<()> {
    out.u64(model.num_tracks() as u64)?;
    for (id, track) in model.tracks() {
        out.u64(ids.point(id))?;
        out.f64s(track.xyz.as_slice())?;
        out.write_all(&track.color)?;
        out.f64(model.track_error_px(track))?;
        out.u64(track.observations.len() as u64)?;
        for observation in &track.observations {
            out.u32(ids.image(observation.image))?;
            out.u32(observation.keypoint)?;
        }
    }
    Ok(())
}

pub(super) fn read(dir: &Path) -> Result<Tables> {
    let open = |name: &str| Reader::open(&dir.join(name).with_extension("bin"));
    let (rigs, frames) = match (open(RIGS), open(FRAMES)) {
        (Ok(mut rigs), Ok(mut frames)) => (read_rigs(&mut rigs)?, read_frames(&mut frames)?),
        // Models older than COLMAP 3.12 have neither.
        (Err(Error::Io { cause, .. }), _) | (_, Err(Error::Io { cause, .. }))
            if cause.kind() == io::ErrorKind::NotFound =>
        {
            Default::default()
        }
        (Err(error), _) | (_, Err(error)) => return Err(error),
    };
    Ok(Tables {
        cameras: read_cameras(&mut open(CAMERAS)?)?,
        rigs,
        frames,
        images: read_images(&mut open(IMAGES)?)?,
        points: read_points(&mut open(POINTS)?)?,
    })
}

fn read_cameras<R: Read>(file: &mut Reader<R>) -> Result<Vec<(u32, Camera)>> {
    let count = file.count(MIN_CAMERA_BYTES, "the number of cameras")?;
    let mut cameras = file.list(count)?;
    for _ in 0..count {
        let id = file.u32("a camera's id")?;
        let model = file.i32("a camera's model")?;
        let kind = CameraModelKind::from_colmap_id(model)
            .map_err(|e| file.error(format!("camera {id}: {e}")))?;
        let mut side = |what: &str| -> Result<u32> {
            let pixels = file.u64(what)?;
            u32::try_from(pixels).map_err(|_| file.error(format!("{what} is {pixels} pixels")))
        };
        let (width, height) = (side("a camera's width")?, side("a camera's height")?);
        let mut params = vec![0.0; kind.num_params()];
        for param in &mut params {
            *param = file.raw_f64("a camera's parameters")?;
        }
        let intrinsics =
            Intrinsics::new(kind, &params).map_err(|e| file.error(format!("camera {id}: {e}")))?;
        cameras.push((id, Camera { intrinsics, width, height, has_focal_prior: false }));
    }
    file.end()?;
    Ok(cameras)
}

/// The id of a sensor if it is a camera, else `None`.
fn read_sensor<R: Read>(file: &mut Reader<R>) -> Result<Option<u32>> {
    let kind = file.i32("a sensor's kind")?;
    let id = file.u32("a sensor's id")?;
    Ok((kind == SENSOR_CAMERA).then_some(id))
}

fn read_rigs<R: Read>(file: &mut Reader<R>) -> Result<Vec<RigRow>> {
    let count = file.count(MIN_RIG_BYTES, "the number of rigs")?;
    let mut rigs = file.list(count)?;
    for _ in 0..count {
        let id = file.u32("a rig's id")?;
        let sensors = u64::from(file.u32("a rig's number of sensors")?);
        let mut cameras = Vec::new();
        if sensors > 0 {
            let others =
                file.check_count(sensors - 1, MIN_SENSOR_BYTES, "a rig's number of sensors")?;
            let reference = read_sensor(file)?.ok_or_else(|| {
                file.error(format!(
                    "the reference sensor of rig {id} is no camera, which is not supported"
                ))
            })?;
            cameras.push((reference, None));
            for _ in 0..others {
                let camera = read_sensor(file)?;
                let has_pose = file.u8("a sensor's pose")? != 0;
                let cam_from_rig = has_pose.then(|| file.pose("a sensor's pose")).transpose()?;
                cameras.extend(camera.map(|camera| (camera, cam_from_rig)));
            }
        }
        rigs.push(RigRow { id, cameras });
    }
    file.end()?;
    Ok(rigs)
}

fn read_frames<R: Read>(file: &mut Reader<R>) -> Result<Vec<FrameRow>> {
    let count = file.count(MIN_FRAME_BYTES, "the number of frames")?;
    let mut frames = file.list(count)?;
    for _ in 0..count {
        let id = file.u32("a frame's id")?;
        let rig = file.u32("a frame's rig")?;
        let rig_from_world = file.pose("a frame's pose")?;
        let data = u64::from(file.u32("a frame's number of images")?);
        let data = file.check_count(data, DATA_BYTES, "a frame's number of images")?;
        let mut images = file.list(data)?;
        for _ in 0..data {
            let camera = read_sensor(file)?;
            let image = file.u64("a frame's image")?;
            if let Some(camera) = camera {
                let image = u32::try_from(image).map_err(|_| {
                    file.error(format!("frame {id} names image {image}, out of range"))
                })?;
                images.push((camera, image));
            }
        }
        frames.push(FrameRow { id, rig, rig_from_world, images });
    }
    file.end()?;
    Ok(frames)
}

fn read_images<R: Read>(file: &mut Reader<R>) -> Result<Vec<ImageRow>> {
    let count = file.count(MIN_IMAGE_BYTES, "the number of images")?;
    let mut images = file.list(count)?;
    for _ in 0..count {
        let id = file.u32("an image's id")?;
        let cam_from_world = file.pose("an image's pose")?;
        let camera = file.u32("an image's camera")?;
        let name = file.c_string("an image's name")?;
        let count = file.count(KEYPOINT_BYTES, "an image's number of keypoints")?;
        let mut keypoints = file.list(count)?;
        let mut points = file.list(count)?;
        for _ in 0..count {
            let pixel = Vector2::new(file.f64("a keypoint's x")?, file.f64("a keypoint's y")?);
            keypoints.push(Keypoint { pixel, scale_px: UNKNOWN_SCALE_PX });
            points.push(file.u64("a keypoint's point")?);
        }
        images.push(ImageRow { id, cam_from_world, camera, name, keypoints, points });
    }
    file.end()?;
    Ok(images)
}

fn read_points<R: Read>(file: &mut Reader<R>) -> Result<Vec<PointRow>> {
    let count = file.count(MIN_POINT_BYTES, "the number of points")?;
    let mut points = file.list(count)?;
    for _ in 0..count {
        let id = file.u64("a point's id")?;
        let xyz = file.vector3("a point's position")?;
        let color = file.bytes("a point's colour")?;
        // The reprojection error is computed from poses and keypoints instead; COLMAP writes −1 or
        // NaN where it has none.
        file.raw_f64("a point's error")?;
        let observations = file.count(OBSERVATION_BYTES, "the length of a track")?;
        let mut track = file.list(observations)?;
        for _ in 0..observations {
            track.push((file.u32("a track's image")?, file.u32("a track's keypoint")?));
        }
        points.push(PointRow { id, xyz, color, track });
    }
    file.end()?;
    Ok(points)
}
