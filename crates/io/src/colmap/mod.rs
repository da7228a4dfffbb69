//! COLMAP's models: a folder with cameras, images, points3D and, since COLMAP 3.12, rigs and
//! frames; binary or text.
//!
//! Ids on disk are ours plus one, so that images and cameras have the same ids as in `database.db`.
//! Only registered images are written. What a model does not hold is lost on the way: keypoint
//! scales (1 when read), image times, hold-out flags, and where a focal length came from.
//!
//! COLMAP wants every image in a frame and every camera on a rig. Frames and rigs of the
//! [`Reconstruction`] are written as such; an image outside of them gets a frame of its own, and a
//! camera outside of them a rig of its own. When read, rigs of one camera vanish again.
//!
//! Format: <https://colmap.github.io/format.html>; the rig files as
//! `src/colmap/scene/reconstruction_io*.cc` of COLMAP 4.2.

mod binary;
mod layout;
mod names;
mod tables;
mod text;

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tiepoint_scene::Reconstruction;

use crate::disk::{self, WrittenFile};
use crate::{AtomicFile, Error, Result};
use layout::Layout;
pub use names::MODEL_FILES;
use names::{IMAGES, REQUIRED};

/// How a model is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `*.bin`, little-endian; every number bit by bit.
    Binary,
    /// `*.txt`; every number with as many digits as bring it back.
    Text,
}

impl Format {
    /// Both, the one first that readers prefer.
    pub const ALL: [Self; 2] = [Self::Binary, Self::Text];

    /// What the names of its files end in, without the dot.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }

    fn other(self) -> Self {
        match self {
            Self::Binary => Self::Text,
            Self::Text => Self::Binary,
        }
    }
}

/// Writes a model into a folder, which is made if need be. A new folder appears with all of its
/// files; in one that is there, the list of images goes first and comes last, so that nobody reads
/// parts of two models.
///
/// # Errors
///
/// Where the model is not valid ([`Reconstruction::validate`]); where an image in no frame is of a
/// camera that has no pose on its rig, since COLMAP wants every image in a frame; where the folder
/// holds a model in the other format, since readers would choose for themselves, and where the
/// system refuses.
pub fn write_model(dir: &Path, model: &Reconstruction, format: Format) -> Result<()> {
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    let layout = Layout::new(dir, model)?;
    let write = |name: &str, mut file: &mut dyn Write| match format {
        Format::Binary => binary::write(name, model, &layout, &mut file),
        Format::Text => text::write(name, model, &layout, &mut file),
    };
    let target = disk::end_of_links(dir).map_err(Error::io(dir))?;
    let is_new = target.file_name().is_some()
        && fs::symlink_metadata(&target)
            .is_err_and(|cause| cause.kind() == io::ErrorKind::NotFound);
    if is_new {
        let part = disk::part_of(&target);
        let written = write_new_folder(&part, &target, format, write);
        if written.is_err() {
            // The first error is the one to report, or nobody is left to tell.
            let _ = disk::remove_own_folder(&part);
        }
        written.map_err(Error::io(dir))
    } else {
        write_into_folder(dir, format, write)
    }
}

/// Writes all files under a temporary name of the folder, and gives it its name.
fn write_new_folder(
    part: &Path,
    target: &Path,
    format: Format,
    write: impl Fn(&str, &mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    disk::create_folders(disk::folder_of(target))?;
    // What a killed run left.
    disk::remove_own_folder(part)?;
    disk::create_folders(part)?;
    for name in MODEL_FILES {
        let path = part.join(name).with_extension(format.suffix());
        let mut file = BufWriter::new(WrittenFile::create_new(&path)?);
        write(name, &mut file)?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync()?;
    }
    disk::sync_folder(part)?;
    disk::rename(part, target)?;
    disk::sync_folder(disk::folder_of(target))
}

/// Writes all files under temporary names in a folder, and replaces those that are there.
fn write_into_folder(
    dir: &Path,
    format: Format,
    write: impl Fn(&str, &mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    let other = format.other().suffix();
    let stale = REQUIRED.map(|name| dir.join(name).with_extension(other));
    if let Some(stale) = stale.iter().find(|path| path.exists()) {
        let what = format!("holds a model as .{other} too: choose another folder");
        return Err(Error::content(stale, what));
    }
    let mut files = Vec::new();
    for name in MODEL_FILES {
        let path = dir.join(name).with_extension(format.suffix());
        let mut file = AtomicFile::create(&path)?;
        write(name, &mut file).map_err(Error::io(&path))?;
        // What is in the buffer might not fit any more once the old images are gone.
        file.flush().map_err(Error::io(&path))?;
        files.push(file);
    }
    let images = dir.join(IMAGES).with_extension(format.suffix());
    let old = disk::end_of_links(&images).map_err(Error::io(&images))?;
    // A device has no part, and is written through.
    if old.is_file() && disk::part_of(&old).is_file() {
        disk::remove_file(&old).map_err(Error::io(&images))?;
        disk::sync_folder(disk::folder_of(&old)).map_err(Error::io(&images))?;
    }
    files.into_iter().try_for_each(AtomicFile::commit)
}

/// Reads a model from a folder: the binary files where there are all of cameras, images and
/// points3D, else the text files.
///
/// Images, cameras and points get ids in the order of those in the files. The result is valid.
pub fn read_model(dir: &Path) -> Result<Reconstruction> {
    let format = Format::ALL.into_iter().find(|format| {
        REQUIRED.iter().all(|name| dir.join(name).with_extension(format.suffix()).is_file())
    });
    let tables = match format {
        Some(Format::Binary) => binary::read(dir)?,
        Some(Format::Text) => text::read(dir)?,
        None => {
            // Says so if the folder itself is the trouble.
            fs::read_dir(dir).map_err(Error::io(dir))?;
            return Err(Error::content(
                dir,
                "holds no COLMAP model: cameras, images and points3D must be there, all as .bin \
                or all as .txt",
            ));
        }
    };
    let model = tables.into_reconstruction(dir)?;
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    Ok(model)
}
