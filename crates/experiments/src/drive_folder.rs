//! Renders a drive to disk.
//!
//! The same command writes the same files again. A folder with other content is rejected, so that
//! drives are not mixed and no foreign file is overwritten: `synth.json` holds the options of the
//! drive in a folder.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::io::colmap::{Format, write_model};
use tiepoint_pipeline::io::dense::DenseMap;
use tiepoint_pipeline::io::ply;
use tiepoint_pipeline::store::AtomicFile;
use tiepoint_pipeline::store::disk::{create_folders, temporary_path};
use tiepoint_synth::{Drive, DriveOptions, Exposure, LidarOptions, reference_cloud};

use crate::{Error, Progress};

/// Distance of the two cameras.
pub const BASELINE_M: f64 = 0.5;
/// Every tenth revolution of the scanner, one per second, covers the street.
const SCAN_EVERY_TURNS: usize = 10;
/// Images in memory per thread; each takes some 25 bytes per pixel.
pub(crate) const IMAGES_PER_THREAD: usize = 3;
/// The whole street is laid out before rendering; at this length it has hundreds of thousands of
/// houses.
const MAX_LENGTH_M: f64 = 100_000.0;
/// File with the options of the drive or the collection in a folder.
pub(crate) const RECORD: &str = "synth.json";
/// Colour of the points of the scanner, which sees none.
const GREY: [u8; 3] = [128; 3];

/// A drive on disk.
#[derive(Debug, Serialize)]
pub struct Rendered {
    /// Its folder.
    pub folder: PathBuf,
    /// The true model, for `evaluate poses --truth colmap:`.
    pub truth: PathBuf,
    /// Its cameras.
    pub cameras: Vec<RenderedCamera>,
    /// Length of the first camera's trajectory, in metres.
    pub driven_m: f64,
}

/// A camera of a drive on disk.
#[derive(Debug, Serialize)]
pub struct RenderedCamera {
    /// Its name, which is that of its folder of images.
    pub name: String,
    /// Number of its images.
    pub images: usize,
    /// Width of an image, in pixels.
    pub width: u32,
    /// Height of an image, in pixels.
    pub height: u32,
    /// Paraxial focal length, in pixels.
    pub focal_px: f64,
}

impl RenderedCamera {
    /// A line of text.
    pub(crate) fn describe(&self) -> String {
        let Self { name, images, width, height, focal_px } = self;
        format!("{name:<9} {images} images, {width} x {height}, focal length {focal_px:.2} px\n")
    }
}

/// Content of [`RECORD`]. Equal records give equal files.
#[derive(Serialize)]
struct Record {
    program: &'static str,
    frames: Option<usize>,
    drive: String,
}

/// Options of a drive to render, and its output folder.
pub struct Plan {
    /// The output folder.
    pub folder: PathBuf,
    /// Maximum number of images per camera.
    pub frames: Option<NonZeroUsize>,
    /// The drive.
    pub options: DriveOptions,
}

impl Plan {
    /// The drive with these options.
    ///
    /// # Errors
    ///
    /// The options are out of range.
    pub fn drive(&self) -> Result<Drive, Error> {
        let length_m = self.options.length_m;
        if length_m > MAX_LENGTH_M {
            return Err(Error::Usage(format!(
                "--length {length_m} is too long: give at most {MAX_LENGTH_M} m"
            )));
        }
        let mut drive = Drive::new(&self.options).map_err(|error| match error {
            tiepoint_synth::Error::OutOfRange { .. } => Error::Usage(error.to_string()),
            _ => error.into(),
        })?;
        if let Some(frames) = self.frames {
            drive.keep_first(frames.get());
        }
        Ok(drive)
    }

    /// Folder of the true model.
    pub fn truth(&self) -> PathBuf {
        self.folder.join("truth/model")
    }

    /// Text of [`RECORD`].
    pub(crate) fn record(&self) -> String {
        let record = Record {
            program: concat!("tiepoint ", env!("CARGO_PKG_VERSION")),
            frames: self.frames.map(usize::from),
            drive: format!("{:?}", self.options),
        };
        serde_json::to_string_pretty(&record).expect("our own types are JSON: string keys") + "\n"
    }
}

/// The point cloud of a laser scanner on the roof over the whole drive, in metres.
pub(crate) fn scan(drive: &Drive) -> Result<Vec<Vector3<f64>>, Error> {
    Ok(reference_cloud(
        drive,
        &LidarOptions { every_turns: SCAN_EVERY_TURNS, ..LidarOptions::default() },
    )?)
}

fn cannot(path: &Path, doing: &str, cause: std::io::Error) -> Error {
    Error::Folder(format!("cannot {doing} {}: {cause}", path.display()))
}

/// Writes the cloud of the laser scanner into the folder of a drive.
///
/// # Errors
///
/// The drive cannot be scanned, or the file cannot be written.
pub fn write_scan(plan: &Plan, drive: &Drive) -> Result<(), Error> {
    let vertex = |xyz: Vector3<f64>| ply::Vertex { xyz, color: GREY };
    let vertices: Vec<ply::Vertex> = scan(drive)?.into_iter().map(vertex).collect();
    Ok(ply::write(&plan.folder.join("truth/scan.ply"), &vertices)?)
}

/// Writes the true depths of the pixel centres of each image into the folder of a drive: z in the
/// camera frame at the capture time, in metres; 0 on the sky and on moving cars.
///
/// # Errors
///
/// A file cannot be written.
pub fn write_depths(plan: &Plan, drive: &Drive) -> Result<(), Error> {
    let folder = plan.folder.join("truth/depth_maps");
    for (index, camera) in drive.cameras().iter().enumerate() {
        let (width, height) = (camera.width as usize, camera.height as usize);
        for exposure in &camera.exposures {
            let cam_from_world = drive.cam_from_world(index, exposure.time_s);
            let depth = |pixel: usize| {
                let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
                let surface = drive.surface_at(index, exposure.time_s, &Vector2::new(x, y));
                let surface = surface.filter(|surface| !surface.is_moving);
                surface.map_or(0.0, |found| (cam_from_world * found.point_in_world).z as f32)
            };
            let values = (0..width * height).into_par_iter().map(depth).collect();
            let path = folder.join(format!("{}.bin", exposure.name));
            if let Some(parent) = path.parent() {
                create_folders(parent).map_err(|cause| cannot(parent, "write", cause))?;
            }
            DenseMap { width, height, channels: 1, values }.write(&path)?;
        }
    }
    Ok(())
}

/// Renders a drive to disk; existing images are not rendered again.
///
/// # Errors
///
/// The folder holds something else or cannot be written, or `progress` stops the work.
pub fn render(plan: &Plan, drive: &Drive, progress: &mut dyn Progress) -> Result<Rendered, Error> {
    let folder = &plan.folder;
    claim(folder, RECORD, &plan.record(), "a drive")?;
    drive.write_tables(folder)?;
    let truth = plan.truth();
    write_model(&truth, &drive.truth(), Format::Binary)?;
    let total = drive.cameras().iter().map(|camera| camera.exposures.len()).sum();
    let mut done = 0;
    for (index, camera) in drive.cameras().iter().enumerate() {
        let renderer = drive.renderer(index);
        // Several images at a time: one thread encodes a file while others render.
        let chunk = IMAGES_PER_THREAD * rayon::current_num_threads();
        for exposures in camera.exposures.chunks(chunk) {
            for exposure in exposures {
                if progress.rendering(&exposure.name, done, total).is_break() {
                    return Err(Error::Pipeline(tiepoint_pipeline::Error::Cancelled));
                }
                done += 1;
            }
            let is_missing = |exposure: &&Exposure| !folder.join(&exposure.name).is_file();
            exposures
                .par_iter()
                .filter(is_missing)
                .try_for_each(|exposure| drive.write_image(folder, index, exposure, &renderer))?;
        }
    }
    Ok(Rendered::new(plan, drive))
}

/// Length of the first camera's trajectory, in metres.
pub(crate) fn driven_m(drive: &Drive) -> f64 {
    let exposures = drive.cameras()[0].exposures.iter();
    let centres: Vec<_> =
        exposures.map(|e| drive.cam_from_world(0, e.time_s).origin_in_a()).collect();
    centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// Claims a new or empty folder by writing the file `record` with this text; a folder whose
/// `record` already has this text is accepted. `contents` names the contents in error messages.
pub(crate) fn claim(folder: &Path, record: &str, text: &str, contents: &str) -> Result<(), Error> {
    let path = folder.join(record);
    match fs::read_to_string(&path) {
        Ok(found) if found == text => return Ok(()),
        Ok(_) => {
            let folder = folder.display();
            return Err(Error::Folder(format!(
                "{folder} holds {contents} with other options, or of another version: choose \
                another folder with -o, or remove it"
            )));
        }
        Err(cause) if cause.kind() == ErrorKind::NotFound => {}
        Err(cause) => return Err(cannot(&path, "read", cause)),
    }
    create_folders(folder).map_err(|cause| cannot(folder, "write", cause))?;
    let entries = fs::read_dir(folder).map_err(|cause| cannot(folder, "read", cause))?;
    // What a run that was killed while it wrote the record leaves.
    let left = temporary_path(&path);
    let is_left = |entry: &io::Result<fs::DirEntry>| {
        entry.as_ref().is_ok_and(|entry| Some(entry.file_name().as_os_str()) == left.file_name())
    };
    if entries.into_iter().any(|entry| !is_left(&entry)) {
        let folder = folder.display();
        return Err(Error::Folder(format!(
            "{folder} is not empty and does not hold {contents} of this program: choose another \
            folder with -o"
        )));
    }
    Ok(AtomicFile::write_with(&path, |file| file.write_all(text.as_bytes()))?)
}

impl Rendered {
    fn new(plan: &Plan, drive: &Drive) -> Self {
        let cameras = drive.cameras().iter().map(|camera| RenderedCamera {
            name: camera.name.clone(),
            images: camera.exposures.len(),
            width: camera.width,
            height: camera.height,
            focal_px: camera.lens.focal_px(),
        });
        let (folder, truth) = (plan.folder.clone(), plan.truth());
        Self { folder, truth, cameras: cameras.collect(), driven_m: driven_m(drive) }
    }

    /// The drive in a few lines of text.
    pub fn describe(&self) -> String {
        let cameras: String = self.cameras.iter().map(RenderedCamera::describe).collect();
        let truth = self.truth.display();
        format!(
            "{cameras}length    {:.1} m\ntruth     colmap:{truth}\nin {}\n",
            self.driven_m,
            self.folder.display()
        )
    }
}
