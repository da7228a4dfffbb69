//! Atomicity of writers: after a kill, a full disk or a device error at any change, the old or the
//! new content is there, and a later run succeeds.
#![cfg(all(feature = "database", feature = "faults"))]
#![allow(clippy::unwrap_used)]

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use tiepoint_features::{Features, Keypoint};
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_io::Result;
use tiepoint_io::colmap::{Format, read_model, write_model};
use tiepoint_io::database::{Database, StageRow, read_stage_rows};
use tiepoint_io::store::AtomicFile;
use tiepoint_io::store::disk::faults::{Faults, Kind};
use tiepoint_io::store::disk::{self, Operation};
use tiepoint_scene::{
    Camera, CameraId, Image, ImageId, ImagePair, Match, Reconstruction, TwoView, TwoViewKind,
};

use crate::common::{RigKind, random_model};

const KINDS: [Kind; 3] = [Kind::Stop, Kind::Full, Kind::Fail];
/// Keypoints of an image; their descriptors take more than a page of the database.
const KEYPOINTS: usize = 40;

fn names(dir: &Path) -> Vec<String> {
    let entries = fs::read_dir(dir).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Runs `work` with a fault at each of its changes in turn, each time in a new folder that
/// `prepare` fills, then checks the folder. Returns the number of changes.
fn test_every_fault(
    parent: &Path,
    prepare: impl Fn(&Path),
    work: impl Fn(&Path) -> Result<()>,
    check: impl Fn(&Path, Kind, bool),
) -> usize {
    let dir = tempfile::tempdir_in(parent).unwrap();
    prepare(dir.path());
    let faults = Faults::count(dir.path());
    work(dir.path()).unwrap();
    let count = faults.log().len();
    assert!(count > 0 && !faults.hit());
    drop(faults);
    for kind in KINDS {
        for n in 0..count {
            let dir = tempfile::tempdir_in(parent).unwrap();
            prepare(dir.path());
            let faults = Faults::at(dir.path(), n, kind);
            let done = work(dir.path());
            // With a full disk, changes that need no space succeed.
            assert!(
                faults.hit() || (kind == Kind::Full && done.is_ok()),
                "{kind:?} at {n} of {count}"
            );
            if kind == Kind::Stop {
                assert!(done.is_err(), "{kind:?} at {n} of {count}: {:?}", &faults.log()[n..]);
            }
            drop(faults);
            check(dir.path(), kind, done.is_ok());
        }
    }
    count
}

fn camera() -> Camera {
    let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
    Camera { intrinsics, width: 640, height: 480, has_focal_prior: true }
}

fn images(prefix: &str) -> Vec<Image> {
    (0..3).map(|index| Image::new(format!("{prefix}{index}.png"), CameraId(0), vec![])).collect()
}

fn features() -> Features {
    let keypoint = |index| Keypoint { x: index as f32, y: 1.0, scale: 1.0, orientation: 0.0 };
    Features {
        keypoints: (0..KEYPOINTS).map(keypoint).collect(),
        descriptors: vec![[7; 128]; KEYPOINTS].into(),
    }
}

fn stage() -> StageRow {
    StageRow { stage: "features".to_owned(), is_complete: true, recipe: "{}".to_owned() }
}

fn pairs() -> [ImagePair; 2] {
    [(0, 1), (1, 2)].map(|(a, b)| ImagePair::new(ImageId(a), ImageId(b)).unwrap())
}

fn matches() -> Vec<Match> {
    (0..KEYPOINTS as u32).map(|k| Match { a: k, b: k }).collect()
}

fn fill(path: &Path, prefix: &str) -> Result<Database> {
    Database::create_with(path, |db| {
        db.write_cameras(&[camera()])?;
        db.write_images(&images(prefix))?;
        db.write_rigs(&[], &[])
    })
}

fn write_database(dir: &Path) -> Result<()> {
    let mut db = fill(&dir.join("database.db"), "new")?;
    let features = features();
    for image in 0..3 {
        db.write_features([(ImageId(image), &features)])?;
    }
    db.clear_matches_for(&[stage()])?;
    let view = TwoView { kind: TwoViewKind::Calibrated, matches: matches(), ..TwoView::default() };
    for pair in pairs() {
        db.write_pairs([(pair, &matches()[..], &view)])?;
    }
    db.close()
}

/// How far the new database got; `None` for the old one. Panics where it is neither.
fn progress(path: &Path, old: &str) -> Option<usize> {
    let rows = read_stage_rows(path).unwrap();
    let db = Database::open(path).unwrap();
    assert_eq!(db.stage_rows().unwrap(), rows);
    let (pairs_done, views) = (db.read_matches().unwrap(), db.read_two_views().unwrap());
    let of_matches: Vec<ImagePair> = pairs_done.iter().map(|(pair, _)| *pair).collect();
    let of_views: Vec<ImagePair> = views.iter().map(|(pair, _)| *pair).collect();
    assert_eq!(of_matches, of_views);
    assert!(pairs_done.iter().all(|(_, list)| *list == matches()));
    assert_eq!(db.read_cameras().unwrap(), [camera()]);
    let found = db.read_images().unwrap();
    let counts = db.keypoint_counts().unwrap();
    let with_features = counts.iter().take_while(|count| count.is_some()).count();
    assert!(counts[with_features..].iter().all(Option::is_none));
    for image in 0..with_features {
        assert_eq!(
            db.read_features(ImageId(image as u32)).unwrap().descriptors,
            features().descriptors
        );
    }
    if found == images(old) {
        assert_eq!((rows, with_features, of_views), (None, 1, vec![pairs()[0]]));
        return None;
    }
    assert_eq!(found, images("new"));
    assert!(rows.is_none() || (with_features == 3 && rows == Some(vec![stage()])));
    assert!(of_views.is_empty() || rows.is_some());
    assert_eq!(of_views[..], pairs()[..of_views.len()]);
    Some(with_features + usize::from(rows.is_some()) + of_views.len())
}

/// A database of a killed run: its log holds all of its content.
fn old_database(dir: &Path) {
    let made = tempfile::tempdir().unwrap();
    let path = made.path().join("database.db");
    let mut db = fill(&path, "old").unwrap();
    db.write_features([(ImageId(0), &features())]).unwrap();
    db.write_pairs([(pairs()[0], &matches()[..], &TwoView::default())]).unwrap();
    for name in ["database.db", "database.db-wal"] {
        fs::copy(made.path().join(name), dir.join(name)).unwrap();
    }
    drop(db);
}

#[test]
fn databases_are_replaced_atomically() {
    let check = |dir: &Path, kind: Kind, is_done: bool, is_first: bool| {
        let path = dir.join("database.db");
        if is_first && !path.exists() {
            assert!(!is_done);
        } else {
            let progress = progress(&path, "old");
            assert!(!is_done || progress == Some(6));
            assert!(!is_first || progress.is_some());
        }
        if kind == Kind::Full {
            // Files can be removed from a full disk.
            assert!(!names(dir).iter().any(|name| name.starts_with('.')), "{:?}", names(dir));
        }
        write_database(dir).unwrap();
        assert_eq!(names(dir), ["database.db"]);
        assert_eq!(progress(&path, "old"), Some(6));
    };
    // In a memory file system if there is one: thousands of files are synchronised.
    let memory = Path::new("/dev/shm");
    let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let first = test_every_fault(
        &parent,
        |_| {},
        write_database,
        |dir, kind, is_done| check(dir, kind, is_done, true),
    );
    let again = test_every_fault(&parent, old_database, write_database, |dir, kind, is_done| {
        check(dir, kind, is_done, false)
    });
    assert!(first > 30 && again > first, "{first} {again}");
}

#[test]
fn changes_of_a_database_are_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let faults = Faults::count(dir.path());
    write_database(dir.path()).unwrap();
    let log = faults.log();
    let root = dir.path().canonicalize().unwrap();
    let (path, part) = (root.join("database.db"), root.join(".database.db.tiepoint-part"));
    let place =
        |operation, path: &Path| log.iter().rposition(|seen| *seen == (operation, path.to_owned()));
    assert!(log.contains(&(Operation::Create, part.clone())));
    // The temporary database is synchronised before the rename.
    let renamed = place(Operation::Rename, &path).unwrap();
    assert!(place(Operation::Write, &part).unwrap() < place(Operation::Sync, &part).unwrap());
    assert!(place(Operation::Sync, &part).unwrap() < renamed);
    assert_eq!(log[renamed + 1], (Operation::SyncFolder, root.clone()));
    // Then each transaction is written to the log, and the log is checkpointed.
    assert_eq!(
        log[renamed..].iter().filter(|(operation, _)| *operation == Operation::Commit).count(),
        6
    );
    let wal = root.join("database.db-wal");
    assert!(place(Operation::Create, &wal).unwrap() > renamed);
    assert!(
        place(Operation::Write, &path).unwrap() > renamed
            && place(Operation::Remove, &wal).is_some()
    );
}

#[test]
fn files_are_replaced_atomically() {
    // More bytes than the buffer of a writer.
    let new = "new ".repeat(5000);
    let write = |dir: &Path| {
        Ok(AtomicFile::write_with(dir.join("file"), |file| file.write_all(new.as_bytes()))?)
    };
    for is_there in [false, true] {
        let prepare = |dir: &Path| {
            if is_there {
                fs::write(dir.join("file"), "old").unwrap();
            }
        };
        let check = |dir: &Path, kind: Kind, is_done: bool| {
            let found = fs::read_to_string(dir.join("file")).ok();
            let old = is_there.then_some("old");
            assert!(found.as_deref() == Some(&new) || (found.as_deref() == old && !is_done));
            if kind == Kind::Full {
                assert!(!names(dir).iter().any(|name| name.starts_with('.')));
            }
            write(dir).unwrap();
            assert_eq!(names(dir), ["file"]);
            assert_eq!(fs::read_to_string(dir.join("file")).unwrap(), new);
        };
        assert!(test_every_fault(&std::env::temp_dir(), prepare, write, check) >= 5);
    }
    let dir = tempfile::tempdir().unwrap();
    let faults = Faults::count(dir.path());
    write(dir.path()).unwrap();
    assert_durable(&faults.log(), |to| disk::folder_of(to).join(".file.tiepoint-part"));
}

/// Checks that each renamed file was synchronised under its temporary name, and its folder after
/// the rename.
fn assert_durable(log: &[(Operation, PathBuf)], part_of: impl Fn(&Path) -> PathBuf) {
    let renames: Vec<usize> =
        (0..log.len()).filter(|index| log[*index].0 == Operation::Rename).collect();
    assert!(!renames.is_empty());
    for index in renames {
        let part = part_of(&log[index].1);
        let of_part: Vec<Operation> = log[..index]
            .iter()
            .filter(|(_, path)| *path == part)
            .map(|(operation, _)| *operation)
            .collect();
        assert!(of_part.ends_with(&[Operation::Write, Operation::Sync]), "{of_part:?}");
        let folder = disk::folder_of(&log[index].1).to_owned();
        assert!(log[index..].contains(&(Operation::SyncFolder, folder)));
    }
}

#[test]
fn models_are_replaced_atomically() {
    let (old, new) =
        (random_model(1, RigKind::SeveralCameras), random_model(2, RigKind::SeveralCameras));
    for format in [Format::Binary, Format::Text] {
        let write = |dir: &Path| write_model(&dir.join("above/model"), &new, format);
        let check = |dir: &Path, is_done: bool, is_there: bool| {
            let model = dir.join("above/model");
            match read_model(&model) {
                Ok(found) => assert!(found == new || (found == old && is_there && !is_done)),
                Err(error) if !is_done => {
                    let error = error.to_string();
                    let is_missing = if is_there {
                        error.contains("holds no COLMAP model")
                    } else {
                        !model.exists()
                    };
                    assert!(is_missing, "{error}");
                }
                Err(error) => panic!("{error}"),
            }
            write(dir).unwrap();
            assert_eq!(read_model(&model).unwrap(), new);
            assert_eq!(names(&dir.join("above")), ["model"]);
            assert!(!names(&model).iter().any(|name| name.starts_with('.')), "{:?}", names(&model));
        };
        test_every_fault(
            &std::env::temp_dir(),
            |_| {},
            write,
            |dir, _, is_done| check(dir, is_done, false),
        );
        let prepare = |dir: &Path| write_model(&dir.join("above/model"), &old, format).unwrap();
        test_every_fault(&std::env::temp_dir(), prepare, write, |dir, _, is_done| {
            check(dir, is_done, true)
        });
        let dir = tempfile::tempdir().unwrap();
        prepare(dir.path());
        let faults = Faults::count(dir.path());
        write(dir.path()).unwrap();
        assert_durable(&faults.log(), |to| {
            to.with_file_name(format!(".{}.tiepoint-part", to.file_name().unwrap().display()))
        });
    }
}

#[test]
fn model_beside_one_in_the_other_format_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (old, new): (Reconstruction, _) =
        (random_model(1, RigKind::SingleCameras), random_model(2, RigKind::SingleCameras));
    write_model(dir.path(), &old, Format::Binary).unwrap();
    let error = write_model(dir.path(), &new, Format::Text).unwrap_err().to_string();
    assert!(error.contains("cameras.bin: holds a model as .bin too"), "{error}");
    assert_eq!(read_model(dir.path()).unwrap(), old);
    assert_eq!(names(dir.path()).len(), 5);
}
