//! Matches and two-view geometries.

use std::path::Path;

use rusqlite::{Row, params};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_scene::{ImagePair, Match, TwoView, TwoViewKind};

use super::connection::{Database, MAX_IMAGE_ID, bytes, error, numbers};
use super::read_only::read_connection;
use super::stages::StageRow;
use crate::binary::pose_numbers;
use crate::{Result, rotation};

pub(super) const KINDS: [TwoViewKind; 9] = [
    TwoViewKind::Undefined,
    TwoViewKind::Degenerate,
    TwoViewKind::Calibrated,
    TwoViewKind::Uncalibrated,
    TwoViewKind::Planar,
    TwoViewKind::Panoramic,
    TwoViewKind::PlanarOrPanoramic,
    TwoViewKind::Watermark,
    TwoViewKind::Multiple,
];
/// Configuration of COLMAP: the relative pose follows from a calibrated rig.
const CALIBRATED_RIG: i64 = 9;

pub(super) fn match_bytes(matches: &[Match]) -> Vec<u8> {
    matches.iter().flat_map(|m| [m.a, m.b]).flat_map(u32::to_le_bytes).collect()
}

/// The file stores matrices by rows, nalgebra by columns.
fn matrix_bytes(matrix: Option<&Matrix3<f64>>) -> Option<Vec<u8>> {
    matrix.map(|matrix| bytes(matrix.transpose().as_slice()))
}

impl Database {
    /// Writes the matches of pairs; replaces those in the file. The first column belongs to the
    /// image with the smaller id, as in [`ImagePair`].
    ///
    /// # Errors
    ///
    /// If a pair has an image that is not in the database, and if the file cannot be written.
    pub fn write_matches<'a>(
        &mut self,
        batch: impl IntoIterator<Item = (ImagePair, &'a [Match])>,
    ) -> Result<()> {
        self.transaction(|db| {
            batch.into_iter().try_for_each(|(pair, matches)| db.put_matches(pair, matches))
        })
    }

    /// Writes two-view geometries of pairs; replaces those in the file.
    ///
    /// # Errors
    ///
    /// If a pair has an image that is not in the database, and if the file cannot be written.
    pub fn write_two_views<'a>(
        &mut self,
        batch: impl IntoIterator<Item = (ImagePair, &'a TwoView)>,
    ) -> Result<()> {
        self.transaction(|db| {
            let sql = db.two_view_sql()?;
            batch.into_iter().try_for_each(|(pair, view)| db.put_two_view(&sql, pair, view))
        })
    }

    /// Writes two-view geometries of pairs and replaces the records of stages, in one transaction.
    ///
    /// # Errors
    ///
    /// If a pair has an image that is not in the database, and if the file cannot be written.
    pub fn write_two_views_for<'a>(
        &mut self,
        batch: impl IntoIterator<Item = (ImagePair, &'a TwoView)>,
        rows: &[StageRow],
    ) -> Result<()> {
        self.transaction(|db| {
            let sql = db.two_view_sql()?;
            batch.into_iter().try_for_each(|(pair, view)| db.put_two_view(&sql, pair, view))?;
            db.replace_stage_rows(rows)
        })
    }

    /// Writes matches and two-view geometries of pairs in one transaction, so that every pair has
    /// both or neither; replaces those in the file.
    ///
    /// # Errors
    ///
    /// If a pair has an image that is not in the database, and if the file cannot be written.
    pub fn write_pairs<'a>(
        &mut self,
        batch: impl IntoIterator<Item = (ImagePair, &'a [Match], &'a TwoView)>,
    ) -> Result<()> {
        self.transaction(|db| {
            let sql = db.two_view_sql()?;
            batch.into_iter().try_for_each(|(pair, matches, view)| {
                db.put_matches(pair, matches)?;
                db.put_two_view(&sql, pair, view)
            })
        })
    }

    fn put_matches(&self, pair: ImagePair, matches: &[Match]) -> Result<()> {
        let sql =
            "INSERT OR REPLACE INTO matches(pair_id, rows, cols, data) VALUES (?1, ?2, 2, ?3)";
        self.execute(
            sql,
            params![self.pair_id_of(pair)?, matches.len() as i64, match_bytes(matches)],
        )
    }

    /// The statement that writes a two-view geometry. Files older than COLMAP 3.8 have no pose.
    fn two_view_sql(&self) -> Result<String> {
        let has_pose = self.columns("two_view_geometries")?.iter().any(|name| name == "qvec");
        let (pose, values) = if has_pose { (", qvec, tvec", ", ?8, ?9") } else { ("", "") };
        Ok(format!(
            "INSERT OR REPLACE INTO two_view_geometries\
            (pair_id, rows, cols, data, config, F, E, H{pose}) \
            VALUES (?1, ?2, 2, ?3, ?4, ?5, ?6, ?7{values})"
        ))
    }

    fn put_two_view(&self, sql: &str, pair: ImagePair, view: &TwoView) -> Result<()> {
        let pose = view.cam2_from_cam1.as_ref().map(pose_numbers);
        let (id, rows) = (self.pair_id_of(pair)?, view.matches.len() as i64);
        let (data, kind) = (match_bytes(&view.matches), view.kind as i64);
        let [f, e, h] = [&view.fundamental, &view.essential, &view.homography]
            .map(|matrix| matrix_bytes(matrix.as_ref()));
        let (q, t) = (pose.map(|pose| bytes(&pose[..4])), pose.map(|pose| bytes(&pose[4..])));
        let values: [&dyn rusqlite::ToSql; 9] = [&id, &rows, &data, &kind, &f, &e, &h, &q, &t];
        // Without the columns of the pose, their values are left out.
        self.execute(sql, &values[..sql.matches('?').count()])
    }

    /// Deletes all matches and two-view geometries.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn clear_matches(&mut self) -> Result<()> {
        self.transaction(Self::delete_matches)
    }

    /// Deletes all matches and two-view geometries and replaces the records of stages, in one
    /// transaction.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn clear_matches_for(&mut self, rows: &[StageRow]) -> Result<()> {
        self.transaction(|db| {
            db.delete_matches()?;
            db.replace_stage_rows(rows)
        })
    }

    fn delete_matches(&self) -> Result<()> {
        self.run("DELETE FROM matches; DELETE FROM two_view_geometries;")
    }

    /// Deletes all two-view geometries.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn clear_two_views(&mut self) -> Result<()> {
        self.transaction(|db| db.run("DELETE FROM two_view_geometries"))
    }

    /// The pairs with a row of matches, sorted.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist or has invalid content, and if the file
    /// cannot be read.
    pub fn matched_pairs(&self) -> Result<Vec<ImagePair>> {
        let numbers =
            self.rows("SELECT pair_id FROM matches ORDER BY pair_id", |row| row.get(0))?;
        numbers.into_iter().map(|number| self.pair(number)).collect()
    }

    /// Whether any pair of a database of COLMAP of any version has matches or a two-view geometry.
    /// Rows are not checked, and the file is not changed.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or its tables are not ordinary ones.
    pub fn has_pairs(path: &Path) -> Result<bool> {
        let database = Self::with(read_connection(path)?, path)?;
        database.check_kinds()?;
        // COLMAP of 2017 has the last in place of the second.
        for table in ["matches", "two_view_geometries", "inlier_matches"] {
            let sql = format!("SELECT EXISTS (SELECT 1 FROM {table} WHERE rows > 0)");
            let is_there = !database.columns(table)?.is_empty();
            if is_there && database.rows(&sql, |row| row.get(0))?.into_iter().any(|found| found) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The number of matches of each pair, sorted by pair, without reading the matches.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist or has invalid content, and if the file
    /// cannot be read.
    pub fn match_counts(&self) -> Result<Vec<(ImagePair, usize)>> {
        let counts = self.rows("SELECT pair_id, rows FROM matches ORDER BY pair_id", |row| {
            Ok((row.get::<_, i64>(0)?, row.get::<_, i64>(1)?))
        })?;
        counts
            .into_iter()
            .map(|(number, rows)| Ok((self.pair(number)?, rows.max(0) as usize)))
            .collect()
    }

    /// The number of inlier matches of each two-view geometry, sorted by pair; `None` if the
    /// geometry is not verified.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist or has invalid content, and if the file
    /// cannot be read.
    pub fn inlier_counts(&self) -> Result<Vec<(ImagePair, Option<usize>)>> {
        let sql = "SELECT pair_id, rows, config FROM two_view_geometries ORDER BY pair_id";
        let counts = self.rows(sql, |row| {
            Ok((row.get::<_, i64>(0)?, row.get::<_, i64>(1)?, row.get::<_, i64>(2)?))
        })?;
        let count = |(number, rows, kind): (i64, i64, i64)| {
            let two_view = TwoView { kind: self.kind(number, kind)?, ..TwoView::default() };
            Ok((self.pair(number)?, two_view.is_verified().then_some(rows.max(0) as usize)))
        };
        counts.into_iter().map(count).collect()
    }

    /// Reads all matches, sorted by pair.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist or has invalid content, and if the file
    /// cannot be read.
    pub fn read_matches(&self) -> Result<Vec<(ImagePair, Vec<Match>)>> {
        let sql = "SELECT pair_id, rows, cols, data FROM matches ORDER BY pair_id";
        self.try_rows(sql, |row| {
            Ok((self.pair(row.get(0).map_err(error(&self.path))?)?, self.matches(row)?))
        })
    }

    /// Reads the matches of a pair; empty if none were written.
    ///
    /// # Errors
    ///
    /// If the row has invalid content, and if the file cannot be read.
    pub fn read_matches_of(&self, pair: ImagePair) -> Result<Vec<Match>> {
        let sql = format!(
            "SELECT pair_id, rows, cols, data FROM matches WHERE pair_id = {}",
            self.pair_id_of(pair)?
        );
        let found = self.try_rows(&sql, |row| self.matches(row))?;
        Ok(found.into_iter().next().unwrap_or_default())
    }

    /// Reads the inlier matches of a pair; empty if there is no two-view geometry.
    ///
    /// # Errors
    ///
    /// If the row has invalid content, and if the file cannot be read.
    pub fn read_inliers_of(&self, pair: ImagePair) -> Result<Vec<Match>> {
        let sql = format!(
            "SELECT pair_id, rows, cols, data FROM two_view_geometries WHERE pair_id = {}",
            self.pair_id_of(pair)?
        );
        let found = self.try_rows(&sql, |row| self.matches(row))?;
        Ok(found.into_iter().next().unwrap_or_default())
    }

    /// Reads all two-view geometries, sorted by pair.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist or has invalid content, and if the file
    /// cannot be read.
    pub fn read_two_views(&self) -> Result<Vec<(ImagePair, TwoView)>> {
        // Older files lack the pose, and those of 2017 the matrices.
        let known = self.columns("two_view_geometries")?;
        let columns = ["F", "E", "H", "qvec", "tvec"]
            .map(|name| if known.iter().any(|known| known == name) { name } else { "NULL" });
        let columns = columns.join(", ");
        let sql = format!(
            "SELECT pair_id, rows, cols, data, config, {columns} FROM two_view_geometries \
            ORDER BY pair_id"
        );
        self.try_rows(&sql, |row| {
            let number = row.get(0).map_err(error(&self.path))?;
            let bad =
                |what: &str| self.content(format!("two-view geometry of pair {number}: {what}"));
            let list = |column: usize, count: usize| -> Result<Option<Vec<f64>>> {
                let blob: Option<Vec<u8>> = row.get(column).map_err(error(&self.path))?;
                let blob = blob.filter(|blob| !blob.is_empty());
                blob.map(|blob| {
                    numbers(&blob, count).ok_or_else(|| bad("a matrix or pose is broken"))
                })
                .transpose()
            };
            let matrix = |column| -> Result<_> {
                Ok(list(column, 9)?.map(|values| Matrix3::from_row_slice(&values)))
            };
            let cam2_from_cam1 = match (list(8, 4)?, list(9, 3)?) {
                // COLMAP up to 3.8 writes zeros for pairs without a pose.
                (Some(q), Some(_)) if q.iter().all(|value| *value == 0.0) => None,
                (Some(q), Some(t)) => {
                    let rotation = rotation::from_wxyz([q[0], q[1], q[2], q[3]]);
                    let rotation = rotation.map_err(|_| bad("its quaternion is no rotation"))?;
                    Some(Rigid3::new(rotation, Vector3::from_column_slice(&t)))
                }
                _ => None,
            };
            let kind = self.kind(number, row.get(4).map_err(error(&self.path))?)?;
            let two_view = TwoView {
                kind,
                fundamental: matrix(5)?,
                essential: matrix(6)?,
                homography: matrix(7)?,
                cam2_from_cam1,
                matches: self.matches(row)?,
            };
            Ok((self.pair(number)?, two_view))
        })
    }

    fn kind(&self, pair: i64, config: i64) -> Result<TwoViewKind> {
        if config == CALIBRATED_RIG {
            return Ok(TwoViewKind::Calibrated);
        }
        let kind = usize::try_from(config).ok().and_then(|index| KINDS.get(index)).copied();
        kind.ok_or_else(|| {
            self.content(format!(
                "two-view geometry of pair {pair}: its configuration {config} is none of COLMAP's, \
                0 to {CALIBRATED_RIG}: match and verify again with the program that wrote it"
            ))
        })
    }

    fn pair_id_of(&self, pair: ImagePair) -> Result<i64> {
        Ok(MAX_IMAGE_ID * self.file_id(pair.a)? + self.file_id(pair.b)?)
    }

    pub(super) fn pair(&self, number: i64) -> Result<ImagePair> {
        let by = || format!("pair {number}");
        let (a, b) = (number.div_euclid(MAX_IMAGE_ID), number.rem_euclid(MAX_IMAGE_ID));
        let (a, b) = (self.image_id(a, by)?, self.image_id(b, by)?);
        ImagePair::new(a, b).filter(|pair| pair.a == a).ok_or_else(|| {
            let [a, b] = [a, b].map(|image| self.shown(image));
            self.content(format!("pair {number} is of {a} and {b}"))
        })
    }

    /// Matches of a row with the columns pair_id, rows, cols, data.
    fn matches(&self, row: &Row<'_>) -> Result<Vec<Match>> {
        let get = || Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?));
        let (number, rows, cols, data): (i64, i64, i64, Option<Vec<u8>>) =
            get().map_err(error(&self.path))?;
        let data = data.unwrap_or_default();
        let words: Vec<u32> =
            data.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        // COLMAP writes an empty list of matches as 0 × 0 or 0 × 2.
        let fits = (cols == 2 || rows == 0) && rows.checked_mul(8) == Some(data.len() as i64);
        if !fits {
            let found = data.len();
            return Err(self
                .content(format!("matches of pair {number}: {found} bytes for {rows} × {cols}")));
        }
        Ok(words.as_chunks::<2>().0.iter().map(|&[a, b]| Match { a, b }).collect())
    }
}
