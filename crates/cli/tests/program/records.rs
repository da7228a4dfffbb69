//! What a workspace says it was made from is what it was made from.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::database::Database;

use crate::{photos, tiepoint_in};

const COUNT: usize = 4;

fn stages(dir: &Path) -> Value {
    serde_json::from_slice(&fs::read(dir.join("ws/stages.json")).unwrap()).unwrap()
}

fn pairs(dir: &Path) -> usize {
    Database::open(&dir.join("ws/database.db")).unwrap().matched_pairs().unwrap().len()
}

/// The state that a kill leaves after the database has begun anew and before `stages.json` is written.
fn with_earlier_record(dir: &Path, begin: impl FnOnce(&mut Database)) {
    let mut database = Database::open(&dir.join("ws/database.db")).unwrap();
    begin(&mut database);
    database.finish().unwrap();
}

#[test]
fn where_record_and_database_differ_the_database_is_right() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    let before = fs::read(dir.join("ws/sparse/0/images.bin")).unwrap();
    with_earlier_record(dir, |database| {
        let mut rows = database.stage_rows().unwrap().unwrap();
        let row = rows.iter_mut().find(|row| row.stage == "match").unwrap();
        row.is_complete = false;
        row.recipe = row.recipe.replace("exhaustive", "sequential:1");
        database.clear_matches_for(&rows).unwrap();
    });
    // Models of the matches that are gone are not served as if they were of these.
    for line in [
        "export {}/ws --to ply -o {}/a.ply",
        "view {}/ws",
        "adjust {}/ws",
        "evaluate poses {}/ws --truth colmap:{}/ws/sparse/0",
    ] {
        tiepoint_in(dir, line).failed(1, &["ws were made before", "tiepoint map", "sparse/0"]);
    }
    tiepoint_in(dir, "export {}/ws/sparse/0 --to ply -o {}/a.ply").done();
    tiepoint_in(dir, "match {}/ws").failed(1, &["pairs sequential:1 and not exhaustive", "--redo match"]);
    assert_eq!(stages(dir)["stages"]["match"]["options"]["pairs"], "sequential:1", "the record is mended");
    tiepoint_in(dir, "match {}/ws --pairs sequential:1").done();
    assert_eq!(pairs(dir), COUNT - 1);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo match").done();
    assert!(fs::read(dir.join("ws/sparse/0/images.bin")).unwrap() == before);
}

#[test]
fn a_damaged_record_is_mended_and_a_damaged_database_named() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    fs::write(dir.join("ws/stages.json"), "{\"version\"").unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    assert_eq!(stages(dir)["stages"]["map"]["is_complete"], true);
    // A database that is none, as an earlier version left it when it was killed.
    fs::write(dir.join("ws/database.db"), "SQLite format 3\0").unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo match").failed(1, &["database.db"]);
    tiepoint_in(dir, "features {}/photos -o {}/ws").done();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo features").done();
    assert_eq!(pairs(dir), COUNT * (COUNT - 1) / 2);
    // A database of somebody else in its place.
    let theirs = dir.join("theirs.db");
    Database::create(&theirs).unwrap().finish().unwrap();
    fs::copy(&theirs, dir.join("ws/database.db")).unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo features")
        .failed(1, &["database.db", "did not make it"]);
    assert!(fs::read(&theirs).unwrap() == fs::read(dir.join("ws/database.db")).unwrap());
}

#[test]
fn a_workspace_of_the_version_before_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    let before = fs::read(dir.join("ws/sparse/0/images.bin")).unwrap();
    // It kept no list of its files and no record in the database.
    fs::remove_file(dir.join("ws/.tiepoint.json")).unwrap();
    let text = fs::read_to_string(dir.join("ws/stages.json")).unwrap();
    fs::write(dir.join("ws/stages.json"), text.replace("\"version\": 2", "\"version\": 1")).unwrap();
    let drop_table = |database: &Path| {
        let connection = rusqlite::Connection::open(database).unwrap();
        connection.execute_batch("DROP TABLE tiepoint_stages").unwrap();
    };
    drop_table(&dir.join("ws/database.db"));
    let kept = tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --json").done().events();
    assert!(kept.iter().all(|event| event["event"] == "stage_kept"), "{kept:?}");
    assert_eq!(stages(dir)["version"], 2);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo map").done();
    assert!(fs::read(dir.join("ws/sparse/0/images.bin")).unwrap() == before);
}
