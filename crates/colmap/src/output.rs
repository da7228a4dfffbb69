//! Models in folders that a caller names.

use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::io::colmap::Format;
use tiepoint_pipeline::sfm::scene::Reconstruction;
use tiepoint_pipeline::store::OutputFolder;
use tiepoint_pipeline::workspace::{model_names, refuse_workspace, stage_model};

/// File of the options that a model was made with, which COLMAP writes beside it.
pub(super) const PROJECT: &str = "project.ini";

/// Writes a model into a folder that the caller named as the output: its model in this format is
/// replaced, whoever made it, also if it is the input. All other files in it stay.
///
/// # Errors
///
/// The folder is a workspace, or writing fails.
pub fn write_model(to: &Path, model: &Reconstruction, format: Format) -> Result<(), Error> {
    write_model_with_project(to, model, format, None)
}

/// Writes a model, and the options that it was made with as a `project.ini`.
pub(super) fn write_model_with_project(
    to: &Path,
    model: &Reconstruction,
    format: Format,
    project: Option<&str>,
) -> Result<(), Error> {
    refuse_workspace(to)?;
    let mut folder = OutputFolder::open(to)?;
    let mut names = model_names(None);
    // As COLMAP leaves the files of the other format, a conversion in place loses nothing.
    let suffix = format!(".{}", format.suffix());
    names.retain(|name| name.ends_with(&suffix));
    if project.is_some() {
        names.push(PROJECT.to_owned());
    }
    folder.may_replace(&names);
    folder.ensure_writable(names.iter().map(String::as_str))?;
    let mut staged = Vec::new();
    if let Some(project) = project {
        folder.stage_bytes(PROJECT, project.as_bytes())?;
        staged.push(PROJECT.to_owned());
    }
    staged.extend(stage_model(&folder, None, model, format)?);
    // Readers might prefer files of the other format.
    let removed: Vec<String> = names.into_iter().filter(|name| !staged.contains(name)).collect();
    folder.publish(&staged, &removed)?;
    Ok(())
}

/// Checks that [`write_model`] may write into a folder.
///
/// # Errors
///
/// The folder is a workspace, or a name of a model's files is not that of a file.
pub(super) fn refuse_foreign_model(to: &Path) -> Result<(), Error> {
    refuse_workspace(to)?;
    if !to.exists() {
        return Ok(());
    }
    let mut folder = OutputFolder::open(to)?;
    let names = model_names(None);
    folder.may_replace(&names);
    Ok(folder.ensure_writable(names.iter().map(String::as_str))?)
}

/// The folder of the models `0`, `1`, … of a mapper, which are replaced together.
pub(super) struct ModelFolders(OutputFolder);

impl ModelFolders {
    /// Opens or creates the folder. Models of this program in it may be replaced, also those that a
    /// command wrote into one of their folders.
    ///
    /// # Errors
    ///
    /// The folder is a workspace or its `sparse`, or has a model of another program.
    pub(super) fn open(to: &Path) -> Result<Self, Error> {
        refuse_workspace(to)?;
        let mut folder = OutputFolder::open(to)?;
        for index in (0..).map(|index: usize| index.to_string()) {
            let path = to.join(&index);
            if !path.is_dir() {
                break;
            }
            let names = names_with_project(None);
            if OutputFolder::is_ours(&path) {
                let own = OutputFolder::open(&path)?;
                let mut ours = Vec::new();
                for name in &names {
                    if own.is_unmodified(name)? {
                        ours.push(format!("{index}/{name}"));
                    }
                }
                folder.claim(&ours)?;
            }
            let names = names_with_project(Some(&index));
            folder.ensure_writable(names.iter().map(String::as_str))?;
        }
        Ok(Self(folder))
    }

    /// Writes models as one transaction, and removes further ones of an earlier run.
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub(super) fn write<'a>(
        mut self,
        models: impl IntoIterator<Item = &'a Reconstruction>,
        format: Format,
        project: Option<&str>,
    ) -> Result<(), Error> {
        let folder = &mut self.0;
        let mut staged = Vec::new();
        for (index, model) in models.into_iter().enumerate() {
            let index = index.to_string();
            if let Some(project) = project {
                let name = format!("{index}/{PROJECT}");
                folder.stage_bytes(&name, project.as_bytes())?;
                staged.push(name);
            }
            staged.extend(stage_model(folder, Some(&index), model, format)?);
        }
        // Other commands may have written other results into this folder.
        let of_model = names_with_project(None);
        let is_of_mapper = |name: &&str| {
            name.split_once('/').is_some_and(|(index, file)| {
                index.parse::<usize>().is_ok() && of_model.iter().any(|name| name == file)
            })
        };
        let known = folder.names().filter(is_of_mapper).filter(|name| folder.exists(name));
        let removed: Vec<String> = known
            .filter(|name| !staged.iter().any(|staged| staged == name))
            .map(str::to_owned)
            .collect();
        folder.publish(&staged, &removed)?;
        Ok(())
    }
}

/// Names of a model's files, and of its options.
fn names_with_project(folder: Option<&str>) -> Vec<String> {
    let project = folder.map_or_else(|| PROJECT.to_owned(), |folder| format!("{folder}/{PROJECT}"));
    model_names(folder).into_iter().chain([project]).collect()
}
