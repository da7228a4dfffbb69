//! Models in folders that a caller names.

use std::path::Path;

use tiepoint_io::colmap::Format;
use tiepoint_sfm::scene::Reconstruction;

use crate::Error;
use crate::output_folder::{OutputFolder, model_names};
use crate::workspace::is_workspace;

/// File of the options that a model was made with, which COLMAP writes beside it.
pub(super) const PROJECT: &str = "project.ini";

/// Who may have made the files that a model replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Replaced {
    /// Anybody: the caller named the folder as the output.
    All,
    /// This program only.
    Ours,
}

/// Writes a model into a folder that the caller named as the output: its model in this format is
/// replaced, whoever made it, also if it is the input. All other files in it stay.
///
/// # Errors
///
/// The folder is a workspace, or writing fails.
pub fn write_model(to: &Path, model: &Reconstruction, format: Format) -> Result<(), Error> {
    put(to, model, format, None, Replaced::All)
}

/// Writes a model, and the options that it was made with as a `project.ini`.
pub(super) fn put(
    to: &Path,
    model: &Reconstruction,
    format: Format,
    project: Option<&str>,
    replaced: Replaced,
) -> Result<(), Error> {
    if is_workspace(to) {
        return Err(Error::ModelIntoWorkspace { path: to.to_owned() });
    }
    let mut folder = OutputFolder::open(to)?;
    let mut names = model_names(None);
    if replaced == Replaced::All {
        // As COLMAP leaves the files of the other format, a conversion in place loses nothing.
        let suffix = format!(".{}", format.suffix());
        names.retain(|name| name.ends_with(&suffix));
    }
    if project.is_some() {
        names.push(PROJECT.to_owned());
    }
    if replaced == Replaced::All {
        folder.may_replace(&names);
    }
    folder.refuse_foreign(names.iter().map(String::as_str))?;
    let mut staged = Vec::new();
    if let Some(project) = project {
        folder.stage_bytes(PROJECT, project.as_bytes())?;
        staged.push(PROJECT.to_owned());
    }
    staged.extend(folder.stage_model(None, model, format)?);
    // Readers might prefer files of the other format.
    let removed: Vec<String> = names.into_iter().filter(|name| !staged.contains(name)).collect();
    folder.publish(&staged, &removed).map(drop)
}

/// Checks that [`write_model`] may write into a folder.
///
/// # Errors
///
/// The folder is a workspace, or a name of a model's files is not that of a file.
pub(super) fn refuse_foreign_model(to: &Path) -> Result<(), Error> {
    if is_workspace(to) {
        return Err(Error::ModelIntoWorkspace { path: to.to_owned() });
    }
    if !to.exists() {
        return Ok(());
    }
    let mut folder = OutputFolder::open(to)?;
    let names = model_names(None);
    folder.may_replace(&names);
    folder.refuse_foreign(names.iter().map(String::as_str))
}

/// Checks before any work is done that [`put`] may write a model of this program only.
///
/// # Errors
///
/// The folder is a workspace, or has a model of another program.
pub(super) fn refuse_foreign(to: &Path) -> Result<(), Error> {
    if is_workspace(to) {
        return Err(Error::ModelIntoWorkspace { path: to.to_owned() });
    }
    if !to.exists() {
        return Ok(());
    }
    let names = model_names(None);
    let names = names.iter().map(String::as_str).chain([PROJECT]);
    OutputFolder::open(to)?.refuse_foreign(names)
}
