//! COLMAP models among the staged files of an output folder.

use std::path::{Path, PathBuf};

use tiepoint_io::colmap::{self, Format, MODEL_FILES};
use tiepoint_sfm::scene::Reconstruction;
use tiepoint_store::{OutputFolder, disk};

use crate::Error;

/// Stages a COLMAP model in a sub-folder (`None`: in the folder itself). Returns the names of its
/// files in the order for [`OutputFolder::publish`].
///
/// # Errors
///
/// The model is invalid or cannot be written.
pub(crate) fn stage_model(
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

/// Names of the files of a COLMAP model in this sub-folder, in both formats.
pub(crate) fn model_names(folder: Option<&str>) -> Vec<String> {
    let prefix = folder.map_or_else(String::new, |folder| format!("{folder}/"));
    let names =
        |format: Format| MODEL_FILES.map(|name| format!("{prefix}{name}.{}", format.suffix()));
    Format::ALL.into_iter().flat_map(names).collect()
}
