//! The records of a workspace agree with its data.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::database::Database;

use crate::own_files::files;
use crate::{photos, tiepoint_in};

const COUNT: usize = 4;

fn stages(dir: &Path) -> Value {
    serde_json::from_slice(&fs::read(dir.join("ws/stages.json")).unwrap()).unwrap()
}

fn pairs(dir: &Path) -> usize {
    Database::open(&dir.join("ws/database.db")).unwrap().matched_pairs().unwrap().len()
}

/// Changes the database only: the state of a run that was killed after it had changed the database
/// and before it wrote `stages.json`.
fn with_earlier_record(dir: &Path, begin: impl FnOnce(&mut Database)) {
    let mut database = Database::open(&dir.join("ws/database.db")).unwrap();
    begin(&mut database);
    database.close().unwrap();
}

#[test]
fn records_of_the_database_take_precedence() {
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
    // Models of replaced matches are rejected.
    for line in [
        "export {}/ws --to ply -o {}/a.ply",
        "view {}/ws",
        "adjust {}/ws",
        "evaluate poses {}/ws --truth colmap:{}/ws/sparse/0",
    ] {
        tiepoint_in(dir, line).failed(1, &["ws were made before", "tiepoint map", "sparse/0"]);
    }
    tiepoint_in(dir, "export {}/ws/sparse/0 --to ply -o {}/a.ply").done();
    tiepoint_in(dir, "match {}/ws")
        .failed(1, &["--pairs sequential:1 and not exhaustive", "--redo match"]);
    assert_eq!(
        stages(dir)["stages"]["match"]["options"]["match.pairs"],
        "sequential:1",
        "the record is mended"
    );
    tiepoint_in(dir, "match {}/ws --pairs sequential:1").done();
    assert_eq!(pairs(dir), COUNT - 1);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo match").done();
    assert!(fs::read(dir.join("ws/sparse/0/images.bin")).unwrap() == before);
}

#[test]
fn damaged_record_is_restored_and_damaged_database_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    fs::write(dir.join("ws/stages.json"), "{\"version\"").unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    assert_eq!(stages(dir)["stages"]["map"]["is_complete"], true);
    // A truncated database.
    fs::write(dir.join("ws/database.db"), "SQLite format 3\0").unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo match").failed(1, &["database.db"]);
    // Without the other record, the database is what is wrong, not a missing stage.
    fs::rename(dir.join("ws/stages.json"), dir.join("stages.json")).unwrap();
    tiepoint_in(dir, "match {}/ws").failed(1, &["ws/database.db", "not a database"]);
    fs::rename(dir.join("stages.json"), dir.join("ws/stages.json")).unwrap();
    tiepoint_in(dir, "features {}/photos -o {}/ws").done();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo features").done();
    assert_eq!(pairs(dir), COUNT * (COUNT - 1) / 2);
    // A foreign database in its place.
    let theirs = dir.join("theirs.db");
    Database::create(&theirs).unwrap().close().unwrap();
    fs::copy(&theirs, dir.join("ws/database.db")).unwrap();
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo features")
        .failed(1, &["database.db", "did not make it"]);
    assert!(fs::read(&theirs).unwrap() == fs::read(dir.join("ws/database.db")).unwrap());
}

/// A record as versions before 0.1.0 wrote it, with another key for its number.
fn before_the_first(mut record: Value) -> Value {
    let record_fields = record.as_object_mut().unwrap();
    record_fields.remove("format").unwrap();
    record_fields.insert("version".to_owned(), 3.into());
    record
}

/// A record as a later version may write it.
fn of_a_later_version(mut record: Value) -> Value {
    record["format"] = 2.into();
    record["stages"]["stage_of_the_future"] = Value::Null;
    record
}

#[test]
fn workspace_of_another_format_is_refused_and_left_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    let (path, database) = (dir.join("ws/stages.json"), dir.join("ws/database.db"));
    let good = (fs::read(&path).unwrap(), fs::read(&database).unwrap());
    let old = "has the format of a version before 0.1.0, and this version reads format 1: use the \
               version that wrote it, or make the workspace again in another folder";
    let later = "has format 2, and this version reads format 1: use the version";
    type Change = fn(Value) -> Value;
    let changes: [(Change, &str); 2] = [(before_the_first, old), (of_a_later_version, later)];
    for (change, how) in changes {
        for file in ["ws/stages.json", "ws/database.db"] {
            fs::write(&path, &good.0).unwrap();
            fs::write(&database, &good.1).unwrap();
            if file == "ws/stages.json" {
                fs::write(&path, change(stages(dir)).to_string()).unwrap();
            } else {
                // The records of the database alone, as after a loss of `stages.json`.
                fs::remove_file(&path).unwrap();
                with_earlier_record(dir, |database| {
                    let mut rows = database.stage_rows().unwrap().unwrap();
                    for row in &mut rows {
                        let record = serde_json::from_str(&row.recipe).unwrap();
                        row.recipe = change(record).to_string();
                    }
                    database.write_stage_rows(&rows).unwrap();
                });
            }
            // Not even the lock is made.
            let _ = fs::remove_file(dir.join("ws/.lock"));
            let before = files(&dir.join("ws"));
            for line in [
                "features {}/photos -o {}/ws",
                "reconstruct {}/photos -o {}/ws --redo features",
                "match {}/ws --redo match",
                "map {}/ws --redo map",
                "dense {}/ws --redo dense",
                "export {}/ws --to ply -o {}/a.ply",
                "adjust {}/ws",
                "view {}/ws",
                "evaluate poses {}/ws --truth colmap:{}/ws/sparse/0",
            ] {
                tiepoint_in(dir, line).failed(1, &[&format!("{file} {how}")]);
            }
            assert!(files(&dir.join("ws")) == before, "{file}");
        }
    }
    fs::write(&path, &good.0).unwrap();
    fs::write(&database, &good.1).unwrap();
    let kept = tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --json").done().events();
    assert!(kept.iter().all(|event| event["event"] == "stage_kept"), "{kept:?}");
}
