//! Protection against malicious databases: SQLite executes code in the schema, and follows pointers
//! in the pages.
//!
//! Views, triggers and functions of the schema are switched off
//! (<https://www.sqlite.org/security.html>). Full scans of tables remain; their number of steps is
//! proportional to the length of the file. More steps mean cyclic pages.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rusqlite::Connection;
use rusqlite::config::DbConfig;

/// Error of a statement that was stopped.
pub(super) const STOPPED: &str = "reading it takes more steps than a database of its length can \
need: it is damaged, or made to take for ever";
/// Instructions of the virtual machine between two calls of the progress handler: some ten
/// milliseconds.
const STEPS: u64 = 1 << 20;
/// Limit of instructions of a statement: a constant, plus a number for each byte of the file. A row
/// has four bytes or more and takes a dozen instructions.
const FREE_STEPS: u64 = 16 << 20;
const STEPS_PER_BYTE: u64 = 64;

/// Switches off all features of a schema other than tables.
pub(super) fn restrict_schema(connection: &Connection) -> rusqlite::Result<()> {
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
                file.as_deref().map_or(0, |file| length(file) + length(&side_file(file, "-wal")));
            let allowed = STEPS_PER_BYTE.saturating_mul(bytes).saturating_add(FREE_STEPS);
            counted.fetch_add(STEPS, Ordering::Relaxed) > allowed
        };
        connection.progress_handler(STEPS as i32, Some(is_too_much))?;
        Ok(Self { steps })
    }

    /// Resets the count at the beginning of a statement.
    pub(super) fn begin(&self) {
        self.steps.store(0, Ordering::Relaxed);
    }
}

/// Path of a file that SQLite keeps beside a database.
pub(super) fn side_file(file: &Path, suffix: &str) -> PathBuf {
    let mut name: OsString = file.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}
