//! Images that this program itself has made: a manifest beside them says which.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::regular::require_regular_file;

/// Beside what this program wrote into a folder: `{"program": "tiepoint", "files": {"images/a.jpg": …}}`,
/// paths being relative to the folder, with `/`.
pub const MANIFEST: &str = ".tiepoint.json";
/// Who wrote it.
const PROGRAM: &str = "tiepoint";

/// The files that a folder's manifest names; none where it has no manifest of this program.
pub(crate) fn made_files(folder: &Path) -> BTreeSet<PathBuf> {
    let path = folder.join(MANIFEST);
    if require_regular_file(&path).is_err() {
        return BTreeSet::new();
    }
    let manifest = fs::read(&path).ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    let of_program = manifest.filter(|manifest| manifest["program"] == PROGRAM);
    let files = of_program.as_ref().and_then(|manifest| manifest["files"].as_object());
    files.into_iter().flatten().map(|(name, _)| folder.join(name)).collect()
}
