use std::path::PathBuf;

use crate::Stage;

/// Paths in one line.
fn listed(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// Why a run could not go on. Each message is one sentence that says what, where and what to do;
/// what earlier stages made is kept.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The workspace cannot be written.
    #[error("cannot write {path}: {cause}; choose a place where files can be written")]
    Output {
        /// Which file or folder.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Something that is there cannot be read.
    #[error("cannot read {path}: {cause}")]
    Unreadable {
        /// Which file or folder.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Another process is at work in it.
    #[error("{path} is in use by another run: wait for it to end, or choose another workspace")]
    InUse {
        /// The workspace.
        path: PathBuf,
    },
    /// Not a workspace.
    #[error("{path} is no workspace: make one with `tiepoint features INPUT -o {path}`")]
    NoWorkspace {
        /// The folder.
        path: PathBuf,
    },
    /// A COLMAP project of somebody else.
    #[error(
        "{path} holds {found}, and this program did not make it: choose another folder for the \
        workspace, or move {found} away"
    )]
    ForeignWorkspace {
        /// The folder.
        path: PathBuf,
        /// What is there.
        found: String,
    },
    /// A file of the workspace is not what this program writes.
    #[error("{path}: {what}; delete it to begin anew")]
    Broken {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The record of the stages is damaged, and no database tells what they were made from.
    #[error(
        "{path} is damaged ({what}), and nothing else tells what the workspace was made from: \
        choose another workspace, or move all \
         of this one's files away"
    )]
    BrokenRecord {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The database is damaged.
    #[error("{cause}: give --redo features to make {path} anew")]
    BrokenDatabase {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        cause: Box<tiepoint_io::Error>,
    },
    /// A file is in the way that is not this program's.
    #[error(
        "{path} is there, and this program did not make it, or somebody has changed it since: \
        move it away, or choose another place"
    )]
    NotOurs {
        /// Which file.
        path: PathBuf,
    },
    /// Results of before were written and could not all be moved to their places.
    #[error(
        "not all results of before are in their places in {path} yet: give the same command \
        again, which ends that first"
    )]
    Unfinished {
        /// The folder.
        path: PathBuf,
    },
    /// The result would be written onto an input.
    #[error(
        "{path} is read by this command, so the result cannot be written there: choose another \
        place"
    )]
    IsInput {
        /// Which file.
        path: PathBuf,
    },
    /// A name that leads out of the folder of the results.
    #[error("the name {name:?} leads out of {path}: rename the image")]
    NotInside {
        /// The folder.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// The models are those of other matches, or were about to be replaced.
    #[error(
        "the models in {path} were made before its features or matches were made anew: run \
        `tiepoint map {path}`, or give \
         {path}/sparse/0 to take them as they are"
    )]
    StaleModels {
        /// The workspace.
        path: PathBuf,
    },
    /// The times of the images are not those that the first stage wrote.
    #[error(
        "{path} has been changed or removed since it was written: move it away, and give your \
        times to `tiepoint features` with \
         --timestamps FILE.csv --redo features, from a file outside the workspace"
    )]
    ChangedTimes {
        /// The file.
        path: PathBuf,
    },
    /// A stage is missing on which the asked one builds.
    #[error("{path} has no {products} yet: run `tiepoint {stage}` \
    first", products = stage.products())]
    Missing {
        /// The workspace.
        path: PathBuf,
        /// What is missing.
        stage: Stage,
    },
    /// No rig was found, or none was looked for.
    #[error(
        "{path} is not there, since this model's cameras are not held to each other: map with \
        --rig soft, hard or auto"
    )]
    NoRig {
        /// The file.
        path: PathBuf,
    },
    /// Nothing to hold rigidly.
    #[error(
        "{path} has no two cameras with poses at common moments, so no rig can be made of it: \
        leave out --rigid"
    )]
    NothingRigid {
        /// The model.
        path: PathBuf,
    },
    /// A format without poses has nothing to be made rigid.
    #[error("{path} would hold the rig's calibration alone, as rig.json has it: leave out --rigid")]
    NoPoses {
        /// The file.
        path: PathBuf,
    },
    /// The stage was made from something else, or in another way.
    #[error(
        "the {products} in {path} were made {how}: give --redo {stage} to make them anew, or \
        choose another workspace",
        products = stage.products()
    )]
    Changed {
        /// The workspace.
        path: PathBuf,
        /// Which stage.
        stage: Stage,
        /// What differs.
        how: String,
    },
    /// Too little to reconstruct.
    #[error(
        "{path} gives {usable} usable photo{s} of {found}: at least two that overlap are \
        needed{also}",
        s = if *usable == 1 { "" } else { "s" },
        also = skipped.first().map_or_else(String::new, |why| format!("; {} skipped, first \
        {why}", skipped.len()))
    )]
    TooFewPhotos {
        /// The input.
        path: PathBuf,
        /// Photos found.
        found: usize,
        /// Photos that could be read.
        usable: usize,
        /// Files that are named like photos and are none that could be used: why, one sentence for
        /// each.
        skipped: Vec<String>,
    },
    /// Photos beside videos.
    #[error(
        "{photos} holds photos and {video} is a video: give folders of photos or videos, not both"
    )]
    MixedInput {
        /// An input that is no video and holds none.
        photos: PathBuf,
        /// A video.
        video: PathBuf,
    },
    /// Two videos would be one camera.
    #[error("two videos are called {name}: rename one, each is a camera of its own")]
    TwoVideosOfOneName {
        /// Name without folder and ending.
        name: String,
    },
    /// The frames in the workspace are not those of these videos.
    #[error(
        "{path} holds the frames of other videos, or another choice of them: give --redo features \
        to take them anew, or choose another \
         workspace"
    )]
    OtherFrames {
        /// The folder of the frames.
        path: PathBuf,
    },
    /// One camera has one size.
    #[error(
        "the photos of camera {camera} have different sizes, {first} is {first_size} and {other} \
        is {other_size}: put them into one folder \
         for each camera"
    )]
    TwoSizes {
        /// The folder.
        camera: String,
        /// A photo.
        first: String,
        /// Its size in pixels.
        first_size: Size,
        /// Another one.
        other: String,
        /// Its size in pixels.
        other_size: Size,
    },
    /// A list of times that does not fit.
    #[error("{path}: {what}")]
    Times {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// No pair of images has a common view.
    #[error(
        "none of the {pairs} pairs of photos in {path} shows the same things: at least {required} \
        matches must agree with each other, \
         and the best pair has {best} in all; take photos that overlap more{or}",
        or = from_exif.map_or_else(String::new, |(focal_px, size)| format!(
            ", or give --focal-prior PX --redo features if the focal length in their EXIF data, \
            {focal_px:.0} pixels for {size}, is wrong"
        ))
    )]
    NoOverlap {
        /// The workspace.
        path: PathBuf,
        /// Pairs that were tried.
        pairs: usize,
        /// Matches of the best of them.
        best: usize,
        /// How many are asked for.
        required: usize,
        /// Focal length in pixels and size of a camera of which EXIF data tell one.
        from_exif: Option<(f64, Size)>,
    },
    /// A rig term without moments.
    #[error(
        "--rig asks for cameras that ride together, and in {path} no two of {cameras} cameras \
        took images at the same moments: put the \
         photos of each camera into a folder of its own, give their times to `tiepoint features` \
         with --timestamps FILE.csv, or \
         choose --rig off"
    )]
    NoMoments {
        /// The workspace.
        path: PathBuf,
        /// Cameras in it.
        cameras: usize,
    },
    /// A rolling shutter without times.
    #[error(
        "--rolling-shutter asks how the cameras move while they take a photo, and in {path} no \
        camera has four photos of which the times are known: \
         give their times to `tiepoint features` with --timestamps FILE.csv, or leave the option \
         out"
    )]
    NoMotion {
        /// The workspace.
        path: PathBuf,
    },
    /// A trajectory with times of images without.
    #[error(
        "no image with a pose in {model} has a time: give times to `tiepoint features` with \
        --timestamps FILE.csv"
    )]
    NoTimes {
        /// The model.
        model: PathBuf,
    },
    /// A model and a truth that cannot be compared.
    #[error("cannot compare {model} with {truth}: {why}")]
    Evaluation {
        /// The model.
        model: PathBuf,
        /// The truth.
        truth: PathBuf,
        /// Why.
        why: String,
    },
    /// A format that goes with its photos, of a model that does not know them.
    #[error(
        "{path} is no workspace, and this format needs the photos: export from the workspace that \
        the model was made in"
    )]
    NoPhotos {
        /// What was to be exported.
        path: PathBuf,
    },
    /// A photo is gone.
    #[error("the photo {image} is no longer in {}: put it back", listed(inputs))]
    NoPhoto {
        /// Its name.
        image: String,
        /// Where the photos were.
        inputs: Vec<PathBuf>,
    },
    /// Clouds that cannot be laid on each other.
    #[error(
        "cannot compare {cloud} with {reference}: one of them has fewer than three points that \
        are not on a line"
    )]
    Clouds {
        /// The cloud.
        cloud: PathBuf,
        /// The reference.
        reference: PathBuf,
    },
    /// LAS needs a feature.
    #[error(
        "{path} is a LAS file, which this build does not read: build with --features las, or \
        convert it to PLY"
    )]
    NoLas {
        /// The file.
        path: PathBuf,
    },
    /// A file of another format.
    #[error(transparent)]
    File(#[from] tiepoint_io::Error),
    /// An option of the detector, or an image that contradicts itself.
    #[error(transparent)]
    Features(#[from] tiepoint_io::features::Error),
    /// An option of matching.
    #[error(transparent)]
    Matching(#[from] tiepoint_sfm::matching::Error),
    /// The mapper.
    #[error(transparent)]
    Mapping(tiepoint_sfm::Error),
    /// The caller's callback asked to stop.
    #[error("stopped on request")]
    Cancelled,
}

impl From<tiepoint_sfm::Error> for Error {
    fn from(error: tiepoint_sfm::Error) -> Self {
        match error {
            tiepoint_sfm::Error::Cancelled => Self::Cancelled,
            error => Self::Mapping(error),
        }
    }
}

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub u32, pub u32);

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {}", self.0, self.1)
    }
}
