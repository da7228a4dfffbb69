//! Masks of photos for the dense stage: pixels that get no depth.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tiepoint_dense::undistort::Undistortion;
use tiepoint_input::fingerprint::fingerprint;
use tiepoint_input::{ImageFolder, Luma};

use crate::Error;
use crate::workspace::model_photos::undistorted_mask;
use crate::workspace::records::Records;

/// The masks of the photos of a workspace.
pub(super) struct Masks {
    photos: ImageFolder,
    /// Index of a photo by its name.
    index_of: BTreeMap<String, usize>,
    /// Fingerprint of the files.
    pub(super) fingerprint: String,
}

impl Masks {
    /// Lists the masks in a folder, which has them as `reconstruct --masks` asks.
    ///
    /// # Errors
    ///
    /// A folder cannot be read, or there is no mask.
    pub(super) fn open(records: &Records, folder: &Path) -> Result<Self, Error> {
        // The feature stage has checked the photos against its limit.
        let photos = ImageFolder::open(&records.inputs, Some(folder))?.with_max_pixels(u64::MAX);
        let masks: [PathBuf; 1] = [folder.to_owned()];
        let fingerprint = fingerprint(&ImageFolder::open(&masks, None)?)?;
        let images = photos.images().iter().enumerate();
        let index_of = images.map(|(index, image)| (image.name.clone(), index)).collect();
        Ok(Self { photos, index_of, fingerprint })
    }

    /// Checks that the mask of a photo, if there is one, has its size.
    ///
    /// # Errors
    ///
    /// It has not, or cannot be read.
    pub(super) fn check(&self, photo: &str) -> Result<(), Error> {
        let Some(index) = self.index_of.get(photo) else { return Ok(()) };
        Ok(self.photos.check_mask(*index)?)
    }

    /// The mask of a photo as its undistorted image sees it: 255 where the image is used, and else
    /// 0. `None` for a photo without a mask.
    ///
    /// # Errors
    ///
    /// The mask cannot be read, or has another size than its photo.
    pub(super) fn undistorted(
        &self,
        photo: &str,
        undistortion: &Undistortion,
    ) -> Result<Option<Luma>, Error> {
        let Some(index) = self.index_of.get(photo) else { return Ok(None) };
        let Some(mask) = self.photos.mask(*index)? else { return Ok(None) };
        undistorted_mask(self.photos.path(*index), Some(&mask), undistortion).map(Some)
    }
}
