//! Cameras that are found: photos of several sizes, turns and lenses in one folder.

use std::fs;
use std::path::Path;

use image::imageops;
use serde_json::Value;

use crate::{photos, tiepoint_in};

/// The cameras of the feature stage as width and height, and the camera (from 0) of each image in
/// the order of their names.
fn cameras_and_images(dir: &Path) -> (Vec<[u64; 2]>, Vec<i64>) {
    let report = fs::read(dir.join("ws/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let cameras = report["stages"]["features"]["cameras"].as_array().unwrap();
    let size = |camera: &Value| ["width", "height"].map(|side| camera[side].as_u64().unwrap());
    let database = rusqlite::Connection::open(dir.join("ws/database.db")).unwrap();
    let mut query = database.prepare("SELECT camera_id - 1 FROM images ORDER BY name").unwrap();
    let images = query.query_map([], |row| row.get(0)).unwrap();
    (cameras.iter().map(size).collect(), images.map(Result::unwrap).collect())
}

/// Eight photos; a third is turned by 90°, and one has half the size.
fn write_mixed(dir: &Path) {
    photos::write(dir, 8, 0);
    for index in [1, 4, 7] {
        let turned = imageops::rotate90(&photos::photo(index, 0));
        turned.save(dir.join(format!("{index}.png"))).unwrap();
    }
    let half = imageops::thumbnail(&photos::photo(5, 0), photos::WIDTH / 2, photos::HEIGHT / 2);
    half.save(dir.join("5.png")).unwrap();
}

#[test]
fn a_folder_of_turned_and_smaller_photos() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    write_mixed(&photos);
    photos::write_truth(&dir.path().join("truth"), 8);
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws").done();
    let (cameras, images) = cameras_and_images(dir.path());
    assert_eq!(cameras, [[320, 240], [240, 320], [160, 120]]);
    assert_eq!(images, [0, 1, 0, 0, 1, 2, 0, 1]);
    // One folder is no rig, so that the default --rig auto has nothing to constrain.
    assert!(!dir.path().join("ws/rig.json").exists());
    let found =
        tiepoint_in(dir.path(), "evaluate poses {}/ws --truth strecha:{}/truth --json").json();
    assert_eq!(found["registered"], 8);
    // The cameras stand on an arc of 2.5 m.
    let error_m = found["centre_error"]["rmse"].as_f64().unwrap();
    assert!(error_m < 0.02, "{error_m}");
}

#[test]
fn groups_of_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    for folder in ["a", "b"] {
        photos::write(&dir.path().join("photos").join(folder), 2, 0);
    }
    for (grouping, expected) in [
        ("auto", [0, 0, 1, 1]),
        ("folder", [0, 0, 1, 1]),
        ("image", [0, 1, 2, 3]),
        ("single", [0, 0, 0, 0]),
    ] {
        let line = format!(
            "features {{}}/photos -o {{}}/ws --cameras {grouping} --max-megapixels 1 --redo \
            features"
        );
        tiepoint_in(dir.path(), &line).done();
        assert_eq!(cameras_and_images(dir.path()).1, expected, "{grouping}");
    }
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws --max-megapixels 1")
        .failed(1, &["--cameras single and not none", "--redo features"]);
}
