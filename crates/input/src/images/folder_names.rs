//! Folders of images that are no cameras, by their names.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::Path;

use super::pixels;

/// Deepest folder below an input; deeper ones mean a cycle of links.
pub(super) const MAX_DEPTH: usize = 16;

/// Folders that systems make, in any case: thumbnails and versions of a NAS (Synology, QNAP),
/// deleted files, indices, what a check of the disk found, archives of macOS. Folders with a dot in
/// front are hidden anyway.
const SYSTEM: [&str; 11] = [
    "@eaDir",
    "@Recycle",
    "@Recently-Snapshot",
    "#recycle",
    "#snapshot",
    "$RECYCLE.BIN",
    "RECYCLER",
    "System Volume Information",
    "__MACOSX",
    "lost+found",
    "LOST.DIR",
];
/// Folders of small copies of the photos beside them.
const THUMBNAILS: [&str; 4] = ["thumb", "thumbs", "thumbnail", "thumbnails"];
/// Folders of masks of the photos in another folder.
const MASKS: [&str; 7] =
    ["mask", "masks", "alpha", "segmentation", "segmentations", "semantic", "semantics"];
/// Folders of other images that programs make from the photos in another folder.
const MADE: [&str; 8] =
    ["depth", "depths", "depth_maps", "depthmaps", "normal", "normals", "normal_maps", "disparity"];
/// Ratios of the sizes in `images` and `images_2`, `images_4`, `images_8`, as trainers of radiance
/// fields name them.
const RATIOS: [u32; 3] = [2, 4, 8];

fn is_one_of(part: &OsStr, names: &[&str]) -> bool {
    names.iter().any(|name| part.eq_ignore_ascii_case(name))
}

/// Whether a folder is one that a system makes.
pub(super) fn is_system_folder(part: &OsStr) -> bool {
    is_one_of(part, &SYSTEM)
}

/// Whether a folder beside photos holds thumbnails.
pub(super) fn is_thumbnail_folder(part: &OsStr) -> bool {
    is_one_of(part, &THUMBNAILS)
}

/// Whether a folder is named as one of masks.
pub(super) fn is_mask_folder(part: &str) -> bool {
    is_one_of(OsStr::new(part), &MASKS)
}

/// The folders whose images were made from those of another one, and that one. A folder must be
/// named so, and each of its images must have the name of a photo: folders of a rig have equal
/// names, too, so that these alone tell nothing. A smaller copy must also have the size that the
/// name tells. `folders` has the name and the path of each image.
pub(super) fn derived_folders<'a>(
    folders: &BTreeMap<&'a str, Vec<(&'a str, &'a Path)>>,
) -> Vec<(&'a str, &'a str)> {
    let is_made = |folder: &str| is_mask_folder(folder) || is_one_of(OsStr::new(folder), &MADE);
    let stem = |name: &'a str| name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let mut derived = Vec::new();
    for (folder, images) in folders {
        let ratio = RATIOS
            .into_iter()
            .find_map(|ratio| Some((folder.strip_suffix(&format!("_{ratio}"))?, ratio)));
        let of = folders.iter().find(|(other, photos)| {
            let is_named = match ratio {
                Some((whole, _)) => whole == **other,
                None => is_made(folder) && !is_made(other),
            };
            let names = || photos.iter().flat_map(|(name, _)| [*name, stem(name)]);
            is_named && {
                let names: BTreeSet<&str> = names().collect();
                images.iter().all(|(name, _)| names.contains(stem(name)))
            }
        });
        let Some((other, photos)) = of else { continue };
        let is_sure = ratio.is_none_or(|(_, ratio)| {
            let (name, small) = images[0];
            let large = photos.iter().find(|(other, _)| stem(other) == stem(name));
            large.is_some_and(|(_, large)| is_smaller(small, large, ratio))
        });
        if is_sure {
            derived.push((*folder, *other));
        }
    }
    derived
}

/// Whether an image has the size of another one, divided by `ratio` and rounded up or down.
fn is_smaller(small: &Path, large: &Path, ratio: u32) -> bool {
    let (Ok((small, _)), Ok((large, _))) = (pixels::stored(small), pixels::stored(large)) else {
        return false;
    };
    let fits = |small: u32, large: u32| [large / ratio, large.div_ceil(ratio)].contains(&small);
    fits(small.0, large.0) && fits(small.1, large.1)
}
