//! The table `tiepoint_photos`: the fingerprints of the photos that the features are of. COLMAP
//! ignores it.

use std::collections::BTreeMap;

use rusqlite::params;

use super::connection::Database;
use crate::Result;

const TABLE: &str = "tiepoint_photos";

impl Database {
    /// Replaces the fingerprints of all photos, by the names of their images. A fingerprint is a
    /// text of the caller.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_photo_fingerprints<'a>(
        &mut self,
        fingerprints: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<()> {
        self.transaction(|db| {
            db.run(&format!(
                "CREATE TABLE IF NOT EXISTS {TABLE} \
                 (name TEXT PRIMARY KEY NOT NULL, fingerprint TEXT NOT NULL); DELETE FROM {TABLE}"
            ))?;
            let sql = format!("INSERT INTO {TABLE}(name, fingerprint) VALUES (?1, ?2)");
            let mut rows = fingerprints.into_iter();
            rows.try_for_each(|(name, fingerprint)| db.execute(&sql, params![name, fingerprint]))
        })
    }

    /// Reads the fingerprints of photos by the names of their images; empty if there are none.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn read_photo_fingerprints(&self) -> Result<BTreeMap<String, String>> {
        if self.columns(TABLE)?.is_empty() {
            return Ok(BTreeMap::new());
        }
        let sql = format!("SELECT name, fingerprint FROM {TABLE}");
        Ok(self.rows(&sql, |row| Ok((row.get(0)?, row.get(1)?)))?.into_iter().collect())
    }
}
