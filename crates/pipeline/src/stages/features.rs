//! Stage 1: extracts keypoints and descriptors of every image into the database.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tiepoint_input::cameras::{
    Calibration, CalibrationSource, Calibrations, FOUND, FoundCameras, Photo, firsts,
};
use tiepoint_input::fingerprint::hash_file;
use tiepoint_input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_input::{CameraGrouping, DEFAULT_MAX_PIXELS, Exif, ImageInfo, Photos, SkippedImage};
use tiepoint_io::database::{Database, read_stage_rows};
use tiepoint_io::features::{Extractor, Features, SiftExtractor};
use tiepoint_io::names::ByName;
use tiepoint_io::timestamps;
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::scene::{Camera, CameraId, Image, ImageId, Position, Reconstruction};
use tiepoint_store::Error as StoreError;

use crate::shard::Shard;
use crate::stages::extraction::{extract_photo, memory_of};
use crate::stages::option_keys;
use crate::workspace::folder::TIMESTAMPS;
use crate::workspace::records::Recipe;
use crate::workspace::report::{CameraReport, FeaturesReport};
use crate::workspace::shards::ShardReport;
use crate::workspace::stage_run::{StageRequest, StageResult, StageRun};
use crate::{Error, Event, Stage, Watch, Workspace, emit};

/// Options of feature extraction.
#[derive(Clone, Debug)]
pub struct FeatureOptions {
    /// Prior knowledge of the intrinsics of cameras without a calibration file.
    pub calibration: Calibration,
    /// Files of known calibrations, whose intrinsics stay fixed.
    pub calibration_files: Vec<CalibrationSource>,
    /// Which photos share a camera.
    pub cameras: CameraGrouping,
    /// What detects and describes keypoints.
    pub extractor: Arc<dyn Extractor>,
    /// CSV file of the capture times with the header `image,seconds`; `None`: times in the file
    /// names or in EXIF.
    pub timestamps: Option<PathBuf>,
    /// Features are those of photos that are reduced to this larger side, in pixels.
    pub max_size: Option<u32>,
    /// Photos with more pixels are skipped, which bounds the memory that a damaged or malicious
    /// file can request. At most [`ABSOLUTE_MAX_PIXELS`](tiepoint_input::ABSOLUTE_MAX_PIXELS).
    pub max_pixels: u64,
    /// Whether the database keeps the positions in EXIF and in videos.
    pub keeps_positions: bool,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self {
            calibration: Calibration::default(),
            calibration_files: Vec::new(),
            cameras: CameraGrouping::default(),
            extractor: Arc::new(SiftExtractor::default()),
            timestamps: None,
            max_size: None,
            max_pixels: DEFAULT_MAX_PIXELS,
            keeps_positions: true,
        }
    }
}

impl FeatureOptions {
    /// The recipe of the stage: fingerprint of the photos, the options, and what was found of the
    /// cameras.
    fn recipe(&self, photos: &Photos, found: &FoundCameras) -> Result<Recipe, Error> {
        let Self {
            calibration,
            calibration_files,
            cameras,
            extractor,
            timestamps,
            max_size,
            max_pixels,
            // Features are the same without.
            keeps_positions: _,
        } = self;
        let files = calibration_files.iter().map(CalibrationSource::fingerprint);
        let files: Vec<String> = files.collect::<Result<_, _>>()?;
        let timestamps = timestamps.as_deref().map(hash_file).transpose()?;
        let mut texts = option_keys::feature_options(calibration, timestamps);
        texts.push(option_keys::max_size_option(*max_size));
        texts.push(option_keys::pixel_limit_option(*max_pixels));
        texts.push(option_keys::cameras_option(*cameras));
        texts.push(option_keys::calibration_files_option(&files));
        texts.extend(found.facts.texts());
        let texts = texts.into_iter().map(|(key, value)| (key.to_owned(), value));
        let texts = texts.chain(option_keys::extractor_options(&**extractor));
        Ok(Recipe::new(photos.fingerprint()?, texts))
    }
}

/// Extracts the features of all photos into the database of a workspace, or resumes that. Photos
/// that cannot be read are reported and skipped.
///
/// # Errors
///
/// The options are invalid; the stage was run with other photos or options, and `redo` does not ask
/// for it; fewer than two photos are usable, or photos that are to share a camera differ in size; a
/// file cannot be read or written; `watch` returns `Break`.
pub fn extract_features(
    photos: &Photos,
    workspace: &mut Workspace,
    options: &FeatureOptions,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    extract_features_of(photos, workspace, options, redo, &|_, _| Ok(()), watch)
}

/// [`extract_features`] of photos that pass a check. It gets the scene without keypoints, before a
/// photo is decoded.
pub(crate) fn extract_features_of(
    photos: &Photos,
    workspace: &mut Workspace,
    options: &FeatureOptions,
    redo: Option<Stage>,
    check: &dyn Fn(&Workspace, &Reconstruction) -> Result<(), Error>,
    watch: Watch,
) -> Result<(), Error> {
    let photos = &photos.with_max_pixels(options.max_pixels);
    let (survey, recipe, skipped) = Survey::new(photos, options)?;
    let calibration_files = options.calibration_files.iter().map(|source| source.path.as_path());
    workspace.folder.protect(photos.files());
    workspace.protect_sources(options.timestamps.as_deref().into_iter().chain(calibration_files));
    let inputs = Some(photos.inputs.clone());
    let request = StageRequest { stage: Stage::Features, recipe: recipe.clone(), redo, inputs };
    check(workspace, &survey.scene())?;
    workspace.run_stage(request, watch, |run| survey.extract(run, options, &recipe, skipped))
}

/// Extracts the features of a shard of the photos into its tile, from which
/// [`extract_features`] with the same photos and options takes them. Photos that cannot be read
/// are left to it.
///
/// # Errors
///
/// Those of [`extract_features`]; an existing tile is damaged or of other photos or options.
pub fn extract_shard(
    photos: &Photos,
    workspace: &Workspace,
    options: &FeatureOptions,
    shard: Shard,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<ShardReport, Error> {
    let photos = &photos.with_max_pixels(options.max_pixels);
    let (survey, recipe, _) = Survey::new(photos, options)?;
    let (stage, recipe) = (Stage::Features, survey.recipe_of_tiles(&recipe));
    workspace.run_shard(stage, (shard, &recipe), redo, watch, |tile, watch| {
        let all: Vec<(ImageId, &Photo)> = survey.photos().collect();
        let own = &all[shard.range(all.len())];
        emit(watch, &Event::StageBegan { stage, total: own.len(), done: 0 })?;
        survey.for_each_features(own, options, |id, image, found| match found {
            Ok(features) => {
                tile.write_features(id, &features)?;
                emit(watch, &Event::ImageDone { image, keypoints: features.keypoints.len() })
            }
            Err(error) => emit(watch, &Event::ImageSkipped { image, reason: &error.to_string() }),
        })
    })
}

/// What is known of the photos before they are decoded.
struct Survey<'a> {
    photos: &'a Photos,
    usable: Vec<Photo>,
    calibrations: Calibrations,
    cameras: Vec<Camera>,
    /// Names and capture times, in seconds, of the images with a known time.
    times: Vec<(&'a str, f64)>,
    /// The positions in EXIF or in videos.
    positions: Vec<(ImageId, Position)>,
}

impl<'a> Survey<'a> {
    /// Also the recipe of the stage, and the photos that cannot be used.
    fn new(
        photos: &'a Photos,
        options: &FeatureOptions,
    ) -> Result<(Self, Recipe, Vec<SkippedImage>), Error> {
        let calibrations = Calibrations::read(&options.calibration_files, &photos.folder)?;
        let (usable, skipped) = photos.survey(options.cameras, &calibrations)?;
        let found = FoundCameras::new(
            photos,
            &usable,
            &options.calibration,
            &calibrations,
            options.cameras,
        )?;
        let recipe = options.recipe(photos, &found)?;
        let times = times(photos, &usable, options)?;
        let cameras = found.cameras;
        let positions = match options.keeps_positions {
            true => positions(photos, &usable),
            false => Vec::new(),
        };
        let survey = Self { photos, usable, calibrations, cameras, times, positions };
        Ok((survey, recipe, skipped))
    }

    /// The recipe of tiles, from that of the stage. Image ids count the usable photos, which are
    /// others where a header could not be read in passing.
    fn recipe_of_tiles(&self, recipe: &Recipe) -> Recipe {
        let mut hash = blake3::Hasher::new();
        for name in self.usable.iter().map(|photo| self.photos.name(photo)) {
            hash.update(&(name.len() as u64).to_le_bytes()).update(name.as_bytes());
        }
        let mut recipe = recipe.clone();
        recipe.options.insert(format!("{FOUND}photos"), hash.finalize().to_hex().to_string());
        recipe
    }

    fn photos(&self) -> impl Iterator<Item = (ImageId, &Photo)> {
        let photos = self.usable.iter().enumerate();
        photos.map(|(index, photo)| (ImageId::from_index(index), photo))
    }

    /// Extracts the features of some photos. `take` gets them in order, with the name of the image.
    fn for_each_features(
        &self,
        photos: &[(ImageId, &Photo)],
        options: &FeatureOptions,
        mut take: impl FnMut(ImageId, &str, Result<Features, Error>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (extractor, folder) = (&*options.extractor, &self.photos.folder);
        let work = |(_, photo): &(ImageId, &Photo)| {
            extract_photo(extractor, folder, photo.index, options.max_size)
        };
        let bytes = |(_, photo): &(ImageId, &Photo)| memory_of(extractor, &photo.info);
        for_each_within_budget(budget_bytes(), bytes, photos, work, |(id, photo), found| {
            take(*id, self.photos.name(photo), found)
        })
    }

    /// The cameras, and the images with their times, without keypoints.
    fn scene(&self) -> Reconstruction {
        let mut scene = Reconstruction::default();
        let cameras: Vec<CameraId> =
            self.cameras.iter().map(|camera| scene.add_camera(*camera)).collect();
        let times: BTreeMap<&str, f64> = self.times.iter().copied().collect();
        for photo in &self.usable {
            let name = self.photos.name(photo);
            let image = Image::new(name, cameras[photo.camera], Vec::new());
            let id = scene.add_image(image);
            scene.set_time(id, times.get(name).copied());
        }
        scene
    }

    /// Extracts the features of the photos that have none yet, or takes them from tiles.
    fn extract(
        &self,
        run: &mut StageRun,
        options: &FeatureOptions,
        recipe: &Recipe,
        mut skipped: Vec<SkippedImage>,
    ) -> Result<StageResult, Error> {
        let recipe = &self.recipe_of_tiles(recipe);
        // What is wrong with them is said before anything is replaced.
        let tiles = run.workspace.check_tiles(Stage::Features, recipe)?;
        let mut database = self.begin(run)?;
        let mut counts = database.keypoint_counts()?;
        let done = counts.iter().flatten().count();
        run.began(self.usable.len(), done)?;
        let notes = self.notes();
        self.announce(run, options, &notes, &skipped)?;
        let StageRun { workspace, watch, .. } = run;
        let mut take = |counts: &mut [Option<usize>], id: ImageId, found| {
            let image = || self.photos.name(&self.usable[id.index()]);
            match found {
                Ok(features) => {
                    database.write_features([(id, &features)])?;
                    let keypoints = features.keypoints.len();
                    counts[id.index()] = Some(keypoints);
                    emit(watch, &Event::ImageDone { image: image(), keypoints })
                }
                Err(error) => {
                    let (image, reason) = (image(), Error::to_string(&error));
                    emit(watch, &Event::ImageSkipped { image, reason: &reason })?;
                    skipped.push(SkippedImage { image: image.to_owned(), reason, others: 0 });
                    Ok(())
                }
            }
        };
        let of_tiles = workspace.for_each_tile(&tiles, |mut tile| {
            while let Some((id, features)) = tile.next_features()? {
                // An interrupted run has written those of some images.
                if counts.get(id.index()) == Some(&None) {
                    take(&mut counts, id, Ok(features))?;
                }
            }
            Ok(())
        });
        let tasks: Vec<(ImageId, &Photo)> =
            self.photos().filter(|(id, _)| counts[id.index()].is_none()).collect();
        let taken = of_tiles.and_then(|()| {
            self.for_each_features(&tasks, options, |id, _, found| take(&mut counts, id, found))
        });
        // A photo that cannot be decoded has no camera to report.
        let read = self.usable.iter().zip(&counts).filter(|(_, count)| count.is_some());
        let cameras: BTreeSet<usize> = read.map(|(photo, _)| photo.camera).collect();
        let found: Vec<usize> = counts.into_iter().flatten().collect();
        if taken.is_err() || found.len() < 2 {
            database.close()?;
            taken?;
            let reason = skipped.into_iter().map(|photo| photo.reason).collect();
            return Err(self.photos.too_few(found.len(), reason).into());
        }
        let fingerprints = self.photos.fingerprints(&self.usable);
        let fingerprints = fingerprints.iter().map(|(name, text)| (*name, text.as_str()));
        database.write_photo_fingerprints(fingerprints)?;
        let camera =
            |index: usize| CameraReport::new(CameraId::from_index(index), &self.cameras[index]);
        let report = FeaturesReport {
            seconds: 0.0,
            images: found.len(),
            keypoints: found.iter().sum(),
            skipped,
            notes,
            cameras: cameras.into_iter().map(camera).collect(),
        };
        Ok(StageResult::features(database, report))
    }

    /// Writes the capture times, and opens the database to resume, or creates it.
    fn begin(&self, run: &mut StageRun) -> Result<Database, Error> {
        let workspace = &mut *run.workspace;
        // Foreign files are detected before anything is replaced.
        let staged = workspace.folder.stage(TIMESTAMPS)?;
        timestamps::write(&staged, self.times.iter().map(|(name, time_s)| (*name, *time_s)))?;
        workspace.folder.ensure_writable_or_equal(TIMESTAMPS)?;
        let database = self.open(workspace, run.begins, run.is_redone)?;
        workspace.publish(vec![TIMESTAMPS.to_owned()], &[], |_| {})?;
        if !workspace.folder.is_unmodified(TIMESTAMPS)? {
            // A foreign file with the same content: it becomes ours.
            workspace.folder.claim(&[TIMESTAMPS.to_owned()])?;
        }
        Ok(database)
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.photos.notes.clone();
        notes.extend(self.photos.folder.notes_on_bits());
        notes.extend(self.photos.notes_on_times(&self.usable, &self.times));
        if !self.positions.is_empty() {
            let place = if self.photos.positions.is_empty() { "EXIF" } else { "their videos" };
            notes.push(format!(
                "{} of {} photos have a position in {place}, which database.db keeps",
                self.positions.len(),
                self.usable.len()
            ));
        }
        notes.extend(self.photos.note_on_panoramas(&self.usable, &self.cameras));
        notes.extend(self.photos.notes_on_copies(&self.usable));
        notes
    }

    /// Tells the caller what was found before the photos are decoded.
    fn announce(
        &self,
        run: &mut StageRun,
        options: &FeatureOptions,
        notes: &[String],
        skipped: &[SkippedImage],
    ) -> Result<(), Error> {
        for what in notes {
            run.emit(&Event::Noted { what })?;
        }
        for SkippedImage { image, reason, .. } in skipped {
            run.emit(&Event::ImageSkipped { image, reason })?;
        }
        let is_unknown = matches!(options.calibration, Calibration::Unknown { focal_px: None, .. });
        for photo in firsts(&self.usable) {
            let calibration = photo.calibration.map(|index| self.calibrations.shown(index));
            if let Some(calibration) = calibration {
                let image = self.photos.name(photo);
                run.emit(&Event::CameraCalibrated { image, calibration: &calibration })?;
            }
        }
        for photo in firsts(&self.usable).filter(|photo| photo.calibration.is_none() && is_unknown)
        {
            let ImageInfo { width, height, ref exif, .. } = photo.info;
            if let Some(focal_px) = exif.implausible_focal_px(width, height) {
                let image = self.photos.name(photo);
                run.emit(&Event::FocalIgnored { image, focal_px })?;
            }
        }
        Ok(())
    }

    /// Opens the database to resume, or creates it with cameras and images.
    ///
    /// # Errors
    ///
    /// A foreign file has its name, it is damaged and is not to be redone, or it cannot be written.
    fn open(
        &self,
        workspace: &Workspace,
        begins: bool,
        is_redone: bool,
    ) -> Result<Database, Error> {
        let path = workspace.database();
        if path.is_file() {
            match read_stage_rows(&path) {
                // The file was renamed into place after cameras, images and rigs had been written,
                // so that only features can be missing.
                Ok(Some(_)) if !begins => {
                    let mut database = Database::open(&path)?;
                    if database.num_images() == self.usable.len() {
                        if !self.positions.is_empty() || !database.read_pose_priors()?.is_empty() {
                            // Those of an interrupted run may be absent, or are not asked for now.
                            database.write_pose_priors(&self.positions)?;
                        }
                        return Ok(database);
                    }
                }
                Ok(Some(_)) => {}
                Ok(None) => return Err(StoreError::ForeignFile { path }.into()),
                Err(_) if !is_sqlite(&path) => return Err(StoreError::ForeignFile { path }.into()),
                Err(cause) if !is_redone => {
                    return Err(Error::BrokenDatabase { path, cause: Box::new(cause) });
                }
                Err(_) => {}
            }
        }
        let image = |photo: &Photo| {
            let name = self.photos.name(photo);
            Image::new(name, CameraId::from_index(photo.camera), Vec::new())
        };
        let images: Vec<Image> = self.usable.iter().map(image).collect();
        Ok(Database::create_with(&path, |database| {
            database.write_cameras(&self.cameras)?;
            database.write_images(&images)?;
            database.write_rigs(&[], &[])?;
            if !self.positions.is_empty() {
                database.write_pose_priors(&self.positions)?;
            }
            database.write_stage_rows(&workspace.records.rows())
        })?)
    }
}

/// The positions in EXIF, and of frames those in their videos.
fn positions(photos: &Photos, usable: &[Photo]) -> Vec<(ImageId, Position)> {
    let position = |(index, photo): (usize, &Photo)| {
        if let Some(position) = photos.positions.get(photos.name(photo)) {
            return Some((ImageId::from_index(index), *position));
        }
        photo.info.exif.position?;
        // The file has what the header does not: deviations in XMP.
        let position = Exif::read(photos.folder.path(photo.index)).ok()?.position?;
        Some((ImageId::from_index(index), position))
    };
    usable.iter().enumerate().filter_map(position).collect()
}

/// Names and capture times, in seconds, of the images with a known time.
fn times<'a>(
    photos: &'a Photos,
    usable: &[Photo],
    options: &FeatureOptions,
) -> Result<Vec<(&'a str, f64)>, Error> {
    let names = usable.iter().map(|photo| photos.folder.images()[photo.index].name.as_str());
    let Some(path) = &options.timestamps else {
        return Ok(names
            .zip(usable)
            .filter_map(|(name, photo)| Some((name, photo.info.time_s?)))
            .collect());
    };
    let given = ByName::new(timestamps::read(path)?);
    let times: Vec<_> = names.filter_map(|name| Some((name, *given.get(name)?))).collect();
    if times.is_empty() {
        let example = photos.folder.images().first().map_or("", |image| image.name.as_str());
        let what = format!(
            "it has a time for none of the photos; names are relative to the input, as {example}"
        );
        return Err(Error::Times { path: path.clone(), what });
    }
    let of_photos: BTreeMap<&str, f64> = times.iter().copied().collect();
    if let Some(what) = implausible(photos, usable, &of_photos) {
        return Err(Error::Times { path: path.clone(), what });
    }
    Ok(times)
}

/// Longest usual interval between photos of a camera, in seconds: four months. Nanoseconds of a
/// camera at 30 Hz make a year, and half or twice of this limit tell no unit apart from another.
const MAX_INTERVAL_S: f64 = 1e7;

/// A sentence on times of a camera that cannot be seconds: all are equal, or years apart.
fn implausible(photos: &Photos, usable: &[Photo], times_s: &BTreeMap<&str, f64>) -> Option<String> {
    let mut of_cameras: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for photo in usable {
        let image = &photos.folder.images()[photo.index];
        if let Some(time_s) = times_s.get(image.name.as_str()) {
            of_cameras.entry(image.camera.index()).or_default().push(*time_s);
        }
    }
    of_cameras.retain(|_, times_s| times_s.len() > 1);
    let mut intervals_s: Vec<f64> = Vec::new();
    for times_s in of_cameras.values_mut() {
        times_s.sort_by(f64::total_cmp);
        intervals_s.extend(times_s.windows(2).map(|two| two[1] - two[0]));
    }
    if !intervals_s.is_empty() && intervals_s.iter().all(|interval_s| *interval_s == 0.0) {
        return Some(
            "all times of a camera are equal: give the time of each photo, or leave \
            `features.timestamps` out"
                .to_owned(),
        );
    }
    let usual_s = median(&mut intervals_s).filter(|usual_s| *usual_s > MAX_INTERVAL_S)?;
    Some(format!(
        "photos of a camera are {usual_s:.0} s apart, more than four months: seconds are expected, \
        not nanoseconds"
    ))
}

/// Whether a file has the header of SQLite.
fn is_sqlite(path: &Path) -> bool {
    const HEADER: &[u8] = b"SQLite format 3\0";
    let mut head = Vec::new();
    let read =
        File::open(path).and_then(|file| file.take(HEADER.len() as u64).read_to_end(&mut head));
    read.is_ok() && head == HEADER
}

#[cfg(test)]
mod tests {
    use tiepoint_synth::image::{GrayImage, Luma};

    use super::*;

    #[test]
    fn tiles_name_the_photos_that_number_the_images() {
        let dir = tempfile::tempdir().unwrap();
        for value in 0..3 {
            let photo = GrayImage::from_pixel(64, 48, Luma([value]));
            photo.save(dir.path().join(format!("{value}.png"))).unwrap();
        }
        let photos = Photos::open(&[dir.path().to_owned()], None).unwrap();
        let (mut survey, recipe, _) = Survey::new(&photos, &FeatureOptions::default()).unwrap();
        let of_all = survey.recipe_of_tiles(&recipe);
        assert_eq!(of_all.difference(&recipe, Stage::Features), None, "no option differs");
        survey.usable.remove(1);
        assert_ne!(survey.recipe_of_tiles(&recipe), of_all);
    }
}
