//! The model that mapping goes on from.

use std::path::{Path, PathBuf};

use tiepoint_input::fingerprint::hash_files;
use tiepoint_sfm::model_tools::{Transferred, transfer_model};
use tiepoint_sfm::scene::Reconstruction;
use tiepoint_sfm::{self as sfm, MapperOptions, RigMode};

use crate::Error;
use crate::stages::option_keys;
use crate::workspace::located_model::{LocatedModel, model_folder};
use crate::workspace::model_output::model_files;

/// A COLMAP model whose images with their poses are the beginning of a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputModel {
    /// Its folder, or a workspace.
    pub path: PathBuf,
    /// Whether its poses are kept to the last bit, and its intrinsics, unless
    /// [`MapOptions::refine`](crate::stages::MapOptions::refine) is given.
    pub fix_existing_frames: bool,
}

impl InputModel {
    /// Finds the files.
    ///
    /// # Errors
    ///
    /// The workspace has no current model, or a file cannot be read.
    pub(crate) fn open(&self) -> Result<OpenedModel, Error> {
        let folder = model_folder(&self.path)?;
        let files: Vec<PathBuf> =
            model_files(&folder).into_iter().filter(|file| file.is_file()).collect();
        Ok(OpenedModel {
            fingerprint: hash_files(&files)?,
            fix_existing_frames: self.fix_existing_frames,
            folder,
            files,
        })
    }
}

/// The files of a model.
pub(crate) struct OpenedModel {
    folder: PathBuf,
    files: Vec<PathBuf>,
    fingerprint: String,
    pub(crate) fix_existing_frames: bool,
}

impl OpenedModel {
    /// Keys and values for the record.
    pub(crate) fn texts(&self) -> Vec<(&'static str, String)> {
        option_keys::input_model_options(&self.fingerprint, self.fix_existing_frames)
    }

    /// The files that mapping reads and must not write.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(PathBuf::as_path)
    }

    /// The options of the mapper for this model: constant poses leave nothing to a rig that may
    /// choose, so that `auto` is `off`.
    ///
    /// # Errors
    ///
    /// An option needs poses or a gauge other than those of the model.
    pub(crate) fn options(&self, mut options: MapperOptions) -> Result<MapperOptions, Error> {
        if self.fix_existing_frames {
            if options.rig == RigMode::Auto {
                options.rig = RigMode::Off;
            }
            if options.rig != RigMode::Off {
                return Err(Error::MovesPoses {
                    option: "`mapper.rig`",
                    with: "`mapper.fix_existing_frames`",
                });
            }
            if options.readout.is_some() {
                let option = "`mapper.readout`";
                return Err(Error::MovesPoses { option, with: "`mapper.fix_existing_frames`" });
            }
        } else if options.rig == RigMode::Paper {
            return Err(Error::MovesPoses {
                option: "`mapper.rig` paper",
                with: "`mapper.input_model`",
            });
        }
        Ok(options)
    }

    /// The scene with the poses and points of the model.
    ///
    /// # Errors
    ///
    /// The model cannot be read, or has no image in common with the scene.
    pub(crate) fn transfer(&self, scene: &Reconstruction) -> Result<Transferred, Error> {
        let model = LocatedModel::open(&self.folder)?.reconstruction;
        transfer_model(scene, &model).map_err(|cause| self.error(cause))
    }

    /// An error of the mapper as one of this model.
    pub(crate) fn error(&self, cause: sfm::Error) -> Error {
        match cause {
            sfm::Error::NoCommonImage { .. }
            | sfm::Error::OtherSize { .. }
            | sfm::Error::NothingToExtend { .. } => {
                Error::InputModel { path: self.folder.clone(), cause }
            }
            cause => cause.into(),
        }
    }
}
