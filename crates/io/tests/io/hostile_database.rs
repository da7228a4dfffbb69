//! Databases of strangers: what SQLite would execute is refused, and what leads in circles ends.
#![cfg(feature = "database")]

use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::Connection;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_io::database::{Database, StageRow, read_stage_rows};
use tiepoint_scene::{Camera, CameraId, Image};

/// Far above what a refusal takes, and far below a hang.
const SOON: Duration = Duration::from_secs(20);
const ENDLESS: &str = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)";

/// A database of two cameras and images, and then what somebody did to it.
fn database(path: &Path, sql: &str) {
    let mut db = Database::create(path).unwrap();
    let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
    let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
    db.write_cameras(&[camera, camera]).unwrap();
    let image = |name: &str, camera| Image::new(name, CameraId(camera), vec![]);
    db.write_images(&[image("a", 0), image("b", 1)]).unwrap();
    db.write_rigs(&[], &[]).unwrap();
    let row = StageRow { stage: "features".to_owned(), is_complete: true, recipe: "{}".to_owned() };
    db.write_stage_rows(&[row]).unwrap();
    db.close().unwrap();
    // Strangers need not keep the rules of the schema.
    let sql = format!("PRAGMA foreign_keys = OFF; {sql}");
    Connection::open(path).unwrap().execute_batch(&sql).unwrap();
}

fn refused(sql: &str, says: &str) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    database(&path, sql);
    let start = Instant::now();
    let error = Database::open(&path).map(drop).expect_err(sql).to_string();
    assert!(error.contains("database.db") && error.contains(says), "{error}");
    assert!(start.elapsed() < SOON, "{sql}");
}

#[test]
fn views_without_end_are_no_tables() {
    for (table, columns) in [
        ("cameras", "x AS camera_id"),
        ("images", "x AS image_id, 'a' AS name, 1 AS camera_id"),
        ("frames", "x AS frame_id, 1 AS rig_id"),
    ] {
        let sql = format!(
            "DROP TABLE {table}; CREATE VIEW {table} AS {ENDLESS} SELECT {columns} FROM c;"
        );
        refused(&sql, &format!("`{table}` is a view and no table"));
    }
}

#[test]
fn triggers_generated_columns_and_virtual_tables_are_refused() {
    let trigger = "CREATE TRIGGER t AFTER INSERT ON images BEGIN INSERT INTO images(name, \
    camera_id) \
         SELECT name || 'x', camera_id FROM images; END;";
    refused(trigger, "`images` has a trigger, `t`");
    let generated = "ALTER TABLE cameras ADD COLUMN more AS (hex(zeroblob(1000)))";
    refused(generated, "`cameras` has generated columns");
    let found =
        "DROP TABLE images; CREATE VIRTUAL TABLE images USING fts5(image_id, name, camera_id);";
    refused(found, "`images` is a virtual one");
}

#[test]
fn a_view_of_stages_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    let view = format!(
        "DROP TABLE tiepoint_stages; CREATE VIEW tiepoint_stages AS {ENDLESS} \
         SELECT x AS stage, 1 AS is_complete, 'r' AS recipe FROM c;"
    );
    database(&path, &view);
    let start = Instant::now();
    let error = read_stage_rows(&path).unwrap_err().to_string();
    assert!(error.contains("`tiepoint_stages` is a view and no table"), "{error}");
    assert!(start.elapsed() < SOON);
}

#[test]
fn a_rig_that_is_listed_again_and_again_multiplies_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    let rows = |what: &str| {
        format!(
            "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 30000) \
            {what} FROM c;"
        )
    };
    // 30,000 rigs of one number with 30,000 sensors each were 900 million rows.
    let sql = format!(
        "DROP TABLE rigs; CREATE TABLE rigs(rig_id, ref_sensor_id, ref_sensor_type); \
         DROP TABLE rig_sensors; CREATE TABLE rig_sensors(rig_id, sensor_id, sensor_type, \
         sensor_from_rig); {} {}",
        rows("INSERT INTO rigs SELECT 1, 1, 0"),
        rows("INSERT INTO rig_sensors SELECT 1, 2, 0, NULL"),
    );
    database(&path, &sql);
    let start = Instant::now();
    let error = Database::open(&path).unwrap().read_rigs().map(drop).unwrap_err().to_string();
    assert!(error.contains("listed twice"), "{error}");
    assert!(start.elapsed() < SOON);
}

/// A tree of pages, each of which names the next one as all of its children: fan-out to the power
/// of depth.
#[test]
fn pages_that_lead_in_circles_end() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("database.db");
    // Images enough for inner pages.
    let sql = "PRAGMA page_size; WITH RECURSIVE c(x) AS (SELECT 3 UNION ALL SELECT x + 1 FROM c \
    WHERE x < 60000) \
               INSERT INTO images(image_id, name, camera_id) SELECT x, 'image number ' || x, 1 \
               FROM c; \
               PRAGMA wal_checkpoint(TRUNCATE); PRAGMA journal_mode = DELETE;";
    database(&path, "PRAGMA journal_mode = DELETE;");
    let connection = Connection::open(&path).unwrap();
    connection.execute_batch(sql).unwrap();
    let query = "SELECT rootpage FROM sqlite_master WHERE name = 'images'";
    let root: i64 = connection.query_row(query, [], |row| row.get(0)).unwrap();
    drop(connection);
    let mut bytes = std::fs::read(&path).unwrap();
    let size = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    // Interior pages of a table begin with 5; the root's cells all name one child, and that one's
    // cells its first child, so that the same leaf is read thousands of times.
    let point_all_to_first = |bytes: &mut [u8], page: usize| {
        let start = (page - 1) * size;
        assert_eq!(bytes[start], 5, "an inner page");
        let count = usize::from(u16::from_be_bytes([bytes[start + 3], bytes[start + 4]]));
        let cell = |bytes: &[u8], k: usize| {
            start
                + usize::from(u16::from_be_bytes([
                    bytes[start + 12 + 2 * k],
                    bytes[start + 13 + 2 * k],
                ]))
        };
        let first: [u8; 4] = bytes[cell(bytes, 0)..][..4].try_into().unwrap();
        for k in 0..count {
            let at = cell(bytes, k);
            bytes[at..at + 4].copy_from_slice(&first);
        }
        bytes[start + 8..start + 12].copy_from_slice(&first);
        u32::from_be_bytes(first) as usize
    };
    let child = point_all_to_first(&mut bytes, root as usize);
    if bytes[(child - 1) * size] == 5 {
        point_all_to_first(&mut bytes, child);
    }
    std::fs::write(&path, bytes).unwrap();
    let start = Instant::now();
    // Damaged or endless, whatever SQLite finds first; no hang and no memory.
    let _ = Database::open(&path).and_then(|db| db.read_images());
    assert!(start.elapsed() < SOON);
}
