//! A finished model on disk, with what its workspace knows of it: the only way in for what is done
//! with finished models.

use std::path::{Path, PathBuf};

use tiepoint_io::colmap::{self, Format};
use tiepoint_io::timestamps;
use tiepoint_sfm::rolling_shutter::RollingShutter;
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_store::{Error as StoreError, OutputFolder};

use crate::Stage;
use crate::error::Error;
use crate::workspace::file_names::{DENSE_CLOUD, model_path};
use crate::workspace::folder::{DATABASE, TIMESTAMPS, current_records, is_workspace};
use crate::workspace::model_output::{model_files, write_colmap};
use crate::workspace::rig_file::RigFile;
use crate::workspace::sidecar::{SIDECAR, Sidecar};

/// A finished model: COLMAP's files, completed by the `tiepoint.json` beside them. A folder with
/// a model of another program has no such file; its images have the times that the workspace around
/// it knows.
#[derive(Clone, Debug, PartialEq)]
pub struct LocatedModel {
    /// Cameras, images and points, with capture times, streams, known intrinsics and held-out
    /// points.
    pub reconstruction: Reconstruction,
    /// Its rolling shutters.
    pub shutters: Vec<RollingShutter>,
    /// Extrinsics and clocks of its rig.
    pub rig: Option<RigFile>,
    /// The folder of its files.
    folder: PathBuf,
    /// The folder that would be its workspace.
    root: PathBuf,
    /// Whether its `tiepoint.json` belongs to it.
    has_sidecar: bool,
    note: Option<String>,
}

impl LocatedModel {
    /// Opens the largest model of a workspace, or the model in a folder.
    ///
    /// # Errors
    ///
    /// Those of [`model_folder`]; the model or its capture times cannot be read.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let folder = model_folder(path)?;
        let (reconstruction, root) = (colmap::read_model(&folder)?, root_of(&folder));
        let mut this = Self {
            reconstruction,
            shutters: Vec::new(),
            rig: None,
            folder,
            root,
            has_sidecar: false,
            note: None,
        };
        if let Err(reason) = this.read_sidecar() {
            let file = this.folder.join(SIDECAR);
            this.note = Some(format!(
                "{} is not used, nor what it says of capture times, known intrinsics, rolling \
                shutters and the rig: {reason}",
                file.display()
            ));
        }
        if !this.has_sidecar && is_workspace(&this.root) {
            this.read_timestamps()?;
        }
        Ok(this)
    }

    /// Completes the model by its sidecar, if it has one; an error says why it is not used.
    fn read_sidecar(&mut self) -> Result<(), String> {
        let file = self.folder.join(SIDECAR);
        if !file.is_file() {
            return Ok(());
        }
        let text = std::fs::read(&file).map_err(|error| error.to_string())?;
        let sidecar = Sidecar::from_json(&file, &text).map_err(|error| error.to_string())?;
        if !sidecar.is_of(&self.folder, self.format()) {
            return Err("another program has changed the model since".to_owned());
        }
        (self.shutters, self.rig) = sidecar.add_to(&mut self.reconstruction)?;
        self.has_sidecar = true;
        Ok(())
    }

    /// Takes the capture times that the workspace knows, by the names of the images.
    fn read_timestamps(&mut self) -> Result<(), Error> {
        let file = self.root.join(TIMESTAMPS);
        if file.is_file() {
            let times = timestamps::read(&file)?;
            let model = &mut self.reconstruction;
            let known: Vec<(ImageId, Option<f64>)> =
                model.images().map(|(id, image)| (id, times.get(&image.name).copied())).collect();
            known.into_iter().for_each(|(id, time_s)| model.set_time(id, time_s));
        }
        Ok(())
    }

    /// The folder of COLMAP's files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Paths of all files that the model may have, and of what its workspace was made of beside the
    /// photos. No result may replace them.
    pub fn files(&self) -> Vec<PathBuf> {
        let records = self.workspace().and_then(|root| current_records(root).ok());
        let sources = records.map(|records| records.sources).unwrap_or_default();
        model_files(&self.folder).into_iter().chain(sources).collect()
    }

    /// The format of COLMAP's files.
    pub fn format(&self) -> Format {
        let has = |name: &str| self.folder.join(name).is_file();
        match has("cameras.txt") && !has("cameras.bin") {
            true => Format::Text,
            false => Format::Binary,
        }
    }

    /// The workspace that it is in.
    pub fn workspace(&self) -> Option<&Path> {
        is_workspace(&self.root).then_some(&*self.root)
    }

    /// Whether it is the largest model of its workspace.
    pub fn is_largest(&self) -> bool {
        let largest = self.root.join(model_path(0));
        self.folder.canonicalize().ok() == largest.canonicalize().ok()
    }

    /// File of the detected keypoints, if the model is in a workspace.
    pub(crate) fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// The dense cloud of the model. Only the largest model of a workspace has one; that of an
    /// earlier model stays on disk.
    pub fn dense_cloud(&self) -> Option<PathBuf> {
        let (root, cloud) = (self.workspace()?, self.root.join(DENSE_CLOUD));
        let is_current = || current_records(root).is_ok_and(|r| r.is_complete(Stage::Dense));
        (self.is_largest() && cloud.is_file() && is_current()).then_some(cloud)
    }

    /// Why what is known of the model is not used, in one sentence.
    pub fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// The same with another reconstruction and without the rig, whose poses and scale may have
    /// changed.
    pub(crate) fn changed(&self, reconstruction: Reconstruction) -> Self {
        Self { reconstruction, rig: None, ..self.clone() }
    }

    /// The same without its place on the earth, for exports.
    pub(crate) fn without_place(&self) -> Self {
        let mut model = self.clone();
        model.reconstruction.georeference = None;
        model
    }

    /// Writes the model into a folder in the format that it was read in, and replaces an earlier
    /// one of this program. No file of `inputs` is replaced.
    ///
    /// # Errors
    ///
    /// A file of a model exists that is an input or not this program's, or writing fails.
    pub(crate) fn write(&self, to: &Path, inputs: &[PathBuf]) -> Result<(), Error> {
        self.write_as(to, self.format(), inputs)
    }

    /// [`LocatedModel::write`] in a format.
    ///
    /// # Errors
    ///
    /// As there.
    pub(crate) fn write_as(
        &self,
        to: &Path,
        format: Format,
        inputs: &[PathBuf],
    ) -> Result<(), Error> {
        let is_known = self.has_sidecar || self.reconstruction.georeference.is_some();
        let known = is_known.then(|| (self.shutters.clone(), self.rig.clone()));
        write_colmap(to, &self.reconstruction, format, known.as_ref(), inputs)
    }
}

/// The folder ROOT of a model in `ROOT/…/INDEX`.
fn root_of(folder: &Path) -> PathBuf {
    let numbered = |path: PathBuf| -> Option<(PathBuf, usize)> {
        let index = path.file_name()?.to_str()?.parse().ok()?;
        Some((path.parent()?.parent()?.to_owned(), index))
    };
    // The folder of a model may be a symbolic link to another place, or the path may contain links
    // that lead into a workspace.
    let as_given = std::path::absolute(folder).ok().and_then(numbered);
    let as_given = as_given.filter(|(root, index)| root.join(model_path(*index)).is_dir());
    let resolved = || folder.canonicalize().ok().and_then(numbered);
    let found = as_given.or_else(resolved).map(|(root, _)| root);
    found.unwrap_or_else(|| folder.join("../.."))
}

/// The folder of a COLMAP model: `path` itself, or `path/sparse/0` if that exists. Changes nothing:
/// the folder may be somebody else's.
///
/// # Errors
///
/// An interrupted run left its results half in place, the models of the workspace were computed
/// from features or matches that have been replaced, or it has none yet; the folder has several
/// models.
pub fn model_folder(path: &Path) -> Result<PathBuf, Error> {
    if OutputFolder::is_unfinished(path) {
        return Err(StoreError::Unfinished { path: path.to_owned() }.into());
    }
    let largest = path.join("sparse/0");
    if !largest.is_dir() {
        // COLMAP's `image_undistorter` puts the model into `sparse` itself.
        let is_model = |folder: &Path| {
            ["cameras.bin", "cameras.txt"].iter().any(|name| folder.join(name).is_file())
        };
        if is_model(path) {
            return Ok(path.to_owned());
        }
        let (only, first) = (path.join("sparse"), path.join("0"));
        if is_model(&only) {
            return Ok(only);
        }
        let path = path.to_owned();
        if is_model(&first) {
            return Err(Error::SeveralModels { path, model: first });
        }
        return if is_workspace(&path) { Err(Error::NoModelYet { path }) } else { Ok(path) };
    }
    if is_workspace(path) && !current_records(path)?.is_complete(Stage::Map) {
        return Err(Error::StaleModels { path: path.to_owned() });
    }
    Ok(largest)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn model_of_an_undistorted_folder_of_colmap_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let (root, sparse) = (dir.path(), dir.path().join("sparse"));
        fs::create_dir(&sparse).unwrap();
        assert_eq!(model_folder(root).unwrap(), root);
        fs::write(sparse.join("cameras.txt"), "").unwrap();
        assert_eq!(model_folder(root).unwrap(), sparse);
        fs::write(root.join("cameras.bin"), "").unwrap();
        assert_eq!(model_folder(root).unwrap(), root, "a model of its own");
        fs::create_dir(sparse.join("0")).unwrap();
        assert_eq!(model_folder(root).unwrap(), sparse.join("0"));
    }

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
        for folder in
            ["ws/sparse/0", "ws/sparse/1", "ws/sparse/../sparse/1/", "current", "ws/sparse/2"]
        {
            let found = root_of(&root.join(folder));
            assert_eq!(found.canonicalize().unwrap(), root.join("ws"), "{folder}");
        }
    }
}
