//! What this program made in a folder: a manifest beside it says which files, and with which
//! content.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::regular::require_regular_file;
use crate::{AtomicFile, Error, Result};

/// The name of the file: `{"program": "tiepoint", "files": {"images/a.jpg": ["<BLAKE3>"]}, …}`.
pub const MANIFEST: &str = ".tiepoint.json";
/// Who wrote it.
const PROGRAM: &str = "tiepoint";

/// The files of this program in a folder. All names are paths relative to the folder, with `/`, and
/// lead to a place in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    program: String,
    /// By name, the hashes of the contents that a file may have. There are two after an
    /// interruption.
    pub files: BTreeMap<String, BTreeSet<String>>,
    /// The files that were replaced together last, in the order in which they take their places.
    #[serde(default)]
    pub order: Vec<String>,
    /// The files that go at the same moment.
    #[serde(default)]
    pub removed: Vec<String>,
}

impl Default for Manifest {
    fn default() -> Self {
        let files = BTreeMap::new();
        Self { program: PROGRAM.to_owned(), files, order: Vec::new(), removed: Vec::new() }
    }
}

impl Manifest {
    /// Reads the manifest of a folder; `None` where there is none.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] where it cannot be read, [`Error::Content`] where it is no manifest of this
    /// program, or names a file outside of the folder: it may come from anybody.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(MANIFEST);
        require_regular_file(&path)?;
        let text = match fs::read(&path) {
            Err(cause) if cause.kind() == ErrorKind::NotFound => return Ok(None),
            text => text.map_err(Error::io(&path))?,
        };
        match serde_json::from_slice::<Self>(&text) {
            Ok(manifest) if manifest.program == PROGRAM && manifest.names().all(is_inside) => {
                Ok(Some(manifest))
            }
            _ => Err(Error::content(&path, "is no list of this program's files")),
        }
    }

    /// Writes it into its folder.
    ///
    /// # Errors
    ///
    /// Where the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_vec(self).expect("a manifest is JSON: string keys");
        AtomicFile::write_with(folder.join(MANIFEST), |file| file.write_all(&text))
    }

    fn names(&self) -> impl Iterator<Item = &String> {
        self.files.keys().chain(&self.order).chain(&self.removed)
    }
}

/// Whether a name leads to a place in the folder that it is relative to.
pub fn is_inside(name: impl AsRef<Path>) -> bool {
    let mut parts = name.as_ref().components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

/// The files that a folder's manifest names; none where it has no manifest of this program.
pub(crate) fn made_files(folder: &Path) -> BTreeSet<PathBuf> {
    let files = Manifest::read(folder).ok().flatten().unwrap_or_default().files;
    files.into_keys().map(|name| folder.join(name)).collect()
}
