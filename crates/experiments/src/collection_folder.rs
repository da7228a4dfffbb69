//! Renders a collection of photos to disk, as [`crate::render`] does a drive.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_pipeline::io::colmap::{Format, write_model};
use tiepoint_synth::{Collection, CollectionOptions, Photo};

use crate::drive_folder::{IMAGES_PER_THREAD, RECORD, RenderedCamera, claim};
use crate::{Error, Progress};

/// A collection on disk.
#[derive(Debug, Serialize)]
pub struct RenderedCollection {
    /// The folder of its photos.
    pub photos: PathBuf,
    /// The true model, for `evaluate poses --truth colmap:`.
    pub truth: PathBuf,
    /// Its cameras.
    pub cameras: Vec<RenderedCamera>,
}

impl RenderedCollection {
    /// The collection in a few lines of text.
    pub fn describe(&self) -> String {
        let cameras: String = self.cameras.iter().map(RenderedCamera::describe).collect();
        let (photos, truth) = (self.photos.display(), self.truth.display());
        format!("{cameras}truth     colmap:{truth}\nin {photos}\n")
    }
}

/// Renders the photos into `folder/photos` and writes the true model into `folder/truth/model`.
/// Existing photos are not rendered again.
///
/// # Errors
///
/// The options are out of range, the folder holds something else or cannot be written, or
/// `progress` stops the work.
pub fn render_collection(
    folder: &Path,
    options: &CollectionOptions,
    progress: &mut dyn Progress,
) -> Result<RenderedCollection, Error> {
    let collection = Collection::new(options).map_err(|error| match error {
        tiepoint_synth::Error::OutOfRange { .. } => Error::Usage(error.to_string()),
        _ => error.into(),
    })?;
    let record = format!("tiepoint {}: {options:?}\n", env!("CARGO_PKG_VERSION"));
    claim(folder, RECORD, &record, "a collection or a drive")?;
    let (photos, truth) = (folder.join("photos"), folder.join("truth/model"));
    write_model(&truth, &collection.truth(), Format::Binary)?;
    let (mut done, total) = (0, collection.photos().len());
    let mut cameras = Vec::new();
    for (index, camera) in collection.cameras().iter().enumerate() {
        let renderer = collection.renderer(index);
        let of_camera: Vec<&Photo> =
            collection.photos().iter().filter(|photo| photo.camera == index).collect();
        for chunk in of_camera.chunks(IMAGES_PER_THREAD * rayon::current_num_threads()) {
            for photo in chunk {
                if progress.rendering(&photo.name, done, total).is_break() {
                    return Err(Error::Pipeline(tiepoint_pipeline::Error::Cancelled));
                }
                done += 1;
            }
            chunk
                .par_iter()
                .filter(|photo| !photos.join(&photo.name).is_file())
                .try_for_each(|photo| collection.write_photo(&photos, photo, &renderer))?;
        }
        cameras.push(RenderedCamera {
            name: camera.name.to_owned(),
            images: of_camera.len(),
            width: camera.width,
            height: camera.height,
            focal_px: camera.lens.focal_px(),
        });
    }
    Ok(RenderedCollection { photos, truth, cameras })
}
