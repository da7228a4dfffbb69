//! COLMAP models among the staged files of an output folder.

use std::path::{Path, PathBuf};

use tiepoint_io::colmap::{self, Format, MODEL_FILES};
use tiepoint_sfm::scene::Reconstruction;
use tiepoint_store::disk::FileId;
use tiepoint_store::{Error as StoreError, OutputFolder, disk};

use crate::Error;
use crate::workspace::folder::refuse_workspace;
use crate::workspace::sidecar::{SIDECAR, ShuttersAndRig, Sidecar};

/// Stages a COLMAP model in a sub-folder (`None`: in the folder itself). Returns the names of its
/// files in the order for [`OutputFolder::publish`].
///
/// # Errors
///
/// The model is invalid or cannot be written.
pub fn stage_model(
    to: &OutputFolder,
    folder: Option<&str>,
    model: &Reconstruction,
    format: Format,
) -> Result<Vec<String>, Error> {
    let path = to.stage(folder.unwrap_or("model"))?;
    let asked = to.path().join(folder.unwrap_or_default());
    colmap::write_model(&path, model, format).map_err(|error| renamed(error, &path, &asked))?;
    let mut names = Vec::new();
    for name in MODEL_FILES {
        let file = format!("{name}.{}", format.suffix());
        match folder {
            Some(folder) => names.push(format!("{folder}/{file}")),
            None => {
                let to = to.stage(&file)?;
                disk::rename(&path.join(&file), &to).map_err(Error::output(&asked.join(&file)))?;
                names.push(file);
            }
        }
    }
    if folder.is_none() {
        disk::remove_empty_folder(&path).map_err(Error::output(&asked))?;
    }
    Ok(names)
}

/// [`stage_model`], with the sidecar of the model if more is known of it than COLMAP's files say.
///
/// # Errors
///
/// The model is invalid or cannot be written.
pub(crate) fn stage_with_sidecar(
    to: &OutputFolder,
    folder: Option<&str>,
    model: &Reconstruction,
    format: Format,
    known: Option<&ShuttersAndRig>,
) -> Result<Vec<String>, Error> {
    let mut names = stage_model(to, folder, model, format)?;
    if let Some((shutters, rig)) = known {
        let mut files = Vec::new();
        for name in &names {
            let file = name.rsplit('/').next().unwrap_or(name);
            files.push((file.to_owned(), to.stage(name)?));
        }
        let sidecar = Sidecar::new(files, model, shutters, rig.clone())?;
        let name = in_folder(folder, SIDECAR);
        to.stage_bytes(&name, &sidecar.to_json())?;
        // Beside the files of another model it counts for nothing.
        names.insert(0, name);
    }
    Ok(names)
}

fn in_folder(folder: Option<&str>, name: &str) -> String {
    folder.map_or_else(|| name.to_owned(), |folder| format!("{folder}/{name}"))
}

/// Replaces the path of a staged file, or folder of files, in an error by the final path.
pub(crate) fn renamed(error: tiepoint_io::Error, staged: &Path, asked: &Path) -> Error {
    use tiepoint_store::Error as Store;
    let rename = |path: PathBuf| match path.strip_prefix(staged) {
        Ok(rest) if rest.as_os_str().is_empty() => asked.to_owned(),
        Ok(rest) => asked.join(rest),
        Err(_) => path,
    };
    Error::File(match error {
        tiepoint_io::Error::Io { path, cause } => {
            tiepoint_io::Error::Io { path: rename(path), cause }
        }
        tiepoint_io::Error::Content { path, what } => {
            tiepoint_io::Error::Content { path: rename(path), what }
        }
        tiepoint_io::Error::Model { path, cause } => {
            tiepoint_io::Error::Model { path: rename(path), cause }
        }
        tiepoint_io::Error::Store(Store::Io { path, cause }) => {
            Store::Io { path: rename(path), cause }.into()
        }
        tiepoint_io::Error::Store(Store::Content { path, what }) => {
            Store::Content { path: rename(path), what }.into()
        }
        other => other,
    })
}

/// Names of the files of a COLMAP model in this sub-folder, in both formats, and of its sidecar.
pub fn model_names(folder: Option<&str>) -> Vec<String> {
    let names = |format: Format| MODEL_FILES.map(|name| format!("{name}.{}", format.suffix()));
    let all = Format::ALL.into_iter().flat_map(names).chain([SIDECAR.to_owned()]);
    all.map(|name| in_folder(folder, &name)).collect()
}

/// Writes a COLMAP model into a folder and replaces an earlier one of this program, no other.
///
/// # Errors
///
/// The folder is a workspace, a file of a model exists in it that is not this program's, or writing
/// fails.
pub fn write_model(to: &Path, model: &Reconstruction, format: Format) -> Result<(), Error> {
    write_colmap(to, model, format, None, &[])
}

/// Checks that [`write_colmap`] may write into a folder, which is created.
///
/// # Errors
///
/// A file of a model exists that is an input or not this program's.
pub(crate) fn refuse_foreign_model(to: &Path, inputs: &[PathBuf]) -> Result<(), Error> {
    model_output(to, inputs).map(drop)
}

/// A folder that a model may be written into.
fn model_output(to: &Path, inputs: &[PathBuf]) -> Result<OutputFolder, Error> {
    let mut folder = OutputFolder::open(to)?;
    folder.protect(inputs.iter().map(PathBuf::as_path));
    folder.ensure_writable(model_names(None).iter().map(String::as_str))?;
    refuse_workspace(to)?;
    Ok(folder)
}

/// Writes a COLMAP model into a folder, with its sidecar if more is known of it, and replaces an
/// earlier one of this program.
///
/// # Errors
///
/// A file of a model exists that is an input or not this program's, or writing fails.
pub(crate) fn write_colmap(
    to: &Path,
    model: &Reconstruction,
    format: Format,
    known: Option<&ShuttersAndRig>,
    inputs: &[PathBuf],
) -> Result<(), Error> {
    let folder = &mut model_output(to, inputs)?;
    let names = model_names(None);
    let staged = stage_with_sidecar(folder, None, model, format, known)?;
    // Readers might prefer files of the other format.
    let removed: Vec<String> = names.into_iter().filter(|name| !staged.contains(name)).collect();
    folder.publish(&staged, &removed)?;
    Ok(())
}

/// Refuses to write `to/sparse/0` where that would hide the model that is read: commands look there
/// first.
///
/// # Errors
///
/// `to` is the folder of the model, or one whose `sparse/0` is.
pub(crate) fn refuse_shadow(model_folder: &Path, to: &Path) -> Result<(), Error> {
    let there = FileId::of(model_folder);
    let shadowed = [to.to_owned(), to.join("sparse/0")].map(|path| FileId::of(&path));
    match there.is_some() && shadowed.contains(&there) {
        true => Err(StoreError::IsInput { path: to.to_owned() }.into()),
        false => Ok(()),
    }
}

/// Paths of all files that a COLMAP model in a folder may have, and of its sidecar.
pub fn model_files(folder: &Path) -> Vec<PathBuf> {
    model_names(None).iter().map(|name| folder.join(name)).collect()
}
