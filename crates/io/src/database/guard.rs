//! Databases of strangers: SQLite executes what stands in their schema, and follows what stands in
//! their pages.
//!
//! Views, triggers and functions of the schema are switched off
//! (<https://www.sqlite.org/security.html>). What is left, tables read from end to end, takes steps
//! in proportion to the file; more than that means pages that lead in circles.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rusqlite::Connection;
use rusqlite::config::DbConfig;

/// What a statement says that was stopped.
pub(super) const STOPPED: &str = "reading it takes more steps than a database of its length can \
need: it is damaged, or made to take for ever";
/// Steps of SQLite's machine between two looks at the count: some ten milliseconds.
const STEPS: u64 = 1 << 20;
/// Steps that any statement may take, and as many for each byte of the file: a row has four bytes
/// or more, and takes a dozen steps.
const FREE_STEPS: u64 = 16 << 20;
const STEPS_PER_BYTE: u64 = 64;

/// Switches off what a schema can do beyond holding rows.
pub(super) fn distrust(connection: &Connection) -> rusqlite::Result<()> {
    for (config, is_on) in [
        (DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
        (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
        (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
        (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
    ] {
        connection.set_db_config(config, is_on)?;
    }
    connection.pragma_update(None, "cell_size_check", true)
}

/// Stops a statement that takes too many steps.
#[derive(Debug)]
pub(super) struct Guard {
    steps: Arc<AtomicU64>,
}

impl Guard {
    pub(super) fn new(connection: &mut Connection) -> rusqlite::Result<Self> {
        let steps = Arc::new(AtomicU64::new(0));
        let (counted, file) = (Arc::clone(&steps), connection.path().map(PathBuf::from));
        let is_too_much = move || {
            let length = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
            let bytes =
                file.as_deref().map_or(0, |file| length(file) + length(&beside(file, "-wal")));
            let allowed = STEPS_PER_BYTE.saturating_mul(bytes).saturating_add(FREE_STEPS);
            counted.fetch_add(STEPS, Ordering::Relaxed) > allowed
        };
        connection.progress_handler(STEPS as i32, Some(is_too_much))?;
        Ok(Self { steps })
    }

    /// Another statement begins.
    pub(super) fn begin(&self) {
        self.steps.store(0, Ordering::Relaxed);
    }
}

/// A file that SQLite keeps beside a database.
pub(super) fn beside(file: &Path, suffix: &str) -> PathBuf {
    let mut name: OsString = file.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}
