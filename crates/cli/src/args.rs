//! The command line. Help texts are read as prose: what an option means, its unit, its default.

mod values;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use tiepoint_pipeline::eval::Alignment;
use tiepoint_pipeline::io::{ABSOLUTE_MAX_PIXELS, DEFAULT_MAX_PIXELS};
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_pipeline::sfm::matching::PairSelection;
use tiepoint_pipeline::sfm::{Readout, RigTerm};
use tiepoint_pipeline::{Calibration, DEFAULT_EVERY, ExportFormat, Stage, Truth};
use tiepoint_synth::{Effects, Mounting, RouteKind};

pub(crate) use values::{ImageSize, Metres, rig_name};
use values::{
    NumberList, PositivePixels, alignment, camera_model, readout, rig_term, route, threads,
};

/// Structure from motion for cameras that ride together: photos in, a COLMAP model out.
#[derive(Debug, Parser)]
#[command(name = "tiepoint", version, propagate_version = true, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Threads to use; by default as many as the machine has. Results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = threads)]
    pub(crate) threads: Option<NonZeroUsize>,
    /// Progress as JSON lines on stderr, and the result as one JSON object on stdout.
    #[arg(long, global = true)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Photos in, a COLMAP project out; goes on where an earlier run stopped.
    Reconstruct(Reconstruct),
    /// First stage: keypoints and descriptors, into WORKSPACE/database.db.
    Features(Features),
    /// Second stage: which images show the same things; matches and two-view geometries.
    Match(Match),
    /// Third stage: poses and points, into WORKSPACE/sparse/0 (and 1, ... where the photos do not
    /// hang together).
    Map(Map),
    /// Bundle adjustment alone, of a COLMAP model or a BAL problem.
    Adjust(Adjust),
    /// Compares a result with the truth.
    #[command(subcommand)]
    Evaluate(Evaluate),
    /// Writes a result in another format.
    Export(Export),
    /// Writes report.html into a workspace: cloud, cameras and plots in one file to open in a
    /// browser, offline too.
    View(View),
    /// Renders the drive of two cameras along a street, with the truth beside it.
    Synth(Synth),
    /// Shows what this program does, with nothing prepared: renders a small loop, reconstructs it
    /// without a constraint between its two cameras, with the paper's and with one mounting,
    /// compares all with the truth.
    Demo(Demo),
    /// The experiments of Huang, Elhashash & Qin 2022 in a rendered world: tables as theirs,
    /// clouds, trajectories, and what is true. By default a run of a minute or two; --length 2200
    /// --rate 10 --size 2000x1500 is as large as theirs. A model of COLMAP's in the folder
    /// colmap/sparse/0 of a workspace gets a column beside ours.
    #[command(subcommand)]
    Experiment(Experiment),
}

#[derive(Debug, Args)]
pub(crate) struct Reconstruct {
    #[command(flatten)]
    pub(crate) input: Input,
    #[command(flatten)]
    pub(crate) cameras: Cameras,
    #[command(flatten)]
    pub(crate) pairs: Pairs,
    #[command(flatten)]
    pub(crate) mapping: Mapping,
    #[command(flatten)]
    pub(crate) seed: Seed,
    /// Makes this stage and the later ones anew, whatever there is: features, match or map.
    #[arg(long, value_name = "STAGE")]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Features {
    #[command(flatten)]
    pub(crate) input: Input,
    #[command(flatten)]
    pub(crate) cameras: Cameras,
    /// Makes this stage anew, whatever there is: features.
    #[arg(long, value_name = "STAGE")]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Match {
    /// A workspace that has features.
    pub(crate) workspace: PathBuf,
    #[command(flatten)]
    pub(crate) pairs: Pairs,
    #[command(flatten)]
    pub(crate) seed: Seed,
    /// Makes this stage anew, whatever there is: match.
    #[arg(long, value_name = "STAGE")]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Map {
    /// A workspace that has matches.
    pub(crate) workspace: PathBuf,
    #[command(flatten)]
    pub(crate) mapping: Mapping,
    #[command(flatten)]
    pub(crate) seed: Seed,
    /// Makes this stage anew, whatever there is: map.
    #[arg(long, value_name = "STAGE")]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Input {
    /// A folder of photos is one camera; a folder with one sub-folder for each camera is several;
    /// each video is one camera (this needs the program ffmpeg).
    #[arg(required = true, value_name = "INPUT")]
    pub(crate) inputs: Vec<PathBuf>,
    /// Where to work and to leave the results; also a COLMAP project.
    #[arg(short, long = "output", value_name = "WORKSPACE")]
    pub(crate) output: PathBuf,
    /// Of a video, one frame of so many is taken, the sharpest; frames that show nothing new, at a
    /// stop, are left out.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_EVERY)]
    pub(crate) every: NonZeroUsize,
    /// When the photos were taken: CSV with the header `image,seconds`. By default from their names
    /// or EXIF.
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) timestamps: Option<PathBuf>,
    /// Where nothing is to be detected: a folder with a mask for each photo, black being out
    /// (left/1.jpg.png for left/1.jpg).
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Photos of more pixels, in millions, are skipped: a file of a few kilobytes can claim any
    /// size, and each pixel takes some 16 bytes of memory. However many threads there are, photos
    /// wait for each other rather than fill more than half of the free memory.
    #[arg(
        long,
        value_name = "N",
        default_value_t = DEFAULT_MAX_PIXELS / MEGA,
        value_parser = clap::value_parser!(u64).range(1..=ABSOLUTE_MAX_PIXELS / MEGA)
    )]
    pub(crate) max_megapixels: u64,
}

/// Pixels of a megapixel.
pub(crate) const MEGA: u64 = 1_000_000;

#[derive(Debug, Args)]
pub(crate) struct Cameras {
    /// Known intrinsics of every camera, in pixels, (0.5, 0.5) being the centre of the first one;
    /// they stay fixed. OpenCV and KITTI count from (0, 0): add 0.5 to cx and cy. Four numbers are
    /// a PINHOLE, more an OPENCV with k1,k2,p1,p2.
    #[arg(
        long,
        value_name = "fx,fy,cx,cy[,k..]",
        allow_hyphen_values = true,
        conflicts_with = "focal_prior"
    )]
    pub(crate) intrinsics: Option<NumberList>,
    /// Focal length of every camera, roughly, in pixels; it is refined. By default from EXIF, else
    /// 1.2 times the larger side.
    #[arg(long, value_name = "PX")]
    pub(crate) focal_prior: Option<PositivePixels>,
    /// COLMAP's name of the camera model; for action cameras THIN_PRISM_FISHEYE. Pixels count as
    /// square where it has two focal lengths [default: SIMPLE_RADIAL].
    #[arg(long, value_name = "NAME", value_parser = camera_model)]
    pub(crate) camera_model: Option<CameraModelKind>,
}

#[derive(Debug, Args)]
pub(crate) struct Pairs {
    /// Which photos to match: exhaustive (each with every other), sequential:N (N neighbours before
    /// and after, within a camera and across cameras), sequential:N+ends (and the first N with the
    /// last N), sequential:N+loops:K (and, wherever the drive comes by again, with the K that look
    /// most alike), similar:K (those alone, for photos in no order).
    #[arg(long, value_name = "SELECTION", default_value_t = PairSelection::Exhaustive)]
    pub(crate) pairs: PairSelection,
}

#[derive(Debug, Args)]
pub(crate) struct Mapping {
    /// What holds cameras that ride together to each other: off (nothing), paper (the baseline
    /// constraint of Huang, Elhashash & Qin 2022: the relative pose at one moment equals that at
    /// the next), soft (one mounting for each camera, as firmly as held-out tracks allow), hard
    /// (one mounting, exactly), auto (the firmest of these that held-out tracks do not contradict).
    /// Times of the photos may be on clocks that disagree: they are found (paper: to half the time
    /// between two photos).
    #[arg(long, value_name = "MODE", default_value = "auto", value_parser = rig_term)]
    pub(crate) rig: RigTerm,
    /// Distance of the first camera and the next (in the order of their folders), with its unit: m,
    /// cm or mm. The result is scaled so that they are that far apart; by default its unit is
    /// arbitrary.
    #[arg(long, value_name = "0.62m")]
    pub(crate) baseline: Option<Metres>,
    /// Of cameras whose rows are exposed one after the other: the time from the first row to the
    /// last one, as 16ms, or `estimate`. It needs times of the photos. By default all rows count as
    /// exposed at once.
    #[arg(long, value_name = "16ms", value_parser = readout, allow_hyphen_values = true)]
    pub(crate) rolling_shutter: Option<Readout>,
}

#[derive(Debug, Args)]
pub(crate) struct Seed {
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u64,
}

#[derive(Debug, Args)]
pub(crate) struct Adjust {
    /// A folder with a COLMAP model, or a BAL problem (a text file).
    #[arg(value_name = "MODEL|PROBLEM.txt")]
    pub(crate) model: PathBuf,
    /// Where to write the result, in the format of the input; without it, only the costs are told.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: Option<PathBuf>,
    /// Leave focal lengths and distortion as they are. (Those that a workspace was given with
    /// --intrinsics stay anyway.)
    #[arg(long)]
    pub(crate) fix_intrinsics: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Evaluate {
    /// Camera poses: centre errors after a similarity, relative-pose AUC, focal length.
    Poses(EvaluatePoses),
    /// A cloud: distance of its points to the nearest ones of a reference, a laser scan say, after
    /// alignment.
    Cloud(EvaluateCloud),
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateCloud {
    /// A PLY, LAS or LAZ file, a workspace, or a folder with a COLMAP model. (LAS and LAZ need a
    /// build with --features las.)
    pub(crate) cloud: PathBuf,
    /// What it is compared with: as above.
    pub(crate) reference: PathBuf,
    /// What is found before distances are measured: similarity (from anywhere, by the clouds' own
    /// axes and then closest points), rigid (a motion from where the cloud is), none. With a scale,
    /// closest points hide drift.
    #[arg(long, value_name = "FREEDOM", default_value = "similarity", value_parser = alignment)]
    pub(crate) align: Alignment,
    /// Puts the cloud of a workspace where its cameras belong, given true poses in the world of the
    /// reference, and only moves it rigidly from there: the honest way. FORMAT as in
    /// `evaluate poses`.
    #[arg(long, value_name = "FORMAT:PATH", conflicts_with = "align")]
    pub(crate) truth: Option<Truth>,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluatePoses {
    /// A folder with a COLMAP model, or a workspace.
    pub(crate) model: PathBuf,
    /// True poses. FORMAT is strecha (a folder of .camera files), kitti (the number of an image is
    /// the line), tum (by time), colmap (a model).
    #[arg(long, value_name = "FORMAT:PATH")]
    pub(crate) truth: Truth,
    /// Compares only images whose names begin with this. By default all; for kitti and tum those of
    /// the first camera.
    #[arg(long, value_name = "PREFIX")]
    pub(crate) images: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct Export {
    /// A workspace, or a folder with a COLMAP model.
    pub(crate) workspace: PathBuf,
    /// colmap and colmap-text (a folder), ply (the cloud), tum or kitti (the trajectory of one
    /// camera), bal, openmvs (a folder with scene.mvs and undistorted images), nerfstudio (a folder
    /// with transforms.json, images and cloud), kalibr (the rig with its clocks, as camchain.yaml).
    #[arg(long, value_name = "FORMAT")]
    pub(crate) to: ExportFormat,
    /// The file or folder to write.
    #[arg(short, long = "output", value_name = "PATH")]
    pub(crate) output: PathBuf,
    /// Adjusts first with every camera held exactly to one calibration, whatever --rig it was
    /// mapped with, and makes the moments frames of a rig; what that does to the errors is told.
    #[arg(long)]
    pub(crate) rigid: bool,
}

#[derive(Debug, Args)]
pub(crate) struct View {
    /// A workspace, or a folder with a COLMAP model.
    pub(crate) workspace: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Synth {
    /// Where to write: left/, right/ and timestamps.csv as cameras leave them, and truth/. New,
    /// empty, or of the same drive.
    #[arg(short, long = "output", value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// At most so many images of each camera, the first ones; by default the whole drive around the
    /// block.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    pub(crate) size: ImageSize,
    /// Seed of the street, the drive and everything random.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Images a second.
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    pub(crate) rate: f64,
    /// Which way the street runs: loop (around a block, back to the start and a little further) or
    /// open (onwards).
    #[arg(long, value_name = "ROUTE", default_value = "loop", value_parser = route)]
    pub(crate) route: RouteKind,
    /// How long the street is, in metres.
    #[arg(long, value_name = "M", default_value_t = 200.0)]
    pub(crate) length: f64,
    /// Which way both cameras look, half a metre apart: front, front-right, right, rear or left.
    #[arg(long, value_name = "MOUNTING", default_value = "front")]
    pub(crate) mounting: Mounting,
    /// What is not ideal: none, all, or some of lens, rolling-shutter, vibration, mounting,
    /// traffic, clocks and photometry, joined by +.
    #[arg(long, value_name = "NAMES", default_value = "none")]
    pub(crate) effects: Effects,
    /// Also writes truth/scan.ply: the cloud of a laser scanner on the roof, for `evaluate cloud`.
    #[arg(long)]
    pub(crate) scan: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Demo {
    /// Where to work and to leave everything. The same command goes on where an earlier one
    /// stopped.
    #[arg(short, long = "output", value_name = "DIR", default_value = "tiepoint-demo")]
    pub(crate) output: PathBuf,
    /// At most so many images of each camera, the first ones; by default the whole loop.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    pub(crate) size: ImageSize,
    /// Seed of the street and of everything random.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Experiment {
    /// Experiment I: one camera, looking to the front, right, rear and left in turn.
    Mounting(Scenery),
    /// Experiment II: two cameras half a metre apart that look right, with and without a constraint
    /// between them.
    Baseline {
        #[command(flatten)]
        scenery: Scenery,
        /// What holds the cameras to each other, one row each: off, paper, soft, hard, auto.
        #[arg(
            long,
            value_name = "MODES",
            value_delimiter = ',',
            default_value = "off,paper,auto",
            value_parser = rig_term
        )]
        rig: Vec<RigTerm>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct Scenery {
    /// Where to work and to leave everything. The same command goes on where an earlier one
    /// stopped.
    #[arg(short, long = "output", value_name = "DIR", default_value = "tiepoint-experiment")]
    pub(crate) output: PathBuf,
    /// At most so many images of each camera, the first ones; by default the whole loop.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "400x300")]
    pub(crate) size: ImageSize,
    /// Seed of the street, the drive and everything random.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Images a second.
    #[arg(long, value_name = "HZ", default_value_t = 2.5)]
    pub(crate) rate: f64,
    /// How long the loop is, in metres.
    #[arg(long, value_name = "M", default_value_t = 160.0)]
    pub(crate) length: f64,
    /// What is not ideal, as in `synth`.
    #[arg(long, value_name = "NAMES", default_value = "all")]
    pub(crate) effects: Effects,
    /// Which photos to match, as in `match`.
    #[arg(long, value_name = "SELECTION", default_value = "sequential:6+ends")]
    pub(crate) pairs: PairSelection,
}

impl Cameras {
    /// What is known of the cameras; an error is one of usage.
    pub(crate) fn calibration(&self) -> Result<Calibration, String> {
        let Some(NumberList(params)) = &self.intrinsics else {
            let model = self.camera_model.unwrap_or(CameraModelKind::SimpleRadial);
            return Ok(Calibration::Unknown {
                model,
                focal_px: self.focal_prior.map(|focal| focal.0),
            });
        };
        let intrinsics = match (self.camera_model, params.len()) {
            (Some(model), _) => Intrinsics::new(model, params),
            (None, 4) => Intrinsics::new(CameraModelKind::Pinhole, params),
            (None, 5..=8) => {
                let mut padded = params.clone();
                padded.resize(CameraModelKind::Opencv.num_params(), 0.0);
                Intrinsics::new(CameraModelKind::Opencv, &padded)
            }
            (None, count) => {
                return Err(format!(
                    "--intrinsics has {count} numbers: give fx,fy,cx,cy, or \
                    fx,fy,cx,cy,k1,k2,p1,p2, or a --camera-model and its \
                     parameters"
                ));
            }
        };
        intrinsics.map(Calibration::Known).map_err(|error| format!("--intrinsics: {error}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clap_finds_the_definitions_sound() {
        <Cli as clap::CommandFactory>::command().debug_assert();
    }

    fn calibration(intrinsics: &str, model: Option<&str>) -> Result<Calibration, String> {
        Cameras {
            intrinsics: Some(intrinsics.parse()?),
            focal_prior: None,
            camera_model: model.map(camera_model).transpose()?,
        }
        .calibration()
    }

    #[test]
    fn intrinsics_choose_their_model() {
        let known =
            |model, params: &[f64]| Ok(Calibration::Known(Intrinsics::new(model, params).unwrap()));
        assert_eq!(
            calibration("9,8,7,6", None),
            known(CameraModelKind::Pinhole, &[9.0, 8.0, 7.0, 6.0])
        );
        let padded = [9.0, 8.0, 7.0, 6.0, -0.5, 0.0, 0.0, 0.0];
        assert_eq!(calibration("9,8,7,6,-.5", None), known(CameraModelKind::Opencv, &padded));
        let radial = known(CameraModelKind::SimpleRadial, &[9.0, 7.0, 6.0, 0.1]);
        assert_eq!(calibration("9,7,6,.1", Some("simple_radial")), radial);
        assert!(calibration("9,8,7", None).unwrap_err().contains("3 numbers"));
        assert!(calibration("-9,8,7,6", None).unwrap_err().contains("--intrinsics"));
        assert!(calibration("9,8,x,6", None).unwrap_err().contains("'x' is no number"));
    }
}
