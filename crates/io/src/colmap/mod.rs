//! Models of COLMAP: a folder with cameras, images, points3D and, since COLMAP 3.12, rigs and
//! frames; binary or text.
//!
//! Ids in the files are indices of [`tiepoint_scene`] plus one, as in `database.db`; a model that
//! was read keeps the ids of its cameras, images and points. Only registered images are written.
//! The format does not hold keypoint scales (1 after reading), image times, hold-out flags, and the
//! origin of a focal length.
//!
//! COLMAP requires a frame for every image and a rig for every camera. Rigs and frames of the
//! [`Reconstruction`] are written as they are; an image in no frame gets a frame of its own, and a
//! camera in no rig gets a rig of its own. The reader drops rigs of one camera.
//!
//! Format: <https://colmap.github.io/format.html>; the rig files as
//! `src/colmap/scene/reconstruction_io*.cc` of COLMAP 4.2.

mod binary;
mod file_ids;
mod file_names;
mod rig_tables;
mod tables;
mod text;

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tiepoint_scene::Reconstruction;
use tiepoint_store::AtomicFile;
use tiepoint_store::disk::{self, WrittenFile};

use crate::{Error, Result};
use file_ids::FileIds;
use rig_tables::RigTables;

pub use file_names::MODEL_FILES;
use file_names::{IMAGES, REQUIRED};
pub(crate) use text::read_cameras;

/// The encoding of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `*.bin`, little-endian; numbers keep all bits.
    Binary,
    /// `*.txt`; numbers with as many digits as identify them.
    Text,
}

impl Format {
    /// Both formats, in the order in which readers look for them.
    pub const ALL: [Self; 2] = [Self::Binary, Self::Text];

    /// Extension of the files, without the dot.
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

/// Writes a model into a folder, which is created if necessary. A new folder is renamed into place
/// with all of its files. In an existing folder, `images` is removed first and written last, so
/// that no reader sees files of two models.
///
/// # Errors
///
/// If the model is not valid ([`Reconstruction::validate`]); if its ids are too large; if an image
/// in no frame has a camera without a pose in its rig, because COLMAP requires a frame for every
/// image; if the folder holds a model in the other format, because readers would prefer one of the
/// two; and if the system reports an error.
pub fn write_model(dir: &Path, model: &Reconstruction, format: Format) -> Result<()> {
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    let ids = FileIds::new(dir, model)?;
    let rig_tables = RigTables::new(dir, model, &ids)?;
    let write = |name: &str, mut file: &mut dyn Write| match format {
        Format::Binary => binary::write(name, model, &ids, &rig_tables, &mut file),
        Format::Text => text::write(name, model, &ids, &rig_tables, &mut file),
    };
    let target = disk::end_of_links(dir).map_err(Error::io(dir))?;
    let is_new = target.file_name().is_some()
        && fs::symlink_metadata(&target)
            .is_err_and(|cause| cause.kind() == io::ErrorKind::NotFound);
    if is_new {
        let temporary = disk::temporary_path(&target);
        let written = write_new_folder(&temporary, &target, format, write);
        if written.is_err() {
            // An earlier error is the one to report.
            let _ = disk::remove_own_folder(&temporary);
        }
        written.map_err(Error::io(dir))
    } else {
        write_into_folder(dir, format, write)
    }
}

/// Writes all files into a folder with a temporary name and renames the folder.
fn write_new_folder(
    temporary: &Path,
    target: &Path,
    format: Format,
    write: impl Fn(&str, &mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    disk::create_folders(disk::folder_of(target))?;
    // The temporary folder of a killed run.
    disk::remove_own_folder(temporary)?;
    disk::create_folders(temporary)?;
    for name in MODEL_FILES {
        let path = temporary.join(name).with_extension(format.suffix());
        let mut file = BufWriter::new(WrittenFile::create_new(&path)?);
        write(name, &mut file)?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync()?;
    }
    disk::sync_folder(temporary)?;
    disk::rename(temporary, target)?;
    disk::sync_folder(disk::folder_of(target))
}

/// Writes all files under temporary names into an existing folder and renames them.
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
        // The flush must succeed before the old `images` is removed: the disk may be full.
        file.flush().map_err(Error::io(&path))?;
        files.push(file);
    }
    let images = dir.join(IMAGES).with_extension(format.suffix());
    let old = disk::end_of_links(&images).map_err(Error::io(&images))?;
    // A device has no temporary file: it is written directly.
    if old.is_file() && disk::temporary_path(&old).is_file() {
        disk::remove_file(&old).map_err(Error::io(&images))?;
        disk::sync_folder(disk::folder_of(&old)).map_err(Error::io(&images))?;
    }
    Ok(files.into_iter().try_for_each(AtomicFile::commit)?)
}

/// Reads a model from a folder: the binary files if cameras, images and points3D are all there,
/// else the text files.
///
/// Images, cameras and points get indices in the order of their ids in the files, which
/// [`Reconstruction::original_ids`] holds. The result is valid ([`Reconstruction::validate`]).
///
/// # Errors
///
/// If the folder holds no complete model, if a file violates its format, and if the files
/// contradict each other.
pub fn read_model(dir: &Path) -> Result<Reconstruction> {
    let format = Format::ALL.into_iter().find(|format| {
        REQUIRED.iter().all(|name| dir.join(name).with_extension(format.suffix()).is_file())
    });
    let tables = match format {
        Some(Format::Binary) => binary::read(dir)?,
        Some(Format::Text) => text::read(dir)?,
        None => {
            // Reports an error of the folder itself.
            fs::read_dir(dir).map_err(Error::io(dir))?;
            return Err(Error::content(
                dir,
                "holds no COLMAP model: give a folder with cameras, images and points3D, all as \
                .bin or all as .txt",
            ));
        }
    };
    let model = tables.into_reconstruction(dir)?;
    model.validate().map_err(|cause| Error::Model { path: dir.to_owned(), cause })?;
    Ok(model)
}
