//! The workspace of a model, and the files in it that belong to the model.

use std::path::{Path, PathBuf};

use tiepoint_input::cameras::CalibrationFacts;
use tiepoint_io::timestamps;
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_store::{Error as StoreError, OutputFolder};

use crate::Stage;
use crate::error::Error;
use crate::workspace::file_names::{model_path, rig_name};
use crate::workspace::folder::{
    DATABASE, REPORT, STAGES, TIMESTAMPS, current_records, is_workspace,
};
use crate::workspace::option_names;
use crate::workspace::records::Records;

/// Workspace and index of a model in `WORKSPACE/sparse/INDEX`.
pub(crate) struct ModelLocation {
    root: PathBuf,
    index: usize,
}

impl ModelLocation {
    /// Location of a model's folder `ROOT/…/INDEX`. A folder without an index counts as 0.
    pub(crate) fn of(folder: &Path) -> Self {
        let numbered = |path: PathBuf| -> Option<Self> {
            let index = path.file_name()?.to_str()?.parse().ok()?;
            Some(Self { root: path.parent()?.parent()?.to_owned(), index })
        };
        // The folder of a model may be a symbolic link to another place, or the path may contain
        // links that lead into a workspace.
        let as_given = std::path::absolute(folder).ok().and_then(numbered);
        let as_given =
            as_given.filter(|location| location.root.join(model_path(location.index)).is_dir());
        let resolved = || folder.canonicalize().ok().and_then(numbered);
        let outside = || Self { root: folder.join("../.."), index: 0 };
        as_given.or_else(resolved).unwrap_or_else(outside)
    }

    /// The folder of the workspace.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// File of the capture times.
    pub(crate) fn timestamps(&self) -> PathBuf {
        self.root.join(TIMESTAMPS)
    }

    /// File of the detected keypoints.
    pub(crate) fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// File of the model's rig extrinsics.
    pub(crate) fn rig(&self) -> PathBuf {
        self.root.join(rig_name(self.index))
    }

    /// Whether the workspace was given known intrinsics, which stay fixed. Without a database, its
    /// `stages.json` decides.
    pub(crate) fn has_known_intrinsics(&self) -> bool {
        if !is_workspace(&self.root) {
            return false;
        }
        let is_given =
            |records: &Records| records.option(Stage::Features, option_names::INTRINSICS).is_some();
        let recorded = || Records::read(&self.root.join(STAGES)).ok().flatten();
        let has_database = self.root.join(DATABASE).is_file();
        current_records(&self.root).is_ok_and(|records| is_given(&records))
            || !has_database && recorded().is_some_and(|records| is_given(&records))
    }

    /// Adds what the workspace knows of its cameras to a model; nothing for a model in no
    /// workspace.
    pub(crate) fn add_calibration_facts(&self, model: &mut Reconstruction) {
        if is_workspace(&self.root)
            && let Ok(records) = current_records(&self.root)
        {
            CalibrationFacts::read(|key| records.option(Stage::Features, key)).add_to(model);
        }
    }

    /// The report of the workspace, and the index of this model in it.
    pub(crate) fn report(&self) -> (PathBuf, usize) {
        (self.root.join(REPORT), self.index)
    }
}

/// The folder of a COLMAP model: `path` itself, or `path/sparse/0` if that exists. Changes nothing:
/// the folder may be somebody else's.
///
/// # Errors
///
/// An interrupted run left its results half in place, or the models of the workspace were computed
/// from features or matches that have been replaced.
pub fn model_folder(path: &Path) -> Result<PathBuf, Error> {
    if OutputFolder::is_unfinished(path) {
        return Err(StoreError::Unfinished { path: path.to_owned() }.into());
    }
    let largest = path.join("sparse/0");
    if !largest.is_dir() {
        return Ok(path.to_owned());
    }
    if is_workspace(path) && !current_records(path)?.is_complete(Stage::Map) {
        return Err(Error::StaleModels { path: path.to_owned() });
    }
    Ok(largest)
}

/// Sets the capture times of the images from a CSV file, if it exists.
///
/// # Errors
///
/// The file exists and cannot be read.
pub fn read_times(model: &mut Reconstruction, file: &Path) -> Result<(), Error> {
    if file.is_file() {
        let times = timestamps::read(file)?;
        let known: Vec<(ImageId, Option<f64>)> =
            model.images().map(|(id, image)| (id, times.get(&image.name).copied())).collect();
        known.into_iter().for_each(|(id, time_s)| model.set_time(id, time_s));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[cfg(unix)]
    #[test]
    fn location_is_found_through_symbolic_links() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().canonicalize().unwrap();
        for folder in ["ws/sparse/0", "ws/sparse/1", "disk/far/model", "copies/5"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        std::os::unix::fs::symlink(root.join("ws/sparse/1"), root.join("current")).unwrap();
        std::os::unix::fs::symlink(root.join("disk/far/model"), root.join("ws/sparse/2")).unwrap();
        for (folder, name) in [
            ("ws/sparse/0", "ws/rig.json"),
            ("ws/sparse/1", "ws/rig-1.json"),
            ("ws/sparse/../sparse/1/", "ws/rig-1.json"),
            ("current", "ws/rig-1.json"),
            ("ws/sparse/2", "ws/rig-2.json"),
        ] {
            let rig = ModelLocation::of(&root.join(folder)).rig();
            let found =
                rig.parent().unwrap().canonicalize().unwrap().join(rig.file_name().unwrap());
            assert_eq!(found, root.join(name), "{folder}");
        }
    }
}
