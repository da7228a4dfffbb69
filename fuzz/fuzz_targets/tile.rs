//! Tiles of shards, behind the right hash: features and pairs.
#![no_main]

use std::fmt::Debug;
use std::io::Write;

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::folder;
use tiepoint_io::Result;
use tiepoint_io::database::{TileReader, TileWriter};
use tiepoint_io::store::HashedFile;
use tiepoint_io::store::disk::Folder;

/// What can be read of a tile before its end or an error, and whether that is all.
fn items<T>(
    folder: &Folder,
    name: &str,
    next: impl Fn(&mut TileReader) -> Result<Option<T>>,
) -> (Vec<T>, bool) {
    let tile = TileReader::open(folder, name).expect("the file is there");
    let Some(mut tile) = tile else { return (Vec::new(), false) };
    let mut items = Vec::new();
    loop {
        match next(&mut tile) {
            Ok(Some(item)) => items.push(item),
            Ok(None) => return (items, true),
            Err(_) => return (items, false),
        }
    }
}

/// What was read is the same when it is written and read again. Texts compare NaN, too.
fn check<T: Debug>(
    folder: &Folder,
    next: impl Fn(&mut TileReader) -> Result<Option<T>>,
    write: impl Fn(&mut TileWriter, &T) -> Result<()>,
) {
    let (found, _) = items(folder, "tile", &next);
    let mut copy = TileWriter::create(folder, "copy", b"").expect("memory is writable");
    found.iter().for_each(|item| write(&mut copy, item).expect("memory is writable"));
    copy.finish().expect("memory is writable");
    let (again, is_all) = items(folder, "copy", &next);
    assert!(is_all);
    assert_eq!(format!("{found:?}"), format!("{again:?}"));
}

fuzz_target!(|data: &[u8]| {
    let folder = Folder::open(&folder()).expect("the folder was made");
    let mut file = HashedFile::create(&folder, "tile").expect("memory is writable");
    file.write_all(data).expect("memory is writable");
    file.commit().expect("memory is writable");
    let is_tile = TileReader::open(&folder, "tile").expect("the file is there").is_some();
    let begins = TileReader::open_unchecked(&folder, "tile").expect("the file is there");
    assert_eq!(is_tile, begins.is_some());
    check(&folder, TileReader::next_features, |copy, (image, features)| {
        copy.write_features(*image, features)
    });
    check(&folder, TileReader::next_pair, |copy, (pair, matches, view)| {
        copy.write_pair(*pair, matches, view)
    });
});
