//! Existing models and databases: an input model, a database of another program, photos in a
//! finished model.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::geometry::Rigid3;
use tiepoint_pipeline::sfm::scene::Reconstruction;

use crate::{photos, tiepoint_in};

/// Photos of the model, and of all.
const OLD: usize = 5;
const ALL: usize = 7;

/// A folder with `old` (photos and their workspace `ws`) and `new`, made once.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let dir = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        photos::write(&dir.path().join("old"), OLD, 0);
        photos::write(&dir.path().join("all"), ALL, 0);
        fs::create_dir(dir.path().join("new")).unwrap();
        for index in OLD..ALL {
            let name = format!("{index}.png");
            fs::copy(dir.path().join("all").join(&name), dir.path().join("new").join(&name))
                .unwrap();
        }
        tiepoint_in(dir.path(), "reconstruct {}/old -o {}/ws").done();
        dir
    });
    dir.path()
}

/// A command line in which `{}` is the folder of all tests and `[]` that of this one.
fn run(own: &Path, line: &str) -> crate::Run {
    tiepoint_in(folder(), &line.replace("[]", own.to_str().unwrap()))
}

fn poses(model: &Reconstruction) -> BTreeMap<String, Rigid3> {
    model.registered().map(|(_, image, pose)| (image.name.clone(), *pose)).collect()
}

/// The largest distance of the photos from their true places, in metres, relative to the old ones:
/// the model's unit and frame come from the first and the last old photo.
fn error_m(model: &BTreeMap<String, Rigid3>) -> f64 {
    let place = |index: usize| model[&format!("{index}.png")].origin_in_a();
    let truth = |index: usize| photos::cam_from_world(index).origin_in_a();
    let unit = (place(OLD - 1) - place(0)).norm() / (truth(OLD - 1) - truth(0)).norm();
    (0..ALL)
        .flat_map(|a| (0..OLD).map(move |b| (a, b)))
        .map(|(a, b)| ((place(a) - place(b)).norm() / unit - (truth(a) - truth(b)).norm()).abs())
        .fold(0.0, f64::max)
}

/// All files below a folder with their contents.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(path.clone(), fs::read(path).unwrap());
            }
        }
    }
    files
}

#[test]
fn new_photos_are_registered_onto_an_input_model() {
    let dir = tempfile::tempdir().unwrap();
    let old = read_model(&folder().join("ws/sparse/0")).unwrap();
    run(dir.path(), "reconstruct {}/all -o []/fixed --input-model {}/ws --fix-existing-frames")
        .done();
    let fixed = read_model(&dir.path().join("fixed/sparse/0")).unwrap();
    let (before, after) = (poses(&old), poses(&fixed));
    assert_eq!(after.len(), ALL);
    for (name, pose) in &before {
        assert_eq!(after[name], *pose, "the bits of the pose of {name}");
    }
    assert_eq!(
        fixed.cameras().next().unwrap().1.intrinsics,
        old.cameras().next().unwrap().1.intrinsics
    );
    assert!(error_m(&after) < 0.02, "{}", error_m(&after));

    // With free poses the frame stays, on the average. The features of the first run are kept.
    run(dir.path(), "map []/fixed --input-model {}/ws/sparse/0 --rig off")
        .failed(1, &["--fix-existing-frames true and not false", "--redo map"]);
    run(dir.path(), "map []/fixed --input-model {}/ws/sparse/0 --redo map").done();
    let free = poses(&read_model(&dir.path().join("fixed/sparse/0")).unwrap());
    assert!(free.len() == ALL && free != after && error_m(&free) < 0.02);
    let size = (before["4.png"].origin_in_a() - before["0.png"].origin_in_a()).norm();
    for (name, pose) in &before {
        let moved = (free[name].origin_in_a() - pose.origin_in_a()).norm();
        assert!(moved < 0.01 * size, "{name} by {moved} of {size}");
    }

    // Constant intrinsics are those of the model; refined ones begin there, near a calibration.
    let given = "features {}/all -o []/given --intrinsics 331,331,160,120";
    run(dir.path(), given).done();
    run(dir.path(), "match []/given").done();
    run(dir.path(), "map []/given --input-model {}/ws --fix-existing-frames")
        .failed(1, &["0.png are given", "the input model has others"]);
    run(dir.path(), "map []/given --input-model {}/ws").done();

    // Bad input.
    let map = "map []/fixed --redo map --input-model";
    let fails = |rest: &str, code, parts: &[&str]| {
        run(dir.path(), &format!("{map} {rest}")).failed(code, parts);
    };
    fails("[]/fixed", 1, &["fixed/sparse/0", "is read by this command"]);
    fails("[]/nothing", 1, &["nothing", "No such file"]);
    fails("{}/all", 1, &["all", "holds no COLMAP model"]);
    fails("{}/ws --baseline 1m", 2, &["--baseline", "--input-model"]);
    fails("{}/ws --fix-existing-frames --rig rigid", 2, &["--rig", "--fix-existing-frames"]);
    fails("{}/ws --rig paper", 2, &["--rig paper", "--input-model"]);
    fails("{}/ws --rig-calibration []/x", 2, &["--rig-calibration", "--input-model"]);
    run(dir.path(), "map []/fixed --fix-existing-frames").failed(2, &["--input-model"]);
    photos::write(&dir.path().join("other/sub"), 2, 0);
    run(dir.path(), "reconstruct []/other -o []/ws2 --input-model {}/ws")
        .failed(1, &["cannot go on from", "by name", "0.png", "sub/0.png"]);
}

#[test]
fn photos_are_localized_in_a_model_that_does_not_change() {
    let dir = tempfile::tempdir().unwrap();
    let before = contents(&folder().join("ws"));
    let found = run(dir.path(), "localize {}/ws {}/new -o []/out --json").done().json();
    assert!(contents(&folder().join("ws")) == before, "the workspace is as it was");
    assert_eq!(found["localized"], ALL - OLD);
    for photo in found["photos"].as_array().unwrap() {
        assert!(photo["inliers"].as_u64().unwrap() >= 30, "{photo}");
        assert_eq!(photo["pose"]["camera_source"], "model");
    }
    let (old, new) = (
        read_model(&folder().join("ws/sparse/0")).unwrap(),
        read_model(&dir.path().join("out")).unwrap(),
    );
    let (before, after) = (poses(&old), poses(&new));
    assert_eq!(after.len(), ALL);
    assert!(before.iter().all(|(name, pose)| after[name] == *pose));
    assert_eq!(old.num_tracks(), new.num_tracks());
    assert!(error_m(&after) < 0.02, "{}", error_m(&after));

    // An unknown focal length, and photos that are in the model.
    let text = run(dir.path(), "localize {}/ws {}/all -o []/all --focal-prior 500").done().stdout();
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines[0].contains("0.png no pose: an image of this name has a pose in the model"),
        "{text}"
    );
    assert!(lines[OLD].starts_with("5.png ") && lines[OLD].split(' ').count() == 9, "{text}");
    assert!(lines[ALL].starts_with("2 of 7 photos have a pose"), "{text}");

    // Bad input.
    run(dir.path(), "localize {}/new {}/new -o []/x").failed(1, &["new", "cameras"]);
    run(dir.path(), "localize {}/ws []/nothing -o []/x").failed(1, &["nothing", "No such file"]);
    run(dir.path(), "localize {}/ws {}/new -o {}/ws").failed(1, &["is read by this command"]);
    run(dir.path(), "localize {}/ws {}/new -o []/x --intrinsics 1,2").failed(2, &["2 numbers"]);
}

/// The database of the workspace as another program would leave it: ids with gaps, without tables
/// for rigs, and changed by `sql`.
fn foreign(path: &Path, sql: &str) {
    fs::copy(folder().join("ws/database.db"), path).unwrap();
    let database = rusqlite::Connection::open(path).unwrap();
    let pair = "2147483647 * (10 * (pair_id / 2147483647)) + 10 * (pair_id % 2147483647)";
    database
        .execute_batch(&format!(
            "PRAGMA foreign_keys = OFF; PRAGMA journal_mode = DELETE; DROP TABLE tiepoint_stages;
            DROP TABLE rig_sensors; DROP TABLE frame_data; DROP TABLE frames; DROP TABLE rigs;
            UPDATE images SET image_id = 1000 + image_id;
            UPDATE images SET image_id = 10 * (image_id - 1000);
            UPDATE keypoints SET image_id = 1000 + image_id;
            UPDATE keypoints SET image_id = 10 * (image_id - 1000);
            UPDATE descriptors SET image_id = 1000 + image_id;
            UPDATE descriptors SET image_id = 10 * (image_id - 1000);
            UPDATE matches SET pair_id = -({pair}); UPDATE matches SET pair_id = -pair_id;
            UPDATE two_view_geometries SET pair_id = -({pair});
            UPDATE two_view_geometries SET pair_id = -pair_id;
            {sql}"
        ))
        .unwrap();
}

/// Float descriptors of 128 numbers.
const FLOAT: &str = "ALTER TABLE descriptors DROP COLUMN type;
    UPDATE descriptors SET cols = 512, data = zeroblob(rows * 512);";

#[test]
fn databases_of_other_programs_are_copied_and_mapped() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("foreign.db");
    // The geometry of hloc's rows is identity matrices and a pose without translation.
    let placeholders = "CREATE TEMP TABLE eye AS SELECT
        x'000000000000f03f000000000000000000000000000000000000000000000000000000000000f03f\
        000000000000000000000000000000000000000000000000000000000000f03f' AS m;
        UPDATE two_view_geometries SET F = (SELECT m FROM eye), E = (SELECT m FROM eye),
        H = (SELECT m FROM eye), config = 2, tvec = zeroblob(24);";
    for (name, sql) in [
        ("matches", format!("{FLOAT} DELETE FROM two_view_geometries;")),
        ("geometries", format!("{FLOAT} {placeholders} DELETE FROM matches;")),
        (
            "older",
            "ALTER TABLE two_view_geometries DROP COLUMN qvec;
             ALTER TABLE two_view_geometries DROP COLUMN tvec; DELETE FROM two_view_geometries;
             DELETE FROM descriptors; DROP TABLE pose_priors;
             CREATE TABLE pose_priors(image_id INTEGER PRIMARY KEY, position BLOB);
             INSERT INTO pose_priors VALUES (20, zeroblob(24));"
                .to_owned(),
        ),
        ("features", "DELETE FROM matches; DELETE FROM two_view_geometries;".to_owned()),
    ] {
        foreign(&file, &sql);
        let before = fs::read(&file).unwrap();
        let line = format!("reconstruct {{}}/old --database []/foreign.db -o []/{name}");
        run(dir.path(), &line).done();
        assert!(fs::read(&file).unwrap() == before, "{name}: the file is as it was");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "no file beside it");
        let model = read_model(&dir.path().join(name).join("sparse/0")).unwrap();
        assert_eq!(model.num_registered(), OLD, "{name}");
        // A second run keeps everything.
        assert!(run(dir.path(), &line).done().stdout().contains("5 of 5 images"));
        let copy = rusqlite::Connection::open(dir.path().join(name).join("database.db")).unwrap();
        let ids = "SELECT group_concat(image_id) FROM (SELECT image_id FROM images ORDER BY name)";
        let ids: String = copy.query_row(ids, [], |row| row.get(0)).unwrap();
        assert_eq!(ids, "1,2,3,4,5");
        if name == "older" {
            let prior = "SELECT image_id FROM pose_priors";
            assert_eq!(copy.query_row(prior, [], |row| row.get::<_, i64>(0)).unwrap(), 2);
        }
        drop(copy);
        fs::remove_dir_all(dir.path().join(name)).unwrap();
    }

    // Without photos, stage by stage; matches of deleted images are left out.
    foreign(&file, "DELETE FROM images WHERE image_id = 50; DELETE FROM two_view_geometries;");
    run(dir.path(), "features --database []/foreign.db -o []/ws").done();
    run(dir.path(), "match []/ws").done();
    run(dir.path(), "map []/ws --rig off").done();
    assert_eq!(read_model(&dir.path().join("ws/sparse/0")).unwrap().num_registered(), OLD - 1);
}

#[test]
fn databases_of_other_programs_may_be_bad_input() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("foreign.db");
    let without_pairs = "DELETE FROM matches; DELETE FROM two_view_geometries;";
    for (index, (sql, parts)) in [
        (
            "DELETE FROM descriptors WHERE image_id = 30;",
            ["2.png has no descriptor for each keypoint", "match the features with the program"],
        ),
        ("UPDATE descriptors SET type = 9;", ["its descriptors", "128 bytes and type 9"]),
        (
            "UPDATE descriptors SET type = -1 WHERE image_id = 30;",
            ["some of its images have descriptors of 128 bytes", "others of SIFT"],
        ),
    ]
    .into_iter()
    .enumerate()
    {
        foreign(&file, &format!("{sql} {without_pairs}"));
        let line = format!("reconstruct --database []/foreign.db -o []/other{index}");
        run(dir.path(), &line).failed(1, &parts);
    }
    let last = "pair_id = (SELECT max(pair_id) FROM two_view_geometries)";
    for (index, config) in [-1, 10, 77].into_iter().enumerate() {
        foreign(&file, &format!("UPDATE two_view_geometries SET config = {config} WHERE {last};"));
        let line = format!("features --database []/foreign.db -o []/config{index}");
        let named = format!("its configuration {config} is none of COLMAP's, 0 to 9");
        run(dir.path(), &line).failed(1, &["foreign.db", &named, "verify again"]);
    }
    foreign(&file, "DELETE FROM keypoints; DELETE FROM matches; DELETE FROM two_view_geometries;");
    run(dir.path(), "features --database []/foreign.db -o []/bad2")
        .failed(1, &["foreign.db", "0 images with keypoints"]);
    foreign(&file, "DROP TABLE matches;");
    run(dir.path(), "features --database []/foreign.db -o []/bad3")
        .failed(1, &["foreign.db", "no table `matches`"]);
    fs::write(&file, "words").unwrap();
    run(dir.path(), "features --database []/foreign.db -o []/bad4").failed(1, &["foreign.db"]);
    run(dir.path(), "features --database []/gone.db -o []/bad5").failed(1, &["gone.db"]);
    run(dir.path(), "features -o []/bad6").failed(2, &["INPUT"]);
    run(dir.path(), "features --database []/foreign.db --cameras image -o []/bad7")
        .failed(2, &["--cameras", "--database"]);
    for (command, option) in [
        ("features", "--max-size 100"),
        ("reconstruct", "--max-size 100"),
        ("features", "--every 2"),
        ("reconstruct", "--max-megapixels 1"),
    ] {
        let name = option.split_once(' ').unwrap().0;
        let line = format!("{command} --database []/foreign.db {option} -o []/bad8");
        run(dir.path(), &line).failed(2, &[name, "--database"]);
        assert!(!dir.path().join("bad8").exists(), "{line}");
    }
}
