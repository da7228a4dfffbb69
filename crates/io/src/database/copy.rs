//! Copies of databases of other programs.

use std::path::Path;

use rusqlite::backup::{Backup, StepResult};
use rusqlite::params;
use tiepoint_scene::ImageId;

use super::connection::{Database, MAX_IMAGE_ID, checkpoint_log, error};
use super::read_only::read_connection;
use crate::{Error, Result};

/// Pages that are copied between two looks at the lock.
const PAGES_PER_STEP: i32 = 4096;
/// Columns with ids of cameras, and the condition of their rows.
const OF_CAMERAS: [(&str, &str, &str); 6] = [
    ("cameras", "camera_id", ""),
    ("images", "camera_id", ""),
    ("rigs", "ref_sensor_id", "ref_sensor_type = 0"),
    ("rig_sensors", "sensor_id", "sensor_type = 0"),
    ("frame_data", "sensor_id", "sensor_type = 0"),
    ("pose_priors", "corr_sensor_id", "corr_sensor_type = 0"),
];
/// Columns with ids of images. Until COLMAP 3.13 a pose prior was of an image.
const OF_IMAGES: [(&str, &str, &str); 6] = [
    ("images", "image_id", ""),
    ("keypoints", "image_id", ""),
    ("descriptors", "image_id", ""),
    ("frame_data", "data_id", "sensor_type = 0"),
    ("pose_priors", "image_id", ""),
    ("pose_priors", "corr_data_id", "corr_sensor_type = 0"),
];
/// Tables of pairs.
const OF_PAIRS: [&str; 2] = ["matches", "two_view_geometries"];

impl Database {
    /// Creates a database at `path` as a copy of the one at `from`, which may be of any version of
    /// COLMAP and is not changed, and replaces a database of that name. All tables are copied, also
    /// unknown ones. `fill` may change the copy before it gets its name.
    ///
    /// In the copy, ids are 1, 2, … in the order of the ids of `from`, as in all files of this
    /// program; the names of the images stay. Rows of images that were deleted are left out. If all
    /// rigs have one camera, each image is in the frame of its number.
    ///
    /// # Errors
    ///
    /// If `from` is not a database of COLMAP, is damaged, or is being written by another program;
    /// and the errors of [`Database::create_with`].
    pub fn copy_with(
        from: &Path,
        path: &Path,
        fill: impl FnOnce(&mut Self) -> Result<()>,
    ) -> Result<Self> {
        let source = read_connection(from)?;
        Self::replace_with(path, |database| {
            let backup = Backup::new(&source, &mut database.connection).map_err(error(from))?;
            loop {
                match backup.step(PAGES_PER_STEP).map_err(error(from))? {
                    StepResult::Done => break,
                    StepResult::More => {}
                    _ => {
                        return Err(Error::content(
                            from,
                            "is being written by another program: wait for it to end",
                        ));
                    }
                }
            }
            drop(backup);
            // The copy of a file in WAL mode would have a log of its own.
            checkpoint_log(&database.connection).map_err(error(from))?;
            database.path = from.to_owned();
            database.upgrade()?;
            database.check_tables()?;
            database.transaction(Self::remove_orphans)?;
            database.index_tables()?;
            database.transaction(Self::number_from_one)?;
            database.index_tables()?;
            database.make_trivial_rigs_regular()?;
            database.read_all()?;
            database.path = path.to_owned();
            fill(database)
        })
    }

    /// Reads what is read of a copy later, when errors name the copy, which nobody knows.
    fn read_all(&self) -> Result<()> {
        self.read_cameras()?;
        self.read_images()?;
        for image in (0..self.num_images()).map(ImageId::from_index) {
            self.read_keypoints(image)?;
        }
        self.matched_pairs()?;
        self.read_two_views().map(drop)
    }

    /// Whether a table has a column.
    fn has_column(&self, table: &str, column: &str) -> Result<bool> {
        Ok(self.columns(table)?.iter().any(|name| name == column))
    }

    /// Deletes the rows of images that do not exist.
    fn remove_orphans(&self) -> Result<()> {
        const EXISTS: &str = "IN (SELECT image_id FROM images)";
        for table in ["keypoints", "descriptors"] {
            self.run(&format!("DELETE FROM {table} WHERE NOT image_id {EXISTS}"))?;
        }
        for table in OF_PAIRS {
            self.run(&format!(
                "DELETE FROM {table} WHERE NOT pair_id / {MAX_IMAGE_ID} {EXISTS} OR NOT pair_id % \
                {MAX_IMAGE_ID} {EXISTS}"
            ))?;
        }
        // A prior of a deleted image would become that of another one.
        for (table, column, condition) in [
            ("frame_data", "data_id", "sensor_type = 0 AND"),
            ("pose_priors", "corr_data_id", "corr_sensor_type = 0 AND"),
            ("pose_priors", "image_id", ""),
        ] {
            if self.has_column(table, column)? {
                self.run(&format!("DELETE FROM {table} WHERE {condition} NOT {column} {EXISTS}"))?;
            }
        }
        Ok(())
    }

    /// Numbers cameras and images from 1 on.
    fn number_from_one(&self) -> Result<()> {
        let is_numbered = |ids: &[i64]| (1..).zip(ids).all(|(number, id)| number == *id);
        if !is_numbered(&self.cameras) {
            self.renumber(&self.cameras, &OF_CAMERAS)?;
        }
        if !is_numbered(&self.images) {
            self.renumber_pairs()?;
            self.renumber(&self.images, &OF_IMAGES)?;
        }
        Ok(())
    }

    /// Numbers ids from 1 on. `ids`: in ascending order.
    fn renumber(&self, ids: &[i64], columns: &[(&str, &str, &str)]) -> Result<()> {
        self.run("CREATE TEMP TABLE numbers(old INTEGER PRIMARY KEY, new INTEGER NOT NULL)")?;
        for (number, id) in (1i64..).zip(ids) {
            self.execute("INSERT INTO numbers(old, new) VALUES (?1, ?2)", params![id, number])?;
        }
        // Two steps, so that no new id is an old one. Ids must stay in their range.
        let aside = ids.iter().fold(ids.len() as i64, |most, id| most.max(*id)) + 1;
        if aside + ids.len() as i64 >= MAX_IMAGE_ID {
            return Err(self.content("its ids are too large: make them smaller".to_owned()));
        }
        for (table, column, condition) in columns {
            if !self.has_column(table, column)? {
                continue;
            }
            let condition =
                if condition.is_empty() { String::new() } else { format!("AND {condition}") };
            self.run(&format!(
                "UPDATE {table} SET {column} = {aside} + (SELECT new FROM numbers WHERE old = \
                {column}) WHERE {column} IN (SELECT old FROM numbers) {condition};
                UPDATE {table} SET {column} = {column} - {aside} WHERE {column} > {aside} AND \
                {column} <= {aside} + {count} {condition};",
                count = ids.len()
            ))?;
        }
        self.run("DROP TABLE numbers")
    }

    /// Numbers the images of pairs. The order of two images of a pair stays.
    fn renumber_pairs(&self) -> Result<()> {
        for table in OF_PAIRS {
            let numbers: Vec<i64> =
                self.rows(&format!("SELECT pair_id FROM {table}"), |row| row.get(0))?;
            let sql = format!("UPDATE {table} SET pair_id = ?2 WHERE pair_id = ?1");
            for number in numbers {
                let pair = self.pair(number)?;
                let [a, b] = [pair.a, pair.b].map(|image| i64::from(image.0) + 1);
                self.execute(&sql, params![number, -(MAX_IMAGE_ID * a + b)])?;
            }
            self.run(&format!("UPDATE {table} SET pair_id = -pair_id"))?;
        }
        Ok(())
    }

    /// Numbers the frames of single images and the rigs of single cameras like these, as models
    /// have them; others stay.
    fn make_trivial_rigs_regular(&mut self) -> Result<()> {
        if !self.has_column("frame_data", "data_id")? {
            return Ok(());
        }
        let count = |sql: &str| -> Result<i64> {
            let counts: Vec<i64> = self.rows(sql, |row| row.get(0))?;
            Ok(counts.into_iter().sum())
        };
        let others = count("SELECT count(*) FROM rig_sensors")?
            + count("SELECT count(*) FROM rigs WHERE ref_sensor_type <> 0")?
            + count("SELECT count(*) FROM frame_data WHERE sensor_type <> 0")?;
        if others == 0 {
            self.write_rigs(&[], &[])?;
        }
        Ok(())
    }
}
