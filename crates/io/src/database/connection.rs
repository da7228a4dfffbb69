//! An open database: cameras, images and helpers for all tables.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode, OpenFlags, Row, params};
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{Camera, CameraId, Image, ImageId};
use tiepoint_store::disk::{self, Operation};
use tiepoint_store::require_regular_file;

#[cfg(feature = "faults")]
use super::faulty_vfs;
use super::guard::{self, Guard};
use super::schema;
use crate::text::excerpt::Excerpt;
use crate::{Error, Result};

/// Upper bound of image ids. COLMAP numbers a pair of images MAX_IMAGE_ID · (smaller id) + (larger
/// id).
pub(super) const MAX_IMAGE_ID: i64 = 2_147_483_647;

/// An open database.
#[derive(Debug)]
pub struct Database {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    /// Ids of the cameras in the file, ascending; the position is the [`CameraId`].
    pub(super) cameras: Vec<i64>,
    /// Ids of the images in the file, ascending; the position is the [`ImageId`].
    pub(super) images: Vec<i64>,
    /// The camera of each image.
    pub(super) camera_of: Vec<CameraId>,
    pub(super) guard: Guard,
}

/// A frame as the database holds it: images that one rig took at one instant, without a pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatabaseFrame {
    /// The rig.
    pub rig: tiepoint_scene::RigId,
    /// The images; at most one of each camera.
    pub images: Vec<ImageId>,
}

impl Database {
    /// Opens an existing database.
    ///
    /// # Errors
    ///
    /// If the file does not exist, is not a database of COLMAP, or has views, virtual tables,
    /// triggers or generated columns in place of tables.
    pub fn open(path: &Path) -> Result<Self> {
        std::fs::metadata(path).map_err(Error::io(path))?;
        require_regular_file(path)?;
        let mut database = Self::with(connect(path, path)?, path)?;
        database.upgrade()?;
        database.check_tables()?;
        // Fails for a read-only file, which can still be read.
        let _ = database.connection.pragma_update(None, "journal_mode", "WAL");
        database.run("PRAGMA synchronous = NORMAL;")?;
        database.disable_foreign_keys()?;
        database.index_tables()?;
        Ok(database)
    }

    /// Gives a database of COLMAP of 2017 the tables of today, as COLMAP does when it opens one:
    /// two-view geometries were inlier matches without matrices.
    pub(super) fn upgrade(&self) -> Result<()> {
        self.check_kinds()?;
        let (geometries, inliers) = ("two_view_geometries", "inlier_matches");
        let mut changes = Vec::new();
        let mut known = self.columns(geometries)?;
        if known.is_empty() {
            known = self.columns(inliers)?;
            changes.push(format!("ALTER TABLE {inliers} RENAME TO {geometries}"));
        }
        let missing = ["F", "E", "H"].into_iter().filter(|name| !known.iter().any(|it| it == name));
        changes
            .extend(missing.map(|name| format!("ALTER TABLE {geometries} ADD COLUMN {name} BLOB")));
        if known.is_empty() || changes.is_empty() {
            return Ok(());
        }
        self.transaction(|database| changes.iter().try_for_each(|change| database.run(change)))
    }

    /// Checks that the tables are ordinary ones. Done first: a view could yield rows without end.
    pub(super) fn check_kinds(&self) -> Result<()> {
        let checked = schema::check(&self.connection).map_err(error(&self.path))?;
        checked.map_err(|what| self.content(what))
    }

    /// [`Self::check_kinds`], and checks that no table is missing.
    pub(super) fn check_tables(&self) -> Result<()> {
        self.check_kinds()?;
        for table in schema::REQUIRED {
            if self.columns(table)?.is_empty() {
                if !self.columns("inlier_matches")?.is_empty() {
                    return Err(self.content(
                        "is a database of COLMAP of 2017, which has to be upgraded: open it with a \
                        newer COLMAP once, or give it with `features.database`, which copies it"
                            .to_owned(),
                    ));
                }
                return Err(
                    self.content(format!("is not a COLMAP database: it has no table `{table}`"))
                );
            }
        }
        Ok(())
    }

    /// Checks the tables, and reads the ids of cameras and images.
    pub(super) fn index_tables(&mut self) -> Result<()> {
        self.check_tables()?;
        self.cameras =
            self.rows("SELECT camera_id FROM cameras ORDER BY camera_id", |row| row.get(0))?;
        self.images.clear();
        self.camera_of.clear();
        self.index_images()
    }

    /// A database without cameras and images; errors name `path`.
    pub(super) fn with(mut connection: Connection, path: &Path) -> Result<Self> {
        let guard = Guard::new(&mut connection).map_err(error(path))?;
        let path = path.to_owned();
        Ok(Self { connection, path, cameras: vec![], images: vec![], camera_of: vec![], guard })
    }

    /// Switches foreign keys off, as COLMAP does: replacing an image must not delete its keypoints.
    pub(super) fn disable_foreign_keys(&self) -> Result<()> {
        self.run("PRAGMA foreign_keys = OFF;")
    }

    /// Checkpoints the write-ahead log and closes the file.
    ///
    /// # Errors
    ///
    /// If the log cannot be written into the file.
    pub fn close(self) -> Result<()> {
        checkpoint_log(&self.connection).map_err(error(&self.path))?;
        self.connection.close().map_err(|(_, cause)| error(&self.path)(cause))
    }

    /// Number of cameras.
    pub fn num_cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Number of images.
    pub fn num_images(&self) -> usize {
        self.images.len()
    }

    /// Writes all cameras in the order of their ids. Replaces the cameras in the file.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_cameras(&mut self, cameras: &[Camera]) -> Result<()> {
        self.transaction(|db| {
            db.run("DELETE FROM cameras")?;
            let sql = "INSERT INTO cameras(camera_id, model, width, height, params, \
            prior_focal_length) \
                       VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
            for (id, camera) in (1i64..).zip(cameras) {
                let params = bytes(camera.intrinsics.params());
                let model = camera.intrinsics.kind().colmap_id();
                db.execute(
                    sql,
                    params![id, model, camera.width, camera.height, params, camera.has_focal_prior],
                )?;
            }
            Ok(())
        })?;
        self.cameras = (1..=cameras.len() as i64).collect();
        Ok(())
    }

    /// Writes all images in the order of their ids. Replaces the images in the file; keypoints and
    /// matches stay with the ids. The cameras must be in the file.
    ///
    /// # Errors
    ///
    /// If an image refers to a camera that is not in the file, and if the file cannot be written.
    pub fn write_images(&mut self, images: &[Image]) -> Result<()> {
        if let Some(image) = images.iter().find(|image| image.camera.index() >= self.cameras.len())
        {
            return Err(self.content(format!(
                "image {} names camera {}, but there are {} cameras",
                image.name,
                image.camera.0,
                self.cameras.len()
            )));
        }
        self.transaction(|db| {
            db.run("DELETE FROM images")?;
            for (id, image) in (1i64..).zip(images) {
                let camera = db.cameras[image.camera.index()];
                let sql = "INSERT INTO images(image_id, name, camera_id) VALUES (?1, ?2, ?3)";
                db.execute(sql, params![id, image.name, camera])?;
            }
            Ok(())
        })?;
        self.images = (1..=images.len() as i64).collect();
        self.camera_of = images.iter().map(|image| image.camera).collect();
        Ok(())
    }

    /// Reads all cameras in the order of their ids.
    ///
    /// # Errors
    ///
    /// If a camera has an unknown model or invalid parameters, and if the file cannot be read.
    pub fn read_cameras(&self) -> Result<Vec<Camera>> {
        let sql = "SELECT camera_id, model, width, height, params, prior_focal_length FROM \
        cameras ORDER BY camera_id";
        self.try_rows(sql, |row| {
            let id: i64 = row.get(0).map_err(error(&self.path))?;
            let bad = |what: String| self.content(format!("camera {id}: {what}"));
            let get = |cause: rusqlite::Error| bad(cause.to_string());
            let kind = CameraModelKind::from_colmap_id(row.get(1).map_err(get)?)
                .map_err(|e| bad(e.to_string()))?;
            let params = numbers(&row.get::<_, Vec<u8>>(4).map_err(get)?, kind.num_params())
                .ok_or_else(|| {
                    bad(format!("the parameters are not {} numbers", kind.num_params()))
                })?;
            Ok(Camera {
                intrinsics: Intrinsics::new(kind, &params).map_err(|e| bad(e.to_string()))?,
                width: row.get(2).map_err(get)?,
                height: row.get(3).map_err(get)?,
                has_focal_prior: row.get::<_, i64>(5).map_err(get)? != 0,
            })
        })
    }

    /// Reads all images in the order of their ids, without keypoints.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn read_images(&self) -> Result<Vec<Image>> {
        let names: Vec<String> =
            self.rows("SELECT name FROM images ORDER BY image_id", |row| row.get(0))?;
        Ok(names
            .into_iter()
            .zip(&self.camera_of)
            .map(|(name, camera)| Image::new(name, *camera, vec![]))
            .collect())
    }

    pub(super) fn index_images(&mut self) -> Result<()> {
        let rows: Vec<(i64, i64)> = self
            .rows("SELECT image_id, camera_id FROM images ORDER BY image_id", |row| {
                Ok((row.get(0)?, row.get(1)?))
            })?;
        for (image, camera) in rows {
            if !(0..MAX_IMAGE_ID).contains(&image) {
                return Err(self.content(format!("the id of image {image} is out of range")));
            }
            let camera = self.cameras.binary_search(&camera).map_err(|_| {
                self.content(format!("image {image} names camera {camera}, which does not exist"))
            })?;
            self.images.push(image);
            self.camera_of.push(CameraId::from_index(camera));
        }
        Ok(())
    }

    /// An image by its name, for messages; by its id in the file if the name cannot be read.
    pub(super) fn shown(&self, image: ImageId) -> String {
        let id = self.images.get(image.index()).copied().unwrap_or(-1);
        self.guard.begin();
        let sql = "SELECT name FROM images WHERE image_id = ?1";
        let name: rusqlite::Result<String> = self.connection.query_row(sql, [id], |row| row.get(0));
        name.map_or_else(|_| format!("image {id}"), |name| Excerpt(&name).to_string())
    }

    /// The id in the file of an image.
    pub(super) fn file_id(&self, image: ImageId) -> Result<i64> {
        self.images.get(image.index()).copied().ok_or_else(|| {
            self.content(format!(
                "there are {} images, and none of index {}",
                self.images.len(),
                image.0
            ))
        })
    }

    /// The image with an id in the file; `referrer` names the row that refers to it, for the error.
    pub(super) fn image_id(
        &self,
        file_id: i64,
        referrer: impl FnOnce() -> String,
    ) -> Result<ImageId> {
        self.images.binary_search(&file_id).map(ImageId::from_index).map_err(|_| {
            self.content(format!("{} names image {file_id}, which does not exist", referrer()))
        })
    }

    pub(super) fn content(&self, what: String) -> Error {
        Error::Content { path: self.path.clone(), what }
    }

    /// The names of the columns of a table; empty if there is no such table.
    pub(super) fn columns(&self, table: &str) -> Result<Vec<String>> {
        self.rows(&format!("SELECT name FROM pragma_table_info('{table}')"), |row| row.get(0))
    }

    pub(super) fn run(&self, sql: &str) -> Result<()> {
        self.guard.begin();
        self.connection.execute_batch(sql).map_err(error(&self.path))
    }

    pub(super) fn execute(&self, sql: &str, params: &[&dyn rusqlite::ToSql]) -> Result<()> {
        self.guard.begin();
        let mut statement = self.connection.prepare_cached(sql).map_err(error(&self.path))?;
        statement.execute(params).map(drop).map_err(error(&self.path))
    }

    /// Runs `work` in a transaction: all of its writes are committed, or none.
    pub(super) fn transaction(&self, work: impl FnOnce(&Self) -> Result<()>) -> Result<()> {
        let transaction = self.connection.unchecked_transaction().map_err(error(&self.path))?;
        work(self)?;
        disk::check_fault(Operation::Commit, &self.path).map_err(Error::io(&self.path))?;
        transaction.commit().map_err(error(&self.path))
    }

    /// Maps the rows of a query.
    pub(super) fn rows<T>(
        &self,
        sql: &str,
        row: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>> {
        self.guard.begin();
        let mut statement = self.connection.prepare(sql).map_err(error(&self.path))?;
        let rows = statement.query_map([], row).map_err(error(&self.path))?;
        rows.collect::<rusqlite::Result<_>>().map_err(error(&self.path))
    }

    /// Maps the rows of a query by a function that may reject a row with an error of this crate.
    pub(super) fn try_rows<T>(
        &self,
        sql: &str,
        mut row: impl FnMut(&Row<'_>) -> Result<T>,
    ) -> Result<Vec<T>> {
        self.guard.begin();
        let mut statement = self.connection.prepare(sql).map_err(error(&self.path))?;
        let mut rows = statement.query([]).map_err(error(&self.path))?;
        let mut list = Vec::new();
        while let Some(next) = rows.next().map_err(error(&self.path))? {
            list.push(row(next)?);
        }
        Ok(list)
    }
}

/// Opens `file` for reading and writing; errors name `path`. The path is made absolute, because
/// SQLite takes names that begin with `file:` for URIs.
pub(super) fn connect(file: &Path, path: &Path) -> Result<Connection> {
    let file = std::path::absolute(file).map_err(Error::io(path))?;
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    #[cfg(feature = "faults")]
    let connection = Connection::open_with_flags_and_vfs(file, flags, faulty_vfs::name());
    #[cfg(not(feature = "faults"))]
    let connection = Connection::open_with_flags(file, flags);
    let connection = connection.map_err(error(path))?;
    guard::restrict_schema(&connection).map_err(error(path))?;
    Ok(connection)
}

/// What is said of a database whose lock another program holds.
const IN_USE: &str = "another program has the database open and is using it: close that program, \
                      or wait until it is done, and run the command again";

/// Checkpoints the write-ahead log into the file and removes it.
pub(super) fn checkpoint_log(connection: &Connection) -> rusqlite::Result<()> {
    for sql in ["PRAGMA wal_checkpoint(TRUNCATE)", "PRAGMA journal_mode = DELETE"] {
        let mut statement = connection.prepare(sql)?;
        let mut rows = statement.query([])?;
        // An error may follow the first row.
        while rows.next()?.is_some() {}
    }
    Ok(())
}

/// Converts an error of SQLite; an interrupted statement exceeded its limit of steps.
pub(super) fn error(path: &Path) -> impl Fn(rusqlite::Error) -> Error {
    move |cause| {
        let cause = match cause.sqlite_error_code() {
            Some(ErrorCode::OperationInterrupted) => guard::STOPPED.to_owned(),
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => IN_USE.to_owned(),
            _ => cause.to_string(),
        };
        Error::Database { path: path.to_owned(), cause }
    }
}

/// Little-endian numbers; `None` unless there are exactly `count` and all are finite.
pub(super) fn numbers(bytes: &[u8], count: usize) -> Option<Vec<f64>> {
    let (chunks, rest) = bytes.as_chunks::<8>();
    let values: Vec<f64> = chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    (rest.is_empty() && values.len() == count && values.iter().all(|v| v.is_finite()))
        .then_some(values)
}

/// Little-endian bytes of numbers.
pub(super) fn bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_lock_of_another_program_is_named_as_such() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("database.db");
        let [other, ours] = [0; 2].map(|_| Connection::open(&path).unwrap());
        ours.busy_timeout(Duration::ZERO).unwrap();
        other.execute_batch("CREATE TABLE t (a); BEGIN EXCLUSIVE;").unwrap();
        let cause = ours.execute_batch("SELECT * FROM t").unwrap_err();
        let message = error(&path)(cause).to_string();
        assert!(
            message.contains("database.db: another program has the database open"),
            "{message}"
        );
    }
}
