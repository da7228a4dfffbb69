//! `feature_extractor`: adds the images of a folder, with their features, to a database.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_pipeline::input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_pipeline::input::{ImageFolder, ImageInfo};
use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::io::features::{Extractor, Features, SiftExtractor};
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_pipeline::sfm::scene::{Camera, CameraId, Image, ImageId};
use tiepoint_pipeline::stages::{extract_photo, memory_of};
use tiepoint_pipeline::{Error, Event, Stage, Watch, emit};

use super::scene::open_to_add;

/// Which images share a camera, as the options `ImageReader.*` say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SharedCamera {
    /// Images with the same body, lens, focal length and size in EXIF. Images that do not name a
    /// body have cameras of their own.
    #[default]
    Exif,
    /// All images.
    Single,
    /// The images of a folder.
    Folder,
    /// No images.
    Image,
    /// All images, and those of this camera of the database, by its id in the file.
    Existing(i64),
}

/// Options of [`extract`].
#[derive(Clone, Debug)]
pub struct ExtractOptions {
    /// Folder of masks, `left/1.jpg.png` for `left/1.jpg`; no keypoints are detected where a mask
    /// is 0.
    pub masks: Option<PathBuf>,
    /// One mask for all images.
    pub camera_mask: Option<PathBuf>,
    /// The images to take, by their names; all if `None`.
    pub names: Option<Vec<String>>,
    /// Which images share a camera.
    pub cameras: SharedCamera,
    /// Camera model.
    pub model: CameraModelKind,
    /// Initial intrinsics of all cameras; `None`: the focal length of EXIF, else the default one.
    pub params: Option<Intrinsics>,
    /// Default focal length over the larger image side.
    pub focal_factor: f64,
    /// Features are detected on images that are reduced to this larger side; `None`: at full size.
    pub max_image_size: Option<u32>,
    /// What detects and describes keypoints.
    pub extractor: Arc<dyn Extractor>,
}

impl Default for ExtractOptions {
    fn default() -> Self {
        Self {
            masks: None,
            camera_mask: None,
            names: None,
            cameras: SharedCamera::default(),
            model: CameraModelKind::SimpleRadial,
            params: None,
            focal_factor: 1.2,
            max_image_size: None,
            extractor: Arc::new(SiftExtractor::default()),
        }
    }
}

/// The result of [`extract`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Extracted {
    /// Number of images whose features are new.
    pub images: usize,
    /// Number of images that had features before.
    pub kept: usize,
    /// Number of images that could not be used.
    pub skipped: usize,
    /// Number of new keypoints.
    pub keypoints: usize,
    /// Number of new cameras.
    pub cameras: usize,
    /// Wall time.
    pub seconds: f64,
}

/// Extracts the features of the images in a folder and below into a database, which is created if
/// there is none. Images that have features in it are kept. Pixels are taken as they are stored,
/// whatever the EXIF orientation says.
///
/// # Errors
///
/// The options are invalid; the folder has no image; the file is not a database of COLMAP; a file
/// cannot be read or written; `watch` returns `Break`.
pub fn extract(
    database: &Path,
    images: &Path,
    options: &ExtractOptions,
    watch: Watch,
) -> Result<Extracted, Error> {
    let start = Instant::now();
    let folder = ImageFolder::as_stored(images, options.masks.as_deref())?;
    let folder = match &options.camera_mask {
        Some(mask) => folder.with_one_mask(mask),
        None => folder,
    };
    let mut result = Extracted::default();
    let mut skip = |image: &str, reason: &str, watch: Watch| {
        result.skipped += 1;
        emit(watch, &Event::ImageSkipped { image, reason })
    };
    for file in folder.skipped() {
        skip(&file.name, &file.reason, watch)?;
    }
    let chosen = chosen(&folder, images, options.names.as_deref(), &mut |image, reason| {
        skip(image, reason, watch)
    })?;
    // An empty file is what SQLite takes for an empty database.
    let is_there = database.metadata().is_ok_and(|found| found.len() > 0);
    let mut database = if is_there { open_to_add(database)? } else { Database::create(database)? };
    let existing = read_existing(&database)?;
    let (pending, mut kept): (Vec<usize>, Vec<usize>) = chosen.into_iter().partition(|&index| {
        existing.get(folder.images()[index].name.as_str()).is_none_or(|found| !found.1)
    });
    for (index, reason) in of_other_size(&database, &folder, &existing, &kept)? {
        kept.retain(|other| *other != index);
        skip(&folder.images()[index].name, &reason, watch)?;
    }
    let (total, done) = (pending.len() + kept.len(), kept.len());
    emit(watch, &Event::StageBegan { stage: Stage::Features, total, done })?;
    let mut cameras = Cameras::new(&database, options)?;
    let infos: Vec<_> = pending.par_iter().map(|&index| folder.info(index)).collect();
    let mut tasks: Vec<Task> = Vec::new();
    for (index, info) in pending.into_iter().zip(infos) {
        let image = &folder.images()[index];
        let found = existing.get(image.name.as_str());
        let task = info.map_err(|cause| cause.to_string()).and_then(|info| {
            let camera = match found {
                Some(_) => None,
                None => Some(cameras.of_image(index, image.camera.index(), &image.name, &info)?),
            };
            Ok(Task { index, existing: found.map(|found| found.0), camera, info })
        });
        match task {
            Ok(task) => tasks.push(task),
            Err(reason) => skip(&image.name, &reason, watch)?,
        }
    }
    let (extractor, most) = (&*options.extractor, options.max_image_size);
    let work = |task: &Task| extract_photo(extractor, &folder, task.index, most);
    let (mut taken_images, mut keypoints) = (0, 0);
    let taken = for_each_within_budget(
        budget_bytes(),
        |task| memory_of(extractor, &task.info),
        &tasks,
        work,
        |task, found: Result<Features, Error>| {
            let image = folder.images()[task.index].name.as_str();
            let features = match found {
                Ok(features) => features,
                Err(cause) => return skip(image, &cause.to_string(), watch),
            };
            match (task.existing, task.camera) {
                (Some(id), _) => database.write_features([(id, &features)])?,
                (None, Some(key)) => cameras.append(&mut database, key, image, &features)?,
                (None, None) => {}
            }
            taken_images += 1;
            keypoints += features.keypoints.len();
            emit(watch, &Event::ImageDone { image, keypoints: features.keypoints.len() })
        },
    );
    database.close()?;
    taken?;
    let seconds = start.elapsed().as_secs_f64();
    emit(watch, &Event::StageDone { stage: Stage::Features, seconds })?;
    let cameras = cameras.added;
    Ok(Extracted { images: taken_images, kept: kept.len(), keypoints, cameras, seconds, ..result })
}

/// The indices of the images to take.
fn chosen(
    folder: &ImageFolder,
    path: &Path,
    names: Option<&[String]>,
    skip: &mut dyn FnMut(&str, &str) -> Result<(), Error>,
) -> Result<Vec<usize>, Error> {
    let all = folder.images();
    let chosen: Vec<usize> = match names {
        None => (0..all.len()).collect(),
        Some(names) => {
            let asked: BTreeSet<&str> = names.iter().map(String::as_str).collect();
            let there: BTreeSet<&str> = all.iter().map(|image| image.name.as_str()).collect();
            for name in asked.difference(&there) {
                skip(name, &format!("{name}: there is no such image in {}", path.display()))?;
            }
            (0..all.len()).filter(|&index| asked.contains(all[index].name.as_str())).collect()
        }
    };
    if chosen.is_empty() {
        let what = match folder.skipped().first() {
            Some(file) => format!("holds no images that can be used; first {}", file.reason),
            None => "holds no images (JPEG, PNG, TIFF, WebP, BMP or PNM) to extract features of"
                .to_owned(),
        };
        return Err(Error::Colmap { path: path.to_owned(), what });
    }
    Ok(chosen)
}

/// The images of a database by their names, and whether they have features.
fn read_existing(database: &Database) -> Result<BTreeMap<String, (ImageId, bool)>, Error> {
    let counts = database.keypoint_counts()?;
    let images = database.read_images()?.into_iter().zip(counts).enumerate();
    Ok(images
        .map(|(index, (image, count))| (image.name, (ImageId::from_index(index), count.is_some())))
        .collect())
}

/// The images whose features in the database are of another size, and what to do. Another image has
/// taken the name.
fn of_other_size(
    database: &Database,
    folder: &ImageFolder,
    existing: &BTreeMap<String, (ImageId, bool)>,
    kept: &[usize],
) -> Result<Vec<(usize, String)>, Error> {
    let (images, cameras) = (database.read_images()?, database.read_cameras()?);
    let other = |&index: &usize| {
        let name = &folder.images()[index].name;
        let camera = &cameras[images[existing.get(name)?.0.index()].camera.index()];
        let info = folder.info(index).ok()?;
        let (is, was) = ((info.width, info.height), (camera.width, camera.height));
        (is != was).then(|| {
            let reason = format!(
                "{name}: has {} x {} pixels, and the features of this name in the database are of \
                {} x {}: give another --database_path",
                is.0, is.1, was.0, was.1
            );
            (index, reason)
        })
    };
    Ok(kept.par_iter().filter_map(other).collect())
}

/// An image to extract.
struct Task {
    /// Index in the folder.
    index: usize,
    /// The image of the database that has no features yet.
    existing: Option<ImageId>,
    /// Number of the camera in [`Cameras`].
    camera: Option<usize>,
    info: ImageInfo,
}

/// What the images of a camera have in common.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    All,
    Folder(usize),
    Image(usize),
    Exif(String, u32, u32),
}

/// The cameras of new images. A camera is written with the first image that has it.
struct Cameras<'a> {
    options: &'a ExtractOptions,
    numbers: BTreeMap<Key, usize>,
    cameras: Vec<Camera>,
    /// The camera of the database, once it is there.
    written: Vec<Option<CameraId>>,
    added: usize,
}

impl<'a> Cameras<'a> {
    fn new(database: &Database, options: &'a ExtractOptions) -> Result<Self, Error> {
        let mut this = Self {
            options,
            numbers: BTreeMap::new(),
            cameras: Vec::new(),
            written: Vec::new(),
            added: 0,
        };
        if let SharedCamera::Existing(id) = options.cameras {
            let ids = database.camera_file_ids();
            let index = ids.binary_search(&id).map_err(|_| Error::Colmap {
                path: database.path().to_owned(),
                what: format!("has no camera {id}: give the id of one that it has"),
            })?;
            this.numbers.insert(Key::All, 0);
            this.cameras.push(database.read_cameras()?[index]);
            this.written.push(Some(CameraId::from_index(index)));
        }
        Ok(this)
    }

    /// The number of the camera of an image; an error says why it cannot have it.
    fn of_image(
        &mut self,
        index: usize,
        folder: usize,
        name: &str,
        info: &ImageInfo,
    ) -> Result<usize, String> {
        let key = match self.options.cameras {
            SharedCamera::Single | SharedCamera::Existing(_) => Key::All,
            SharedCamera::Folder => Key::Folder(folder),
            SharedCamera::Image => Key::Image(index),
            SharedCamera::Exif => {
                let exif = &info.exif;
                let device = &exif.device;
                if device.model.is_none() {
                    Key::Image(index)
                } else {
                    let text = format!("{device:?} {:?} {:?}", exif.focal_mm, exif.focal_35mm);
                    Key::Exif(text, info.width, info.height)
                }
            }
        };
        if let Some(&number) = self.numbers.get(&key) {
            let camera = &self.cameras[number];
            if (camera.width, camera.height) != (info.width, info.height) {
                return Err(format!(
                    "{name}: has {} × {} pixels, and the camera that it is to share has {} × {}",
                    info.width, info.height, camera.width, camera.height
                ));
            }
            return Ok(number);
        }
        let camera = self.new_camera(info);
        self.numbers.insert(key, self.cameras.len());
        self.cameras.push(camera);
        self.written.push(None);
        Ok(self.cameras.len() - 1)
    }

    fn new_camera(&self, info: &ImageInfo) -> Camera {
        let ImageInfo { width, height, ref exif, .. } = *info;
        let ExtractOptions { model, params, focal_factor, .. } = *self.options;
        if let Some(intrinsics) = params {
            return Camera { intrinsics, width, height, has_focal_prior: true };
        }
        let known = exif.focal_px(width, height, None);
        let focal_px = known.unwrap_or(focal_factor * f64::from(width.max(height)));
        let intrinsics = Intrinsics::centred(model, focal_px, width, height);
        Camera { intrinsics, width, height, has_focal_prior: known.is_some() }
    }

    /// Writes an image, and its camera before it if it is the first.
    fn append(
        &mut self,
        database: &mut Database,
        number: usize,
        name: &str,
        features: &Features,
    ) -> Result<(), Error> {
        let known = self.written[number];
        let id = known.unwrap_or_else(|| CameraId::from_index(database.num_cameras()));
        let new = known.is_none().then_some(&self.cameras[number]);
        database.append_image(new, &Image::new(name, id, Vec::new()), features)?;
        self.added += usize::from(known.is_none());
        self.written[number] = Some(id);
        Ok(())
    }
}
