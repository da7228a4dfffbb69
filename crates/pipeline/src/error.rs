use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use tiepoint_input::Size;
use tiepoint_io::features::DescriptorFormat;
use tiepoint_sfm::geometry::crs::Crs;

use crate::{Shard, Stage};

fn comma_separated(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn format_name(format: Option<u64>) -> String {
    let number = |format| format!("format {format}");
    format.map_or_else(|| "the format of a version before 0.1.0".to_owned(), number)
}

/// Why a call failed. Each message is one sentence: what failed, on which file, and what to do.
/// Results of earlier stages stay on disk.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The photos, videos or calibrations of the input do not do.
    #[error(transparent)]
    Input(#[from] tiepoint_input::Error),
    /// A file of the results cannot be read or written, or is somebody else's.
    #[error(transparent)]
    Store(#[from] tiepoint_store::Error),
    /// The folder is not a workspace.
    #[error("{path} is not a workspace: make one of photos by `stage.features`")]
    NoWorkspace {
        /// The folder.
        path: PathBuf,
    },
    /// The folder holds files of a COLMAP project that this program did not write.
    #[error(
        "{path} holds {found}, and this program did not make it: choose another folder for the \
        workspace, or move {found} away"
    )]
    ForeignWorkspace {
        /// The folder.
        path: PathBuf,
        /// Name of the foreign file in it.
        found: String,
    },
    /// A file of the workspace does not have the content that this program writes.
    #[error("{path}: {what}; delete it to start again")]
    Broken {
        /// The file.
        path: PathBuf,
        /// The defect.
        what: String,
    },
    /// The record of the stages is damaged, and there is no database to restore it from.
    #[error(
        "{path} is damaged ({what}), and there is no database.db to restore it from: choose \
        another workspace, or move all files of this one away"
    )]
    BrokenRecord {
        /// The file.
        path: PathBuf,
        /// The defect.
        what: String,
    },
    /// Another version of the program wrote a file of the workspace.
    #[error(
        "{path} has {}, and this version reads format {known}: use the version that wrote it, or \
        make the workspace again in another folder",
        format_name(*found)
    )]
    OtherFormat {
        /// The file.
        path: PathBuf,
        /// Its format; `None` for one of before 0.1.0.
        found: Option<u64>,
        /// The format that is read.
        known: u64,
    },
    /// The database is damaged.
    #[error("{cause}: give `stage.redo` features to make {path} again")]
    BrokenDatabase {
        /// The file.
        path: PathBuf,
        /// The defect.
        cause: Box<tiepoint_io::Error>,
    },
    /// No two registered images of the model share points, so that there is nothing to match.
    #[error(
        "no two of the {images} registered images of {path} share enough points for a depth map: \
        run `stage.map` with images that overlap"
    )]
    NothingDense {
        /// The model.
        path: PathBuf,
        /// Number of registered images.
        images: usize,
    },
    /// An image cannot be used for dense reconstruction.
    #[error("{path}: {cause}")]
    Dense {
        /// The image.
        path: PathBuf,
        /// The reason.
        cause: tiepoint_dense::Error,
    },
    /// A workspace was not mapped, or without success.
    #[error("{path} is a workspace that holds no COLMAP model: run `stage.map` first")]
    NoModelYet {
        /// The workspace.
        path: PathBuf,
    },
    /// A folder has a folder for each model.
    #[error("{path} holds no COLMAP model, but one in each of its folders: give one, as {model}")]
    SeveralModels {
        /// The folder.
        path: PathBuf,
        /// The first model.
        model: PathBuf,
    },
    /// The models were computed from features or matches that have been replaced.
    #[error(
        "the models in {path} were made before its current features or matches: run `stage.map` \
        again, or give {path}/sparse/0 to use the old models"
    )]
    StaleModels {
        /// The workspace.
        path: PathBuf,
    },
    /// The capture times are not those that the feature stage wrote.
    #[error(
        "{path} has been changed or removed since it was written: move it away, and give your \
        times to `stage.features` with `features.timestamps` FILE.csv `stage.redo` features, \
        from a file outside the workspace"
    )]
    ChangedTimes {
        /// The file.
        path: PathBuf,
    },
    /// An earlier stage, which this one needs, is not complete.
    #[error("{path} has no {products} yet: run `stage.{stage}` \
    first", products = stage.products())]
    Missing {
        /// The workspace.
        path: PathBuf,
        /// The missing stage.
        stage: Stage,
    },
    /// The model has no rig: mapping estimated no rig extrinsics.
    #[error(
        "{path} has no rig, because it was mapped without rig extrinsics: map with `mapper.rig` \
        soft, rigid or auto"
    )]
    NoRig {
        /// The folder of the model.
        path: PathBuf,
    },
    /// No two cameras have poses at common frames, so that rig extrinsics are undetermined.
    #[error(
        "{path} has no two cameras with poses at common frames, so no rig can be made of it: \
        leave out `export.rigid`"
    )]
    NoRigFrames {
        /// The model.
        path: PathBuf,
    },
    /// `--rigid` was given with a format that holds no poses.
    #[error(
        "{path} would hold the rig's calibration only, as in rig.json: leave out \
    `export.rigid`"
    )]
    NoPoses {
        /// The file.
        path: PathBuf,
    },
    /// `--rigid` was given with a format on the earth.
    #[error(
        "exact rig extrinsics move the cameras of {model} and leave its frame on the earth: leave \
        out `export.rigid`"
    )]
    RigidHasNoPlace {
        /// The model.
        model: PathBuf,
    },
    /// The stage on disk was computed from another input or with other options.
    #[error(
        "the {products} in {path} were made {how}: give `stage.redo` {stage} to make them again, \
        or choose another workspace",
        products = stage.products()
    )]
    Changed {
        /// The workspace.
        path: PathBuf,
        /// The stage.
        stage: Stage,
        /// The difference, as the end of the sentence "they were made …".
        how: String,
    },
    /// Some shards of a stage have no tile.
    #[error(
        "{path} has {there} tiles of {products}, and that of shard {shard} is missing or was \
        interrupted: run that shard of `stage.{stage}`, or delete the folder to do without shards",
        products = stage.products()
    )]
    MissingShard {
        /// The folder of the tiles.
        path: PathBuf,
        /// The stage.
        stage: Stage,
        /// The first shard without a tile.
        shard: Shard,
        /// The number of tiles.
        there: usize,
    },
    /// A stage has tiles of two numbers of shards.
    #[error(
        "{path} has tiles of {products} of {} and of {} shards: delete those of one of the two",
        counts[0],
        counts[1],
        products = stage.products()
    )]
    TwoDivisions {
        /// The folder of the tiles.
        path: PathBuf,
        /// The stage.
        stage: Stage,
        /// Two numbers of shards.
        counts: [usize; 2],
    },
    /// A tile is damaged, or not that of this shard and these options.
    #[error(
        "{path} {why}: give the options of all shards, or delete it and run shard {shard} of \
        `stage.{stage}` again"
    )]
    Tile {
        /// The tile.
        path: PathBuf,
        /// The stage.
        stage: Stage,
        /// The shard.
        shard: Shard,
        /// The defect, as the end of the sentence "the tile …".
        why: String,
    },
    /// Sub-maps are asked for, and the images are one map.
    #[error(
        "{path} is mapped as one map: it has too few images for sub-maps of this size, or \
        `mapper.submaps` is off; run `stage.map` alone"
    )]
    NoSubmaps {
        /// The workspace.
        path: PathBuf,
    },
    /// There is no sub-map of this number.
    #[error("{path} has sub-maps 1 to {count}, and none of number {number}")]
    NoSubmap {
        /// The workspace.
        path: PathBuf,
        /// The number.
        number: NonZeroUsize,
        /// How many there are.
        count: usize,
    },
    /// The first sub-map, with whose intrinsics the others begin, is not there.
    #[error("{path} has no sub-map 1, with whose intrinsics the others begin: map it first")]
    MissingFirstSubmap {
        /// The workspace.
        path: PathBuf,
    },
    /// Pairs that came with a database are to be matched in shards.
    #[error(
        "the pairs of {path} came with its database, and verifying them is no work for shards: run \
        `stage.match` without shards, or give `stage.redo` match to match its images anew"
    )]
    ImportedPairs {
        /// The workspace.
        path: PathBuf,
    },
    /// Videos are to be read in shards.
    #[error(
        "{path} is a video, and shards are of photos: run `stage.features` without shards, which \
        writes its frames"
    )]
    ShardOfVideo {
        /// The video.
        path: PathBuf,
    },
    /// The frames in the workspace come from other videos or another `--every`.
    #[error(
        "{path} holds frames of other videos or with another `features.every`: give `stage.redo` \
        features to extract them again, or choose another workspace"
    )]
    OtherFrames {
        /// The folder of the frames.
        path: PathBuf,
    },
    /// A command on a database or a model of COLMAP does not fit what is there.
    #[error("{path}: {what}")]
    Colmap {
        /// The file or folder.
        path: PathBuf,
        /// The contradiction, and what to do.
        what: String,
    },
    /// A file of capture times does not fit the photos.
    #[error("{path}: {what}")]
    Times {
        /// The file.
        path: PathBuf,
        /// The defect.
        what: String,
    },
    /// No image pair has a verified two-view geometry.
    #[error(
        "none of the {pairs} pairs of photos in {path} overlaps: a pair needs at least {required} \
        matches that fit a two-view geometry, and the best pair has {best} matches in total; take \
        photos that overlap more{or}",
        or = from_exif.map_or_else(String::new, |(focal_px, size)| format!(
            ", or give `features.focal_prior` PX `stage.redo` features if the focal length in \
            their EXIF data, {focal_px:.0} pixels for {size}, is wrong"
        ))
    )]
    NoOverlap {
        /// The workspace.
        path: PathBuf,
        /// Number of pairs that were matched.
        pairs: usize,
        /// Largest number of matches of a pair.
        best: usize,
        /// Number of inliers that a pair needs.
        required: usize,
        /// Focal length in pixels from EXIF and image size in pixels of a camera that has one.
        from_exif: Option<(f64, Size)>,
    },
    /// The images do not determine a depth: the camera only turned, or all points are on a plane.
    #[error(
        "the photos in {path} give no model: {turned} of the {verified} pairs that match agree \
        with a camera that turned on one spot, so that no point has a depth; take photos from \
        different places, a tenth of the distance to the scene apart"
    )]
    OneSpot {
        /// The workspace.
        path: PathBuf,
        /// Number of pairs whose matches agree with a homography.
        turned: usize,
        /// Number of pairs with a two-view geometry.
        verified: usize,
    },
    /// No pair of images that was tried keeps points.
    #[error(
        "the photos in {path} give no model: of the {verified} pairs that match, {turned} agree \
        with a camera that turned on one spot, and no other keeps points with a depth; take photos \
        from different places that overlap more"
    )]
    NoModel {
        /// The workspace.
        path: PathBuf,
        /// Number of pairs whose matches agree with a homography.
        turned: usize,
        /// Number of pairs with a two-view geometry.
        verified: usize,
    },
    /// A similarity takes a model to numbers that are not finite.
    #[error(
        "cannot transform {path}: poses or points would not be finite numbers; check the scale and \
        the translation of the transform"
    )]
    TransformOverflows {
        /// The model.
        path: PathBuf,
    },
    /// A rig constraint was asked for, and there is one camera.
    #[error(
        "`mapper.rig` needs two cameras, and the images are of one, {camera}: put the photos of \
        each camera into a folder of its own, without `features.cameras` single, or choose \
        `mapper.rig` off"
    )]
    OneCamera {
        /// Its stream.
        camera: String,
    },
    /// A rig constraint was asked for, and no two cameras have synchronous images.
    #[error(
        "`mapper.rig` needs two cameras with images of the same times, and of the {cameras} \
        cameras of {path} no two have them: put the photos of each camera into a folder of its \
        own, without `features.cameras` single, give their times to `stage.features` with \
        `features.timestamps` FILE.csv, or choose `mapper.rig` off"
    )]
    NoSynchronousImages {
        /// The workspace.
        path: PathBuf,
        /// Number of cameras in it.
        cameras: usize,
    },
    /// An image has known intrinsics, and others in the input model.
    #[error(
        "the intrinsics of {image} are given, and the input model has others: run \
        `stage.features` without `features.intrinsics` and without `features.calibration` for \
        the photos of the model"
    )]
    TwoCalibrations {
        /// The first image.
        image: String,
    },
    /// The focal length is to be constant, and it is not known.
    #[error(
        "the focal length of {image} in {path} is not known, and `mapper.refine` does not list \
        focal: give it to `stage.features` with `features.calibration`, `features.intrinsics` or \
        `features.focal_prior`, or add focal to the list"
    )]
    UnknownFocal {
        /// The workspace.
        path: PathBuf,
        /// The first image of which it is not known.
        image: String,
    },
    /// A rolling shutter was asked for, and no camera has enough images with capture times.
    #[error(
        "`mapper.readout` needs the motion of the cameras, and in {path} no camera has four \
        photos with known capture times: give the times to `stage.features` with \
        `features.timestamps` FILE.csv, or leave the option out"
    )]
    NoTimedSequence {
        /// The workspace.
        path: PathBuf,
    },
    /// A format with times was asked for, and no registered image has a time.
    #[error(
        "no image with a pose in {model} has a time: give times to `stage.features` with \
        `features.timestamps` FILE.csv"
    )]
    NoTimes {
        /// The model.
        model: PathBuf,
    },
    /// A format that holds one pose a line was asked for, and poses are missing between others.
    #[error(
        "{model} has no poses of frames {frames}, and every later line of a KITTI file would be of \
        a wrong frame: export to tum, with times, or to colmap-text"
    )]
    TrajectoryGaps {
        /// The model.
        model: PathBuf,
        /// The numbers of the frames.
        frames: String,
    },
    /// A model cannot be compared with the ground truth.
    #[error("cannot compare {model} with {truth}: {reason}")]
    Evaluation {
        /// The model.
        model: PathBuf,
        /// The ground truth.
        truth: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The format needs the photos, and a bare model does not tell where they are.
    #[error(
        "{path} is in no workspace, and the photos are needed: name the workspace that the model \
        was made in, or the folder of the photos with `export.images` if the command has it"
    )]
    NoPhotos {
        /// The model.
        path: PathBuf,
    },
    /// A camera sees half of all directions or more, and a PINHOLE image less.
    #[error(
        "the camera of {image} sees 180 degrees or more, which no PINHOLE image holds: cut the \
        photos into views first, or give them as they are (an export as colmap or \
        nerfstudio) to a program that takes fisheye cameras"
    )]
    TooWide {
        /// The first image of the camera.
        image: String,
    },
    /// The format needs rolling shutters, and the model was mapped without.
    #[error(
        "{path} has no rolling shutter: map with `mapper.readout` estimate, or with the readout \
        time if it is known; for photos of a global shutter `model.undistort` writes the folder \
        that trainers of splats read"
    )]
    NoShutter {
        /// The model.
        path: PathBuf,
    },
    /// Detected keypoints were asked for, and a model has no database with them.
    #[error(
        "the detected keypoints of {image} are not in {path}: export from the workspace that \
        the model was made in"
    )]
    NoDetectedKeypoints {
        /// The database.
        path: PathBuf,
        /// The image.
        image: String,
    },
    /// A photo of the workspace is no longer where it was.
    #[error("the photo {image} is no longer in {}: put it back", comma_separated(inputs))]
    NoPhoto {
        /// Its name.
        image: String,
        /// The input folders.
        inputs: Vec<PathBuf>,
    },
    /// A folder of photos of the workspace is no longer where it was.
    #[error(
        "{path} is no longer there, with the photos of this workspace: put it back, give its new \
         place by `export.images` if the command has it, or give its new place and the workspace \
         to `stage.features`, which keeps the results"
    )]
    MovedPhotos {
        /// The folder.
        path: PathBuf,
    },
    /// Mapping cannot go on from a model.
    #[error("cannot go on from {path}: {cause}")]
    InputModel {
        /// The folder of the model.
        path: PathBuf,
        /// The reason.
        cause: tiepoint_sfm::Error,
    },
    /// A database of another program has too few images.
    #[error(
        "{path} has {images} images with keypoints: a map needs at least two, so extract features \
        first, or leave out `features.database`"
    )]
    EmptyDatabase {
        /// The file.
        path: PathBuf,
        /// Number of its images with keypoints.
        images: usize,
    },
    /// Features of another program have no descriptors.
    #[error(
        "{path}: {image} has no descriptor for each keypoint, so that it cannot be matched: match \
        the features with the program that made them, and give that database"
    )]
    NoDescriptors {
        /// The database.
        path: PathBuf,
        /// Name of an image.
        image: String,
    },
    /// Similar images are asked for, and the descriptors are not those of SIFT.
    #[error(
        "{path}: similar images are found by SIFT descriptors, and those of its images are \
        {format}; all pairs and sequences need no similar images"
    )]
    NoRetrieval {
        /// The database.
        path: PathBuf,
        /// What the descriptors are.
        format: DescriptorFormat,
    },
    /// Photos would get other features than the images of a model.
    #[error(
        "{path} has features of {found}, and the photos would get those of {asked}: they cannot be \
        compared"
    )]
    OtherFeatures {
        /// The database.
        path: PathBuf,
        /// The extractor or the descriptors of the model's images.
        found: String,
        /// Those of the photos.
        asked: String,
    },
    /// An extractor gives features that do not fit together.
    #[error(
        "the extractor {extractor} gives {keypoints} keypoints and {descriptors} descriptors of \
        {format}, not a descriptor of its own format for each keypoint"
    )]
    InvalidFeatures {
        /// Name of the extractor.
        extractor: String,
        /// Number of keypoints.
        keypoints: usize,
        /// Number of descriptors.
        descriptors: usize,
        /// What they are.
        format: DescriptorFormat,
    },
    /// A model has no database with the features of its images.
    #[error(
        "{path} has no database.db beside its model: give a workspace, or a folder with \
        database.db and sparse/"
    )]
    NoModelDatabase {
        /// The folder.
        path: PathBuf,
    },
    /// Positions are those of other photos.
    #[error(
        "none of the {count} positions in {path} is of a photo here, the first is of `{first}`: \
        names are relative to the input, as `left/0001.jpg`"
    )]
    PositionsOfOthers {
        /// The file.
        path: PathBuf,
        /// Number of positions.
        count: usize,
        /// The first name in it.
        first: String,
    },
    /// Two options contradict each other.
    #[error("{option} sets poses that {with} keeps: leave one of them out")]
    MovesPoses {
        /// An option.
        option: &'static str,
        /// The other one.
        with: &'static str,
    },
    /// A cloud is too small or degenerate to be aligned.
    #[error(
        "cannot compare {cloud} with {reference}: one of them has fewer than three points that \
        are not on a line"
    )]
    DegenerateClouds {
        /// The cloud.
        cloud: PathBuf,
        /// The reference.
        reference: PathBuf,
    },
    /// A model could not be aligned to another model or to positions.
    #[error("cannot align {model} to {reference}: {reason}")]
    NoAlignment {
        /// The model.
        model: PathBuf,
        /// The other model, or the file of positions.
        reference: PathBuf,
        /// The reason.
        reason: String,
    },
    /// A model could not be compared with surveyed points.
    #[error("cannot compare {model} with {reference}: {reason}")]
    NoComparison {
        /// The model.
        model: PathBuf,
        /// The file of points.
        reference: PathBuf,
        /// The reason.
        reason: String,
    },
    /// No point of a model is in the box that it is cropped to.
    #[error("no point of {path} is in the box, of {points}: see `model.info` of {path}")]
    EmptyCrop {
        /// The model.
        path: PathBuf,
        /// Number of its points.
        points: usize,
    },
    /// A format needs images of a plane, and a camera is spherical.
    #[error(
        "{image} is a spherical panorama, which has no undistorted image: export the model to \
         colmap instead"
    )]
    NoImagePlane {
        /// The name of an image.
        image: String,
    },
    /// glTF is written in its binary form, and the file would be read as text.
    #[error("{path}: programs read a .gltf file as text, and this one is binary: name it .glb")]
    BinaryGltf {
        /// The file.
        path: PathBuf,
    },
    /// The build lacks the feature `las`.
    #[error(
        "{path} is a LAS file, which this build cannot read: build with the feature las, or \
        convert it to PLY"
    )]
    NoLas {
        /// The file.
        path: PathBuf,
    },
    /// The build lacks the feature `las`.
    #[error(
        "{path} cannot be written, because this build has no LAS: build with the feature las, or \
         use dense/fused.ply of the workspace"
    )]
    NoLasWriter {
        /// The file.
        path: PathBuf,
    },
    /// A photo was replaced since its features were extracted.
    #[error(
        "{path} is not the photo that the model was made from, which had the same name: put that \
        photo back, or make the model anew with `stage.redo` features"
    )]
    ChangedPhoto {
        /// The photo.
        path: PathBuf,
    },
    /// A photo that EXIF turns lies where an export would put an upright copy.
    #[error(
        "{path} is stored turned and has an EXIF orientation, which readers of this format ignore: \
        give another folder with -o, which gets upright copies"
    )]
    TurnedInPlace {
        /// The photo.
        path: PathBuf,
    },
    /// A page would be written among the files of a model.
    #[error(
        "the page would be among the files of the model in {model}: run this in another folder, \
        which gets it"
    )]
    PageInModel {
        /// The folder of the model.
        model: PathBuf,
    },
    /// A model would be written among the files of a workspace.
    #[error("{path} is a workspace, which has its models in sparse: give another folder")]
    ModelIntoWorkspace {
        /// The workspace.
        path: PathBuf,
    },
    /// A model is not georeferenced, or by Cartesian coordinates only.
    #[error(
        "nothing tells where on the earth {model} is: map with positions on WGS 84 \
        (`mapper.position_priors`), or align it with them"
    )]
    NoPlace {
        /// The model.
        model: PathBuf,
    },
    /// A coordinate reference system has heights, and the model has none.
    #[error(
        "{crs} takes heights, and the positions of {model} had none: choose EPSG:4326 or a zone of \
        UTM, whose coordinates do not depend on them"
    )]
    NoHeights {
        /// The model.
        model: PathBuf,
        /// The system.
        crs: Crs,
    },
    /// A model is far outside of a zone of UTM.
    #[error(
        "{model} has a point at latitude {latitude_deg:.4} and longitude {longitude_deg:.4}, far \
        outside of {crs}: there, the zone of UTM is {zone}"
    )]
    OutsideCrs {
        /// The model.
        model: PathBuf,
        /// The system.
        crs: Crs,
        /// The zone of the point.
        zone: Crs,
        /// Latitude of the point, in degrees.
        latitude_deg: f64,
        /// Its longitude.
        longitude_deg: f64,
    },
    /// A format cannot be written in a coordinate reference system.
    #[error(
        "{format} is not written in {crs}: ply, las and csv are in any, geojson and gpx in \
        EPSG:4326 and EPSG:4979 only"
    )]
    NotInCrs {
        /// The format.
        format: &'static str,
        /// The system.
        crs: Crs,
    },
    /// A workspace has no dense cloud.
    #[error(
        "{path} has no dense cloud of its model: run `stage.dense` first, with `stage.redo` \
        dense if its files were deleted"
    )]
    NoDenseCloud {
        /// The workspace.
        path: PathBuf,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] tiepoint_io::Error),
    /// An option is out of its range.
    #[error(transparent)]
    Option(#[from] tiepoint_sfm::geometry::OptionError),
    /// Feature extraction failed.
    #[error(transparent)]
    Features(#[from] tiepoint_io::features::Error),
    /// Descriptor matching failed.
    #[error(transparent)]
    Matching(#[from] tiepoint_sfm::matching::Error),
    /// An extractor or a matcher failed.
    #[error(transparent)]
    Method(Box<dyn std::error::Error + Send + Sync>),
    /// A matcher does not give a list of matches for each pair.
    #[error("the matcher gives {lists} lists of matches for {pairs} pairs of images")]
    InvalidMatches {
        /// Number of pairs.
        pairs: usize,
        /// Number of lists.
        lists: usize,
    },
    /// A matcher names a keypoint that does not exist.
    #[error(
        "the matcher matches keypoints {} and {} of images with {} and {} keypoints",
        .keypoints[0], .keypoints[1], .counts[0], .counts[1]
    )]
    InvalidMatch {
        /// The keypoints.
        keypoints: [u32; 2],
        /// Numbers of keypoints of the two images.
        counts: [usize; 2],
    },
    /// The mapper failed.
    #[error(transparent)]
    Mapping(tiepoint_sfm::Error),
    /// The bundle adjustment of a model in a given file failed.
    #[error("{path}: cannot be adjusted: {cause}")]
    Unadjustable {
        /// The model.
        path: PathBuf,
        /// Why not.
        cause: tiepoint_sfm::Error,
    },
    /// The event callback returned `Break`.
    #[error("stopped on request")]
    Cancelled,
}

impl Error {
    /// Converts an error of the operating system for a file or folder that is written.
    pub(crate) fn output(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let error = tiepoint_store::Error::output(path);
        move |cause| Self::Store(error(cause))
    }

    /// Converts an error of the operating system for a file or folder that is read.
    pub(crate) fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let error = tiepoint_store::Error::unreadable(path);
        move |cause| Self::Store(error(cause))
    }

    /// Converts an error of the adjustment of the model at `path`.
    pub fn adjusting<E: Into<tiepoint_sfm::Error>>(path: &Path) -> impl Fn(E) -> Self {
        move |cause| match cause.into() {
            tiepoint_sfm::Error::Cancelled => Self::Cancelled,
            cause => Self::Unadjustable { path: path.to_owned(), cause },
        }
    }
}

impl From<tiepoint_sfm::Error> for Error {
    fn from(error: tiepoint_sfm::Error) -> Self {
        match error {
            tiepoint_sfm::Error::Cancelled => Self::Cancelled,
            error => Self::Mapping(error),
        }
    }
}
