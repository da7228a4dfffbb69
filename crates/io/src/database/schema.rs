//! The tables of COLMAP 4.2.1, which COLMAP 3.8 reads and writes as well.
//!
//! COLMAP 3 reads columns by their place. So tables have the layout that COLMAP 4 gives a database
//! of COLMAP 3 when it opens one: columns of version 3 first, those of version 4 behind them.

use rusqlite::Connection;

/// Tables of every version.
pub(super) const REQUIRED: [&str; 6] =
    ["cameras", "images", "keypoints", "descriptors", "matches", "two_view_geometries"];

/// Tables of newer versions, and our own.
const OPTIONAL: [&str; 8] = [
    "inlier_matches",
    "rigs",
    "rig_sensors",
    "frames",
    "frame_data",
    "pose_priors",
    "tiepoint_photos",
    "tiepoint_stages",
];

/// Checks that all tables that are read are ordinary tables; the inner error names the first one
/// that is not. A view may be without end, a virtual table may run any code, a generated column
/// computes, and a trigger would write.
pub(super) fn check(connection: &Connection) -> rusqlite::Result<Result<(), String>> {
    let mut statement =
        connection.prepare("SELECT type, name, tbl_name, rootpage FROM sqlite_master")?;
    let mut rows = statement.query([])?;
    let known =
        |name: &str| REQUIRED.iter().chain(&OPTIONAL).any(|known| known.eq_ignore_ascii_case(name));
    let mut tables = Vec::new();
    while let Some(row) = rows.next()? {
        let (kind, name, of): (String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let page: Option<i64> = row.get(3)?;
        match kind.as_str() {
            "trigger" if known(&of) => {
                return Ok(Err(format!("its table `{of}` has a trigger, `{name}`")));
            }
            "table" if known(&name) && page.is_none_or(|page| page == 0) => {
                return Ok(Err(format!(
                    "its table `{name}` is a virtual one, whose rows are no data"
                )));
            }
            "table" if known(&name) => tables.push(name),
            "view" if known(&name) => {
                return Ok(Err(format!("`{name}` is a view and no table")));
            }
            _ => {}
        }
    }
    for table in tables {
        let sql = "SELECT count(*) FROM pragma_table_xinfo(?1) WHERE hidden <> 0";
        if connection.query_row(sql, [&table], |row| row.get::<_, i64>(0))? > 0 {
            return Ok(Err(format!(
                "its table `{table}` has generated columns, which are no data"
            )));
        }
    }
    Ok(Ok(()))
}

/// Version `user_version` of the schema: 1000000 · major + 10000 · minor + 100 · patch of COLMAP.
/// The columns `prior_…` stay empty; COLMAP 3 writes descriptors without a type.
pub(super) const CREATE: &str = "
CREATE TABLE rigs (
    rig_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    ref_sensor_id INTEGER NOT NULL,
    ref_sensor_type INTEGER NOT NULL);
CREATE UNIQUE INDEX rig_ref_sensor_assignment ON rigs(ref_sensor_id, ref_sensor_type);
CREATE TABLE rig_sensors (
    rig_id INTEGER NOT NULL,
    sensor_id INTEGER NOT NULL,
    sensor_type INTEGER NOT NULL,
    sensor_from_rig BLOB,
    FOREIGN KEY(rig_id) REFERENCES rigs(rig_id) ON DELETE CASCADE);
CREATE UNIQUE INDEX rig_sensor_assignment ON rig_sensors(sensor_id, sensor_type);
CREATE TABLE cameras (
    camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    model INTEGER NOT NULL,
    width INTEGER NOT NULL,
    height INTEGER NOT NULL,
    params BLOB,
    prior_focal_length INTEGER NOT NULL);
CREATE TABLE frames (
    frame_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    rig_id INTEGER NOT NULL,
    FOREIGN KEY(rig_id) REFERENCES rigs(rig_id) ON DELETE CASCADE);
CREATE TABLE frame_data (
    frame_id INTEGER NOT NULL,
    data_id INTEGER NOT NULL,
    sensor_id INTEGER NOT NULL,
    sensor_type INTEGER NOT NULL,
    FOREIGN KEY(frame_id) REFERENCES frames(frame_id) ON DELETE CASCADE);
CREATE UNIQUE INDEX frame_sensor_assignment ON frame_data(data_id, sensor_type);
CREATE TABLE images (
    image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    name TEXT NOT NULL UNIQUE,
    camera_id INTEGER NOT NULL,
    prior_qw REAL,
    prior_qx REAL,
    prior_qy REAL,
    prior_qz REAL,
    prior_tx REAL,
    prior_ty REAL,
    prior_tz REAL,
    CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
    FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE UNIQUE INDEX index_name ON images(name);
CREATE TABLE pose_priors (
    pose_prior_id INTEGER PRIMARY KEY NOT NULL,
    corr_data_id INTEGER NOT NULL,
    corr_sensor_id INTEGER NOT NULL,
    corr_sensor_type INTEGER NOT NULL,
    position BLOB,
    position_covariance BLOB,
    gravity BLOB,
    coordinate_system INTEGER NOT NULL);
CREATE UNIQUE INDEX pose_prior_data_assignment ON pose_priors(corr_data_id, corr_sensor_id, \
corr_sensor_type);
CREATE TABLE keypoints (
    image_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE descriptors (
    image_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    type INTEGER NOT NULL DEFAULT 0,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE matches (
    pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB);
CREATE TABLE two_view_geometries (
    pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    config INTEGER NOT NULL,
    F BLOB,
    E BLOB,
    H BLOB,
    qvec BLOB,
    tvec BLOB,
    camera1 BLOB,
    camera2 BLOB);
PRAGMA user_version = 4020100;
";
