//! Stage 1 and 2 for a database of another program: it is copied into the workspace and taken as it
//! is.
//!
//! Verified pairs keep their matches. Pairs with matches alone are verified. A pair whose row holds
//! no geometry but placeholders (identity matrices, a pose without translation) gets the geometry
//! of its own matches, because the mapper begins with it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tiepoint_input::ImageFolder;
use tiepoint_input::fingerprint::{hash_files, of_photo};
use tiepoint_input::parallel::for_each_in_order;
use tiepoint_io::database::{Database, read_stage_rows};
use tiepoint_sfm::convert::keypoint;
use tiepoint_sfm::geometry::nalgebra::Matrix3;
use tiepoint_sfm::scene::{
    Camera, CameraId, Image, ImageId, ImagePair, Match, TwoView, TwoViewKind,
};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions};
use tiepoint_store::{Error as StoreError, escaped};

use crate::stages::option_keys;
use crate::stages::stationary::Removal;
use crate::stages::verification::{of_keypoints, verify};
use crate::workspace::option_names;
use crate::workspace::records::Recipe;
use crate::workspace::report::{CameraReport, FeaturesReport, MatchReport};
use crate::workspace::stage_run::{StageRequest, StageResult, StageRun};
use crate::{Error, Event, Stage, Watch, Workspace};

/// Pairs per transaction.
const PAIRS_PER_TRANSACTION: usize = 64;

/// Copies a database of another program into a workspace, in place of extracting features. The file
/// is not changed. `inputs`: folders of the photos, for colours and dense reconstruction; may be
/// empty.
///
/// # Errors
///
/// The file is not a database of COLMAP or has fewer than two images with keypoints; the stage was
/// run with another file, and `redo` does not ask for it; a file cannot be read or written.
pub fn import_features(
    file: &Path,
    inputs: &[PathBuf],
    workspace: &mut Workspace,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    let has_pairs = Database::has_pairs(file)?;
    let fingerprint = hash_files(&files_of(file))?;
    let recipe =
        Recipe::new(fingerprint.clone(), option_keys::database_options(&fingerprint, has_pairs));
    let absolute = |path: &PathBuf| path.canonicalize().map_err(Error::unreadable(path));
    let inputs: Vec<PathBuf> = inputs.iter().map(absolute).collect::<Result<_, _>>()?;
    workspace.protect_sources([file]);
    let request = StageRequest { stage: Stage::Features, recipe, redo, inputs: Some(inputs) };
    workspace.run_stage(request, watch, |run| copy_database(file, run))
}

/// Copies the database into the workspace.
fn copy_database(file: &Path, run: &mut StageRun) -> Result<StageResult, Error> {
    let workspace = &mut *run.workspace;
    let path = workspace.database();
    if path.is_file() && !matches!(read_stage_rows(&path), Ok(Some(_))) {
        return Err(StoreError::ForeignFile { path }.into());
    }
    let rows = workspace.records.rows();
    // As they are now. Without photos, or with other names, there are none.
    let fingerprints = ImageFolder::open(&workspace.records.inputs, None).map_or_else(
        |_| Vec::new(),
        |folder| {
            let photos = folder.images().par_iter().enumerate();
            let photos = photos.filter_map(|(index, image)| {
                Some((image.name.clone(), of_photo(folder.path(index)).ok()?))
            });
            photos.collect::<Vec<(String, String)>>()
        },
    );
    let database = Database::copy_with(file, &path, |database| {
        let fingerprints = fingerprints.iter().map(|(name, of)| (name.as_str(), of.as_str()));
        database.write_photo_fingerprints(fingerprints)?;
        database.write_stage_rows(&rows)
    })?;
    workspace.note(|_| {})?;
    let counts: Vec<usize> = database.keypoint_counts()?.into_iter().flatten().collect();
    let images = counts.iter().filter(|count| **count > 0).count();
    run.began(images, images)?;
    if images < 2 {
        database.close()?;
        return Err(Error::EmptyDatabase { path: file.to_owned(), images });
    }
    let notes: Vec<String> =
        absent_photos_note(&run.workspace.records.inputs, &database.read_images()?)
            .into_iter()
            .collect();
    for what in &notes {
        run.emit(&Event::Noted { what })?;
    }
    let cameras = database.read_cameras()?;
    let cameras = cameras.iter().enumerate();
    let report = FeaturesReport {
        seconds: 0.0,
        images,
        keypoints: counts.iter().sum(),
        skipped: Vec::new(),
        notes,
        cameras: cameras
            .map(|(index, camera)| CameraReport::new(CameraId::from_index(index), camera))
            .collect(),
    };
    Ok(StageResult::features(database, report))
}

/// A note on images of a database that are not in the folders of photos that were given with it.
fn absent_photos_note(inputs: &[PathBuf], images: &[Image]) -> Option<String> {
    let first = inputs.first()?;
    // Of several inputs, names begin with the folder's own.
    let is_there = |name: &str| {
        let folders = inputs.iter().flat_map(|input| [Some(input.as_path()), input.parent()]);
        folders.flatten().any(|folder| folder.join(name).is_file())
    };
    let absent: Vec<&Image> = images.iter().filter(|image| !is_there(&image.name)).collect();
    let example = escaped(Path::new(&absent.first()?.name));
    Some(format!(
        "{} of {} images of the database are not in {}, as {example}: their points get no colour, \
        and undistort and dense need them; give the folder that the names begin in",
        absent.len(),
        images.len(),
        escaped(first)
    ))
}

/// A database and its log.
fn files_of(file: &Path) -> Vec<PathBuf> {
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    let log = PathBuf::from(log);
    let has_log = log.metadata().is_ok_and(|found| found.len() > 0);
    std::iter::once(file.to_owned()).chain(has_log.then_some(log)).collect()
}

/// Whether the pairs of a workspace came with its database and are to be kept.
pub(crate) fn has_imported_pairs(workspace: &Workspace, redo: Option<Stage>) -> bool {
    let option = |stage, key| workspace.records.option(stage, key);
    let of_matches = option(Stage::Match, option_names::PAIRS);
    redo != Some(Stage::Match)
        && option(Stage::Features, option_names::FOUND_PAIRS).is_some()
        && of_matches.is_none_or(|pairs| pairs == option_names::PAIRS_OF_DATABASE)
}

/// Checks that the features of a database of another program can be matched.
///
/// # Errors
///
/// [`Error::NoDescriptors`]; descriptors of several kinds, or of one that is not known.
pub(crate) fn require_descriptors(workspace: &Workspace, database: &Database) -> Result<(), Error> {
    if workspace.records.option(Stage::Features, option_names::DATABASE).is_none() {
        return Ok(());
    }
    if let Some(image) = database.image_without_descriptors()? {
        return Err(Error::NoDescriptors { path: workspace.database(), image });
    }
    database.descriptor_format()?;
    Ok(())
}

/// Stage 2 for pairs that came with the database: verifies those that have matches alone.
///
/// # Errors
///
/// The stage was run with other options; the database cannot be read or written; `watch` returns
/// `Break`.
pub(crate) fn verify_imported_pairs(
    workspace: &mut Workspace,
    options: &VerifyOptions,
    seed: u64,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    let input = workspace.fingerprint(Stage::Features)?;
    let pairs = option_names::PAIRS_OF_DATABASE.to_owned();
    let recipe = Recipe::new(input, option_keys::matching_options(pairs, options, seed));
    let request = StageRequest { stage: Stage::Match, recipe, redo, inputs: None };
    workspace.run_stage(request, watch, |run| verify_all(run, options, seed))
}

/// Verifies the pairs that have matches alone.
fn verify_all(
    run: &mut StageRun,
    options: &VerifyOptions,
    seed: u64,
) -> Result<StageResult, Error> {
    let mut database = Database::open(&run.workspace.database())?;
    if run.begins {
        database.write_stage_rows(&run.workspace.records.rows())?;
        run.workspace.note(|_| {})?;
    }
    let pairs = ImportedPairs::read(&database)?;
    run.began(pairs.all.len(), 0)?;
    let tasks: Vec<ImagePair> = pairs.all.keys().copied().collect();
    let names: Vec<String> = pairs.images.iter().map(|image| image.name.clone()).collect();
    let mut report = MatchReport::default();
    let mut batch: Vec<(ImagePair, TwoView)> = Vec::new();
    // Matches are read a batch at a time.
    for tasks in tasks.chunks(PAIRS_PER_TRANSACTION) {
        let read = tasks.iter().map(|pair| Ok((*pair, database.read_matches_of(*pair)?)));
        let read = read.collect::<Result<Vec<_>, Error>>()?;
        let work = |(pair, matches): &(ImagePair, Vec<Match>)| {
            pairs.verified(*pair, matches, options, seed)
        };
        let taken = for_each_in_order(&read, work, |(pair, matches), (view, is_new)| {
            let inliers = view.matches.len();
            report.pairs += 1;
            report.matches += if matches.is_empty() { inliers } else { matches.len() };
            if view.is_verified() {
                report.verified_pairs += 1;
                report.inlier_matches += inliers;
            }
            if is_new {
                batch.push((*pair, view));
            }
            let [image1, image2] = [pair.a, pair.b].map(|image| names[image.index()].as_str());
            run.emit(&Event::PairDone { image1, image2, matches: matches.len(), inliers })
        });
        database.write_two_views(batch.iter().map(|(pair, view)| (*pair, view)))?;
        batch.clear();
        taken?;
    }
    let removal = Removal::find(&database, options, seed)?;
    let report = removal.added_to(report, &database)?;
    Ok(StageResult::matches(database, report, removal.into_views()))
}

/// The pairs of a database, with their images.
pub struct ImportedPairs {
    cameras: Vec<Camera>,
    images: Vec<Image>,
    /// The two-view geometry of each pair that has one.
    pub all: BTreeMap<ImagePair, Option<TwoView>>,
}

impl ImportedPairs {
    /// Reads all pairs, those with matches alone too.
    ///
    /// # Errors
    ///
    /// The database cannot be read.
    pub fn read(database: &Database) -> Result<Self, Error> {
        let mut all: BTreeMap<ImagePair, Option<TwoView>> =
            database.matched_pairs()?.into_iter().map(|pair| (pair, None)).collect();
        all.extend(database.read_two_views()?.into_iter().map(|(pair, view)| (pair, Some(view))));
        let mut images = Vec::new();
        for (index, image) in database.read_images()?.into_iter().enumerate() {
            let keypoints = database.read_keypoints(ImageId::from_index(index))?;
            let keypoints = keypoints.iter().map(keypoint).collect();
            images.push(Image::new(image.name, image.camera, keypoints));
        }
        Ok(Self { cameras: database.read_cameras()?, images, all })
    }

    /// The two-view geometry of a pair, and whether it differs from that in the database. `raw`:
    /// matches of a pair without a geometry.
    pub fn verified(
        &self,
        pair: ImagePair,
        raw: &[Match],
        options: &VerifyOptions,
        seed: u64,
    ) -> (TwoView, bool) {
        let found = self.all[&pair].as_ref();
        let is_decided = found.is_some_and(|view| view.kind != TwoViewKind::Undefined);
        if let (Some(view), true) = (found, is_decided) {
            let cleaned = without_placeholders(view);
            let has_geometry = cleaned.cam2_from_cam1.is_some() || cleaned.fundamental.is_some();
            if !cleaned.is_verified() || cleaned.matches.is_empty() || has_geometry {
                let is_new = cleaned != *view;
                return (cleaned, is_new);
            }
            let estimated = self.verify(pair, &cleaned.matches, options, seed);
            // All matches were inliers to the program that wrote them.
            let matches = cleaned.matches.clone();
            let view = if estimated.is_verified() { estimated } else { cleaned };
            return (TwoView { matches, ..view }, true);
        }
        let own = found.map_or(&[][..], |view| &view.matches);
        (self.verify(pair, if raw.is_empty() { own } else { raw }, options, seed), true)
    }

    fn verify(
        &self,
        pair: ImagePair,
        matches: &[Match],
        options: &VerifyOptions,
        seed: u64,
    ) -> TwoView {
        let image = |id: ImageId| &self.images[id.index()];
        let view = |id: ImageId| ImageObservations {
            keypoints: &image(id).keypoints,
            camera: &self.cameras[image(id).camera.index()],
        };
        let matches = of_keypoints(pair, matches.to_vec(), |id| image(id).keypoints.len());
        verify(pair, view, &matches, options, seed)
    }
}

/// A two-view geometry without placeholders: programs write identity or zero for a matrix or a pose
/// that they did not estimate.
fn without_placeholders(view: &TwoView) -> TwoView {
    let is_real = |matrix: &Matrix3<f64>| *matrix != Matrix3::identity() && matrix.amax() > 0.0;
    let is_still = view.kind == TwoViewKind::Panoramic;
    TwoView {
        kind: view.kind,
        fundamental: view.fundamental.filter(is_real),
        essential: view.essential.filter(is_real),
        homography: view.homography.filter(is_real),
        cam2_from_cam1: view
            .cam2_from_cam1
            .filter(|pose| is_still || pose.translation.norm_squared() > 0.0),
        matches: view.matches.clone(),
    }
}
