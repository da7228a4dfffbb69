//! The input photos of a workspace.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tiepoint_geometry::CameraModelKind;
use tiepoint_scene::{Camera, Position};
use tiepoint_store::escaped;

use super::calibration::Calibrations;
use super::grouping::{CameraGrouping, CameraNumbers, GroupedPhoto};
use crate::fingerprint::{fingerprint, of_photo};
use crate::images::{ImageFolder, ImageInfo, first_names};
use crate::{Error, Size};

/// An image that was skipped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct SkippedImage {
    /// Its name.
    pub image: String,
    /// The reason.
    pub reason: String,
    /// Number of further files that the reason holds for, and names.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub others: usize,
}

fn is_zero(number: &usize) -> bool {
    *number == 0
}

/// The files of the input photos; their contents are not read yet.
#[derive(Clone, Debug)]
pub struct Photos {
    /// The images of all inputs.
    pub folder: ImageFolder,
    /// The inputs, as absolute paths.
    pub inputs: Vec<PathBuf>,
    masks: Option<PathBuf>,
    /// What the report notes about them.
    pub notes: Vec<String>,
    /// Positions by name, of frames of videos, whose files have none.
    pub positions: BTreeMap<String, Position>,
}

/// A photo whose header could be read.
pub struct Photo {
    /// Index in [`Photos::folder`].
    pub index: usize,
    /// Index of its camera among the cameras with a usable photo.
    pub camera: usize,
    /// Number of its lens. Cameras of one lens differ in the size of their photos.
    pub lens: usize,
    /// Number of its known calibration.
    pub calibration: Option<usize>,
    /// Its size and EXIF data.
    pub info: ImageInfo,
}

impl Photos {
    /// Lists the photos of `inputs`: folders of images, or folders with one sub-folder per camera
    /// of a rig. `masks`: folder of masks; no keypoints are detected where a mask is 0.
    ///
    /// # Errors
    ///
    /// A folder cannot be read, or there are fewer than two photos.
    pub fn open(inputs: &[PathBuf], masks: Option<&Path>) -> Result<Self, Error> {
        let folder = ImageFolder::open(inputs, masks)?;
        // Absolute, so that a later run in another working directory finds them.
        let absolute =
            |path: &PathBuf| path.canonicalize().map_err(tiepoint_store::Error::unreadable(path));
        let photos = Self {
            notes: folder.notes().to_vec(),
            folder,
            inputs: inputs.iter().map(absolute).collect::<Result<_, _>>()?,
            masks: masks.map(Path::to_owned),
            positions: BTreeMap::new(),
        };
        let found = photos.folder.images().len();
        if found < 2 {
            let reason = photos.folder.skipped().iter().map(|file| file.reason.clone()).collect();
            return Err(photos.too_few(found, reason));
        }
        Ok(photos)
    }

    /// The same photos with a limit on their pixels; larger ones are skipped.
    pub fn with_max_pixels(&self, max_pixels: u64) -> Self {
        Self { folder: self.folder.clone().with_max_pixels(max_pixels), ..self.clone() }
    }

    /// [`Error::TooFewPhotos`] with the reasons why the others are skipped.
    pub fn too_few(&self, usable: usize, skipped: Vec<String>) -> Error {
        let path = self.inputs.first().cloned().unwrap_or_default();
        let others: usize = self.folder.skipped().iter().map(|file| 1 + file.others).sum();
        let found = self.folder.images().len() + others;
        Error::TooFewPhotos { path, found, usable, skipped }
    }

    /// Paths of the photos.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        (0..self.folder.images().len()).map(|index| self.folder.path(index))
    }

    /// The name of a photo.
    pub fn name(&self, photo: &Photo) -> &str {
        &self.folder.images()[photo.index].name
    }

    /// The name and the fingerprint of each of these photos; those that cannot be read are left
    /// out.
    pub fn fingerprints(&self, of: &[Photo]) -> Vec<(&str, String)> {
        let fingerprint =
            |photo: &Photo| Some((self.name(photo), of_photo(self.folder.path(photo.index)).ok()?));
        of.par_iter().filter_map(fingerprint).collect()
    }

    /// Fingerprint of all photos and masks.
    ///
    /// # Errors
    ///
    /// The folder of masks cannot be read.
    pub fn fingerprint(&self) -> Result<String, Error> {
        let photos = fingerprint(&self.folder)?;
        let Some(masks) = &self.masks else { return Ok(photos) };
        let masks = fingerprint(&ImageFolder::open(std::slice::from_ref(masks), None)?)?;
        Ok(format!("{photos} masked by {masks}"))
    }

    /// Names the photos without a time of folders of which most photos have one, a sentence each.
    pub fn notes_on_times(&self, photos: &[Photo], times_s: &[(&str, f64)]) -> Vec<String> {
        let timed: BTreeSet<&str> = times_s.iter().map(|(name, _)| *name).collect();
        let notes = self.folder.camera_names().iter().enumerate().filter_map(|(camera, folder)| {
            let names = photos.iter().map(|photo| &self.folder.images()[photo.index]);
            let names = names.filter(|image| image.camera.index() == camera);
            let (with, without): (Vec<&str>, Vec<&str>) =
                names.map(|image| image.name.as_str()).partition(|name| timed.contains(name));
            let (has, it) = match without.len() {
                0 => return None,
                count if count >= with.len() => return None,
                1 => ("photos has", "it"),
                _ => ("photos have", "them"),
            };
            let (count, all) = (without.len(), with.len() + without.len());
            let (names, folder) = (first_names(&without), escaped(Path::new(folder)));
            Some(format!(
                "{folder}: {count} of {all} {has} no time, and times pair no photo of another \
                camera with {it}: {names}; `features.timestamps` FILE gives times"
            ))
        });
        notes.collect()
    }

    /// Names the photos that say that they are panoramas and have a camera of another model.
    pub fn note_on_panoramas(&self, photos: &[Photo], cameras: &[Camera]) -> Option<String> {
        let is_flat = |photo: &&Photo| {
            photo.info.exif.is_panorama
                && cameras[photo.camera].intrinsics.kind() != CameraModelKind::Equirectangular
        };
        let names: Vec<&str> =
            photos.iter().filter(is_flat).map(|photo| self.name(photo)).collect();
        let shown = first_names(&names);
        (!names.is_empty()).then(|| {
            format!(
                "{} photos say that they are panoramas, which have no lens: {shown}; give \
                `features.camera_model` EQUIRECTANGULAR if all photos are panoramas all around, \
                and take them out of the folder if not",
                names.len()
            )
        })
    }

    /// Names the photos that are in the folder twice: the same bytes, or names that differ in their
    /// extension alone.
    pub fn notes_on_copies(&self, photos: &[Photo]) -> Vec<String> {
        let mut by_content: BTreeMap<String, Vec<&str>> = BTreeMap::new();
        for (name, fingerprint) in self.fingerprints(photos) {
            by_content.entry(fingerprint).or_default().push(name);
        }
        let mut by_stem: BTreeMap<(PathBuf, u32, u32), Vec<&str>> = BTreeMap::new();
        for photo in photos {
            let name = self.name(photo);
            let key = (Path::new(name).with_extension(""), photo.info.width, photo.info.height);
            by_stem.entry(key).or_default().push(name);
        }
        let pairs = |groups: Vec<Vec<&str>>, what: (&str, &str)| {
            let mut pairs: Vec<String> = groups
                .into_iter()
                .filter(|names| names.len() > 1)
                .map(|names| format!("{} and {}", names[0], names[1]))
                .collect();
            pairs.sort_unstable();
            let shown = first_names(&pairs.iter().map(String::as_str).collect::<Vec<_>>());
            let count = pairs.len();
            let (photos, what) =
                if count == 1 { ("photo is", what.0) } else { ("photos are", what.1) };
            (count > 0).then(|| {
                format!("{count} {photos} there twice{what}; the second one adds little: {shown}")
            })
        };
        let same = pairs(by_content.into_values().collect(), ("", ""));
        let of_one_name =
            pairs(by_stem.into_values().collect(), (" by its name", " by their names"));
        same.into_iter().chain(of_one_name).collect()
    }

    /// Reads the headers of all photos, and returns usable and skipped ones.
    ///
    /// # Errors
    ///
    /// Photos that `grouping` makes one camera differ in size, or fewer than two are usable.
    pub fn survey(
        &self,
        grouping: CameraGrouping,
        calibrations: &Calibrations,
    ) -> Result<(Vec<Photo>, Vec<SkippedImage>), Error> {
        let images = self.folder.images();
        let infos: Vec<_> =
            (0..images.len()).into_par_iter().map(|index| self.folder.info(index)).collect();
        let mut photos = Vec::<Photo>::new();
        let files = self.folder.skipped().iter();
        let mut skipped: Vec<SkippedImage> = files
            .map(|file| SkippedImage {
                image: file.name.clone(),
                reason: file.reason.clone(),
                others: file.others,
            })
            .collect();
        let folders = images.iter().map(|image| image.camera.index());
        let readable = folders
            .zip(&infos)
            .filter_map(|(folder, info)| info.as_ref().ok().map(|info| (folder, info)));
        let mut cameras = CameraNumbers::new(grouping, readable);
        // The first photo of each camera.
        let mut firsts: Vec<usize> = Vec::new();
        for (index, (image, info)) in images.iter().zip(infos).enumerate() {
            let info = match info {
                Ok(info) => info,
                Err(error) => {
                    skipped.push(SkippedImage {
                        image: image.name.clone(),
                        reason: error.to_string(),
                        others: 0,
                    });
                    continue;
                }
            };
            let calibration = calibrations.of_image(index);
            let (lens, camera) = cameras.of(&GroupedPhoto {
                index: photos.len(),
                folder: image.camera.index(),
                calibration,
                info: &info,
            });
            match firsts.get(camera) {
                None => firsts.push(photos.len()),
                Some(first) => {
                    let first = &photos[*first];
                    let size = |info: &ImageInfo| Size(info.width, info.height);
                    if size(&first.info) != size(&info) {
                        // The sizes of the photos are not those of the file.
                        if let Some(calibration) = calibration {
                            calibrations.camera(calibration, &image.name, &info)?;
                        }
                        return Err(Error::TwoSizes {
                            grouping,
                            first: self.name(first).to_owned(),
                            first_size: size(&first.info),
                            other: image.name.clone(),
                            other_size: size(&info),
                        });
                    }
                }
            }
            photos.push(Photo { index, camera, lens, calibration, info });
        }
        if photos.len() < 2 {
            return Err(
                self.too_few(photos.len(), skipped.into_iter().map(|photo| photo.reason).collect())
            );
        }
        Ok((photos, skipped))
    }
}
