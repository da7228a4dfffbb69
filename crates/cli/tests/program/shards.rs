//! Stages in shards, and mapping in parts: processes that share the work of a stage.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use rusqlite::Connection;
use rusqlite::types::Value;
use tiepoint_pipeline::store::disk::temporary_path;

use crate::{photos, tiepoint_in};

const COUNT: usize = 7;
const SHARDS: usize = 3;
const TILES: &str = ".tiepoint-tiles";

/// All rows of the tables that features and matching fill.
fn rows(workspace: &Path) -> Vec<(String, Vec<Vec<Value>>)> {
    let database = Connection::open(workspace.join("database.db")).unwrap();
    let tables = [
        "cameras",
        "images",
        "keypoints",
        "descriptors",
        "matches",
        "two_view_geometries",
        "tiepoint_photos",
        "tiepoint_stages",
    ];
    let of_table = |table: &str| {
        let mut rows = database.prepare(&format!("SELECT * FROM {table} ORDER BY 1")).unwrap();
        let columns = rows.column_count();
        let row = |row: &rusqlite::Row| (0..columns).map(|column| row.get(column)).collect();
        let rows: Vec<Vec<Value>> =
            rows.query_map([], row).unwrap().collect::<Result<_, _>>().unwrap();
        assert!(!rows.is_empty(), "{table}");
        (table.to_owned(), rows)
    };
    tables.map(of_table).into()
}

/// Runs a command line once for each shard, all at the same time.
fn run_all(dir: &Path, line: &str) {
    let start = |number: usize| {
        let line = line.replace("{}", dir.to_str().unwrap());
        let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
        command.args(line.split_whitespace());
        command.args(["--shard", &format!("{number}/{SHARDS}")]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let processes: Vec<_> = (1..=SHARDS).map(start).collect();
    for process in processes {
        let output = process.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn shards_give_the_rows_and_models_of_one_process() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    // A photo that cannot be decoded is skipped by all.
    let good = fs::read(dir.join("photos/3.png")).unwrap();
    fs::write(dir.join("photos/damaged.png"), &good[..good.len() / 2]).unwrap();
    let one = tiepoint_in(dir, "reconstruct {}/photos -o {}/one --json").done().json();

    run_all(dir, "features {}/photos -o {}/ws");
    assert!(!dir.join("ws/database.db").exists(), "shards leave their tiles alone");
    let tile = dir.join("ws").join(TILES).join("features-2-of-3");
    let made = fs::read(&tile).unwrap();
    let again = "features {}/photos -o {}/ws --shard 2/3 --json";
    assert_eq!(tiepoint_in(dir, again).done().json()["is_kept"], true);
    assert_eq!(
        tiepoint_in(dir, &format!("{again} --redo features")).done().json()["is_kept"],
        false
    );
    assert!(fs::read(&tile).unwrap() == made, "the same bytes");
    tiepoint_in(dir, "match {}/ws --shard 1/3").failed(1, &["is not a workspace"]);
    tiepoint_in(dir, "features {}/photos -o {}/ws").done();
    assert!(!dir.join("ws").join(TILES).exists(), "the database has their content");
    let left = tiepoint_in(dir, again).done().json();
    assert_eq!((&left["is_kept"], &left["tile"]), (&true.into(), &().into()));

    run_all(dir, "match {}/ws");
    let merged = tiepoint_in(dir, "match {}/ws --json").done();
    assert!(merged.events().iter().all(|event| event["event"] != "pair_done"), "none is left");
    assert!(rows(&dir.join("ws")) == rows(&dir.join("one")));
    let report = tiepoint_in(dir, "map {}/ws --json").done().json();
    for part in [&["models"][..], &["warnings"], &["stages", "features", "skipped"]] {
        let of = |report: &serde_json::Value| {
            part.iter().fold(report.clone(), |at, key| at[key].clone())
        };
        assert_eq!(of(&report), of(&one), "{part:?}");
    }
    for file in ["cameras", "images", "points3D"] {
        let read = |ws: &str| fs::read(dir.join(format!("{ws}/sparse/0/{file}.bin"))).unwrap();
        assert!(read("ws") == read("one"), "{file}");
    }
}

#[test]
fn a_shard_that_is_missing_or_wrong_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let tiles = dir.join("ws").join(TILES);
    let (plain, shard) = ("features {}/photos -o {}/ws", |number| {
        format!("features {{}}/photos -o {{}}/ws --shard {number}/{SHARDS}")
    });
    let tile = |number: usize| tiles.join(format!("features-{number}-of-{SHARDS}"));
    run_all(dir, plain);

    // A killed process leaves the begin of a file under another name.
    let good = fs::read(tile(2)).unwrap();
    fs::remove_file(tile(2)).unwrap();
    fs::write(temporary_path(&tile(2)), &good[..good.len() / 2]).unwrap();
    let missing =
        ["2 tiles of features", "shard 2/3 is missing or was interrupted", "`tiepoint fea"];
    tiepoint_in(dir, plain).failed(1, &missing);
    tiepoint_in(dir, &shard(2)).done();
    assert!(fs::read(tile(2)).unwrap() == good, "the same bytes after a kill");
    assert!(!temporary_path(&tile(2)).exists());

    fs::copy(tile(1), tile(2)).unwrap();
    tiepoint_in(dir, plain).failed(1, &["features-2-of-3 is a copy of shard 1/3", "delete it"]);
    let mut damaged = good.clone();
    damaged[good.len() / 2] ^= 1;
    fs::write(tile(2), &damaged).unwrap();
    tiepoint_in(dir, plain).failed(1, &["features-2-of-3 is damaged", "run shard 2/3"]);
    tiepoint_in(dir, &shard(2)).failed(1, &["features-2-of-3 is damaged"]);
    fs::remove_file(tile(2)).unwrap();
    let other = format!("{} --max-size 100", shard(2));
    tiepoint_in(dir, &other).done();
    tiepoint_in(dir, plain).failed(1, &["features-2-of-3 was made with --max-size 100 and not"]);
    fs::write(tile(2), &good).unwrap();
    tiepoint_in(dir, &format!("{plain} --shard 1/2")).done();
    tiepoint_in(dir, plain).failed(1, &["of features of 2 and of 3 shards", "delete"]);
    fs::remove_file(tiles.join("features-1-of-2")).unwrap();
    photos::photo(0, 7).save(dir.join("photos/9.png")).unwrap();
    tiepoint_in(dir, plain).failed(1, &["was made from other photos"]);
    fs::remove_file(dir.join("photos/9.png")).unwrap();
    assert!(!dir.join("ws/database.db").exists(), "nothing was begun");
    tiepoint_in(dir, plain).done();

    // Matches: another seed, and features that were made anew since.
    for number in 1..=SHARDS {
        let seed = usize::from(number == 3);
        let line = format!("match {{}}/ws --seed {seed} --shard {number}/{SHARDS}");
        tiepoint_in(dir, &line).done();
    }
    tiepoint_in(dir, "match {}/ws").failed(1, &["match-3-of-3 was made with", "seed 1 and not 0"]);
    fs::remove_file(tiles.join("match-3-of-3")).unwrap();
    tiepoint_in(dir, "match {}/ws --shard 3/3").done();
    tiepoint_in(dir, &format!("{plain} --max-size 300 --redo features")).done();
    tiepoint_in(dir, "match {}/ws").failed(1, &["match-1-of-3", "from other features"]);
    fs::remove_dir_all(&tiles).unwrap();
    tiepoint_in(dir, "match {}/ws").done();

    for wrong in ["0/3", "4/3", "3"] {
        tiepoint_in(dir, &format!("{plain} --shard {wrong}")).failed(2, &["i/n", wrong]);
    }
}

/// Shards of a complete stage, and files of others among the tiles.
#[test]
fn tiles_of_other_options_and_files_of_others_stay() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let tiles = dir.join("ws").join(TILES);
    let (plain, redo) = ("features {}/photos -o {}/ws", "--max-size 100 --redo features");
    tiepoint_in(dir, plain).done();
    run_all(dir, &format!("{plain} {redo}"));
    fs::write(tiles.join("features-02-of-4"), "mine").unwrap();
    let begun = temporary_path(&tiles.join("features-3-of-4"));
    fs::write(&begun, "of a killed shard").unwrap();
    let kept = tiepoint_in(dir, plain).done();
    let note = "of shard 1/3 was made with --max-size 100 and not";
    assert!(kept.stderr().contains(note), "{}", kept.stderr());
    assert!(!begun.exists());
    let left = || fs::read_dir(&tiles).unwrap().count();
    assert_eq!(left(), SHARDS + 1, "none is removed unread");
    let report = tiepoint_in(dir, &format!("{plain} {redo} --json")).done();
    let done = report.events().into_iter().filter(|event| event["event"] == "image_done").count();
    assert_eq!(done, COUNT);
    assert_eq!(left(), 1, "taken and removed");
    run_all(dir, &format!("{plain} {redo}"));
    tiepoint_in(dir, &format!("{plain} --max-size 100")).done();
    assert_eq!(fs::read(tiles.join("features-02-of-4")).unwrap(), b"mine");
    assert_eq!(left(), 1, "the database has the same");
}

/// JSON has no bytes that are not UTF-8.
#[cfg(target_os = "linux")]
#[test]
fn path_that_is_not_utf8_is_shown_in_json() {
    use std::os::unix::ffi::OsStrExt;

    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), COUNT, 0);
    let workspace = dir.path().join(std::ffi::OsStr::from_bytes(b"caf\xe9"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.arg("features").arg(dir.path().join("photos")).arg("-o").arg(&workspace);
    let output = command.args(["--shard", "1/3", "--json"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let tile = report["tile"].as_str().unwrap();
    assert!(tile.ends_with("caf\u{fffd}/.tiepoint-tiles/features-1-of-3"), "{tile}");
}

/// Shards run side by side, and not beside a command that changes the workspace.
#[test]
fn shards_share_a_workspace_with_shards_alone() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let (plain, shard) = ("features {}/photos -o {}/ws", "features {}/photos -o {}/ws --shard 1/2");
    tiepoint_in(dir, shard).done();
    let lock = File::open(dir.join("ws/.lock")).unwrap();
    lock.try_lock_shared().unwrap();
    tiepoint_in(dir, &shard.replace("1/2", "2/2")).done();
    tiepoint_in(dir, plain).failed(1, &["in use by another run"]);
    lock.unlock().unwrap();
    lock.try_lock().unwrap();
    tiepoint_in(dir, shard).failed(1, &["in use by another run"]);
    lock.unlock().unwrap();
    tiepoint_in(dir, plain).done();
}

/// Of the models of a workspace.
fn models(workspace: &Path) -> Vec<Vec<u8>> {
    let read = |name: &str| fs::read(workspace.join(format!("sparse/0/{name}.bin"))).unwrap();
    ["cameras", "images", "points3D"].map(read).into()
}

/// 60 images in two parts: by one process on one thread and on two, and by a process for each part.
#[test]
fn sub_maps_give_the_same_bytes_whoever_maps_them() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let synth = "synth -o {}/drive --frames 30 --size 160x120 --rate 5 --route open --seed 3";
    tiepoint_in(dir, synth).done();
    tiepoint_in(dir, "features {}/drive -o {}/ws --timestamps {}/drive/timestamps.csv").done();
    tiepoint_in(dir, "match {}/ws --pairs sequential:6").done();
    let workspaces = ["one", "two", "parts"].map(|name| dir.join(name));
    for to in &workspaces {
        fs::create_dir(to).unwrap();
        for entry in fs::read_dir(dir.join("ws")).unwrap().map(Result::unwrap) {
            fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
    let map = |ws: &str, more: &str| {
        tiepoint_in(dir, &format!("map {{}}/{ws} --rig off --submaps 50 {more}"))
    };
    let one = map("one", "--threads 1 --max-memory 1MB --json").done().json();
    assert_eq!(one["models"][0]["registered"], 60, "{one}");
    map("two", "--threads 2").done();
    assert!(models(&workspaces[0]) == models(&workspaces[1]), "any number of threads");
    assert!(!workspaces[0].join(TILES).exists());

    map("parts", "--submap 2").failed(1, &["no sub-map 1", "map it first"]);
    map("parts", "--merge").failed(1, &["0 tiles of models", "shard 1/2 is missing"]);
    map("parts", "--submap 3").failed(1, &["sub-maps 1 to 2", "none of number 3"]);
    map("parts", "--submap 1").done();
    map("parts", "--merge").failed(1, &["1 tiles of models", "shard 2/2 is missing"]);
    let kept = map("parts", "--submap 1 --json").done().json();
    assert_eq!(kept["is_kept"], true);
    let other = map("parts", "--submap 2 --seed 1").failed(1, &["map-1-of-2 was made with"]);
    assert!(other.stderr().contains("seed 0 and not 1"), "{}", other.stderr());
    let tile = workspaces[2].join(TILES).join("map-1-of-2");
    let made = fs::read(&tile).unwrap();
    map("parts", "--seed 1").failed(1, &["map-1-of-2 was made with", "seed 0 and not 1"]);
    assert!(fs::read(&tile).unwrap() == made, "it is not replaced");
    map("parts", "--submap 2").done();
    map("parts", "--merge").done();
    let left = map("parts", "--submap 2 --json").done().json();
    assert_eq!((&left["is_kept"], &left["tile"]), (&true.into(), &().into()));
    assert!(models(&workspaces[0]) == models(&workspaces[2]), "a process for each part");
    assert!(!workspaces[2].join(TILES).exists());

    // Tiles of other options stay when the stage is complete.
    fs::create_dir(workspaces[2].join(TILES)).unwrap();
    fs::write(&tile, &made).unwrap();
    let done = tiepoint_in(dir, "map {}/parts --rig off --submaps off --redo map").done();
    let note = "tiles of map stay";
    assert!(done.stderr().contains(note), "{}", done.stderr());
    assert!(fs::read(&tile).unwrap() == made);

    // One map: too few images for parts by default, or something else gives the frame.
    for options in ["--submaps off", "--submaps auto"] {
        let line = format!("map {{}}/ws --rig off {options} --submap 1");
        tiepoint_in(dir, &line).failed(1, &["is mapped as one map", "run `tiepoint map` alone"]);
    }
    tiepoint_in(dir, "map {}/ws --submaps 50 --rig paper").failed(1, &["as one map"]);
    tiepoint_in(dir, "map {}/ws --submaps 20").failed(1, &["submaps", "at least 50"]);
}

/// A run that maps all parts by itself and is killed in the second one: what it leaves is its own,
/// and is in the way of nobody when the matches change.
#[test]
fn tiles_of_a_killed_map_are_discarded_when_its_input_changes() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let synth = "synth -o {}/drive --frames 30 --size 160x120 --rate 2.5 --route open --seed 3";
    tiepoint_in(dir, synth).done();
    tiepoint_in(dir, "features {}/drive -o {}/ws --timestamps {}/drive/timestamps.csv").done();
    tiepoint_in(dir, "match {}/ws --pairs sequential:3").done();
    let tile = dir.join("ws").join(TILES).join("map-1-of-2");
    let killed = || {
        let mut map = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
        map.arg("map").arg(dir.join("ws")).args(["--rig", "off", "--submaps", "50"]);
        let mut map = map.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        while !tile.exists() {
            assert!(map.try_wait().unwrap().is_none(), "it ended before its first tile");
            std::thread::sleep(Duration::from_millis(1));
        }
        map.kill().unwrap();
        map.wait().unwrap();
    };
    // Says what there is, and maps nothing.
    let merge = "map {}/ws --rig off --submaps 50 --merge";
    killed();
    tiepoint_in(dir, merge).failed(1, &["1 tiles of models", "shard 2/2 is missing"]);
    tiepoint_in(dir, &format!("{merge} --redo map")).failed(1, &["0 tiles", "shard 1/2"]);
    assert!(!tile.exists());
    killed();
    tiepoint_in(dir, "match {}/ws --pairs sequential:2 --redo match").done();
    tiepoint_in(dir, merge).failed(1, &["0 tiles of models", "shard 1/2 is missing"]);
}
