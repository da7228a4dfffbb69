//! The command line. The help text of an option states its meaning, unit and default.

mod values;

use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{ArgGroup, Args, Parser, Subcommand};
use clap_complete::Shell;
use tiepoint_pipeline::eval::Alignment;
use tiepoint_pipeline::evaluation::Truth;
use tiepoint_pipeline::input::{
    ABSOLUTE_MAX_PIXELS, Calibration, CalibrationSource, CameraGrouping, DEFAULT_MAX_PIXELS,
};
use tiepoint_pipeline::models::{ExportFormat, UndistortOptions};
use tiepoint_pipeline::sfm::RigMode;
use tiepoint_pipeline::sfm::geometry::crs::Crs;
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_pipeline::sfm::matching::PairSelection;
use tiepoint_pipeline::sfm::rolling_shutter::Readout;
use tiepoint_pipeline::stages::{PositionPriors, Submaps};
use tiepoint_pipeline::{Shard, Stage};
use tiepoint_synth::trajectory::Carrier;
use tiepoint_synth::{CollectionKind, Effects, RouteKind, ViewDirection};

pub(crate) use values::{CropBox, ImageSize, Metres, PositivePixels, Quantiles, Refine, threads};
use values::{
    NumberList, downscale, memory, one_of, position_priors, positive, readout, refine, rig_mode,
    submaps,
};

/// Structure from motion for cameras mounted on one vehicle: photos in, a COLMAP model out.
#[derive(Debug, Parser)]
#[command(name = "tiepoint", version, propagate_version = true, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Number of threads [default: all of the machine].
    ///
    /// The results do not depend on it.
    #[arg(help_heading = "Output", long, global = true, value_name = "N", value_parser = threads)]
    pub(crate) threads: Option<NonZeroUsize>,
    /// Progress as JSON lines on stderr, the result as JSON on stdout.
    #[arg(help_heading = "Output", long, global = true)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Photos or videos in, a COLMAP project out: runs all stages.
    ///
    /// Runs features, match and map, with --dense also dense. Resumes an interrupted run.
    Reconstruct(Reconstruct),
    /// Stage 1: extracts SIFT keypoints and descriptors into WORKSPACE/database.db.
    Features(Features),
    /// Stage 2: matches image pairs and verifies them by two-view geometry.
    Match(Match),
    /// Stage 3: poses and points, by incremental mapping.
    ///
    /// Writes WORKSPACE/sparse/0; images that are not connected to this model give further models
    /// in sparse/1, sparse/2, ...
    Map(Map),
    /// Stage 4: depth maps and a dense coloured cloud of the largest model.
    ///
    /// Writes a dense workspace of COLMAP in WORKSPACE/dense (images, sparse, stereo, fused.ply,
    /// fused.ply.vis). Resumes an interrupted run image by image. Each depth has the probability
    /// that it is right in stereo/confidence_maps, each point in its property `confidence`.
    ///
    /// A model of rolling shutters (`map --rolling-shutter`) is seen from the poses of the rows
    /// where the motion is known (`report.json` counts these images): the depth of a pixel is z in
    /// the pose of its row. Programs that take one pose an image, as COLMAP's stereo_fusion and
    /// trainers of splats, shear such depth maps.
    Dense(Dense),
    /// Estimates the poses of photos in an existing model, which stays as it is.
    ///
    /// Prints a line for each photo: name, number of inliers and cam_from_world as qw qx qy qz tx
    /// ty tz.
    Localize(Localize),
    /// Bundle adjustment of a COLMAP model or a BAL problem.
    Adjust(Adjust),
    /// Compares a model with ground truth.
    #[command(subcommand)]
    Evaluate(Evaluate),
    /// Counts, transforms, aligns, crops and merges COLMAP models.
    #[command(subcommand)]
    Model(ModelCommand),
    /// Writes a model in another format.
    Export(Export),
    /// Undistorted images and PINHOLE model for trainers of Gaussian splats.
    ///
    /// As 3DGS, gsplat, LichtFeld, Brush and nerfstudio read them: DIR/images with the names of the
    /// photos, DIR/masks and DIR/sparse/0.
    Undistort(Undistort),
    /// Writes report.html, to look at a model in a browser.
    ///
    /// Point clouds, cameras, rig and plots in one file that a browser shows offline. It is in the
    /// workspace; that of another model is NAME.html in the current folder.
    View(View),
    /// Renders a drive of two cameras, or a collection of photos, with its truth.
    Synth(Synth),
    /// Renders two drives and compares the constraints of --rig.
    ///
    /// Needs no data: renders an open street and a loop as seen by two cameras, reconstructs each
    /// with --rig off and auto, the street also with paper, and compares the models with the
    /// ground truth.
    Demo(Demo),
    /// Experiments I and II of Huang, Elhashash & Qin 2022 on rendered images.
    ///
    /// Prints the paper's tables beside the ground truth. By default a run of a minute or two;
    /// --length 2200 --rate 10 --size 2000x1500 has the size of the paper's data. A COLMAP model in
    /// the folder colmap/sparse/0 of a workspace gets a column of its own.
    #[command(subcommand)]
    Experiment(Experiment),
    /// COLMAP's commands with COLMAP's options, done by this program.
    ///
    /// The options are those of COLMAP 3.x and 4.x. `tiepoint colmap help` lists the commands,
    /// `tiepoint colmap VERB -h` the options of one. Under the name `colmap` (a link to the
    /// program) the program is this command.
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Colmap(Colmap),
    /// Prints the completions of a shell to stdout.
    ///
    /// The shell reads them from its folder of completions.
    Completions(Completions),
    /// Prints the manual page of the program or of a command to stdout, in roff.
    Man(Man),
}

#[derive(Debug, Args)]
pub(crate) struct Colmap {
    /// The command of COLMAP and its options: `mapper --database_path database.db ...`.
    #[arg(value_name = "VERB", trailing_var_arg = true, allow_hyphen_values = true)]
    pub(crate) words: Vec<OsString>,
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
    /// Also runs the stage dense, as `tiepoint dense` does.
    #[arg(help_heading = "Output", long)]
    pub(crate) dense: bool,
    /// Computes this stage and the later ones again.
    ///
    /// One of features, match, map or (with --dense) dense.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "STAGE",
        value_parser = one_of(&Stage::ALL, Stage::name),
        hide_possible_values = true
    )]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Features {
    #[command(flatten)]
    pub(crate) input: Input,
    #[command(flatten)]
    pub(crate) cameras: Cameras,
    /// Does one of several parts of this stage: i/n is part i of n.
    ///
    /// For several machines with a shared folder, or a job array. Each part is a process of its
    /// own, with the same other options, and leaves a file in the workspace. When all parts are
    /// done, this command without --shard makes the database of them.
    #[arg(help_heading = "Output", long, value_name = "i/n", conflicts_with = "database")]
    pub(crate) shard: Option<Shard>,
    /// Computes this stage again: features.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "STAGE",
        value_parser = one_of(&Stage::ALL, Stage::name),
        hide_possible_values = true
    )]
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
    /// Does one of several parts of this stage: i/n is part i of n.
    ///
    /// For several machines with a shared folder, or a job array. Each part is a process of its
    /// own, with the same other options, and leaves a file in the workspace. When all parts are
    /// done, this command without --shard makes the database of them.
    #[arg(help_heading = "Output", long, value_name = "i/n")]
    pub(crate) shard: Option<Shard>,
    /// Computes this stage again: match.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "STAGE",
        value_parser = one_of(&Stage::ALL, Stage::name),
        hide_possible_values = true
    )]
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
    /// Maps one part of --submaps alone.
    ///
    /// For several machines with a shared folder, or a job array. Part 1 comes first: the others
    /// begin with its intrinsics. Each part leaves a file in the workspace; --merge makes the model
    /// of them.
    #[arg(help_heading = "Output", long, value_name = "K")]
    pub(crate) submap: Option<NonZeroUsize>,
    /// Assembles the parts that --submap made; without it, missing ones are mapped.
    #[arg(help_heading = "Output", long, conflicts_with = "submap")]
    pub(crate) merge: bool,
    /// Computes this stage again: map.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "STAGE",
        value_parser = one_of(&Stage::ALL, Stage::name),
        hide_possible_values = true
    )]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
pub(crate) struct Localize {
    /// A workspace, or a folder with database.db and sparse/, or a model in it.
    pub(crate) model: PathBuf,
    /// Folders of photos.
    #[arg(required = true, value_name = "INPUT")]
    pub(crate) inputs: Vec<PathBuf>,
    /// Folder for the model with the photos, as COLMAP's binary files.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: PathBuf,
    /// Known intrinsics of all photos, in pixels, as in `features`.
    ///
    /// By default those of a camera of the model with photos of the same size, body, lens and focal
    /// length; else the focal length is estimated with the pose.
    #[arg(
        long,
        value_name = "fx,fy,cx,cy",
        allow_hyphen_values = true,
        conflicts_with = "focal_prior"
    )]
    pub(crate) intrinsics: Option<NumberList>,
    /// Known intrinsics of single photos, as in `features`.
    #[arg(long, value_name = "FILE", conflicts_with = "intrinsics")]
    pub(crate) calibration: Vec<CalibrationSource>,
    /// Initial focal length of all photos, in pixels; it is estimated with the pose.
    #[arg(long, value_name = "PX")]
    pub(crate) focal_prior: Option<PositivePixels>,
    /// COLMAP's name of the camera model of the photos [default: SIMPLE_RADIAL].
    #[arg(
        long,
        value_name = "NAME",
        value_parser = one_of(CameraModelKind::ALL, CameraModelKind::name),
        hide_possible_values = true,
        ignore_case = true
    )]
    pub(crate) camera_model: Option<CameraModelKind>,
    /// Folder with a mask for each photo, as in `features`.
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Reduces the photos to this width and height at most, in pixels, as in `features`.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..))]
    pub(crate) max_size: Option<u32>,
    #[command(flatten)]
    pub(crate) seed: Seed,
}

#[derive(Debug, Args)]
pub(crate) struct Dense {
    /// A workspace that has a model.
    ///
    /// The photos must still be where they were.
    pub(crate) workspace: PathBuf,
    /// Reduces the photos to this width and height at most, in pixels.
    ///
    /// Depth maps and undistorted images have that size. By default they have that of the photos.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..))]
    pub(crate) max_size: Option<u32>,
    /// Folder with a mask for each photo, left/1.jpg.png for left/1.jpg.
    ///
    /// No depths are estimated where the mask is black.
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Also writes normal maps, which COLMAP's stereo_fusion reads.
    #[arg(long)]
    pub(crate) normal_maps: bool,
    /// Also writes depth maps as 16-bit PNG, as trainers of splats read them.
    ///
    /// They are in dense/depth_png; scale.json there has the depth of one unit. Confidences are in
    /// dense/confidence_png, 255 for certain.
    #[arg(long)]
    pub(crate) depth_pngs: bool,
    /// Computes this stage again: dense.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "STAGE",
        value_parser = one_of(&Stage::ALL, Stage::name),
        hide_possible_values = true
    )]
    pub(crate) redo: Option<Stage>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Input")]
pub(crate) struct Input {
    /// Folders of photos, or videos.
    ///
    /// A folder of photos, a folder with one sub-folder of photos per camera of a rig, or videos
    /// (one camera each; the program ffmpeg reads them).
    // Arguments without a name come last in a heading, unless they have an order.
    #[arg(required_unless_present = "database", value_name = "INPUT", display_order = 0)]
    pub(crate) inputs: Vec<PathBuf>,
    /// Takes the features and matches of a COLMAP database.
    ///
    /// Of COLMAP, pycolmap or hloc, of any version. If it has matches or two-view geometries,
    /// --pairs has no effect. It is copied and not changed. Its rigs are not used: give them with
    /// --rig-calibration. INPUT is then optional: the folder that the names of the images are
    /// relative to, for colours.
    #[arg(
        long,
        display_order = 1,
        value_name = "FILE",
        conflicts_with_all = ["masks", "timestamps", "calibration", "intrinsics", "focal_prior",
                              "camera_model", "cameras", "every", "max_megapixels"]
    )]
    pub(crate) database: Option<PathBuf>,
    /// Folder for intermediate files and results: a COLMAP project.
    #[arg(help_heading = "Output", short, long = "output", value_name = "WORKSPACE")]
    pub(crate) output: PathBuf,
    /// Of a video, takes the sharpest of every N frames; 1 takes all.
    ///
    /// By default the sharpest of each tenth of a second, and more where the image moves fast.
    /// Videos of one drive give frames of the same times. Frames without image motion, as at a
    /// stop, are left out. Photos are all taken.
    #[arg(long, value_name = "N")]
    pub(crate) every: Option<NonZeroUsize>,
    /// Capture times of the photos: CSV with the header `image,seconds`.
    ///
    /// By default the times in the file names or in EXIF.
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) timestamps: Option<PathBuf>,
    /// Folder with a mask for each photo, left/1.jpg.png for left/1.jpg.
    ///
    /// No keypoints are detected where the mask is black, nor depths with --dense.
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Reduces the photos to this width and height at most, in pixels.
    ///
    /// Keypoints are detected in the reduced photos; their positions, the intrinsics and the model
    /// are in pixels of the photos. With --dense, depth maps have the reduced size. By default
    /// photos are taken as they are.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..))]
    pub(crate) max_size: Option<u32>,
    /// Bound on the size of a photo, against damaged files: larger ones are skipped.
    ///
    /// In millions of pixels. A pixel takes about 16 bytes of memory. As many photos are processed
    /// at a time as half of the free memory holds.
    #[arg(
        long,
        value_name = "N",
        hide_short_help = true,
        default_value_t = DEFAULT_MAX_PIXELS / MEGA,
        value_parser = clap::value_parser!(u64).range(1..=ABSOLUTE_MAX_PIXELS / MEGA)
    )]
    pub(crate) max_megapixels: u64,
}

/// Pixels per megapixel.
pub(crate) const MEGA: u64 = 1_000_000;

#[derive(Debug, Args)]
#[command(next_help_heading = "Cameras")]
pub(crate) struct Cameras {
    /// Photos that share a camera: auto, folder, image or single.
    ///
    /// auto: photos of one folder with the same size, EXIF orientation, body, lens and focal
    /// length; folder: each folder has one camera; image: each photo has its own; single: all have
    /// one.
    #[arg(
        long,
        value_name = "GROUPS",
        default_value = CameraGrouping::Auto.name(),
        value_parser = one_of(&CameraGrouping::ALL, CameraGrouping::name),
        hide_possible_values = true
    )]
    pub(crate) cameras: CameraGrouping,
    /// Known intrinsics of all cameras, in pixels.
    ///
    /// Mapping refines them if the images contradict them (--calibration-sigma). The centre of the
    /// first pixel is (0.5, 0.5) as in COLMAP; for intrinsics of OpenCV or KITTI, which have it at
    /// (0, 0), add 0.5 to cx and cy. They are those of the stored photo and are turned as EXIF
    /// says. Four numbers are a PINHOLE camera, more are an OPENCV one (k1,k2,p1,p2).
    #[arg(
        long,
        value_name = "fx,fy,cx,cy",
        allow_hyphen_values = true,
        conflicts_with = "focal_prior"
    )]
    pub(crate) intrinsics: Option<NumberList>,
    /// Known intrinsics of single cameras, from a file.
    ///
    /// As [PATTERN=]FILE[#CAMERA][@WxH]. FILE is COLMAP's cameras.txt, OpenCV's or ROS's YAML,
    /// Kalibr's camchain, KITTI's calib.txt or calib_cam_to_cam.txt, each with its own pixel
    /// centre. With a PATTERN it is for the folders or photos that match (`*` any characters, `?`
    /// one), so that `*=FILE` is for all; #CAMERA is the name of the camera in the file, as
    /// `left=calib.txt#P2`. Without a pattern the cameras of the file are those of the folders, by
    /// name (also camera_name, topic, and the name of a file of one camera) or in their order.
    /// `@WxH` behind `#` or `#CAMERA` states the image size of a file that has none. A calibration
    /// of the size of the stored photo is turned as EXIF says. May be given several times; the
    /// first that is for a photo counts.
    #[arg(long, value_name = "FILE", conflicts_with = "intrinsics")]
    pub(crate) calibration: Vec<CalibrationSource>,
    /// Initial focal length of all cameras, in pixels; it is refined.
    ///
    /// By default from EXIF, else 1.2 times the larger image side. For photos whose lens EXIF names
    /// it is scaled with the size of the photo.
    #[arg(long, value_name = "PX")]
    pub(crate) focal_prior: Option<PositivePixels>,
    /// COLMAP's name of the camera model [default: the images decide].
    ///
    /// By default SIMPLE_RADIAL, in place of which mapping takes RADIAL, OPENCV or a fisheye
    /// where the images give very strong evidence. THIN_PRISM_FISHEYE suits action cameras,
    /// EQUIRECTANGULAR panoramas. In models with two focal lengths fx and fy stay equal. A wrong
    /// name lists all.
    #[arg(
        long,
        value_name = "NAME",
        value_parser = one_of(CameraModelKind::ALL, CameraModelKind::name),
        hide_possible_values = true,
        ignore_case = true
    )]
    pub(crate) camera_model: Option<CameraModelKind>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Matching")]
pub(crate) struct Pairs {
    /// Image pairs to match: auto, exhaustive, sequential:N or similar:K.
    ///
    /// auto: all of up to 60 images; of more, neighbours and loops of recordings (by times below a
    /// second, or the same numbers in two cameras), and all of up to 200 photos. Above 200, numbers
    /// alone show a sequence, too, and photos have their most similar images. exhaustive: all.
    /// sequential:N: each image with its N neighbours before and after, within a camera and across
    /// cameras (sequential alone is sequential:10). sequential:N+thin: of these those that are 1,
    /// 2, 3, 4, 6, 8, 12, 16 ... images away. sequential:N+ends: also the first N with the last N.
    /// sequential:N+loops:K: also each image with its K most similar images, to find loops.
    /// similar:K: each image with its K most similar images only, for unordered photos.
    #[arg(long, value_name = "SELECTION", default_value_t = PairSelection::Auto)]
    pub(crate) pairs: PairSelection,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Rig and time")]
pub(crate) struct Mapping {
    /// Constraint between cameras of a rig: auto, off, paper, soft or rigid.
    ///
    /// off: none. paper: the baseline constraint of Huang, Elhashash & Qin 2022; the relative pose
    /// is the same at consecutive frames. soft: one sensor_from_rig per camera with standard
    /// deviations as small as held-out tracks allow. rigid: one exact sensor_from_rig per camera.
    /// auto: the strongest of off, soft and rigid that held-out tracks do not contradict. Cameras
    /// need not be synchronised: their time offsets are estimated (paper: to half a frame
    /// interval).
    #[arg(
        long,
        value_name = "MODE",
        default_value = "auto",
        value_parser = rig_mode(),
        hide_possible_values = true
    )]
    pub(crate) rig: RigMode,
    /// Known rigs: COLMAP's rig_config.json or Kalibr's camchain.
    ///
    /// In rig_config.json photos of one frame have the same name after their image_prefix. The
    /// cameras of a camchain are the folders, by name or in their order; photos of one frame have
    /// the same name, or the same time. Frames are registered as a whole, and the extrinsics are
    /// kept, unless --refine names them. Intrinsics in the file are used, too, where --calibration
    /// gives none.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with_all = ["rig", "baseline", "rolling_shutter", "input_model"]
    )]
    pub(crate) rig_calibration: Option<PathBuf>,
    /// Intrinsics to refine: none, or a list as focal,distortion.
    ///
    /// By default focal,principal-point,distortion, and known intrinsics only if the images
    /// contradict them. The list may also have aspect (fx and fy are refined separately; else
    /// pixels stay square, which anamorphic video does not have) and prism (the thin prism of the
    /// model; else it stays fixed). Known intrinsics have a prior at their values, and with
    /// distortion in the list a PINHOLE camera becomes an OPENCV one. With extrinsics in the list,
    /// those of --rig-calibration are refined.
    #[arg(help_heading = "Cameras", long, value_name = "LIST", value_parser = refine)]
    pub(crate) refine: Option<Refine>,
    /// Standard deviation of known intrinsics at the image border, in pixels.
    ///
    /// How far the error of each parameter moves the border of the image. By default they are kept
    /// unless the images contradict them, and then it is 1. With --refine none they are exact.
    #[arg(help_heading = "Cameras", long, value_name = "PX")]
    pub(crate) calibration_sigma: Option<PositivePixels>,
    /// Distance of the first two cameras, with its unit: sets the scale.
    ///
    /// In m, cm or mm. The first two cameras are those in the order of their folders. The model is
    /// scaled to it; by default the scale is arbitrary.
    #[arg(long, value_name = "0.62m", conflicts_with = "input_model")]
    pub(crate) baseline: Option<Metres>,
    /// Positions of the photos: a CSV or GPX file, auto (EXIF, GoPro) or off.
    ///
    /// auto takes positions of EXIF or GoPro's videos, or pose_priors of --database. A CSV file has
    /// the header image,lat,lon,alt (WGS 84, degrees and metres) or image,x,y,z (metres, z up), and
    /// perhaps sigma or sigma_h,sigma_v (standard deviations in metres, else estimated). With
    /// seconds in place of image, and in GPX, times are of a clock of their own: its offset from
    /// that of the photos is estimated, and where the antenna is. The model is then in metres, x
    /// east, y north, z up, and georeference.json has its origin. Positions with stated deviations
    /// also take part in the adjustments, if held-out ones say that it helps.
    #[arg(
        help_heading = "Input",
        long,
        value_name = "FILE",
        default_value = "auto",
        value_parser = position_priors
    )]
    pub(crate) position_priors: PositionPriors,
    /// Surveyed points with marks in photos: gcp_list.txt or CSV.
    ///
    /// The models are brought into their frame and adjusted together with them; positions of the
    /// photos are then not used. A point or mark that the others contradict is named and not used.
    /// Points whose names begin with CHK- are check points: their errors are reported only.
    /// gcp_list.txt is that of OpenDroneMap. A CSV file has a header with the columns point,
    /// lat,lon,alt (WGS 84) or x,y,z (metres, z up), image, px and py, and perhaps sigma or
    /// sigma_h,sigma_v (metres; 0.01 by default) and sigma_px (of the marks; 3 by default).
    #[arg(
        help_heading = "Input",
        long,
        value_name = "FILE",
        conflicts_with_all = ["baseline", "input_model"]
    )]
    pub(crate) control_points: Option<PathBuf>,
    /// Goes on from a model, and keeps its frame and scale.
    ///
    /// A folder with a COLMAP model, or a workspace. Its poses, intrinsics and points are initial
    /// values, and further photos are registered onto it. Its rigs are left out: all images have
    /// independent poses. Images are compared by name; those that the workspace lacks stay in the
    /// result.
    #[arg(help_heading = "Input", long, value_name = "MODEL")]
    pub(crate) input_model: Option<PathBuf>,
    /// With --input-model: its poses stay as they are.
    ///
    /// Its intrinsics stay, too, unless --refine is given. By default they are refined with the new
    /// ones.
    #[arg(help_heading = "Input", long, requires = "input_model")]
    pub(crate) fix_existing_frames: bool,
    /// Readout time of rolling shutters, as 16ms, or `estimate`.
    ///
    /// From the first row to the last. Needs capture times. By default a global shutter is assumed.
    #[arg(long, value_name = "16ms", value_parser = readout, allow_hyphen_values = true)]
    pub(crate) rolling_shutter: Option<Readout>,
    /// Maps parts of so many images apart, and assembles them: auto, off or a number.
    ///
    /// auto: 500 images, of sequences from 2,000 images on. Parts overlap; they are cut in the
    /// order of sequences, other images by what they see. Not with --rig-calibration,
    /// --input-model and --rig paper.
    #[arg(long, value_name = "IMAGES", default_value = "auto", value_parser = submaps)]
    pub(crate) submaps: Submaps,
    /// Memory for parts that are mapped at once, as 8GB [default: half of the free memory].
    ///
    /// The results do not depend on it.
    #[arg(
        help_heading = "Output",
        long,
        value_name = "SIZE",
        value_parser = memory,
        hide_short_help = true
    )]
    pub(crate) max_memory: Option<u64>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Output")]
pub(crate) struct Seed {
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u64,
}

#[derive(Debug, Args)]
pub(crate) struct Adjust {
    /// Folder with a COLMAP model, workspace, or BAL problem (a text file).
    #[arg(value_name = "MODEL|PROBLEM.txt")]
    pub(crate) model: PathBuf,
    /// Where to write the result; without it only the costs are printed.
    ///
    /// In the format of the input.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: Option<PathBuf>,
    /// Replaces a file at the place of the result, whoever made it.
    ///
    /// Inputs are never replaced, nor other files in a folder.
    #[arg(long, requires = "output")]
    pub(crate) overwrite: bool,
    /// Keeps all intrinsics fixed.
    ///
    /// Without it those of a calibration have a prior at their values, and those that mapping kept
    /// with --refine none stay fixed.
    #[arg(long)]
    pub(crate) fix_intrinsics: bool,
    /// Surveyed points that are marked in images, as of `reconstruct`.
    ///
    /// The model is brought into their frame and adjusted together with them. A point or mark that
    /// the others contradict is named and not used.
    #[arg(long, value_name = "FILE")]
    pub(crate) control_points: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Evaluate {
    /// Camera poses: ATE, rotation errors, relative-pose AUC, focal lengths.
    ///
    /// Position errors are those after Sim(3) alignment.
    Poses(EvaluatePoses),
    /// Point cloud: distances to a reference, as a laser scan.
    ///
    /// To the nearest points of the reference, after alignment.
    Cloud(EvaluateCloud),
    /// Surveyed points: errors of the model, which is in their frame.
    ///
    /// Each point is triangulated from its marks. The model is not changed.
    Points(EvaluatePoints),
}

#[derive(Debug, Args)]
pub(crate) struct EvaluatePoints {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
    /// Points with coordinates and marks, as --control-points of `reconstruct`.
    pub(crate) points: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateCloud {
    /// PLY, LAS or LAZ file, workspace, or folder with a COLMAP model.
    ///
    /// LAS and LAZ need a build with --features las.
    pub(crate) cloud: PathBuf,
    /// Reference cloud, in the same formats.
    pub(crate) reference: PathBuf,
    /// Alignment before distances are measured: similarity, rigid or none.
    ///
    /// similarity: initialised from the principal axes of both clouds, refined by ICP. rigid: ICP
    /// from the given coordinates. ICP with a free scale hides scale drift.
    #[arg(
        long,
        value_name = "FREEDOM",
        default_value = "similarity",
        value_parser = one_of(&Alignment::ALL, Alignment::name),
        hide_possible_values = true
    )]
    pub(crate) align: Alignment,
    /// Aligns by true camera poses in the frame of the reference.
    ///
    /// The cameras of a workspace are aligned to them; then rigid ICP refines, so that scale drift
    /// stays visible. FORMAT as in `evaluate poses`.
    #[arg(long, value_name = "FORMAT:PATH", conflicts_with = "align")]
    pub(crate) truth: Option<Truth>,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluatePoses {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
    /// True poses.
    ///
    /// FORMAT is strecha (a folder of .camera files), kitti (image number = line number from 0),
    /// tum (by time), colmap (a model).
    #[arg(long, value_name = "FORMAT:PATH")]
    pub(crate) truth: Truth,
    /// Compares only images whose names start with this prefix.
    ///
    /// By default all; for kitti and tum those of the first camera.
    #[arg(long, value_name = "PREFIX")]
    pub(crate) images: Option<String>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum ModelCommand {
    /// Prints cameras, counts, the mean reprojection error and the extent of the points.
    Info(ModelInfo),
    /// Applies a similarity transform to poses and points.
    Transform(TransformModel),
    /// Brings a model into the frame of another, or of camera positions.
    ///
    /// By a similarity transform that outliers do not affect. The other model has common images.
    Align(AlignModel),
    /// Keeps the points in a box, and the images that see one of them.
    Crop(CropModel),
    /// Adds the images and points of further models to the first one, in its frame.
    ///
    /// The models need common images with the same keypoints. Adjust the result with `adjust`.
    Merge(MergeModels),
}

#[derive(Debug, Args)]
pub(crate) struct ModelInfo {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct TransformModel {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
    /// Text file with the transform: scale qw qx qy qz tx ty tz.
    ///
    /// From the old frame to the new one, as COLMAP's model_transformer reads it.
    #[arg(long, value_name = "FILE")]
    pub(crate) by: PathBuf,
    /// Applies the inverse of the transform.
    #[arg(long)]
    pub(crate) inverse: bool,
    /// Folder for the new model, in the format of the old one.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: PathBuf,
}

/// Default threshold of the transfer error between two models, in pixels, as in COLMAP's
/// `align_reconstructions_via_reprojections`: drift is larger than the noise of keypoints.
const MAX_TRANSFER_ERROR_PX: f64 = 8.0;

#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("target").args(["to", "positions", "control_points"]).required(true)
)]
pub(crate) struct AlignModel {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
    /// The model whose frame the result has: folder or workspace.
    ///
    /// Points that the same keypoints of common images observe in both models are compared.
    #[arg(long, value_name = "MODEL")]
    pub(crate) to: Option<PathBuf>,
    /// File with camera positions: lines `name x y z`, or CSV.
    ///
    /// They are in the frame that the result has. A CSV file has the header image,lat,lon,alt (WGS
    /// 84, degrees and metres), after which x is east, y north and z up, or image,x,y,z (metres, z
    /// up).
    #[arg(long, value_name = "FILE", requires = "max_error")]
    pub(crate) positions: Option<PathBuf>,
    /// Maximum distance of a camera from its position, in the unit of the file.
    ///
    /// Of image,lat,lon,alt in metres. Images farther away are outliers.
    #[arg(long, value_name = "DISTANCE", value_parser = positive, requires = "positions")]
    pub(crate) max_error: Option<f64>,
    /// Points with coordinates and marks, as of `reconstruct`; the model keeps its shape.
    ///
    /// A point that the others contradict is named and not used; names that begin with CHK- are
    /// check points, whose errors are printed only.
    #[arg(long, value_name = "FILE")]
    pub(crate) control_points: Option<PathBuf>,
    /// With --to: maximum error of a point in the other model's images, in pixels.
    #[arg(
        long,
        value_name = "PX",
        value_parser = positive,
        default_value_t = MAX_TRANSFER_ERROR_PX
    )]
    pub(crate) max_error_px: f64,
    /// Folder for the new model, in the format of the old one.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: PathBuf,
    /// Also writes the transform to this file, for `model transform`.
    #[arg(long, value_name = "FILE")]
    pub(crate) save_transform: Option<PathBuf>,
    /// Replaces the file of --save-transform, whoever made it.
    ///
    /// Inputs are never replaced.
    #[arg(long, requires = "save_transform")]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("region").args(["bounds", "quantiles"]).required(true))]
pub(crate) struct CropModel {
    /// Folder with a COLMAP model, or workspace.
    pub(crate) model: PathBuf,
    /// The box, in units of the model.
    #[arg(long = "box", value_name = "x1,y1,z1,x2,y2,z2", allow_hyphen_values = true)]
    pub(crate) bounds: Option<CropBox>,
    /// The box between two quantiles of the points, as 0.01,0.99.
    ///
    /// Of each coordinate, from 0 to 1.
    #[arg(long, value_name = "q1,q2", allow_hyphen_values = true)]
    pub(crate) quantiles: Option<Quantiles>,
    /// Folder for the new model, in the format of the old one.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct MergeModels {
    /// Folders with COLMAP models, or workspaces; two or more.
    #[arg(required = true, num_args = 2.., value_name = "MODEL")]
    pub(crate) models: Vec<PathBuf>,
    /// Maximum reprojection error, in pixels.
    ///
    /// Of a point in the images of the other model, and of the observations of merged points.
    #[arg(
        long,
        value_name = "PX",
        value_parser = positive,
        default_value_t = MAX_TRANSFER_ERROR_PX
    )]
    pub(crate) max_error_px: f64,
    /// Folder for the new model, in the format of the first one.
    #[arg(short, long = "output", value_name = "OUT")]
    pub(crate) output: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Export {
    /// Workspace, or folder with a COLMAP model.
    pub(crate) workspace: PathBuf,
    /// Format: colmap, ply, gltf, nerfstudio, gsplat, openmvs, ... (--help has all).
    ///
    /// colmap or colmap-text (a folder), ply (point cloud), las (the dense cloud of a workspace, as
    /// LAS or LAZ by the extension; needs a build with the feature las), gltf (binary, .glb:
    /// points, dense cloud and cameras for 3D viewers), tum or kitti (trajectory of the first
    /// camera), bal, openmvs (a folder with scene.mvs and undistorted images), nerfstudio (a folder
    /// with transforms.json, images and cloud), 3dgs-deblur (the same with the velocities and the
    /// readout time of rolling shutters), gsplat (a folder with the photos, sparse/0 with the
    /// detected keypoints, and rolling_shutter.json with viewmats of first and last rows), kalibr
    /// (camchain.yaml with extrinsics and time offsets of the rig), geojson or gpx (the paths of
    /// the cameras of a georeferenced model on WGS 84, for maps), csv (image,x,y,z: the centres of
    /// the cameras, as --position-priors takes them). Trainers that want PINHOLE images, as Brush
    /// and LichtFeld, take the folder of `undistort`.
    #[arg(
        long,
        value_name = "FORMAT",
        value_parser = one_of(&ExportFormat::ALL, ExportFormat::name),
        hide_possible_values = true
    )]
    pub(crate) to: ExportFormat,
    /// The file or folder to write.
    #[arg(short, long = "output", value_name = "PATH")]
    pub(crate) output: PathBuf,
    /// Replaces a file at the place of the result, whoever made it.
    ///
    /// Inputs are never replaced, nor other files in a folder.
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Coordinates in this system, as EPSG:32632, of a georeferenced model.
    ///
    /// For ply, las and csv; by default they are in the frame of the model. EPSG:4326 and EPSG:4979
    /// (WGS 84: longitude, latitude, height), EPSG:4978 (ECEF), EPSG:32601 to 32660 and 32701 to
    /// 32760 (UTM on WGS 84), EPSG:25828 to 25838 (UTM on ETRS89, taken as equal to WGS 84).
    /// Heights are above the ellipsoid. LAS files state the system.
    #[arg(long, value_name = "CODE", conflicts_with = "rigid")]
    pub(crate) crs: Option<Crs>,
    /// The folder that the names of the model's images are relative to.
    ///
    /// By default the photos are the inputs of the workspace.
    #[arg(long, value_name = "DIR")]
    pub(crate) images: Option<PathBuf>,
    /// First adjusts the model with exact rig extrinsics.
    ///
    /// One sensor_from_rig per camera, whatever --rig it was mapped with. Writes rigs and frames,
    /// and prints the reprojection error before and after.
    #[arg(long)]
    pub(crate) rigid: bool,
    /// Writes the keypoints as they were detected in the photos.
    ///
    /// As database.db has them. By default those of the model, which with --rolling-shutter are
    /// where a global shutter would have seen them. gsplat always gets the detected ones.
    #[arg(long, conflicts_with = "rigid")]
    pub(crate) detected_keypoints: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Undistort {
    /// Workspace, or folder with a COLMAP model.
    pub(crate) model: PathBuf,
    /// Output folder.
    ///
    /// Files of an earlier run are replaced, others never.
    #[arg(short, long = "output", value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// The folder that the names of the model's images are relative to.
    ///
    /// By default the photos are the inputs of the workspace.
    #[arg(long, value_name = "DIR")]
    pub(crate) images: Option<PathBuf>,
    /// Folder with a mask for each photo, left/1.jpg.png for left/1.jpg.
    ///
    /// Writes masks of all undistorted images, black where the mask is black and where a pixel has
    /// no source.
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Writes the keypoints that were detected in the photos.
    ///
    /// By default those of the model, which with --rolling-shutter are where a global shutter would
    /// have seen them.
    #[arg(long)]
    pub(crate) detected_keypoints: bool,
    /// Also writes images at fractions of the size, as 2,4,8.
    ///
    /// With their masks, rounded down: 2,4,8 gives images_2, images_4 and images_8.
    #[arg(
        long,
        value_name = "N,..",
        value_delimiter = ',',
        value_parser = downscale
    )]
    pub(crate) downscale: Vec<u32>,
    /// Blank pixels: 0 none, 1 as many as all pixels of the photo need.
    #[arg(long, value_name = "SHARE", default_value_t = UndistortOptions::default().blank_pixels)]
    pub(crate) blank_pixels: f64,
    /// Smallest size of the undistorted images, relative to the photos.
    #[arg(long, value_name = "SCALE", default_value_t = UndistortOptions::default().min_scale)]
    pub(crate) min_scale: f64,
    /// Largest size of the undistorted images, relative to the photos.
    #[arg(long, value_name = "SCALE", default_value_t = UndistortOptions::default().max_scale)]
    pub(crate) max_scale: f64,
    /// Reduces the undistorted images to this width and height at most, in pixels.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_size: Option<u32>,
}

#[derive(Debug, Args)]
pub(crate) struct View {
    /// Workspace, or folder with a COLMAP model.
    pub(crate) workspace: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Synth {
    /// Output folder; it must be new, empty, or from the same command.
    ///
    /// It gets left/, right/, timestamps.csv and truth/, of a collection photos/ and truth/.
    #[arg(short, long = "output", value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Renders no drive but photos of three cameras in no order.
    ///
    /// Of an object on a table, of a room from inside, of streets from a drone, of the facades of a
    /// street, of two identical houses (twins; twins-apart has no photos between them).
    #[arg(
        long,
        value_name = "KIND",
        value_parser = one_of(&CollectionKind::ALL, CollectionKind::name),
        conflicts_with_all = [
            "frames", "size", "rate", "route", "carrier", "length", "view_direction", "effects",
            "scan", "depths"
        ]
    )]
    pub(crate) collection: Option<CollectionKind>,
    /// Number of photos of the collection.
    #[arg(long, value_name = "N", default_value_t = 80, requires = "collection")]
    pub(crate) photos: usize,
    /// Renders only the first N images of each camera; by default the whole drive.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    pub(crate) size: ImageSize,
    /// Seed of the street, the drive and all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Images per second of each camera.
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    pub(crate) rate: f64,
    /// Route: loop, open or highway.
    ///
    /// loop: around a block, back to the start and a little further. open: one way. highway:
    /// straight at 24 to 30 m/s, with little beside it.
    #[arg(
        long,
        value_name = "ROUTE",
        default_value = "loop",
        value_parser = one_of(&RouteKind::ALL, RouteKind::name),
        hide_possible_values = true
    )]
    pub(crate) route: RouteKind,
    /// What carries the cameras: car, handheld or drone.
    ///
    /// handheld: at walking pace on the pavement. drone: above the roofs, looking obliquely down.
    #[arg(
        long,
        value_name = "CARRIER",
        default_value = "car",
        value_parser = one_of(&Carrier::ALL, Carrier::name),
        hide_possible_values = true
    )]
    pub(crate) carrier: Carrier,
    /// Length of the street, in metres.
    #[arg(long, value_name = "M", default_value_t = 200.0)]
    pub(crate) length: f64,
    /// Viewing direction: front, front-right, right, rear or left.
    ///
    /// Of both cameras, half a metre apart.
    #[arg(
        long,
        value_name = "DIRECTION",
        default_value = "front",
        value_parser = one_of(&ViewDirection::ALL, ViewDirection::name),
        hide_possible_values = true
    )]
    pub(crate) view_direction: ViewDirection,
    /// Imperfections to simulate: none, all, or names joined by +.
    ///
    /// lens, rolling-shutter, vibration, misalignment, traffic, clocks, photometry and lens-field
    /// (a smooth displacement of 0.15 px that no camera model describes; not in all).
    #[arg(long, value_name = "NAMES", default_value = "none")]
    pub(crate) effects: Effects,
    /// Also writes the cloud of a laser scanner, truth/scan.ply.
    ///
    /// The scanner is on the roof. The cloud is for `evaluate cloud`.
    #[arg(long)]
    pub(crate) scan: bool,
    /// Also writes the true depth maps, truth/depth_maps.
    ///
    /// The true depth of each pixel centre as a depth map of COLMAP; 0 on the sky and on moving
    /// cars.
    #[arg(long)]
    pub(crate) depths: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Demo {
    /// Output folder.
    ///
    /// The same command resumes an interrupted run.
    #[arg(short, long = "output", value_name = "DIR", default_value = "tiepoint-demo")]
    pub(crate) output: PathBuf,
    /// Renders at most the first N images of each camera of each drive.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "560x420")]
    pub(crate) size: ImageSize,
    /// Seed of the streets and all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Experiment {
    /// Experiment I: one camera that looks front, right, rear and left in turn.
    Mounting(Scenery),
    /// Experiment II: two cameras, with and without a rig constraint.
    ///
    /// They are half a metre apart and look to the right.
    Baseline {
        #[command(flatten)]
        scenery: Scenery,
        /// Rig constraints to compare, a row each: off, paper, soft, rigid, auto.
        #[arg(
            long,
            value_name = "MODES",
            value_delimiter = ',',
            default_value = "off,paper,auto",
            value_parser = rig_mode(),
            hide_possible_values = true
        )]
        rig: Vec<RigMode>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct Scenery {
    /// Output folder.
    ///
    /// The same command resumes an interrupted run.
    #[arg(short, long = "output", value_name = "DIR", default_value = "tiepoint-experiment")]
    pub(crate) output: PathBuf,
    /// Renders only the first N images of each camera; by default the whole drive.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<NonZeroUsize>,
    /// Size of the images, in pixels.
    #[arg(long, value_name = "WxH", default_value = "400x300")]
    pub(crate) size: ImageSize,
    /// Seed of the street, the drive and all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Images per second of each camera.
    #[arg(long, value_name = "HZ", default_value_t = 2.5)]
    pub(crate) rate: f64,
    /// Course of the street: loop or open, as in `synth`.
    #[arg(
        long,
        value_name = "ROUTE",
        default_value = "loop",
        value_parser = one_of(&[RouteKind::Loop, RouteKind::Open], RouteKind::name),
        hide_possible_values = true
    )]
    pub(crate) route: RouteKind,
    /// Length of the route, in metres.
    #[arg(long, value_name = "M", default_value_t = 160.0)]
    pub(crate) length: f64,
    /// Imperfections to simulate, as in `synth`.
    #[arg(long, value_name = "NAMES", default_value = "all")]
    pub(crate) effects: Effects,
    /// Image pairs to match, as in `match`.
    #[arg(long, value_name = "SELECTION", default_value = "sequential:6+ends")]
    pub(crate) pairs: PairSelection,
    /// Compares the sparse clouds only.
    #[arg(long)]
    pub(crate) no_dense: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Completions {
    /// The shell.
    pub(crate) shell: Shell,
}

#[derive(Debug, Args)]
pub(crate) struct Man {
    /// The command, as `map` or `model crop`; by default the page of the program itself.
    #[arg(value_name = "COMMAND")]
    pub(crate) command: Vec<String>,
}

impl Cameras {
    /// The calibration that --intrinsics, --focal-prior and --camera-model give.
    ///
    /// # Errors
    ///
    /// The number or the values of the intrinsics do not fit the camera model.
    pub(crate) fn initial(&self) -> Result<Calibration, String> {
        initial_calibration(self.intrinsics.as_ref(), self.focal_prior, self.camera_model)
    }
}

impl Localize {
    /// [`Cameras::initial`] of the photos.
    ///
    /// # Errors
    ///
    /// The number or the values of the intrinsics do not fit the camera model.
    pub(crate) fn initial(&self) -> Result<Calibration, String> {
        initial_calibration(self.intrinsics.as_ref(), self.focal_prior, self.camera_model)
    }
}

fn initial_calibration(
    intrinsics: Option<&NumberList>,
    focal_prior: Option<PositivePixels>,
    camera_model: Option<CameraModelKind>,
) -> Result<Calibration, String> {
    let Some(NumberList(params)) = intrinsics else {
        let focal_px = focal_prior.map(|focal| focal.0);
        return Ok(Calibration::Unknown { model: camera_model, focal_px });
    };
    let intrinsics = match (camera_model, params.len()) {
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
                    fx,fy,cx,cy,k1,k2,p1,p2, or --camera-model NAME and its parameters"
            ));
        }
    };
    intrinsics.map(Calibration::Known).map_err(|error| format!("--intrinsics: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clap_accepts_the_definitions() {
        <Cli as clap::CommandFactory>::command().debug_assert();
    }

    /// Values of a fixed set that an option takes, by what clap tells completions.
    fn values_of(command: &str, option: &str) -> Vec<String> {
        let mut cli = <Cli as clap::CommandFactory>::command();
        let command = cli.find_subcommand_mut(command).unwrap();
        let arg = command.get_arguments().find(|arg| arg.get_long() == Some(option)).unwrap();
        arg.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect()
    }

    #[test]
    fn completions_know_the_values_of_fixed_sets() {
        for (command, option, some) in [
            ("reconstruct", "rig", "rigid"),
            ("reconstruct", "redo", "match"),
            ("features", "cameras", "single"),
            ("features", "camera-model", "OPENCV_FISHEYE"),
            ("export", "to", "3dgs-deblur"),
            ("synth", "route", "open"),
            ("synth", "carrier", "drone"),
            ("synth", "view-direction", "front-right"),
        ] {
            let values = values_of(command, option);
            assert!(values.iter().any(|value| value == some), "--{option}: {values:?}");
        }
        let parse = |rig: &str| {
            let words = ["tiepoint", "map", "ws", "--rig", rig];
            match Cli::try_parse_from(words).ok()?.command {
                Command::Map(map) => Some(map.mapping.rig),
                _ => None,
            }
        };
        assert!(RigMode::ALL.into_iter().all(|mode| parse(mode.name()) == Some(mode)));
        assert_eq!((parse("hard"), parse("loose")), (Some(RigMode::Rigid), None));
    }

    fn calibration(intrinsics: &str, model: Option<&str>) -> Result<Calibration, String> {
        Cameras {
            cameras: CameraGrouping::Auto,
            calibration: Vec::new(),
            intrinsics: Some(intrinsics.parse()?),
            focal_prior: None,
            camera_model: model
                .map(|name| CameraModelKind::from_name(&name.to_uppercase()).unwrap()),
        }
        .initial()
    }

    #[test]
    fn number_of_intrinsics_determines_the_camera_model() {
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
        assert!(calibration("9,8,x,6", None).unwrap_err().contains("'x' is not a number"));
    }
}
