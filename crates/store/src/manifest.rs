//! The manifest of a folder: the files that this program wrote there, with the hashes of their
//! contents.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::regular_file::require_regular_file;
use crate::{AtomicFile, Error, Result};

/// Name of the manifest: `{"program": "tiepoint", "files": {"images/a.jpg": ["<BLAKE3>"]}, …}`.
pub const MANIFEST: &str = "tiepoint-files.json";
/// Value of `program`.
const PROGRAM: &str = "tiepoint";

/// The files that this program wrote into a folder. Names are paths relative to the folder, with
/// `/`, and lead to a place in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    program: String,
    /// By name, the hashes of the contents that a file may have: two after an interrupted
    /// replacement.
    pub files: BTreeMap<String, BTreeSet<String>>,
    /// The files of the last joint replacement, in the order in which they are renamed.
    #[serde(default)]
    pub order: Vec<String>,
    /// The files that the last joint replacement removes.
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
    /// Reads the manifest of a folder; `None` if there is none.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be read. [`Error::Content`] if it is not a manifest of this
    /// program, or if a name leads out of the folder: a manifest may come from anybody.
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

    /// Writes the manifest into its folder.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_vec(self).expect("a manifest is JSON: string keys");
        AtomicFile::write_with(folder.join(MANIFEST), |file| file.write_all(&text))
    }

    fn names(&self) -> impl Iterator<Item = &String> {
        self.files.keys().chain(&self.order).chain(&self.removed)
    }
}

/// Whether a relative path leads to a place inside of its folder: not empty, not absolute, without
/// `..`.
pub fn is_inside(name: impl AsRef<Path>) -> bool {
    let mut parts = name.as_ref().components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

/// The paths of the files that the manifest of a folder names. Empty without a valid manifest of
/// this program.
pub fn manifest_files(folder: &Path) -> BTreeSet<PathBuf> {
    let files = Manifest::read(folder).ok().flatten().unwrap_or_default().files;
    files.into_keys().map(|name| folder.join(name)).collect()
}
