//! `synth`: a drive on disk.
//!
//! The same command writes the same files again. A folder with anything else is refused, so that no
//! drive is mixed with another and nothing of anybody is overwritten: `synth.json` says what the
//! files were made from.

use std::fs;
use std::io::{ErrorKind, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_pipeline::eval::geometry::nalgebra::Vector3;
use tiepoint_pipeline::io::AtomicFile;
use tiepoint_pipeline::io::colmap::{Format, write_model};
use tiepoint_pipeline::io::disk::create_folders;
use tiepoint_synth::{
    Drive, DriveOptions, Exposure, LidarOptions, Mount, reference_cloud, write_ply,
};

use crate::args::Synth;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

/// Distance of the two cameras.
pub(crate) const BASELINE_M: f64 = 0.5;
/// A scan a second shows everything beside the way.
const SCAN_EVERY_TURNS: usize = 10;
/// Images at once, for each thread; each takes some 25 bytes a pixel.
const AT_ONCE: usize = 3;
/// A street is laid out as a whole before anything is rendered; this one has hundreds of thousands
/// of houses.
const MAX_LENGTH_M: f64 = 100_000.0;
/// What the files were made from.
const RECORD: &str = "synth.json";

/// What was written.
#[derive(Debug, Serialize)]
pub(crate) struct Rendered {
    folder: PathBuf,
    /// The true model, for `evaluate poses --truth colmap:`.
    pub(crate) truth: PathBuf,
    pub(crate) cameras: Vec<RenderedCamera>,
    /// Way of the first camera from its first image to its last.
    pub(crate) driven_m: f64,
}

#[derive(Debug, Serialize)]
pub(crate) struct RenderedCamera {
    name: String,
    pub(crate) images: usize,
    width: u32,
    height: u32,
    focal_px: f64,
}

/// Made from the same, files are the same.
#[derive(Serialize)]
struct Record {
    program: &'static str,
    frames: Option<usize>,
    drive: String,
}

pub(crate) fn synth(args: &Synth, output: &Output) -> Result<(), Failure> {
    let plan = Plan::of(args);
    let drive = plan.drive()?;
    let mut progress = Progress::new(output);
    let rendered = render(&plan, &drive, &mut progress)?;
    if args.scan {
        write_ply(&args.output.join("truth/scan.ply"), &scan(&drive)?)?;
    }
    drop(progress);
    output.result(&rendered, || rendered.describe())
}

/// A drive, and where it is to lie.
pub(crate) struct Plan {
    pub(crate) folder: PathBuf,
    /// At most so many images of each camera.
    pub(crate) frames: Option<NonZeroUsize>,
    pub(crate) options: DriveOptions,
}

impl Plan {
    fn of(args: &Synth) -> Self {
        let options = DriveOptions {
            seed: args.seed,
            route: args.route,
            length_m: args.length,
            mounts: Mount::stereo(args.mounting, BASELINE_M).to_vec(),
            width: args.size.width,
            height: args.size.height,
            rate_hz: args.rate,
            effects: args.effects,
            ..DriveOptions::default()
        };
        Self { folder: args.output.clone(), frames: args.frames, options }
    }

    /// The drive that this means.
    pub(crate) fn drive(&self) -> Result<Drive, Failure> {
        let length_m = self.options.length_m;
        if length_m > MAX_LENGTH_M {
            return Err(Failure::Usage(format!(
                "--length {length_m} is more than anybody can drive here: at most {MAX_LENGTH_M} m"
            )));
        }
        let mut drive = Drive::new(&self.options).map_err(|error| match error {
            tiepoint_synth::Error::OutOfRange { .. } => Failure::Usage(error.to_string()),
            _ => error.into(),
        })?;
        if let Some(frames) = self.frames {
            drive.keep_first(frames.get());
        }
        Ok(drive)
    }

    /// Where the true model lies.
    pub(crate) fn truth(&self) -> PathBuf {
        self.folder.join("truth/model")
    }

    /// What the files are made from, in words.
    pub(crate) fn record(&self) -> String {
        let record = Record {
            program: concat!("tiepoint ", env!("CARGO_PKG_VERSION")),
            frames: self.frames.map(usize::from),
            drive: format!("{:?}", self.options),
        };
        serde_json::to_string_pretty(&record).expect("our own types are JSON: string keys") + "\n"
    }
}

/// What a laser scanner on the roof sees, the whole drive long.
pub(crate) fn scan(drive: &Drive) -> Result<Vec<Vector3<f64>>, Failure> {
    Ok(reference_cloud(
        drive,
        &LidarOptions { every_turns: SCAN_EVERY_TURNS, ..LidarOptions::default() },
    )?)
}

/// Renders a drive to disk; images that are there are not rendered again.
pub(crate) fn render(
    plan: &Plan,
    drive: &Drive,
    progress: &mut Progress,
) -> Result<Rendered, Failure> {
    let folder = &plan.folder;
    claim(folder, RECORD, &plan.record(), "a drive")?;
    drive.write_tables(folder)?;
    let truth = plan.truth();
    write_model(&truth, &drive.truth(), Format::Binary)?;
    let total = drive.cameras().iter().map(|camera| camera.exposures.len()).sum();
    let mut done = 0;
    for (index, camera) in drive.cameras().iter().enumerate() {
        let renderer = drive.renderer(index);
        // Several at a time: files are encoded by one thread each, while others render.
        for exposures in camera.exposures.chunks(AT_ONCE * rayon::current_num_threads()) {
            for exposure in exposures {
                if progress.rendering(&exposure.name, done, total).is_break() {
                    return Err(Failure::Cancelled);
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

pub(crate) fn driven_m(drive: &Drive) -> f64 {
    let exposures = drive.cameras()[0].exposures.iter();
    let centres: Vec<_> =
        exposures.map(|e| drive.cam_from_world(0, e.time_s).origin_in_a()).collect();
    centres.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// Makes the folder ours, if it is new or empty; it may be already, if its `record` has the same
/// text.
pub(crate) fn claim(folder: &Path, record: &str, text: &str, what: &str) -> Result<(), Failure> {
    let path = folder.join(record);
    let cannot = |path: &Path, doing: &str, cause: std::io::Error| {
        Failure::CouldNot(format!("cannot {doing} {}: {cause}", path.display()))
    };
    match fs::read_to_string(&path) {
        Ok(found) if found == text => return Ok(()),
        Ok(_) => {
            let folder = folder.display();
            return Err(Failure::CouldNot(format!(
                "{folder} holds {what} with other options, or of another version: choose another \
                folder with -o, or remove it"
            )));
        }
        Err(cause) if cause.kind() == ErrorKind::NotFound => {}
        Err(cause) => return Err(cannot(&path, "read", cause)),
    }
    create_folders(folder).map_err(|cause| cannot(folder, "write", cause))?;
    let mut entries = fs::read_dir(folder).map_err(|cause| cannot(folder, "read", cause))?;
    if entries.next().is_some() {
        let folder = folder.display();
        return Err(Failure::CouldNot(format!(
            "{folder} is not empty, and what is there is not {what} of this program: choose \
            another folder with -o"
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

    fn describe(&self) -> String {
        let line = |camera: &RenderedCamera| {
            let RenderedCamera { name, images, width, height, focal_px } = camera;
            format!(
                "{name:<9} {images} images, {width} x {height}, focal length {focal_px:.2} px\n"
            )
        };
        let cameras: String = self.cameras.iter().map(line).collect();
        let truth = self.truth.display();
        format!(
            "{cameras}driven    {:.1} m\ntruth     colmap:{truth}\nin {}\n",
            self.driven_m,
            self.folder.display()
        )
    }
}
