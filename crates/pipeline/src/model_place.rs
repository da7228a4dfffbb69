//! Where a model lies in a workspace, and the files beside it that tell more of it.

use std::path::{Path, PathBuf};

use crate::file_names::{model_path, rig_name};
use crate::records::Records;
use crate::workspace::{DATABASE, REPORT, STAGES, TIMESTAMPS, current_records, is_workspace};
use crate::{Stage, option_keys};

/// The workspace that a model's folder lies in, if it does, and its number there.
pub(crate) struct ModelPlace {
    root: PathBuf,
    index: usize,
}

impl ModelPlace {
    /// Of `WORKSPACE/sparse/0`, or of a copy that lies as deep.
    pub(crate) fn of(folder: &Path) -> Self {
        let numbered = |path: PathBuf| -> Option<Self> {
            let index = path.file_name()?.to_str()?.parse().ok()?;
            Some(Self { root: path.parent()?.parent()?.to_owned(), index })
        };
        // A folder of models may be a link to elsewhere; and a link may lead into a workspace.
        let as_given = std::path::absolute(folder).ok().and_then(numbered);
        let as_given = as_given.filter(|place| place.root.join(model_path(place.index)).is_dir());
        let at_the_end = || folder.canonicalize().ok().and_then(numbered);
        let elsewhere = || Self { root: folder.join("../.."), index: 0 };
        as_given.or_else(at_the_end).unwrap_or_else(elsewhere)
    }

    /// When images were taken.
    pub(crate) fn timestamps(&self) -> PathBuf {
        self.root.join(TIMESTAMPS)
    }

    /// How the model's cameras are held to each other.
    pub(crate) fn rig(&self) -> PathBuf {
        self.root.join(rig_name(self.index))
    }

    /// Whether the workspace was given the intrinsics of its cameras, which stay then. Where its
    /// database is gone, its record tells.
    pub(crate) fn has_known_intrinsics(&self) -> bool {
        if !is_workspace(&self.root) {
            return false;
        }
        let is_given =
            |records: &Records| records.option(Stage::Features, option_keys::INTRINSICS).is_some();
        let recorded = || Records::read(&self.root.join(STAGES)).ok().flatten();
        let has_database = self.root.join(DATABASE).is_file();
        current_records(&self.root).is_ok_and(|records| is_given(&records))
            || !has_database && recorded().is_some_and(|records| is_given(&records))
    }

    /// What is said of the models, the largest first; and which of them this one is.
    pub(crate) fn report(&self) -> (PathBuf, usize) {
        (self.root.join(REPORT), self.index)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_model_is_found_by_links_and_behind_them() {
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
            let rig = ModelPlace::of(&root.join(folder)).rig();
            let found =
                rig.parent().unwrap().canonicalize().unwrap().join(rig.file_name().unwrap());
            assert_eq!(found, root.join(name), "{folder}");
        }
    }
}
