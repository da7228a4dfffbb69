//! The text files: one line for each record, two for an image; `#` begins a comment.

use std::io::{self, Write};
use std::path::Path;

use tiepoint_geometry::Intrinsics;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_scene::{Camera, Keypoint, Reconstruction};

use super::file_ids::{FileIds, NO_POINT};
use super::file_names::{CAMERAS, FRAMES, IMAGES, POINTS, RIGS};
use super::rig_tables::{FrameRow, RigRow, RigTables};
use super::tables::{ImageRow, PointRow, Tables, UNKNOWN_SCALE_PX};

use crate::binary::pose_numbers;
use crate::text::excerpt::Excerpt;
use crate::text::{Lines, Number, Numbers, Words};
use crate::{Error, Result};

/// Name and number of COLMAP for cameras among the types of sensors.
const SENSOR_CAMERA: [&str; 2] = ["CAMERA", "0"];

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
    writeln!(out, "# Camera list with one line of data per camera:")?;
    writeln!(out, "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]")?;
    writeln!(out, "# Number of cameras: {}", model.cameras().count())?;
    for (id, camera) in model.cameras() {
        let Camera { intrinsics, width, height, .. } = camera;
        let (id, name) = (ids.camera(id), intrinsics.kind().name());
        writeln!(out, "{id} {name} {width} {height} {}", Numbers(intrinsics.params()))?;
    }
    Ok(())
}

fn write_rigs(rig_tables: &RigTables, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "# Rig calib list with one line of data per calib:")?;
    writeln!(
        out,
        "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, \
         SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])"
    )?;
    writeln!(out, "# Number of rigs: {}", rig_tables.rigs.len())?;
    for rig in &rig_tables.rigs {
        write!(out, "{} {}", rig.id, rig.cameras.len())?;
        for (k, (camera, cam_from_rig)) in rig.cameras.iter().enumerate() {
            write!(out, " {} {camera}", SENSOR_CAMERA[0])?;
            match cam_from_rig {
                Some(pose) => write!(out, " 1 {}", Numbers(&pose_numbers(pose)))?,
                None if k > 0 => write!(out, " 0")?,
                None => {}
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

fn write_frames(rig_tables: &RigTables, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "# Frame list with one line of data per frame:")?;
    writeln!(
        out,
        "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, \
         DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)"
    )?;
    writeln!(out, "# Number of frames: {}", rig_tables.frames.len())?;
    for frame in &rig_tables.frames {
        let pose = pose_numbers(&frame.rig_from_world);
        write!(out, "{} {} {} {}", frame.id, frame.rig, Numbers(&pose), frame.images.len())?;
        for (camera, image) in &frame.images {
            write!(out, " {} {camera} {image}", SENSOR_CAMERA[0])?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn write_images(model: &Reconstruction, ids: &FileIds, out: &mut impl Write) -> io::Result<()> {
    let (images, observations) = (model.num_registered(), model.num_observations());
    writeln!(out, "# Image list with two lines of data per image:")?;
    writeln!(out, "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME")?;
    writeln!(out, "#   POINTS2D[] as (X, Y, POINT3D_ID)")?;
    let mean = observations as f64 / images.max(1) as f64;
    writeln!(out, "# Number of images: {images}, mean observations per image: {mean}")?;
    for (id, image, cam_from_world) in model.registered() {
        let (id, camera) = (ids.image(id), ids.camera(image.camera));
        let is_line = image.name.trim() == image.name && !image.name.contains(['\n', '\r']);
        if image.name.is_empty() || !is_line {
            let what = format!("the name {:?} cannot stand in a line of text", image.name);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        writeln!(out, "{id} {} {camera} {}", Numbers(&pose_numbers(cam_from_world)), image.name)?;
        let mut space = "";
        for (keypoint, point) in image.keypoints.iter().zip(image.points()) {
            write!(out, "{space}{} ", Numbers(keypoint.pixel.as_slice()))?;
            match point {
                Some(point) => write!(out, "{}", ids.point(*point))?,
                None => write!(out, "-1")?,
            }
            space = " ";
        }
        writeln!(out)?;
    }
    Ok(())
}

fn write_points(model: &Reconstruction, ids: &FileIds, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "# 3D point list with one line of data per point:")?;
    writeln!(out, "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)")?;
    let (count, mean) = (model.num_tracks(), model.mean_track_length());
    writeln!(out, "# Number of points: {count}, mean track length: {mean}")?;
    for (id, track) in model.tracks() {
        let (xyz, [r, g, b]) = (Numbers(track.xyz.as_slice()), track.color);
        write!(out, "{} {xyz} {r} {g} {b} {}", ids.point(id), Number(model.track_error_px(track)))?;
        for observation in &track.observations {
            write!(out, " {} {}", ids.image(observation.image), observation.keypoint)?;
        }
        writeln!(out)?;
    }
    Ok(())
}

pub(super) fn read(dir: &Path) -> Result<Tables> {
    let open = |name: &str| Lines::open(&dir.join(name).with_extension("txt"));
    let (rigs, frames) = match (open(RIGS), open(FRAMES)) {
        (Ok(rigs), Ok(frames)) => (records(rigs, read_rig)?, records(frames, read_frame)?),
        // Models older than COLMAP 3.12 have neither.
        (Err(Error::Io { cause, .. }), _) | (_, Err(Error::Io { cause, .. }))
            if cause.kind() == io::ErrorKind::NotFound =>
        {
            Default::default()
        }
        (Err(error), _) | (_, Err(error)) => return Err(error),
    };
    Ok(Tables {
        cameras: read_cameras(open(CAMERAS)?)?,
        rigs,
        frames,
        images: read_images(open(IMAGES)?)?,
        points: records(open(POINTS)?, read_point)?,
    })
}

/// Reads `cameras.txt`: ids and cameras.
pub(crate) fn read_cameras(lines: Lines) -> Result<Vec<(u32, Camera)>> {
    records(lines, read_camera)
}

/// Reads one record from each line.
fn records<T>(mut lines: Lines, record: impl Fn(&mut Words<'_>) -> Result<T>) -> Result<Vec<T>> {
    let mut records = Vec::new();
    while let Some(mut words) = lines.next()? {
        records.push(record(&mut words)?);
        words.end()?;
    }
    Ok(records)
}

fn read_camera(words: &mut Words<'_>) -> Result<(u32, Camera)> {
    let id = words.number("the camera's id")?;
    let name = words.word("the camera's model")?;
    let (width, height) = (words.number("the width")?, words.number("the height")?);
    let mut params = Vec::new();
    while !words.is_empty() {
        params.push(words.f64("a parameter")?);
    }
    let intrinsics =
        Intrinsics::from_name(name, &params).map_err(|cause| words.error(cause.to_string()))?;
    Ok((id, Camera { intrinsics, width, height, has_focal_prior: false }))
}

/// The id of a sensor if it is a camera, else `None`.
fn read_sensor(words: &mut Words<'_>) -> Result<Option<u32>> {
    let is_camera = SENSOR_CAMERA.contains(&words.word("a sensor's kind")?);
    let id = words.number("a sensor's id")?;
    Ok(is_camera.then_some(id))
}

fn read_rig(words: &mut Words<'_>) -> Result<RigRow> {
    let id = words.number("the rig's id")?;
    let sensors: usize = words.number("the number of sensors")?;
    let mut cameras = Vec::new();
    for k in 0..sensors {
        let camera = read_sensor(words)?;
        if k == 0 {
            let reference = camera.ok_or_else(|| {
                words.error(format!(
                    "the reference sensor of rig {id} is no camera, which is not supported"
                ))
            })?;
            cameras.push((reference, None));
            continue;
        }
        let cam_from_rig = match words.word("whether the sensor has a pose")? {
            "0" => None,
            "1" => Some(words.pose("the sensor's pose")?),
            other => {
                return Err(words.error(format!(
                    "whether a sensor has a pose is `{}`, not 0 or 1",
                    Excerpt(other)
                )));
            }
        };
        cameras.extend(camera.map(|camera| (camera, cam_from_rig)));
    }
    Ok(RigRow { id, cameras })
}

fn read_frame(words: &mut Words<'_>) -> Result<FrameRow> {
    let id = words.number("the frame's id")?;
    let rig = words.number("the frame's rig")?;
    let rig_from_world = words.pose("the frame's pose")?;
    let data: usize = words.number("the number of images")?;
    let mut images = Vec::new();
    for _ in 0..data {
        let camera = read_sensor(words)?;
        let image: u64 = words.number("an image's id")?;
        if let Some(camera) = camera {
            let image = u32::try_from(image)
                .map_err(|_| words.error(format!("the id of image {image} is out of range")))?;
            images.push((camera, image));
        }
    }
    Ok(FrameRow { id, rig, rig_from_world, images })
}

fn read_images(mut lines: Lines) -> Result<Vec<ImageRow>> {
    let mut images = Vec::new();
    while let Some(mut words) = lines.next()? {
        let id = words.number("the image's id")?;
        let cam_from_world = words.pose("the image's pose")?;
        let camera = words.number("the image's camera")?;
        let name = words.rest().to_owned();
        if name.is_empty() {
            return Err(words.error("the image has no name"));
        }
        let mut keypoints = Vec::new();
        let mut points = Vec::new();
        // The line of keypoints follows immediately and may be empty.
        if let Some(mut words) = lines.next_raw()? {
            while !words.is_empty() {
                let [x, y] = words.f64s("a keypoint's x or y")?;
                keypoints.push(Keypoint { pixel: Vector2::new(x, y), scale_px: UNKNOWN_SCALE_PX });
                points.push(match words.word("a keypoint's point")? {
                    "-1" => NO_POINT,
                    word => word.parse().map_err(|_| {
                        words.error(format!("a keypoint's point is `{}`", Excerpt(word)))
                    })?,
                });
            }
        }
        images.push(ImageRow { id, cam_from_world, camera, name, keypoints, points });
    }
    Ok(images)
}

fn read_point(words: &mut Words<'_>) -> Result<PointRow> {
    let id = words.number("the point's id")?;
    let xyz = Vector3::from(words.f64s::<3>("the point's position")?);
    let color = [words.number("red")?, words.number("green")?, words.number("blue")?];
    // The reprojection error is computed from poses and keypoints instead; COLMAP writes −1 or NaN
    // where it has none.
    words.word("the point's error")?;
    let mut track = Vec::new();
    while !words.is_empty() {
        track.push((words.number("a track's image")?, words.number("a track's keypoint")?));
    }
    Ok(PointRow { id, xyz, color, track })
}
