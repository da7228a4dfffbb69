//! The photos of a model, and their masks.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tiepoint_dense::undistort::Undistortion;
use tiepoint_input::fingerprint::of_photo;
use tiepoint_input::{ImageFolder, Luma, Rgb};
use tiepoint_io::database::Database;
use tiepoint_sfm::scene::{Camera, Image, Reconstruction};

use crate::Error;
use crate::workspace::folder::{DATABASE, current_records, is_workspace};
use crate::workspace::located_model::LocatedModel;

/// The photos of the registered images of a model, by name.
pub(crate) struct ModelPhotos {
    folder: ImageFolder,
    /// Index of a photo in the folder.
    index_of: BTreeMap<String, usize>,
}

impl ModelPhotos {
    /// The inputs of the workspace that a model is in. The masks are where `reconstruct --masks`
    /// asks for them.
    ///
    /// # Errors
    ///
    /// The model is in no workspace, a photo is gone, or there is no mask.
    pub(crate) fn of_workspace(model: &LocatedModel, masks: Option<&Path>) -> Result<Self, Error> {
        let Some(root) = model.workspace() else {
            return Err(Error::NoPhotos { path: model.folder().to_owned() });
        };
        let model = &model.reconstruction;
        let inputs = current_records(root)?.inputs;
        if let Some(path) = inputs.iter().find(|input| !input.exists()) {
            return Err(Error::MovedPhotos { path: path.clone() });
        }
        let this = Self::new(ImageFolder::open(&inputs, masks)?);
        for (_, image, _) in model.registered() {
            if !this.index_of.contains_key(&image.name) {
                return Err(Error::NoPhoto { image: image.name.clone(), inputs });
            }
        }
        let known = fingerprints_of(root)?;
        let photos: Vec<&str> =
            model.registered().map(|(_, image, _)| image.name.as_str()).collect();
        photos.par_iter().try_for_each(|image| match known.get(*image) {
            Some(known) if !is_unchanged(this.path(image), known) => {
                Err(Error::ChangedPhoto { path: this.path(image).to_owned() })
            }
            _ => Ok(()),
        })?;
        Ok(this)
    }

    /// The files below a folder that have the names of the images.
    ///
    /// # Errors
    ///
    /// A photo is not there, or there is no mask.
    pub(crate) fn below(
        folder: &Path,
        model: &Reconstruction,
        masks: Option<&Path>,
    ) -> Result<Self, Error> {
        let names = model.registered().map(|(_, image, _)| image.name.as_str());
        Ok(Self::new(ImageFolder::of_names(folder, names, masks)?))
    }

    fn new(folder: ImageFolder) -> Self {
        let images = folder.images().iter().enumerate();
        let index_of = images.map(|(index, image)| (image.name.clone(), index)).collect();
        // The size of a photo is that of its camera, whatever it is.
        Self { folder: folder.with_max_pixels(u64::MAX), index_of }
    }

    /// Takes the pixels of photos and masks as they are stored.
    pub(crate) fn with_stored_pixels(self) -> Self {
        Self { folder: self.folder.with_stored_pixels(), ..self }
    }

    /// The undistorted image of a photo.
    ///
    /// # Errors
    ///
    /// The photo cannot be read or has another size than its camera.
    pub(crate) fn undistorted(
        &self,
        image: &str,
        undistortion: &Undistortion,
    ) -> Result<Rgb, Error> {
        let from = undistortion.from();
        let rgb = self.folder.rgb_of_size(self.index_of[image], from.width, from.height)?;
        undistorted_image(self.path(image), &rgb, undistortion)
    }

    /// The undistorted grey image of a photo.
    ///
    /// # Errors
    ///
    /// The photo cannot be read or has another size than its camera.
    pub(crate) fn undistorted_grey(
        &self,
        image: &str,
        undistortion: &Undistortion,
    ) -> Result<Luma, Error> {
        let luma = self.folder.luma(self.index_of[image])?;
        let data = undistortion
            .image::<1>(&luma.data)
            .map_err(|cause| Error::Dense { path: self.path(image).to_owned(), cause })?;
        let to = undistortion.to();
        Ok(Luma { width: to.width, height: to.height, data })
    }

    /// The file of a registered image's photo.
    pub(crate) fn path(&self, image: &str) -> &Path {
        self.folder.path(self.index_of[image])
    }

    /// The files of all photos and masks of the registered images.
    pub(crate) fn files<'a>(&'a self, model: &'a Reconstruction) -> impl Iterator<Item = &'a Path> {
        let indices = model.registered().map(|(_, image, _)| self.index_of[&image.name]);
        indices.flat_map(|index| {
            [Some(self.folder.path(index)), self.folder.mask_path(index)].into_iter().flatten()
        })
    }

    /// Checks, by the headers alone, that all photos have the sizes of their cameras, and all masks
    /// those of their photos.
    ///
    /// # Errors
    ///
    /// One has not, or cannot be read.
    pub(crate) fn check_sizes(&self, model: &Reconstruction) -> Result<(), Error> {
        for (_, image, _) in model.registered() {
            let camera = model.camera(image.camera);
            let index = self.index_of[&image.name];
            self.folder.check_size(index, camera.width, camera.height)?;
            self.folder.check_mask(index)?;
        }
        Ok(())
    }

    /// The mask of a photo, 0 where it is not used. `None` for a photo without a mask.
    ///
    /// # Errors
    ///
    /// The mask cannot be read, or has another size than its photo.
    pub(crate) fn mask(&self, image: &str) -> Result<Option<Luma>, Error> {
        Ok(self.folder.mask(self.index_of[image])?)
    }
}

/// The fingerprints of the photos that the features of a workspace are of, by the names of the
/// images. With features that another program made, those of the photos when these were taken over.
///
/// # Errors
///
/// The database cannot be read.
pub fn fingerprints_of(root: &Path) -> Result<BTreeMap<String, String>, Error> {
    let database = root.join(DATABASE);
    if !database.is_file() {
        return Ok(BTreeMap::new());
    }
    Ok(Database::open_read_only(&database)?.read_photo_fingerprints()?)
}

/// Whether a photo has a fingerprint. A photo that cannot be read is reported by what reads it.
pub fn is_unchanged(photo: &Path, known: &str) -> bool {
    of_photo(photo).map_or(true, |found| found == known)
}

/// The registered images of a model, with the files of their photos: below the folder `images`, or
/// the inputs of the workspace that the model is in.
///
/// # Errors
///
/// Those of [`ModelPhotos::below`] and [`ModelPhotos::of_workspace`].
pub(crate) fn photos_of<'a>(
    located: &'a LocatedModel,
    images: Option<&Path>,
) -> Result<Vec<(&'a Image, PathBuf)>, Error> {
    let model = &located.reconstruction;
    let photos = match images {
        Some(images) => ModelPhotos::below(images, model, None)?,
        None => ModelPhotos::of_workspace(located, None)?,
    };
    let photo = |image: &'a Image| (image, photos.path(&image.name).to_owned());
    Ok(model.registered().map(|(_, image, _)| photo(image)).collect())
}

/// Checks, by the headers alone, that photos have the sizes of their cameras. First of all, as the
/// size of a camera decides how long its undistortion takes.
///
/// # Errors
///
/// One has not, or cannot be read.
pub(crate) fn check_sizes(
    photos: &[(&Image, PathBuf)],
    model: &Reconstruction,
) -> Result<(), Error> {
    photos.par_iter().try_for_each(|(image, path)| {
        let camera = model.camera(image.camera);
        Ok(Rgb::check_size(path, camera.width, camera.height)?)
    })
}

/// Writes the undistorted image of a photo.
///
/// # Errors
///
/// The photo cannot be read or has another size than its camera, or writing fails.
pub(crate) fn write_undistorted(
    photo: &Path,
    undistortion: &Undistortion,
    target: &Path,
) -> Result<(), Error> {
    let from = undistortion.from();
    let rgb = Rgb::read_of_size(photo, from.width, from.height)?;
    Ok(undistorted_image(photo, &rgb, undistortion)?.write(target)?)
}

/// The undistorted image of a photo with these pixels.
///
/// # Errors
///
/// It has another size than its camera.
fn undistorted_image(photo: &Path, rgb: &Rgb, undistortion: &Undistortion) -> Result<Rgb, Error> {
    let to = undistortion.to();
    let data = undistortion
        .image::<3>(&rgb.data)
        .map_err(|cause| Error::Dense { path: photo.to_owned(), cause })?;
    Ok(Rgb { width: to.width, height: to.height, data })
}

/// The mask of a photo as its undistorted image sees it: 255 where the image is used, and else 0.
/// `None` for `mask` gives the mask of the pixels with a source.
///
/// # Errors
///
/// The mask has another size than the camera of its photo.
pub(crate) fn undistorted_mask(
    photo: &Path,
    mask: Option<&Luma>,
    undistortion: &Undistortion,
) -> Result<Luma, Error> {
    let data = undistortion
        .mask(mask.map(|mask| mask.data.as_slice()))
        .map_err(|cause| Error::Dense { path: photo.to_owned(), cause })?;
    let to = undistortion.to();
    Ok(Luma { width: to.width, height: to.height, data })
}

/// Memory for decoding a colour image, in bytes per pixel; a progressive JPEG file takes most.
pub(crate) const DECODER_BYTES_PER_PIXEL: u64 = 12;

/// Memory for decoding a photo of a camera, in bytes.
pub fn decoder_bytes(camera: &Camera) -> u64 {
    // A camera of a foreign model may have any size in its file.
    (DECODER_BYTES_PER_PIXEL * u64::from(camera.width))
        .saturating_mul(u64::from(camera.height))
        .min(1 << 48)
}

/// The input folders of a workspace; `None` if the folder is no workspace or its records are
/// damaged.
pub fn inputs_of(root: &Path) -> Option<Vec<PathBuf>> {
    let records = is_workspace(root).then(|| current_records(root).ok()).flatten();
    records.map(|records| records.inputs)
}
