//! COLMAP's models: a folder with cameras, images, points3D and, since COLMAP 3.12, rigs and frames; binary or text.
//!
//! Ids on disk are ours plus one, so that images and cameras have the same ids as in `database.db`. Only registered
//! images are written. What a model does not hold is lost on the way: keypoint scales (1 when read), image times, hold-out
//! flags, and where a focal length came from.
//!
//! COLMAP wants every image in a frame and every camera on a rig. Frames and rigs of the [`Reconstruction`] are written as
//! such; an image outside of them gets a frame of its own, and a camera outside of them a rig of its own. When read, rigs of
//! one camera vanish again.
//!
//! Format: <https://colmap.github.io/format.html>; the rig files as `src/colmap/scene/reconstruction_io*.cc` of COLMAP 4.2.

mod binary;
mod layout;
mod tables;
mod text;

use std::path::Path;

use tiepoint_scene::Reconstruction;

use crate::{AtomicFile, Error, Result};
use layout::Layout;

/// How a model is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `*.bin`, little-endian; every number bit by bit.
    Binary,
    /// `*.txt`; every number with as many digits as bring it back.
    Text,
}

impl Format {
    fn suffix(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }
}

const CAMERAS: &str = "cameras";
const RIGS: &str = "rigs";
const FRAMES: &str = "frames";
const IMAGES: &str = "images";
const POINTS: &str = "points3D";

/// Writes a model into a folder, which is made if need be. The files appear together, after all have been written.
///
/// The model must be valid; and where an image is in a frame, the image's pose must be the one that the frame and the rig give
/// it, since that is the one which COLMAP reads.
pub fn write_model(dir: &Path, model: &Reconstruction, format: Format) -> Result<()> {
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    let layout = Layout::new(dir, model)?;
    std::fs::create_dir_all(dir).map_err(Error::io(dir))?;
    let mut files = Vec::new();
    for name in [CAMERAS, RIGS, FRAMES, IMAGES, POINTS] {
        let path = dir.join(name).with_extension(format.suffix());
        let mut file = AtomicFile::create(&path)?;
        let written = match format {
            Format::Binary => binary::write(name, model, &layout, &mut file),
            Format::Text => text::write(name, model, &layout, &mut file),
        };
        written.map_err(Error::io(&path))?;
        files.push(file);
    }
    files.into_iter().try_for_each(AtomicFile::commit)
}

/// Reads a model from a folder: the binary files where there are all of cameras, images and points3D, else the text files.
///
/// Images, cameras and points get ids in the order of those in the files. The result is valid.
pub fn read_model(dir: &Path) -> Result<Reconstruction> {
    let format = [Format::Binary, Format::Text].into_iter().find(|format| {
        [CAMERAS, IMAGES, POINTS].iter().all(|name| dir.join(name).with_extension(format.suffix()).is_file())
    });
    let tables = match format {
        Some(Format::Binary) => binary::read(dir)?,
        Some(Format::Text) => text::read(dir)?,
        None => {
            // Says so if the folder itself is the trouble.
            std::fs::read_dir(dir).map_err(Error::io(dir))?;
            return Err(Error::content(
                dir,
                "holds no COLMAP model: cameras, images and points3D must be there, all as .bin or all as .txt",
            ));
        }
    };
    let model = tables.into_reconstruction(dir)?;
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    Ok(model)
}
