//! The records of a workspace agree with its data.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tiepoint_pipeline::io::database::Database;

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
    // A truncated database, as an earlier version left it when it was killed.
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

/// Options as versions 1 and 2 of the record held them, of a run with the defaults.
const LEGACY_OPTIONS: [(&str, &[(&str, &str)]); 3] = [
    (
        "features",
        &[
            ("camera-model", "SIMPLE_RADIAL"),
            (
                "detector",
                "Options { first_octave: -1, octaves: 4, levels: 3, peak_threshold: 0.0066666664, \
                edge_threshold: 10.0, \
                 max_features: 8192, limit: WholeLevels, max_orientations: 2, orientation: \
                 Dominant, \
                 normalization: RootL1, domain_sizes: None }",
            ),
        ],
    ),
    (
        "match",
        &[
            (
                "matching",
                "Options { max_ratio: Some(0.8), max_angle_rad: Some(0.7), mutual: true, method: \
                BruteForce, \
                 preempt: None }",
            ),
            ("pairs", "exhaustive"),
            ("seed", "0"),
            (
                "verification",
                "VerifyOptions { max_error_px: 4.0, min_num_inliers: 15, min_essential_share: \
                0.95, \
                 max_homography_share: 0.8 }",
            ),
        ],
    ),
    (
        "map",
        &[(
            "mapper",
            "MapperOptions { refine: RefineIntrinsics { focal: true, principal_point: true, \
            distortion: true }, \
             tracks: TrackOptions { max_create_error_px: 12.0, max_merge_error_px: 4.0, \
             min_angle_rad: 0.026179938779914945, two_view: false, max_transitivity: 5 }, \
             filter: FilterOptions { max_error_px: 4.0, min_angle_rad: 0.026179938779914945 }, \
             register: RegisterOptions { max_error_px: 12.0, min_num_inliers: 30, \
             min_inlier_share: 0.25 }, \
             min_initial_inliers: 30, min_model_size: 3, loss: SoftL1(4.0), local_images: 6, \
             global_growth: 1.1, \
             rig: Auto, readout: None, seed: 0 }",
        )],
    ),
];

/// The recipes of an earlier version: each has the fingerprint of the one before as its input.
fn legacy_recipes(photos: &str) -> Vec<(&'static str, Value)> {
    let mut input = photos.to_owned();
    let recipe = |(stage, options): &(&'static str, &[(&str, &str)])| {
        let mut hash = blake3::Hasher::new();
        let words = options.iter().flat_map(|(name, value)| [*name, *value]);
        for word in std::iter::once(input.as_str()).chain(words) {
            hash.update(&(word.len() as u64).to_le_bytes()).update(word.as_bytes());
        }
        let options: BTreeMap<&str, &str> = options.iter().copied().collect();
        let recipe = json!({ "input": input, "options": options });
        input = hash.finalize().to_hex().to_string();
        (*stage, recipe)
    };
    LEGACY_OPTIONS.iter().map(recipe).collect()
}

/// Version 1 kept no list of its files and no record in the database; version 2 kept options as
/// texts of Rust's structs there.
#[test]
fn workspace_of_an_earlier_version_stays_valid() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    let model = || fs::read(dir.join("ws/sparse/0/images.bin")).unwrap();
    let (before, now) = (model(), stages(dir));
    let recipes = legacy_recipes(now["stages"]["features"]["input"].as_str().unwrap());
    let make_legacy = |version: u32| {
        let mut legacy = now.clone();
        legacy["version"] = version.into();
        for (stage, recipe) in &recipes {
            legacy["stages"][stage] = recipe.clone();
            legacy["stages"][stage]["is_complete"] = true.into();
        }
        fs::write(dir.join("ws/stages.json"), legacy.to_string()).unwrap();
        let connection = rusqlite::Connection::open(dir.join("ws/database.db")).unwrap();
        connection.execute_batch("DROP TABLE IF EXISTS tiepoint_stages").unwrap();
        if version == 1 {
            // It is not there where the last command only read.
            let _ = fs::remove_file(dir.join("ws/.tiepoint.json"));
        } else {
            let columns = "stage TEXT PRIMARY KEY NOT NULL, is_complete INTEGER NOT NULL, recipe \
            TEXT NOT NULL";
            connection.execute_batch(&format!("CREATE TABLE tiepoint_stages ({columns})")).unwrap();
            for (stage, recipe) in &recipes[..2] {
                let row = (stage, recipe.to_string());
                connection.execute("INSERT INTO tiepoint_stages VALUES (?1, 1, ?2)", row).unwrap();
            }
        }
    };
    for version in [2, 1] {
        make_legacy(version);
        // Commands that only read accept it.
        tiepoint_in(dir, "export {}/ws --to ply -o {}/a.ply").done();
        for (line, expected) in [
            ("match {}/ws --pairs sequential:1", "--pairs exhaustive and not sequential:1"),
            ("map {}/ws --rig off --seed 3", "--rig auto and not off, --seed 0 and not 3"),
            ("features {}/photos -o {}/ws --focal-prior 500", "--focal-prior none and not 500"),
        ] {
            make_legacy(version);
            tiepoint_in(dir, line).failed(1, &[expected, "--redo"]);
        }
        make_legacy(version);
        // In the second round the record has the current version.
        for _ in 0..2 {
            let kept = tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --json").done().events();
            assert!(kept.iter().all(|event| event["event"] == "stage_kept"), "{version}: {kept:?}");
            assert_eq!(stages(dir), now);
        }
    }
    make_legacy(1);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo map").done();
    assert!(model() == before);
    assert_eq!(stages(dir), now);
}
