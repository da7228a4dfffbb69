//! Poses of photos in an existing model. Neither the model nor its workspace is changed.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_input::cameras::{Calibration, CalibrationSource, Calibrations};
use tiepoint_input::{DEFAULT_MAX_PIXELS, Exif, ImageFolder, ImageInfo};
use tiepoint_io::colmap::Format;
use tiepoint_io::database::Database;
use tiepoint_io::features::{Extractor, Features, SiftExtractor};
use tiepoint_sfm::convert::keypoint;
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::retrieval::{RetrievalIndex, Vocabulary};
use tiepoint_sfm::matching::{Matcher, NearestNeighbours, PreparedImages};
use tiepoint_sfm::model_tools::transfer_model;
use tiepoint_sfm::register::{Localization, QueryCamera, RegisterOptions, localize_image};
use tiepoint_sfm::scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, ImagePair, Observation, Reconstruction,
};
use tiepoint_sfm::tracks::FilterOptions;
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions};
use tiepoint_store::Error as StoreError;

use crate::stages::extraction::extract_photo;
use crate::stages::pair_choice::learn_retrieval;
use crate::stages::verification::{match_pairs, verify};
use crate::workspace::database_scene::read_scene;
use crate::workspace::folder::{DATABASE, current_records, is_workspace};
use crate::workspace::format::path_text;
use crate::workspace::located_model::LocatedModel;
use crate::workspace::model_output::write_colmap;
use crate::workspace::option_names::EXTRACTOR;
use crate::{Error, Event, Stage, Watch, emit};

/// Up to this number of images of the model, a photo is matched with all; above it, with this
/// number of the most similar ones. hloc retrieves as many.
const MAX_IMAGES: usize = 50;
/// Cameras of the model that a photo is tried with, those of most images first.
const MAX_CAMERAS: usize = 4;
/// Cameras of the model, those of most images first, whose photos are opened for their EXIF data: a
/// model of single photos has a camera for each.
const MAX_EXIF_CAMERAS: usize = 256;
/// Images of the model that are kept in memory, of 1.4 MiB each with 8192 features.
const MAX_LOADED: usize = 256;

/// Options of [`localize`].
#[derive(Clone, Debug)]
pub struct LocalizeOptions {
    /// Known intrinsics of all photos; of unknown ones the model of the camera and the initial
    /// focal length.
    pub calibration: Calibration,
    /// Files of known calibrations.
    pub calibration_files: Vec<CalibrationSource>,
    /// Folder of masks; no keypoints are detected where a mask is 0.
    pub masks: Option<PathBuf>,
    /// Features are those of photos that are reduced to this larger side, in pixels.
    pub max_size: Option<u32>,
    /// Photos with more pixels are skipped.
    pub max_pixels: u64,
    /// What detects and describes keypoints; that of the model's features.
    pub extractor: Arc<dyn Extractor>,
    /// What matches descriptors.
    pub matcher: Arc<dyn Matcher>,
    /// Options of geometric verification.
    pub verify: VerifyOptions,
    /// Options of the absolute pose.
    pub register: RegisterOptions,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            calibration: Calibration::default(),
            calibration_files: Vec::new(),
            masks: None,
            max_size: None,
            max_pixels: DEFAULT_MAX_PIXELS,
            extractor: Arc::new(SiftExtractor::default()),
            matcher: Arc::new(NearestNeighbours::default()),
            verify: VerifyOptions::default(),
            register: RegisterOptions::default(),
            seed: 0,
        }
    }
}

/// The result of [`localize`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LocalizeReport {
    /// The folder of the model with the photos.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// Number of photos with a pose.
    pub localized: usize,
    /// Wall time.
    pub seconds: f64,
    /// The photos, in the order of their names.
    pub photos: Vec<LocalizedPhoto>,
}

/// A photo, with its pose if one was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LocalizedPhoto {
    /// Its name, relative to the input.
    pub image: String,
    /// Number of keypoints that observe a point of the model.
    pub inliers: usize,
    /// Number of correspondences between keypoints and points before the estimation.
    pub correspondences: usize,
    /// The pose; `None` if none was found.
    pub pose: Option<PhotoPose>,
    /// Why there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// The pose of a photo in the frame of the model, and its camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhotoPose {
    /// Rotation of cam_from_world, a Hamilton quaternion.
    pub rotation_wxyz: [f64; 4],
    /// Translation of cam_from_world, in units of the model.
    pub translation: [f64; 3],
    /// COLMAP's name of the camera model.
    pub camera_model: &'static str,
    /// Parameters of the camera, in pixels.
    pub camera_params: Vec<f64>,
    /// Where the camera comes from.
    pub camera_source: CameraSource,
}

/// Where the intrinsics of a photo come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraSource {
    /// A file of calibrations, or intrinsics of the command line.
    Calibration,
    /// A camera of the model.
    Model,
    /// The focal length was estimated with the pose.
    Estimated,
}

/// Estimates the poses of photos in a model, and writes the model with them to `output`: its own
/// images, points and intrinsics stay as they are. It must be in a folder with the `database.db` of
/// its features. Photos are compared with the images that the database has features of.
///
/// The intrinsics of a photo are those of a calibration, else those of a camera of the model whose
/// photos have the same size and the same body, lens and focal length in EXIF, as far as they can
/// be read; else the focal length is estimated with the pose.
///
/// # Errors
///
/// There is no database with features; these are of another extractor; there are more than 50
/// images without SIFT descriptors; the photos or a calibration cannot be read; `output` holds
/// files of others or the model; `watch` returns `Break`.
pub fn localize(
    model: &LocatedModel,
    inputs: &[PathBuf],
    output: &Path,
    options: &LocalizeOptions,
    watch: Watch,
) -> Result<LocalizeReport, Error> {
    let start = Instant::now();
    options.verify.validate()?;
    options.register.validate()?;
    let photos = ImageFolder::open(inputs, options.masks.as_deref())?;
    let photos = photos.with_max_pixels(options.max_pixels);
    let calibrations = Calibrations::read(&options.calibration_files, &photos)?;
    let mut map = ReferenceModel::open(model, options)?;
    let mut inputs = model.files();
    inputs.push(map.database_file.clone());
    inputs.extend((0..photos.images().len()).map(|index| photos.path(index).to_owned()));
    refuse_inside(output, &map)?;
    let mut report =
        LocalizeReport { path: output.to_owned(), localized: 0, seconds: 0.0, photos: Vec::new() };
    for file in photos.skipped() {
        emit(watch, &Event::ImageSkipped { image: &file.name, reason: &file.reason })?;
        report.photos.push(LocalizedPhoto::without_pose(&file.name, 0, file.reason.clone()));
    }
    let mut localized: Vec<(ImageId, Localization)> = Vec::new();
    for (index, photo) in photos.images().iter().enumerate() {
        let name = photo.name.as_str();
        let found = map.query(&photos, index, &calibrations, options);
        let found = found.and_then(|query| match query {
            Ok(query) => map.localize(&query, options).map(|found| Ok((query, found))),
            Err(reason) => Ok(Err(reason)),
        })?;
        let entry = match found {
            Err(reason) => LocalizedPhoto::without_pose(name, 0, reason),
            Ok((_, Err(correspondences))) => {
                let reason = format!(
                    "too few of {correspondences} correspondences fit a pose: {} are needed",
                    options.register.min_num_inliers
                );
                LocalizedPhoto::without_pose(name, correspondences, reason)
            }
            Ok((query, Ok(found))) => {
                let entry = LocalizedPhoto::new(name, &query, &found);
                localized.push((query.image, found));
                entry
            }
        };
        emit(watch, &Event::ImageLocalized { image: name, inliers: entry.inliers })?;
        report.photos.push(entry);
    }
    report.photos.sort_by(|a, b| a.image.cmp(&b.image));
    report.localized = localized.len();
    map.add(localized);
    write_colmap(output, &map.scene, Format::Binary, None, &inputs)?;
    report.seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

/// Checks that the output is not the folder of the model or of its database.
fn refuse_inside(output: &Path, map: &ReferenceModel) -> Result<(), Error> {
    let Ok(output) = output.canonicalize() else { return Ok(()) };
    let folders = [Some(map.folder.as_path()), map.database_file.parent()];
    let is_input = |folder: &Path| folder.canonicalize().is_ok_and(|folder| folder == output);
    if folders.into_iter().flatten().any(is_input) {
        return Err(StoreError::IsInput { path: output }.into());
    }
    Ok(())
}

impl LocalizedPhoto {
    fn without_pose(image: &str, correspondences: usize, reason: String) -> Self {
        let image = image.to_owned();
        Self { image, inliers: 0, correspondences, pose: None, reason: Some(reason) }
    }

    fn new(image: &str, query: &Query, found: &Localization) -> Self {
        let q = found.cam_from_world.rotation;
        Self {
            image: image.to_owned(),
            inliers: found.inliers.len(),
            correspondences: found.num_candidates,
            pose: Some(PhotoPose {
                rotation_wxyz: [q.w, q.i, q.j, q.k],
                translation: found.cam_from_world.translation.into(),
                camera_model: found.intrinsics.kind().name(),
                camera_params: found.intrinsics.params().to_vec(),
                camera_source: query.cameras[found.camera].1,
            }),
            reason: None,
        }
    }
}

/// A photo in the scene.
struct Query {
    image: ImageId,
    features: Features,
    cameras: Vec<(QueryCamera, CameraSource)>,
}

/// The model with its features.
struct ReferenceModel {
    folder: PathBuf,
    database_file: PathBuf,
    database: Database,
    /// The images of the database with the poses and points of the model, then the photos.
    scene: Reconstruction,
    /// The images with points.
    posed: Vec<ImageId>,
    /// Cameras of the model, those of most images first, with what is known of their photos.
    cameras: Vec<(CameraId, Option<ExifKey>)>,
    retrieval: Option<(Vocabulary, RetrievalIndex)>,
    /// The images in memory.
    loaded: BTreeSet<ImageId>,
    images: Box<dyn PreparedImages>,
}

/// What the photos of a camera have in common: the body, the lens and its setting.
#[derive(Clone, Debug, PartialEq)]
struct ExifKey {
    device: tiepoint_input::images::Device,
    setting: [Option<f64>; 3],
}

impl ExifKey {
    fn new(exif: &Exif) -> Self {
        let setting = [exif.focal_mm, exif.focal_35mm, exif.digital_zoom];
        Self { device: exif.device.clone(), setting }
    }
}

impl ReferenceModel {
    fn open(located: &LocatedModel, options: &LocalizeOptions) -> Result<Self, Error> {
        let folder = located.folder().to_owned();
        // The model may be that of `sparse/0` or of another folder with a database.
        let root = folder.ancestors().take(3).find(|root| root.join(DATABASE).is_file());
        let Some(root) = root else {
            return Err(Error::NoModelDatabase { path: folder });
        };
        let database_file = root.join(DATABASE);
        let database = Database::open_read_only(&database_file)?;
        require_features_of(&database, root, &*options.extractor)?;
        let scene = read_scene(&database)?;
        let num_images = scene.num_images();
        let model = &located.reconstruction;
        let found = transfer_model(&scene, model)
            .map_err(|cause| Error::InputModel { path: folder.clone(), cause })?;
        let scene = found.scene;
        let is_posed = |id: &ImageId| id.index() < num_images && scene.image(*id).num_points() > 0;
        let posed: Vec<ImageId> = found.existing.into_iter().filter(is_posed).collect();
        if posed.is_empty() {
            return Err(Error::InputModel {
                path: folder,
                cause: tiepoint_sfm::Error::NothingToExtend { images: model.num_registered() },
            });
        }
        let retrieval = match posed.len() > MAX_IMAGES {
            true => Some(learn_retrieval(&database, &posed, options.seed)?),
            false => None,
        };
        let cameras = exif_of_cameras(root, &scene);
        let (loaded, images) = (BTreeSet::new(), options.matcher.images());
        Ok(Self {
            folder,
            database_file,
            database,
            scene,
            posed,
            cameras,
            retrieval,
            loaded,
            images,
        })
    }

    /// Adds a photo to the scene. The inner error says why it cannot be used.
    fn query(
        &mut self,
        photos: &ImageFolder,
        index: usize,
        calibrations: &Calibrations,
        options: &LocalizeOptions,
    ) -> Result<Result<Query, String>, Error> {
        let name = photos.images()[index].name.as_str();
        let there = self.scene.images().find(|(_, image)| image.name == name);
        if there.is_some_and(|(_, image)| image.cam_from_world().is_some()) {
            let reason = "an image of this name has a pose in the model; if it is another photo, \
                rename it";
            return Ok(Err(reason.to_owned()));
        }
        let info = match photos.info(index) {
            Ok(info) => info,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let cameras = self.cameras_of(name, index, &info, calibrations, options)?;
        // Not the features of the database, whose image of this name may be another photo.
        let (extractor, most) = (&*options.extractor, options.max_size);
        let features = match extract_photo(extractor, photos, index, most) {
            Ok(features) => features,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let ImageInfo { width, height, .. } = info;
        let first = cameras[0].0;
        let camera = self.scene.add_camera(Camera {
            intrinsics: first.intrinsics,
            width,
            height,
            has_focal_prior: first.is_focal_known,
        });
        let keypoints = features.keypoints.iter().map(keypoint).collect();
        let image = self.scene.add_image(Image::new(name, camera, keypoints));
        Ok(Ok(Query { image, features, cameras }))
    }

    /// The cameras that a photo may have been taken with.
    fn cameras_of(
        &self,
        name: &str,
        index: usize,
        info: &ImageInfo,
        calibrations: &Calibrations,
        options: &LocalizeOptions,
    ) -> Result<Vec<(QueryCamera, CameraSource)>, Error> {
        let known = |intrinsics, source| (QueryCamera { intrinsics, is_focal_known: true }, source);
        if let Some(calibration) = calibrations.of_image(index) {
            let camera = calibrations.camera(calibration, name, info)?;
            return Ok(vec![known(camera.intrinsics, CameraSource::Calibration)]);
        }
        if let Calibration::Known(_) = options.calibration {
            let camera = options.calibration.of_photo(name, info)?;
            return Ok(vec![known(camera.intrinsics, CameraSource::Calibration)]);
        }
        let key = ExifKey::new(&info.exif);
        let is_same = |(camera, known): &&(CameraId, Option<ExifKey>)| {
            let Camera { width, height, .. } = *self.scene.camera(*camera);
            (width, height) == (info.width, info.height)
                && known.as_ref().is_none_or(|known| *known == key)
        };
        let is_asked =
            matches!(options.calibration, Calibration::Unknown { focal_px: Some(_), .. });
        if !is_asked {
            let same = self.cameras.iter().filter(is_same).take(MAX_CAMERAS);
            let same: Vec<_> = same
                .map(|(camera, _)| {
                    known(self.scene.camera(*camera).intrinsics, CameraSource::Model)
                })
                .collect();
            if !same.is_empty() {
                return Ok(same);
            }
        }
        let intrinsics = options.calibration.of_photo(name, info)?.intrinsics;
        Ok(vec![(QueryCamera { intrinsics, is_focal_known: false }, CameraSource::Estimated)])
    }

    /// The pose of a photo; the inner error is the number of correspondences.
    fn localize(
        &mut self,
        query: &Query,
        options: &LocalizeOptions,
    ) -> Result<Result<Localization, usize>, Error> {
        let candidates = self.similar_images(query);
        self.load(&candidates)?;
        let own = query.image;
        self.images.insert(&[(own.0, &query.features)]).map_err(Error::Method)?;
        // The image of a photo comes behind those of the database.
        let pairs: Vec<ImagePair> =
            candidates.iter().filter_map(|image| ImagePair::new(*image, own)).collect();
        let count = |image: ImageId| self.scene.image(image).keypoints.len();
        let matched = match_pairs(&*self.images, &pairs, count)?;
        self.images.retain(&|image| image != own.0);
        let scene = &self.scene;
        let view = |image| ImageObservations {
            keypoints: &scene.image(image).keypoints,
            camera: scene.camera_of(image),
        };
        let two_views: Vec<_> = (pairs.par_iter().zip(matched))
            .map(|(pair, matches)| {
                (*pair, verify(*pair, view, &matches, &options.verify, options.seed))
            })
            .collect();
        let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
        let graph = CorrespondenceGraph::new(&counts, two_views);
        let cameras: Vec<QueryCamera> = query.cameras.iter().map(|(camera, _)| *camera).collect();
        let found = localize_image(
            &graph,
            &mut self.scene,
            query.image,
            &cameras,
            &options.register,
            FilterOptions::default().max_error_px,
            Rng::stream(options.seed, &[u64::from(query.image.0)]).next_u64(),
        );
        Ok(found.ok_or_else(|| graph.num_correspondences(query.image)))
    }

    /// The images that a photo is matched with.
    fn similar_images(&self, query: &Query) -> Vec<ImageId> {
        let Some((vocabulary, index)) = &self.retrieval else { return self.posed.clone() };
        let described =
            vocabulary.describe(query.features.descriptors.as_sift().unwrap_or_default());
        let mut similar: Vec<ImageId> = index
            .most_similar(&described, MAX_IMAGES, |_| true)
            .into_iter()
            .map(|found| self.posed[found.image as usize])
            .collect();
        similar.sort_unstable();
        similar
    }

    /// Loads the features of images of the database.
    fn load(&mut self, images: &[ImageId]) -> Result<(), Error> {
        if self.loaded.len() + images.len() > MAX_LOADED {
            self.loaded.retain(|image| images.contains(image));
            self.images.retain(&|image| images.contains(&ImageId(image)));
        }
        for &image in images {
            if !self.loaded.contains(&image) {
                let features = self.database.read_features(image)?;
                self.images.insert(&[(image.0, &features)]).map_err(Error::Method)?;
                self.loaded.insert(image);
            }
        }
        Ok(())
    }

    /// Registers the photos with a pose.
    fn add(&mut self, localized: Vec<(ImageId, Localization)>) {
        for (image, found) in localized {
            let camera = self.scene.image(image).camera;
            self.scene.camera_mut(camera).intrinsics = found.intrinsics;
            self.scene.register(image, found.cam_from_world);
            for (keypoint, point) in found.inliers {
                self.scene.add_observation(point, Observation { image, keypoint });
            }
        }
    }
}

/// Checks that the features of a database are those of an extractor, as far as the database and the
/// records beside it tell.
fn require_features_of(
    database: &Database,
    root: &Path,
    extractor: &dyn Extractor,
) -> Result<(), Error> {
    let path = database.path().to_owned();
    if let Some(image) = database.image_without_descriptors()? {
        return Err(Error::NoDescriptors { path, image });
    }
    let records = is_workspace(root).then(|| current_records(root).ok()).flatten();
    let (key, built_in) = EXTRACTOR;
    let name = records.as_ref().map(|all| all.option(Stage::Features, key).unwrap_or(built_in));
    let (found, asked) = (database.descriptor_format()?, extractor.format());
    let (found, asked) = match name {
        _ if found != asked => (found.to_string(), asked.to_string()),
        Some(name) if name != extractor.name() => (name.to_owned(), extractor.name().to_owned()),
        _ => return Ok(()),
    };
    Err(Error::OtherFeatures { path, found, asked })
}

/// The cameras of a model, those of most images first, and the facts in EXIF of a photo of each; of
/// a camera whose photos cannot be read nothing is known.
fn exif_of_cameras(root: &Path, scene: &Reconstruction) -> Vec<(CameraId, Option<ExifKey>)> {
    let records = is_workspace(root).then(|| current_records(root).ok()).flatten();
    let photos = records.and_then(|records| ImageFolder::open(&records.inputs, None).ok());
    let facts = |camera: CameraId| {
        let photos = photos.as_ref()?;
        let of_camera = |name: &str| {
            scene.registered().any(|(_, image, _)| image.camera == camera && image.name == name)
        };
        let index = photos.images().iter().position(|photo| of_camera(&photo.name))?;
        Some(ExifKey::new(&photos.info(index).ok()?.exif))
    };
    let count = |camera: CameraId| {
        scene.registered().filter(|(_, image, _)| image.camera == camera).count()
    };
    let mut cameras: Vec<(usize, CameraId)> =
        scene.cameras().map(|(camera, _)| (count(camera), camera)).collect();
    cameras.retain(|(count, _)| *count > 0);
    cameras.sort_by_key(|(count, camera)| (std::cmp::Reverse(*count), *camera));
    let known = |(order, (_, camera)): (usize, (usize, CameraId))| {
        (camera, if order < MAX_EXIF_CAMERAS { facts(camera) } else { None })
    };
    cameras.into_iter().enumerate().map(known).collect()
}
