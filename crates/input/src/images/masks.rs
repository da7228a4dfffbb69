//! The files of a folder of masks, found by the names of images.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tiepoint_io::names::ByName;
use tiepoint_store::{escaped, irregular_kind};

use super::folder_names::MAX_DEPTH;
use super::skipped::SkippedFile;

/// A folder of masks.
pub(super) struct Masks<'a> {
    folder: &'a Path,
    /// Its files by their names, once a mask was not found as the image is written.
    files: OnceCell<ByName<PathBuf>>,
}

impl<'a> Masks<'a> {
    pub(super) fn open(folder: &'a Path) -> Self {
        Self { folder, files: OnceCell::new() }
    }

    /// The mask of an image: `NAME.png`, `NAME`, or the name with `png`, `mask.png` or `_mask.png`
    /// for the extension, as written or else as it looks. An entry with that name that is no
    /// regular file is skipped.
    pub(super) fn of(&self, name: &str, skipped: &mut Vec<SkippedFile>) -> Option<PathBuf> {
        let stem = Path::new(name).with_extension("").to_string_lossy().into_owned();
        let of_stem = [".png", ".mask.png", "_mask.png"].map(|end| format!("{stem}{end}"));
        let names = [format!("{name}.png"), name.to_owned()].into_iter().chain(of_stem);
        let names: Vec<String> = names.collect();
        let as_written = names.iter().map(|name| self.folder.join(name)).find(|path| {
            let Ok(metadata) = fs::metadata(path) else { return false };
            if let (Some(kind), false) = (irregular_kind(&metadata), metadata.is_dir()) {
                let shown = escaped(path);
                let reason = format!("{shown}: is {kind} and no regular file, so it masks nothing");
                skipped.push(SkippedFile { name: shown, reason, others: 0 });
            }
            metadata.is_file()
        });
        as_written.or_else(|| {
            let files = self.files.get_or_init(|| {
                let mut files = BTreeMap::new();
                list(self.folder, "", 0, &mut files);
                ByName::new(files)
            });
            names.iter().find_map(|name| files.get(name).cloned())
        })
    }
}

/// Adds the regular files below a folder. What cannot be read holds no masks.
fn list(folder: &Path, within: &str, depth: usize, files: &mut BTreeMap<String, PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        let Some(part) = path.file_name().and_then(|part| part.to_str()) else { continue };
        if path.is_dir() {
            if depth < MAX_DEPTH {
                list(&path, &format!("{within}{part}/"), depth + 1, files);
            }
        } else if path.is_file() {
            files.insert(format!("{within}{part}"), path);
        }
    }
}
