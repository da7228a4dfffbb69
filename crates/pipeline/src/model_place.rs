//! Where a model lies in a workspace, and the files beside it that tell more of it.

use std::path::{Path, PathBuf};

use crate::workspace::{REPORT, RIG, SPARSE, TIMESTAMPS, current_records, is_workspace};
use crate::{Error, Stage, option_keys};

/// The folder of a model, relative to the workspace.
pub(crate) fn model_path(index: usize) -> String {
    format!("{SPARSE}/{index}")
}

/// The file of a model's rig, relative to the workspace: `rig.json` of the largest model, `rig-1.json` of the next.
pub(crate) fn rig_name(index: usize) -> String {
    if index == 0 { RIG.to_owned() } else { format!("rig-{index}.json") }
}

/// The workspace that a model's folder lies in, if it does, and its number there.
pub(crate) struct ModelPlace {
    root: PathBuf,
    index: usize,
}

impl ModelPlace {
    /// Of `WORKSPACE/sparse/0`, or of a copy that lies as deep.
    pub(crate) fn of(folder: &Path) -> Self {
        let whole = folder.canonicalize();
        let name = whole.as_ref().ok().and_then(|path| path.file_name()?.to_str()?.parse().ok());
        Self { root: folder.join("../.."), index: name.unwrap_or(0) }
    }

    /// When images were taken.
    pub(crate) fn timestamps(&self) -> PathBuf {
        self.root.join(TIMESTAMPS)
    }

    /// How the model's cameras are held to each other.
    pub(crate) fn rig(&self) -> PathBuf {
        self.root.join(rig_name(self.index))
    }

    /// Whether the workspace was given the intrinsics of its cameras, which stay then.
    ///
    /// # Errors
    ///
    /// Where the workspace's records cannot be read.
    pub(crate) fn has_known_intrinsics(&self) -> Result<bool, Error> {
        if !is_workspace(&self.root) {
            return Ok(false);
        }
        Ok(current_records(&self.root)?.option(Stage::Features, option_keys::INTRINSICS).is_some())
    }

    /// What is said of the models, the largest first; and which of them this one is.
    pub(crate) fn report(&self) -> (PathBuf, usize) {
        (self.root.join(REPORT), self.index)
    }
}
