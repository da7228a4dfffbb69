//! Database of COLMAP: round trips, and layouts of older versions.
#![cfg(feature = "database")]
#![allow(clippy::unwrap_used)]

use std::f32::consts::PI;
use std::path::Path;

use proptest::prelude::*;
use tiepoint_features::{
    DescriptorEntries, DescriptorFormat, DescriptorKind, Descriptors, Features, Keypoint,
};
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_io::database::{Database, DatabaseFrame, StageRow, read_stage_rows};
use tiepoint_scene::{
    Camera, CameraId, Image, ImageId, ImagePair, Match, Rig, RigId, RigSensor, TwoView, TwoViewKind,
};

use crate::common;

/// Scale and orientation are computed from four f32 columns: a few units in the last place.
const SHAPE_TOLERANCE: f32 = 1e-6;

fn cameras() -> Vec<Camera> {
    let camera = |kind, has_focal_prior| Camera {
        intrinsics: Intrinsics::centred(kind, 501.25, 640, 480),
        width: 640,
        height: 480,
        has_focal_prior,
    };
    vec![camera(CameraModelKind::Pinhole, true), camera(CameraModelKind::SimplePinhole, false)]
}

fn images() -> Vec<Image> {
    ["a/1.png", "b/1.png", "a/2.png", "b/2.png"]
        .iter()
        .enumerate()
        .map(|(index, name)| Image::new(*name, CameraId::from_index(index % 2), vec![]))
        .collect()
}

fn filled(path: &Path) -> Database {
    let mut db = Database::create(path).unwrap();
    db.write_cameras(&cameras()).unwrap();
    db.write_images(&images()).unwrap();
    db
}

fn random_features(rng: &mut Rng, count: usize) -> Features {
    let keypoints = (0..count).map(|_| Keypoint {
        x: (640.0 * rng.uniform()) as f32,
        y: (480.0 * rng.uniform()) as f32,
        scale: (0.5 + 50.0 * rng.uniform()) as f32,
        orientation: ((2.0 * rng.uniform() - 1.0) as f32) * PI,
    });
    let keypoints = keypoints.collect();
    Features {
        keypoints,
        descriptors: (0..count)
            .map(|_| std::array::from_fn::<u8, 128, _>(|_| rng.below(256) as u8))
            .collect(),
    }
}

fn random_two_view(rng: &mut Rng) -> TwoView {
    let mut some = |_| (rng.uniform() < 0.5).then(|| Matrix3::from_fn(|_, _| rng.normal()));
    let (fundamental, essential, homography) = (some(()), some(()), some(()));
    TwoView {
        kind: [TwoViewKind::Calibrated, TwoViewKind::Watermark, TwoViewKind::Multiple]
            [rng.below(3)],
        fundamental,
        essential,
        homography,
        cam2_from_cam1: (rng.uniform() < 0.5).then(|| common::pose(rng)),
        matches: (0..rng.below(5))
            .map(|k| Match { a: k as u32, b: rng.below(1000) as u32 })
            .collect(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 16,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn database_is_read_as_written(seed: u64) {
        let mut rng = Rng::stream(seed, &[]);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("database.db");
        let mut db = filled(&path);
        let features: Vec<Features> =
            (0..4).map(|count| random_features(&mut rng, 3 * count)).collect();
        db.write_features((0..4).map(|k| (ImageId(k), &features[k as usize]))).unwrap();
        let pairs: Vec<ImagePair> = [(0, 1), (2, 1), (0, 3)]
            .map(|(a, b)| ImagePair::new(ImageId(a), ImageId(b)).unwrap())
            .into();
        let views: Vec<TwoView> = pairs.iter().map(|_| random_two_view(&mut rng)).collect();
        db.write_matches(pairs.iter().zip(&views).map(|(pair, view)| (*pair, &view.matches[..])))
            .unwrap();
        db.write_two_views(pairs.iter().copied().zip(&views)).unwrap();
        db.close().unwrap();
        let files: Vec<_> = std::fs::read_dir(dir.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        prop_assert_eq!(files, ["database.db"]);

        let db = Database::open(&path).unwrap();
        prop_assert_eq!(db.read_cameras().unwrap(), cameras());
        prop_assert_eq!(db.read_images().unwrap(), images());
        prop_assert_eq!(db.keypoint_counts().unwrap(), [Some(0), Some(3), Some(6), Some(9)]);
        for (index, written) in features.iter().enumerate() {
            let read = db.read_features(ImageId::from_index(index)).unwrap();
            prop_assert_eq!(&read.descriptors, &written.descriptors);
            prop_assert_eq!(read.keypoints.len(), written.keypoints.len());
            for (r, w) in read.keypoints.iter().zip(&written.keypoints) {
                prop_assert_eq!((r.x, r.y), (w.x, w.y));
                prop_assert!((r.scale / w.scale - 1.0).abs() < SHAPE_TOLERANCE);
                prop_assert!((r.orientation - w.orientation).abs() < SHAPE_TOLERANCE * 2.0 * PI);
            }
        }
        // (0, 1), (0, 3), (1, 2)
        let order = [0, 2, 1];
        prop_assert_eq!(db.matched_pairs().unwrap(), order.map(|k| pairs[k]));
        let counts: Vec<_> = db
            .read_matches()
            .unwrap()
            .iter()
            .map(|(pair, matches)| (*pair, matches.len()))
            .collect();
        prop_assert_eq!(db.match_counts().unwrap(), counts);
        let counts = db.read_two_views().unwrap().into_iter().map(|(pair, two_view)| {
            (pair, two_view.is_verified().then_some(two_view.matches.len()))
        });
        prop_assert_eq!(db.inlier_counts().unwrap(), counts.collect::<Vec<_>>());
        prop_assert_eq!(
            db.read_matches().unwrap(),
            order.map(|k| (pairs[k], views[k].matches.clone()))
        );
        prop_assert_eq!(db.read_two_views().unwrap(), order.map(|k| (pairs[k], views[k].clone())));
    }

    /// A database with overwritten bytes gives an error or values, and does not panic.
    #[test]
    fn damaged_database_never_panics(place in 0.0..1.0, damage: [u8; 16]) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("database.db");
        let mut db = filled(&path);
        let mut rng = Rng::stream(1, &[]);
        db.write_features([(ImageId(0), &random_features(&mut rng, 5))]).unwrap();
        db.write_two_views([(
            ImagePair::new(ImageId(0), ImageId(1)).unwrap(),
            &random_two_view(&mut rng),
        )])
        .unwrap();
        db.close().unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let start = ((bytes.len() - damage.len()) as f64 * place) as usize;
        bytes[start..start + damage.len()].copy_from_slice(&damage);
        std::fs::write(&path, bytes).unwrap();
        if let Ok(db) = Database::open(&path) {
            let _ = (
                db.read_cameras(),
                db.read_images(),
                db.read_two_views(),
                db.read_matches(),
                db.read_rigs(),
            );
            let _ = (db.match_counts(), db.inlier_counts());
            (0..db.num_images()).for_each(|k| drop(db.read_features(ImageId::from_index(k))));
        }
    }
}

#[test]
fn rigs_and_frames_are_read_as_written_and_other_cameras_get_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let mut db = filled(&dir.path().join("database.db"));
    db.write_rigs(&[], &[]).unwrap();
    assert_eq!(db.read_rigs().unwrap(), (vec![], vec![]));
    let cam_from_rig =
        Some(Rigid3::from_axis_angle([0.1, 0.2, 0.3].into(), [1.0, 2.0, 3.0].into()));
    for cam_from_rig in [None, cam_from_rig] {
        let rig = Rig {
            sensors: vec![
                RigSensor { camera: CameraId(1), cam_from_rig: Some(Rigid3::identity()) },
                RigSensor { camera: CameraId(0), cam_from_rig },
            ],
        };
        let frame = DatabaseFrame { rig: RigId(0), images: vec![ImageId(0), ImageId(1)] };
        db.write_rigs(std::slice::from_ref(&rig), std::slice::from_ref(&frame)).unwrap();
        let (rigs, frames) = db.read_rigs().unwrap();
        assert_eq!(rigs, [rig]);
        let alone = |id| DatabaseFrame { rig: RigId(0), images: vec![ImageId(id)] };
        assert_eq!(frames, [frame, alone(2), alone(3)]);
    }
}

/// Descriptors of every kind are those that were written, with the columns and the type that COLMAP
/// gives them: bytes of the blob, and its number of the kind.
#[test]
fn descriptors_of_every_kind_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    let mut db = filled(&path);
    let keypoint = Keypoint { x: 1.0, y: 2.0, scale: 1.0, orientation: 0.0 };
    for (kind, dim, number, cols) in [
        (DescriptorKind::Sift, 128, 0, 128),
        (DescriptorKind::AlikedN16Rot, 128, 1, 512),
        (DescriptorKind::AlikedN32, 128, 2, 512),
        (DescriptorKind::Bytes, 32, -1, 32),
        (DescriptorKind::Bytes, 128, -1, 128),
        (DescriptorKind::Floats, 64, -2, 256),
    ] {
        let format = DescriptorFormat { kind, dim };
        let entries = match kind.has_floats() {
            true => DescriptorEntries::Floats((0..2 * dim).map(|k| k as f32 / 3.0).collect()),
            false => DescriptorEntries::Bytes((0..2 * dim).map(|k| k as u8).collect()),
        };
        let descriptors = Descriptors::new(format, entries).unwrap();
        let features = Features { keypoints: vec![keypoint; 2], descriptors };
        db.write_features([(ImageId(1), &features)]).unwrap();
        assert_eq!(db.read_features(ImageId(1)).unwrap(), features);
        assert_eq!(db.descriptor_format().unwrap(), format);
        let sql = rusqlite::Connection::open(&path).unwrap();
        let query = "SELECT type, rows, cols FROM descriptors";
        let row = |row: &rusqlite::Row| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
        let found: (i64, i64, i64) = sql.query_row(query, [], row).unwrap();
        assert_eq!(found, (number, 2, cols));
    }
    let sift = random_features(&mut Rng::stream(3, &[]), 2);
    db.write_features([(ImageId(2), &sift)]).unwrap();
    let error = db.descriptor_format().unwrap_err().to_string();
    assert!(error.contains("descriptors of 64 floats, others of SIFT"), "{error}");
    // What no program is known to write.
    for (number, cols, message) in
        [(7, 256, "256 bytes and type 7"), (1, 254, "254 bytes and type 1"), (-1, 0, "0 bytes")]
    {
        let sql = rusqlite::Connection::open(&path).unwrap();
        sql.execute(
            "UPDATE descriptors SET type = ?1, cols = ?2, data = zeroblob(2 * ?2)",
            [number, cols],
        )
        .unwrap();
        for error in [
            db.read_features(ImageId(1)).unwrap_err().to_string(),
            db.descriptor_format().unwrap_err().to_string(),
        ] {
            assert!(error.contains(message), "{error}");
        }
    }
    // Without types, descriptors of another size than SIFT's are bytes of another kind.
    db.close().unwrap();
    let sql = rusqlite::Connection::open(&path).unwrap();
    sql.execute_batch(
        "ALTER TABLE descriptors DROP COLUMN type;
         UPDATE descriptors SET cols = 512, data = zeroblob(1024);",
    )
    .unwrap();
    drop(sql);
    let db = Database::open(&path).unwrap();
    let format = DescriptorFormat { kind: DescriptorKind::Bytes, dim: 512 };
    assert_eq!(db.descriptor_format().unwrap(), format);
    let features = db.read_features(ImageId(1)).unwrap();
    assert_eq!(features.descriptors.format(), format);
    assert_eq!(db.image_without_descriptors().unwrap(), None);
    db.close().unwrap();
    let mut db = Database::open(&path).unwrap();
    let error = db.write_features([(ImageId(1), &features)]).unwrap_err().to_string();
    assert!(error.contains("no column for the type of descriptors"), "{error}");
    db.write_features([(ImageId(1), &sift)]).unwrap();
}

#[test]
fn layouts_of_other_versions_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    filled(&path).close().unwrap();
    // Ids with gaps, keypoints of two and four columns, no rigs, no poses, no types of descriptors.
    let sql = rusqlite::Connection::open(&path).unwrap();
    sql.execute_batch(
        "PRAGMA foreign_keys = OFF; UPDATE images SET image_id = image_id * 10; DROP TABLE \
        rig_sensors;",
    )
    .unwrap();
    let blob = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let insert = "INSERT INTO keypoints VALUES (?1, 1, ?2, ?3)";
    sql.execute(insert, rusqlite::params![10, 2, blob(&[1.0, 2.0])]).unwrap();
    sql.execute(insert, rusqlite::params![20, 4, blob(&[1.0, 2.0, 3.0, 0.5])]).unwrap();
    sql.execute(insert, rusqlite::params![30, 6, blob(&[1.0, 2.0])]).unwrap();
    sql.execute(insert, rusqlite::params![40, 2, blob(&[1.0, f32::NAN])]).unwrap();
    sql.execute_batch(
        "ALTER TABLE descriptors DROP COLUMN type;
         INSERT INTO descriptors VALUES (10, 1, 128, zeroblob(128));
         ALTER TABLE two_view_geometries DROP COLUMN qvec; ALTER TABLE two_view_geometries DROP \
         COLUMN tvec;
         INSERT INTO two_view_geometries VALUES (2147483647 * 10 + 30, 0, 0, NULL, 9, NULL, NULL, \
         NULL, NULL, NULL);",
    )
    .unwrap();
    drop(sql);

    let db = Database::open(&path).unwrap();
    let expected = |scale, orientation| vec![Keypoint { x: 1.0, y: 2.0, scale, orientation }];
    assert_eq!(db.read_features(ImageId(0)).unwrap().keypoints, expected(1.0, 0.0));
    assert_eq!(db.read_keypoints(ImageId(1)).unwrap(), expected(3.0, 0.5));
    assert_eq!(db.keypoint_counts().unwrap(), [Some(1); 4]);
    for (image, message) in
        [(1, "1 keypoints but 0 descriptors"), (2, "8 bytes for 1 × 6"), (3, "is not finite")]
    {
        let error = db.read_features(ImageId(image)).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    assert_eq!(db.read_rigs().unwrap(), (vec![], vec![]));
    let views = db.read_two_views().unwrap();
    assert_eq!(views.len(), 1);
    assert_eq!(views[0].0, ImagePair::new(ImageId(0), ImageId(2)).unwrap());
    assert_eq!(views[0].1.kind, TwoViewKind::Calibrated);
}

#[test]
fn databases_of_2017_and_those_without_matrices_are_upgraded() {
    let dir = tempfile::tempdir().unwrap();
    let layouts = [
        "DROP TABLE two_view_geometries; CREATE TABLE inlier_matches(pair_id INTEGER PRIMARY KEY \
         NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB, config INTEGER NOT \
         NULL);",
        "DROP TABLE two_view_geometries; CREATE TABLE two_view_geometries(pair_id INTEGER PRIMARY \
         KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB, config INTEGER \
         NOT NULL);",
    ];
    for (index, (layout, table)) in
        layouts.into_iter().zip(["inlier_matches", "two_view_geometries"]).enumerate()
    {
        let path = dir.path().join(format!("{index}.db"));
        filled(&path).close().unwrap();
        let sql = rusqlite::Connection::open(&path).unwrap();
        sql.execute_batch(&format!(
            "PRAGMA foreign_keys = OFF; {layout} INSERT INTO {table} VALUES (2147483647 + 3, 1, 2, \
             x'0000000001000000', 2);"
        ))
        .unwrap();
        drop(sql);
        let before = std::fs::read(&path).unwrap();
        let copy = dir.path().join("copy.db");
        let views = |database: &Database| database.read_two_views().unwrap();
        assert!(Database::has_pairs(&path).unwrap());
        let copied = views(&Database::copy_with(&path, &copy, |_| Ok(())).unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), before);
        assert_eq!(copied.len(), 1);
        assert_eq!(copied[0].1.matches, [Match { a: 0, b: 1 }]);
        assert_eq!((copied[0].1.fundamental, copied[0].1.cam2_from_cam1), (None, None));
        assert_eq!(views(&Database::open(&path).unwrap()), copied);
        // As what is written then has its columns.
        let mut database = Database::open(&path).unwrap();
        database.write_two_views([(copied[0].0, &copied[0].1)]).unwrap();
        assert_eq!(views(&database), copied);
    }
}

#[test]
fn files_of_other_formats_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    assert!(Database::open(&path).is_err());
    for content in [
        "",
        "this is no database, but it is longer than the header of one, which has a hundred bytes; \
        or so",
    ] {
        std::fs::write(&path, content).unwrap();
        let error = Database::open(&path).unwrap_err().to_string();
        assert!(error.contains("database"), "{error}");
    }
    let mut db = Database::create(&path).unwrap();
    assert!(db.write_images(&images()).unwrap_err().to_string().contains("there are 0 cameras"));
    db.write_cameras(&cameras()).unwrap();
    db.write_images(&images()).unwrap();
    let error = db.write_features([(ImageId(9), &Features::default())]).unwrap_err().to_string();
    assert!(error.contains("there are 4 images, and none of index 9"), "{error}");
}

fn stage(name: &str, is_complete: bool) -> StageRow {
    StageRow { stage: name.to_owned(), is_complete, recipe: format!("{{\"of\": \"{name}\"}}") }
}

fn names(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn paths_are_not_interpreted_as_uris() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("file:w");
    std::fs::create_dir(&folder).unwrap();
    let path = folder.join("a ?mode=memory#%41ä.db");
    let mut db = filled(&path);
    db.write_stage_rows(&[stage("features", true)]).unwrap();
    db.close().unwrap();
    assert_eq!(names(&folder), ["a ?mode=memory#%41ä.db"]);
    assert_eq!(Database::open(&path).unwrap().num_images(), 4);
    assert_eq!(read_stage_rows(&path).unwrap(), Some(vec![stage("features", true)]));
}

#[test]
fn complete_database_replaces_the_old_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    filled(&path).close().unwrap();
    let part = dir.path().join(".database.db.tiepoint-part");
    let error = Database::create_with(&path, |db| {
        db.write_cameras(&cameras())?;
        assert!(Database::create(&path).unwrap_err().to_string().contains("another run"));
        assert_eq!(names(dir.path()), [".database.db.tiepoint-part", "database.db"]);
        db.write_images(&[Image::new("x", CameraId(7), vec![])])
    });
    assert!(error.unwrap_err().to_string().starts_with(&format!("{}: image x", path.display())));
    assert_eq!(names(dir.path()), ["database.db"]);
    assert_eq!(Database::open(&path).unwrap().read_images().unwrap(), images());

    // A killed run leaves its log and an incomplete temporary database.
    let mut db = Database::open(&path).unwrap();
    db.write_images(&images()[..1]).unwrap();
    let copy = dir.path().join("killed");
    std::fs::create_dir(&copy).unwrap();
    for suffix in ["", "-wal", "-shm"] {
        let name = format!("database.db{suffix}");
        std::fs::copy(dir.path().join(&name), copy.join(&name)).unwrap();
    }
    assert!(Database::create(&path).is_err(), "it is open");
    drop(db);
    let path = copy.join("database.db");
    std::fs::write(copy.join(".database.db.tiepoint-part"), "half").unwrap();
    let failed = Database::create_with(&path, |db| db.write_images(&images()));
    assert!(failed.is_err());
    assert_eq!(Database::open(&path).unwrap().num_images(), 1);
    Database::create_with(&path, |db| db.write_cameras(&cameras())).unwrap().close().unwrap();
    assert_eq!(names(&copy), ["database.db"]);
    let db = Database::open(&path).unwrap();
    assert_eq!((db.num_cameras(), db.num_images()), (2, 0));
    drop(db);

    // Files beside a file that is not a database, or beside none, may be of another database.
    std::fs::write(&path, "x".repeat(5000)).unwrap();
    for suffix in ["-wal", "-shm", "-journal"] {
        let beside = copy.join(format!("database.db{suffix}"));
        std::fs::write(&beside, "x".repeat(5000)).unwrap();
        for _ in 0..2 {
            let error = Database::create(&path).unwrap_err().to_string();
            assert!(error.contains(&format!("database.db{suffix}: may be the log")), "{error}");
            assert_eq!(std::fs::read(&beside).unwrap(), "x".repeat(5000).as_bytes());
            let _ = std::fs::remove_file(&path);
        }
        std::fs::remove_file(beside).unwrap();
        std::fs::write(&path, "x".repeat(5000)).unwrap();
    }
    Database::create(&path).unwrap().close().unwrap();
    assert_eq!(names(&copy), ["database.db"]);
    #[cfg(unix)]
    {
        let link = dir.path().join("link.db");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        Database::create_with(&link, |db| db.write_cameras(&cameras())).unwrap().close().unwrap();
        assert!(link.is_symlink());
        assert_eq!(Database::open(&path).unwrap().num_cameras(), 2);
        std::os::unix::fs::symlink(&path, &part).unwrap();
        let path = dir.path().join("database.db");
        assert!(Database::create(&path).unwrap_err().to_string().contains("in the way"));
    }
}

#[test]
fn stage_rows_are_written_with_their_data() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    let mut db = filled(&path);
    assert_eq!(db.stage_rows().unwrap(), None);
    assert_eq!(read_stage_rows(&path).unwrap(), None);
    let rows = [stage("matching", false), stage("features", true)];
    db.write_stage_rows(&rows).unwrap();
    let pair = ImagePair::new(ImageId(0), ImageId(1)).unwrap();
    let view = random_two_view(&mut Rng::stream(1, &[]));
    db.write_pairs([(pair, &[Match { a: 1, b: 2 }][..], &view)]).unwrap();
    assert_eq!(db.read_matches().unwrap(), [(pair, vec![Match { a: 1, b: 2 }])]);
    assert_eq!(db.read_two_views().unwrap(), [(pair, view)]);
    // Two records with the same name: nothing is written.
    assert!(db.clear_matches_for(&[stage("x", true), stage("x", false)]).is_err());
    assert_eq!(db.matched_pairs().unwrap(), [pair]);
    assert_eq!(db.stage_rows().unwrap(), Some(rows.to_vec()));
    db.clear_matches_for(&rows[1..]).unwrap();
    assert!(db.matched_pairs().unwrap().is_empty() && db.read_two_views().unwrap().is_empty());

    // While the database is open, after a kill with and without the index of the log, and after
    // closing.
    let expected = Some(rows[1..].to_vec());
    assert_eq!(read_stage_rows(&path).unwrap(), expected);
    for (index, suffixes) in [&["", "-wal", "-shm"][..], &["", "-wal"]].into_iter().enumerate() {
        let copy = dir.path().join(index.to_string());
        std::fs::create_dir(&copy).unwrap();
        let list: Vec<String> =
            suffixes.iter().map(|suffix| format!("database.db{suffix}")).collect();
        for name in &list {
            std::fs::copy(dir.path().join(name), copy.join(name)).unwrap();
        }
        let mut sorted = list.clone();
        sorted.sort();
        for is_read_only in [false, true] {
            set_read_only(&copy, is_read_only);
            let before = std::fs::read(copy.join("database.db")).unwrap();
            let log = std::fs::read(copy.join("database.db-wal")).unwrap();
            assert_eq!(read_stage_rows(&copy.join("database.db")).unwrap(), expected);
            assert_eq!(names(&copy), sorted);
            assert_eq!(std::fs::read(copy.join("database.db")).unwrap(), before);
            assert_eq!(std::fs::read(copy.join("database.db-wal")).unwrap(), log);
        }
        set_read_only(&copy, false);
        assert_eq!(
            Database::open(&copy.join("database.db")).unwrap().stage_rows().unwrap(),
            expected
        );
    }
    // A database that another program closed may be in WAL mode without a log.
    drop(db);
    let alone = dir.path().join("alone");
    std::fs::create_dir(&alone).unwrap();
    std::fs::copy(&path, alone.join("database.db")).unwrap();
    for is_read_only in [false, true] {
        set_read_only(&alone, is_read_only);
        assert_eq!(read_stage_rows(&alone.join("database.db")).unwrap(), expected);
        assert_eq!(names(&alone), ["database.db"]);
    }
    set_read_only(&alone, false);
    Database::open(&path).unwrap().close().unwrap();
    assert_eq!(read_stage_rows(&path).unwrap(), expected);
    assert!(names(dir.path()).iter().all(|name| !name.contains('-')));
    assert!(read_stage_rows(&dir.path().join("none.db")).is_err());
    std::fs::write(&path, "this is no database").unwrap();
    assert!(read_stage_rows(&path).is_err());
}

fn set_read_only(dir: &Path, is_read_only: bool) {
    for path in
        std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).chain([dir.to_owned()])
    {
        let mut permissions = std::fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(is_read_only);
        std::fs::set_permissions(&path, permissions).unwrap();
    }
}

#[test]
fn a_pose_of_zeros_is_none() {
    // COLMAP 3.8 writes them for pairs whose pose it does not estimate.
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    let mut db = filled(&path);
    let pair = ImagePair::new(ImageId(0), ImageId(1)).unwrap();
    let view = TwoView { cam2_from_cam1: Some(Rigid3::identity()), ..TwoView::default() };
    db.write_two_views([(pair, &view)]).unwrap();
    assert_eq!(db.read_two_views().unwrap()[0].1.cam2_from_cam1, view.cam2_from_cam1);
    db.close().unwrap();
    let sql = rusqlite::Connection::open(&path).unwrap();
    sql.execute("UPDATE two_view_geometries SET qvec = zeroblob(32), tvec = zeroblob(24)", [])
        .unwrap();
    drop(sql);
    let db = Database::open(&path).unwrap();
    assert_eq!(db.read_two_views().unwrap()[0].1.cam2_from_cam1, None);
}

#[test]
fn copies_of_other_programs_files_have_ids_from_one_on() {
    let dir = tempfile::tempdir().unwrap();
    let (path, copy) = (dir.path().join("theirs.db"), dir.path().join("ours.db"));
    let mut db = filled(&path);
    let mut rng = Rng::stream(4, &[]);
    let features = random_features(&mut rng, 5);
    let ids = [0, 1, 2, 3].map(ImageId);
    db.write_features(ids.map(|id| (id, &features))).unwrap();
    let matches = [Match { a: 1, b: 2 }];
    let pairs =
        [(0, 1), (1, 2), (0, 3), (2, 3)].map(|(a, b)| ImagePair::new(ids[a], ids[b]).unwrap());
    db.write_matches(pairs.map(|pair| (pair, &matches[..]))).unwrap();
    db.write_rigs(&[], &[]).unwrap();
    db.close().unwrap();
    let sql = rusqlite::Connection::open(&path).unwrap();
    // The second image was deleted; cameras are 7 and 9, images 0, 30 and 2000000000.
    sql.execute_batch(
        "PRAGMA foreign_keys = OFF; DELETE FROM images WHERE image_id = 2;
         UPDATE cameras SET camera_id = 5 + 2 * camera_id;
         UPDATE images SET camera_id = 5 + 2 * camera_id;
         UPDATE rigs SET ref_sensor_id = 5 + 2 * ref_sensor_id;
         UPDATE frame_data SET sensor_id = 5 + 2 * sensor_id;
         INSERT INTO pose_priors VALUES (1, 3, 7, 0, NULL, NULL, NULL, 1);
         INSERT INTO pose_priors VALUES (2, 2, 7, 0, NULL, NULL, NULL, 1);
         CREATE TABLE theirs(text); INSERT INTO theirs VALUES ('stays');",
    )
    .unwrap();
    let images = [("images", "image_id"), ("keypoints", "image_id"), ("descriptors", "image_id")];
    let images =
        images.into_iter().chain([("frame_data", "data_id"), ("pose_priors", "corr_data_id")]);
    for (table, column) in images {
        for (old, new) in [(1, 0), (3, 30), (4, 2_000_000_000)] {
            sql.execute(&format!("UPDATE {table} SET {column} = {new} WHERE {column} = {old}"), [])
                .unwrap();
        }
    }
    for (a, b, new_a, new_b) in
        [(1, 4, 0, 2_000_000_000), (3, 4, 30, 2_000_000_000), (1, 2, 0, 2), (2, 3, 2, 30)]
    {
        let id = |a: i64, b: i64| 2_147_483_647 * a + b;
        let update = "UPDATE matches SET pair_id = ?1 WHERE pair_id = ?2";
        sql.execute(update, [id(new_a, new_b), id(a, b)]).unwrap();
    }
    drop(sql);
    let before = std::fs::read(&path).unwrap();

    let read = Database::open_read_only(&path).unwrap();
    assert_eq!(read.num_images(), 3);
    assert!(Database::has_pairs(&path).unwrap());
    assert_eq!(read.image_without_descriptors().unwrap(), None);
    assert_eq!(read.descriptor_format().unwrap(), DescriptorFormat::SIFT);
    drop(read);
    let db = Database::copy_with(&path, &copy, |_| Ok(())).unwrap();
    let found: Vec<(String, CameraId)> =
        db.read_images().unwrap().into_iter().map(|image| (image.name, image.camera)).collect();
    let expected = [("a/1.png", 0), ("a/2.png", 0), ("b/2.png", 1)];
    assert_eq!(found, expected.map(|(name, camera)| (name.to_owned(), CameraId(camera))));
    assert_eq!(db.keypoint_counts().unwrap(), [Some(5); 3]);
    let expected = [(0, 2), (1, 2)].map(|(a, b)| ImagePair::new(ids[a], ids[b]).unwrap());
    assert_eq!(db.matched_pairs().unwrap(), expected);
    assert_eq!(db.read_matches_of(expected[1]).unwrap(), matches);
    db.close().unwrap();
    let sql = rusqlite::Connection::open(&copy).unwrap();
    let text = |query: &str| sql.query_row(query, [], |row| row.get::<_, String>(0)).unwrap();
    assert_eq!(text("SELECT group_concat(image_id) FROM images ORDER BY image_id"), "1,2,3");
    assert_eq!(text("SELECT group_concat(camera_id) FROM cameras ORDER BY camera_id"), "1,2");
    assert_eq!(text("SELECT text FROM theirs"), "stays");
    let priors =
        text("SELECT group_concat(corr_data_id || ',' || corr_sensor_id) FROM pose_priors");
    assert_eq!(priors, "2,1", "that of the deleted image is left out");
    assert_eq!(
        text("SELECT group_concat(frame_id || data_id || sensor_id) FROM frame_data"),
        "111,221,332"
    );
    drop(sql);
    assert_eq!(std::fs::read(&path).unwrap(), before, "the file is only read");
    std::fs::write(&path, "words").unwrap();
    assert!(Database::copy_with(&path, &copy, |_| Ok(())).is_err());
    assert!(Database::open(&copy).is_ok(), "an earlier copy stays");
}

#[test]
fn pose_priors_are_positions_with_deviations() {
    use tiepoint_scene::{Place, Position};
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.db");
    let mut db = Database::create(&path).unwrap();
    db.write_cameras(&cameras()).unwrap();
    let names = ["0.png", "1.png", "2.png", "3.png", "4.png", "5.png"];
    let images = names.map(|name| Image::new(name, CameraId(0), Vec::new()));
    db.write_images(&images).unwrap();
    db.close().unwrap();
    let blob = |values: &[f64]| -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    };
    let sql = rusqlite::Connection::open(&path).unwrap();
    let covariance = blob(&[4.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 25.0]);
    let unknown = blob(&[f64::NAN; 9]);
    // COLMAP's frames: 0 is WGS 84, 1 Cartesian, -1 unknown.
    for (image, xyz, covariance, system) in [
        (1, vec![48.1, 11.5, f64::NAN], &covariance, 0),
        (2, vec![1.0, 2.0, 3.0], &unknown, 1),
        (3, vec![0.0, 0.0, 5.0], &unknown, 0),
        (4, vec![95.0, 0.0, 5.0], &unknown, 0),
        (5, vec![1.0, 2.0, 3.0], &unknown, -1),
        (6, vec![1.0, 2.0], &unknown, 1),
        (77, vec![1.0, 2.0, 3.0], &unknown, 1),
    ] {
        let insert = "INSERT INTO pose_priors VALUES (?1, ?1, 1, 0, ?2, ?3, NULL, ?4)";
        sql.execute(insert, rusqlite::params![image, blob(&xyz), covariance, system]).unwrap();
    }
    // Cells of other types, as only other programs write them.
    sql.execute_batch(
        "INSERT INTO pose_priors VALUES (8, 6, 4, 0, 'here', x'00', NULL, 1);
         INSERT INTO pose_priors VALUES (9, 6, 2, 0, zeroblob(24), 'x', NULL, x'01');
         INSERT INTO pose_priors VALUES (10, 6, 3, 0, 1.5, 7, NULL, 'one');",
    )
    .unwrap();
    drop(sql);
    let db = Database::open_read_only(&path).unwrap();
    let place = Place::Geodetic { latitude_deg: 48.1, longitude_deg: 11.5, altitude_m: None };
    let first = Position { place, sigma_horizontal_m: Some(3.0), sigma_vertical_m: Some(5.0) };
    let place = Place::Cartesian(Vector3::new(1.0, 2.0, 3.0));
    let second = Position { place, sigma_horizontal_m: None, sigma_vertical_m: None };
    assert_eq!(db.read_pose_priors().unwrap(), [(ImageId(0), first), (ImageId(1), second)]);
    drop(db);
    // What is written is read again, also where a deviation or an altitude is not known.
    let level = Position { sigma_vertical_m: None, ..first };
    let written = [(ImageId(1), second), (ImageId(2), first), (ImageId(4), level)];
    let mut db = Database::open(&path).unwrap();
    db.write_pose_priors(&written).unwrap();
    assert_eq!(db.read_pose_priors().unwrap(), written);
    assert!(db.write_pose_priors(&[(ImageId(6), first)]).is_err(), "there are six images");
    db.close().unwrap();
    // COLMAP 3.10 has rows of images.
    let sql = rusqlite::Connection::open(&path).unwrap();
    sql.execute_batch(
        "DROP TABLE pose_priors;
         CREATE TABLE pose_priors(image_id INTEGER, position BLOB, coordinate_system INTEGER);",
    )
    .unwrap();
    let insert = "INSERT INTO pose_priors VALUES (2, ?1, 1)";
    sql.execute(insert, [blob(&[1.0, 2.0, 3.0])]).unwrap();
    drop(sql);
    let db = Database::open_read_only(&path).unwrap();
    assert_eq!(db.read_pose_priors().unwrap(), [(ImageId(1), second)]);
    drop(db);
    let sql = rusqlite::Connection::open(&path).unwrap();
    sql.execute_batch("ALTER TABLE pose_priors RENAME COLUMN image_id TO photo").unwrap();
    drop(sql);
    let db = Database::open_read_only(&path).unwrap();
    assert_eq!(db.read_pose_priors().unwrap(), []);
}

/// COLMAP 3.8 reads columns by their place, and writes rows without the newer columns.
#[test]
fn tables_have_the_columns_of_colmap_3_in_its_order() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    Database::create(&path).unwrap().close().unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    let columns = |table: &str| {
        let sql = format!("SELECT name FROM pragma_table_info('{table}') ORDER BY cid");
        let mut statement = connection.prepare(&sql).unwrap();
        let names = statement.query_map([], |row| row.get::<_, String>(0)).unwrap();
        names.map(Result::unwrap).collect::<Vec<_>>().join(" ")
    };
    for (table, theirs) in [
        ("cameras", "camera_id model width height params prior_focal_length"),
        (
            "images",
            "image_id name camera_id prior_qw prior_qx prior_qy prior_qz prior_tx prior_ty \
             prior_tz",
        ),
        ("keypoints", "image_id rows cols data"),
        ("descriptors", "image_id rows cols data"),
        ("matches", "pair_id rows cols data"),
        ("two_view_geometries", "pair_id rows cols data config F E H qvec tvec"),
    ] {
        assert!(columns(table).starts_with(theirs), "{table}: {}", columns(table));
    }
    connection
        .execute_batch(
            "PRAGMA foreign_keys = OFF;
             INSERT INTO descriptors(image_id, rows, cols, data) VALUES (1, 0, 128, NULL);
             INSERT INTO images(image_id, name, camera_id, prior_qw, prior_tz) \
             VALUES (1, '1.jpg', 1, NULL, NULL);",
        )
        .unwrap();
}
