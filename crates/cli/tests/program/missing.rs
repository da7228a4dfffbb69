//! What the program says of images without a pose.

use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use crate::photos::photo;
use crate::tiepoint_in;

/// Photos of a room, and their seed; another seed is another room.
const PHOTOS: usize = 5;
const ROOM: u64 = 0;
const OTHER_ROOM: u64 = 77;

#[test]
fn a_photo_of_another_place_is_named_with_its_reason() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    for index in 0..PHOTOS {
        photo(index, ROOM).save(folder.join(format!("{index}.png"))).unwrap();
    }
    photo(0, OTHER_ROOM).save(folder.join("other.png")).unwrap();
    // What cannot be read is no image, and is told, too: two photos of one kind in one sentence.
    for name in ["7.heic", "8.heic", "cut.jpg"] {
        fs::write(folder.join(name), b"\xff\xd8\xff\xe0").unwrap();
    }
    let text = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/w").done().stdout();
    for part in ["missing   1 of 6 images has no pose in sparse/0", "1 without a verified pair"] {
        assert!(text.contains(part), "{text}");
    }
    let report: Value =
        serde_json::from_slice(&fs::read(dir.path().join("w/report.json")).unwrap()).unwrap();
    assert_eq!(
        report["stages"]["map"]["unregistered"],
        json!([{ "image": "other.png", "model": "sparse/0", "reason": "no_pair" }])
    );
    tiepoint_in(dir.path(), "view {}/w").done();
    let page = fs::read_to_string(dir.path().join("w/report.html")).unwrap();
    for part in [
        "Images without a pose",
        "other.png",
        "without a verified pair",
        "Incomplete: 5 of 6",
        "3 files of the input were left out",
        "Files of the input that were left out",
        "cut.jpg: ",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // A page that is older than the model says so.
    let older = std::time::SystemTime::now() - Duration::from_secs(3600);
    let page = fs::File::options().append(true).open(dir.path().join("w/report.html")).unwrap();
    page.set_modified(older).unwrap();
    let again = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/w").done().stdout();
    assert!(again.contains("writes report.html again"), "{again}");
    assert!(!text.contains("writes report.html again"), "{text}");
    for part in [
        "result    incomplete: 5 of 6 images",
        "next      tiepoint view",
        "3 skipped",
        "3 files of the input were left out, first ",
    ] {
        assert!(text.contains(part), "{text}");
    }
}
