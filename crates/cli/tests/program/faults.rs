//! Fault injection at chosen file system operations: kills, full disks and failing writes. Files of
//! the user are not changed, the records of the workspace are true, and the same command resumes to
//! the same result. With `TIEPOINT_ALL_FAULTS` every operation is tested; `bench/durability.py`
//! does that, and also kills the program from outside.

mod checkpoints;

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use image::imageops::{FilterType, resize};
use rayon::prelude::*;
use tiepoint_io::colmap::read_model;
use tiepoint_io::database::Database;
use tiepoint_io::store::Error as StoreError;
use tiepoint_io::store::disk::Operation;
use tiepoint_io::store::disk::faults::{Faults, Kind};
use tiepoint_pipeline::input::Calibration;
use tiepoint_pipeline::models::{ExportFormat, ExportSource, adjust, export};
use tiepoint_pipeline::sfm::MapperOptions;
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Rng};
use tiepoint_pipeline::stages::{
    DenseOptions, FeatureOptions, MapOptions, MatchOptions, OpenedInput, dense, extract_features,
    extract_shard, match_shard, open_input, open_shared_input,
};
use tiepoint_pipeline::workspace::LocatedModel;
use tiepoint_pipeline::{Error, Options, Stage, Workspace, reconstruct};
use tiepoint_report::view;

use crate::photos;

const COUNT: usize = 4;
/// Small enough for a run in a tenth of a second, large enough for a model.
const SIZE: (u32, u32) = (144, 108);
/// Number of writes that are drawn per command.
const DRAWN_WRITES: usize = 2;
/// Number of renames, commits and syncs that are drawn per command.
const DRAWN_DECISIVE: usize = 12;
/// With this environment variable every operation is tested.
const WHOLE: &str = "TIEPOINT_ALL_FAULTS";
const MAX_TRIES: usize = 100;
const BETWEEN_TRIES: Duration = Duration::from_millis(20);
/// The folder of new results before and after the rename that commits them
/// (`pipeline/output_folder.rs`).
const STAGED: &str = ".tiepoint-new";
const COMMITTED: &str = ".tiepoint-commit";
/// Seed of the draws.
const SEED: u64 = 20_261_123;

/// A command of the program.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Command {
    Reconstruct,
    /// Features and matches in two shards each.
    Shards,
    /// With another camera model.
    RedoFeatures,
    /// With other image pairs.
    RedoMatch,
    /// With another seed.
    RedoMap,
    Export(ExportFormat, &'static str),
    Adjust,
    View,
    /// With all that it can write.
    Dense,
}

impl Command {
    fn options(self) -> Options {
        let mut options = Options::default();
        match self {
            Self::RedoFeatures => {
                let calibration = Calibration::Unknown {
                    model: Some(CameraModelKind::Radial),
                    focal_px: Some(200.0),
                };
                options.features = FeatureOptions { calibration, ..FeatureOptions::default() };
            }
            Self::RedoMatch => {
                let pairs = "sequential:2".parse().unwrap();
                options.matching = MatchOptions { pairs, ..MatchOptions::default() };
            }
            Self::RedoMap => {
                let mapper = MapperOptions { seed: 7, ..MapperOptions::default() };
                options.mapping = MapOptions { mapper, ..MapOptions::default() };
            }
            _ => {}
        }
        options.redo = match self {
            Self::RedoFeatures => Some(Stage::Features),
            Self::RedoMatch => Some(Stage::Match),
            Self::RedoMap => Some(Stage::Map),
            _ => None,
        };
        options
    }

    fn run(self, dir: &Path, redo: Option<Stage>) -> Result<(), Error> {
        let ws = dir.join("ws");
        let watch = &mut |_: &tiepoint_pipeline::Event| ControlFlow::Continue(());
        match self {
            Self::Export(format, name) => {
                let source = ExportSource {
                    model: &LocatedModel::open(&ws)?,
                    images: None,
                    crs: None,
                    overwrite: false,
                };
                export(&source, format, &dir.join("out").join(name)).map(drop)
            }
            Self::Adjust => {
                adjust(&ws, Some(&dir.join("out")), false, false, None, watch).map(drop)
            }
            Self::View => view(&LocatedModel::open(&ws)?, &ws, &str::to_owned).map(drop),
            Self::Dense => {
                let options = DenseOptions {
                    write_normal_maps: true,
                    write_depth_pngs: true,
                    ..DenseOptions::default()
                };
                dense(&mut Workspace::open(&ws)?, &options, redo, watch)
            }
            Self::Shards => {
                let (photos, options) = ([dir.join("photos")], self.options());
                let shards = || ["1/2", "2/2"].map(|shard| shard.parse().unwrap());
                for shard in shards() {
                    let opened = retried(|| open_shared_input(&photos, None, &ws))?;
                    let OpenedInput { photos, workspace, .. } = opened;
                    let options = &options.features;
                    extract_shard(&photos, &workspace, options, shard, redo, watch)?;
                }
                let mut opened = retried(|| open_input(&photos, None, &ws, None, redo, watch))?;
                let options_of = &options.features;
                extract_features(&opened.photos, &mut opened.workspace, options_of, redo, watch)?;
                drop(opened);
                for shard in shards() {
                    let workspace = retried(|| Workspace::open_shared(&ws))?;
                    match_shard(&workspace, &options.matching, shard, redo, watch)?;
                }
                retried(|| reconstruct(&photos, &ws, &options, watch).map(drop))
            }
            _ => {
                let options = Options { redo, ..self.options() };
                reconstruct(&[dir.join("photos")], &ws, &options, watch).map(drop)
            }
        }
    }

    /// Whether it needs a complete workspace.
    fn has_workspace(self) -> bool {
        ![Self::Reconstruct, Self::Shards].contains(&self)
    }
}

/// Tries again while a workspace is in use: processes that other tests start inherit the locks of
/// this process until exec.
fn retried<T>(mut run: impl FnMut() -> Result<T, Error>) -> Result<T, Error> {
    let mut tries = 0;
    loop {
        match run() {
            Err(Error::Store(StoreError::InUse { .. })) if tries < MAX_TRIES => tries += 1,
            ended => return ended,
        }
        std::thread::sleep(BETWEEN_TRIES);
    }
}

/// Names and contents of the wanted files below a folder.
fn files(dir: &Path, is_wanted: &dyn Fn(&str) -> bool) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(folder) else { continue };
        for entry in entries {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(dir).unwrap().to_str().unwrap().to_owned();
            if path.is_dir() {
                folders.push(path);
            } else if is_wanted(&name) {
                all.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    all
}

fn of_user(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    files(dir, &|name| name.starts_with("photos/") || name.ends_with("mine.txt"))
}

/// Contents of the result files, which must be the same after every fault.
fn results(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let is_result = |name: &str| {
        name.starts_with("ws/sparse/")
            || name.starts_with("ws/dense/")
            || name == "ws/points.ply"
            || name == "ws/timestamps.csv"
            || name.starts_with("out/") && !name.contains("/.")
    };
    files(dir, &is_result)
}

fn leftovers(dir: &Path) -> Vec<String> {
    let is_left = |name: &str| {
        let hidden =
            name.contains(".tiepoint-") || name.ends_with("-wal") || name.ends_with("-shm");
        hidden || name.ends_with("-journal")
    };
    files(dir, &is_left).into_keys().collect()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

/// Checks that the records agree with the data.
fn check_record(dir: &Path, case: &str) {
    let ws = dir.join("ws");
    if let Ok(database) = Database::open(&ws.join("database.db")) {
        assert_eq!(database.num_images(), COUNT, "{case}");
        let rows = database.stage_rows().unwrap().unwrap_or_else(|| panic!("{case}: no record"));
        let row = |stage: &str| rows.iter().find(|row| row.stage == stage);
        let features = row("features").unwrap_or_else(|| panic!("{case}: no record of features"));
        let model = database.read_cameras().unwrap()[0].intrinsics.kind().name();
        assert!(
            features.recipe.contains(&format!("\"{model}\"")),
            "{case}: {} {model}",
            features.recipe
        );
        let pairs = database.matched_pairs().unwrap().len();
        match row("match") {
            None => assert_eq!(pairs, 0, "{case}"),
            Some(row) => {
                let most = if row.recipe.contains("sequential:2") { 5 } else { 6 };
                assert!(
                    pairs <= most && (pairs == most || !row.is_complete),
                    "{case}: {pairs} {}",
                    row.recipe
                );
            }
        }
    }
    // A model is complete or absent, and never a mix of two.
    if ws.join("sparse/0/images.bin").is_file() {
        read_model(&ws.join("sparse/0")).unwrap_or_else(|error| panic!("{case}: {error}"));
    }
}

/// A temporary folder, in memory if possible, where a sync costs nothing.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Injects one fault, resumes, and checks the results.
fn test_fault(
    command: Command,
    base: &Path,
    expected: &BTreeMap<String, Vec<u8>>,
    at: usize,
    kind: Kind,
) {
    let case = format!("{command:?}, {kind:?} at change {at}");
    let dir = folder();
    let dir = dir.path().canonicalize().unwrap();
    copy(base, &dir);
    if !command.has_workspace() {
        fs::remove_dir_all(dir.join("ws")).unwrap();
    }
    let mine = of_user(&dir);
    let faults = Faults::at(&dir, at, kind);
    let ended = command.run(&dir, command.options().redo);
    let hit = faults.hit();
    drop(faults);
    assert!(of_user(&dir) == mine, "{case}: files of the user changed");
    if let Err(error) = &ended {
        assert!(hit && error.to_string().lines().count() == 1, "{case}: {error}");
    }
    check_record(&dir, &case);
    // Resumes without --redo, or with it if the stage had not begun, as the message says.
    let again = |redo| retried(|| command.run(&dir, redo));
    let on = match again(None) {
        Err(Error::Changed { .. }) => again(command.options().redo),
        ended => ended,
    };
    on.unwrap_or_else(|error| panic!("{case}, then {error} (first {ended:?})"));
    assert!(of_user(&dir) == mine, "{case}: files of the user changed");
    let now = results(&dir);
    for (name, bytes) in expected {
        assert!(now.get(name) == Some(bytes), "{case}: {name} differs");
    }
    assert_eq!(now.len(), expected.len(), "{case}: {:?}", now.keys());
    assert!(leftovers(&dir).is_empty(), "{case}: {:?}", leftovers(&dir));
}

#[test]
fn nothing_is_lost_and_no_record_is_false_whatever_fails() {
    let base = folder();
    let base = base.path().canonicalize().unwrap();
    fs::create_dir_all(base.join("photos")).unwrap();
    for index in 0..COUNT {
        let small = resize(&photos::photo(index, 0), SIZE.0, SIZE.1, FilterType::Triangle);
        small.save(base.join(format!("photos/{index}.png"))).unwrap();
    }
    Command::Reconstruct.run(&base, None).unwrap();
    for name in ["ws/mine.txt", "ws/sparse/0/mine.txt", "out/mine.txt"] {
        fs::create_dir_all(base.join(name).parent().unwrap()).unwrap();
        fs::write(base.join(name), "mine").unwrap();
    }
    let commands = [
        Command::Reconstruct,
        Command::Shards,
        Command::RedoFeatures,
        Command::RedoMatch,
        Command::RedoMap,
        Command::Export(ExportFormat::Colmap, ""),
        Command::Export(ExportFormat::Nerfstudio, ""),
        Command::Export(ExportFormat::OpenMvs, ""),
        Command::Export(ExportFormat::Ply, "a.ply"),
        Command::Adjust,
        Command::View,
        Command::Dense,
    ];
    for command in commands {
        let dir = folder();
        let dir = dir.path().canonicalize().unwrap();
        copy(&base, &dir);
        if !command.has_workspace() {
            fs::remove_dir_all(dir.join("ws")).unwrap();
        }
        let faults = Faults::count(&dir);
        command.run(&dir, command.options().redo).unwrap();
        let log = faults.log();
        drop(faults);
        check_order(&log, &format!("{command:?}"));
        let expected = results(&dir);
        let mut writes: Vec<usize> =
            (0..log.len()).filter(|at| log[*at].0 == Operation::Write).collect();
        let mut rng = Rng::stream(SEED, &[log.len() as u64]);
        let is_whole = std::env::var_os(WHOLE).is_some();
        let mut draw = |changes: &mut Vec<usize>, count: usize| {
            while changes.len() > count && !is_whole {
                changes.swap_remove(rng.below(changes.len()));
            }
        };
        draw(&mut writes, DRAWN_WRITES);
        let decides = |at: &usize| {
            matches!(log[*at].0, Operation::Rename | Operation::Commit | Operation::Sync)
        };
        let mut decisive: Vec<usize> = (0..log.len()).filter(decides).collect();
        draw(&mut decisive, DRAWN_DECISIVE);
        let mut cases: Vec<(usize, Kind)> = Vec::new();
        for at in writes {
            cases.extend([Kind::Stop, Kind::Full, Kind::Fail].map(|kind| (at, kind)));
        }
        cases.extend(decisive.iter().flat_map(|at| [(*at, Kind::Stop), (*at, Kind::Fail)]));
        let stops = cases.iter().filter(|(_, kind)| *kind == Kind::Stop).count();
        println!("{command:?}: {} changes, {stops} stops, {} faults", log.len(), cases.len());
        cases.par_iter().for_each(|&(at, kind)| test_fault(command, &base, &expected, at, kind));
    }
}

/// Checks the order of operations that survives a power loss: files are synchronised before they
/// are renamed, and their folder afterwards.
///
/// Several threads write images, so that other files may be open during a rename. A rename needs
/// only its own temporary file to be synchronised, or all files of a renamed folder.
fn check_order(log: &[(Operation, PathBuf)], case: &str) {
    let mut unsynced: Vec<&PathBuf> = Vec::new();
    let mut renames_checked = 0;
    for (operation, path) in log {
        match operation {
            Operation::Create | Operation::Write => unsynced.push(path),
            Operation::Sync | Operation::Remove => unsynced.retain(|other| *other != path),
            Operation::Rename => {
                let staged = path.with_file_name(STAGED);
                let is_commit = path.file_name().is_some_and(|name| name == COMMITTED);
                let name = path.file_name().unwrap().to_string_lossy();
                let own = path.with_file_name(format!(".{name}.tiepoint-part"));
                let waiting = unsynced
                    .iter()
                    .find(|other| ***other == own || is_commit && other.starts_with(&staged));
                renames_checked += 1;
                assert!(
                    waiting.is_none(),
                    "{case}: {waiting:?} is not on the disk before {path:?} gets its name"
                );
            }
            _ => {}
        }
    }
    assert!(renames_checked > 0, "{case}: nothing was renamed");
    let last_rename = log.iter().rposition(|(operation, _)| *operation == Operation::Rename);
    let last_sync = log.iter().rposition(|(operation, _)| *operation == Operation::SyncFolder);
    assert!(last_rename <= last_sync, "{case}: the last name is not on the disk");
}
