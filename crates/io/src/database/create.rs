//! Creation of databases. A new database replaces the old one only when it is complete.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode};
use tiepoint_store::disk::{self, WrittenFile};

use super::connection::{Database, checkpoint_log, connect, error};
use super::guard::side_file;
use super::schema;
use crate::{Error, Result};

/// Suffixes of the files that SQLite keeps beside a database.
const SIDE_FILE_SUFFIXES: [&str; 3] = ["-wal", "-shm", "-journal"];
/// The first bytes of a database (<https://www.sqlite.org/fileformat.html>, section 1.3).
const MAGIC: &[u8; 16] = b"SQLite format 3\0";

impl Database {
    /// Creates an empty database; replaces a database of that name.
    ///
    /// # Errors
    ///
    /// The errors of [`Database::create_with`].
    pub fn create(path: &Path) -> Result<Self> {
        Self::create_with(path, |_| Ok(()))
    }

    /// Creates a database under a temporary name, lets `fill` write its first content, and renames
    /// it to `path`, replacing the database there. The folder must exist; symbolic links to files
    /// are followed. A temporary database of a killed run is removed.
    ///
    /// # Errors
    ///
    /// If `fill` fails, if another run creates the database or has the old one open, if there is a
    /// log or journal and no database, and if the system reports an error. The old database is then
    /// unchanged.
    pub fn create_with(path: &Path, fill: impl FnOnce(&mut Self) -> Result<()>) -> Result<Self> {
        Self::replace_with(path, |database| {
            database.transaction(|db| db.run(schema::CREATE))?;
            fill(database)
        })
    }

    /// [`Database::create_with`] for a file without tables.
    pub(super) fn replace_with(
        path: &Path,
        fill: impl FnOnce(&mut Self) -> Result<()>,
    ) -> Result<Self> {
        if path.file_name().is_none() {
            return Err(Error::content(path, "is not the name of a file"));
        }
        let target = disk::end_of_links(path).map_err(Error::io(path))?;
        match fs::metadata(&target) {
            Ok(found) if !found.is_file() => {
                return Err(Error::content(path, "exists and is not a regular file"));
            }
            Ok(_) => {}
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {}
            Err(cause) => return Err(Error::io(path)(cause)),
        }
        for file in SIDE_FILE_SUFFIXES.map(|suffix| side_file(&target, suffix)) {
            // They are somebody's, and may hold the only copy of committed data.
            if !is_database(&target) && fs::symlink_metadata(&file).is_ok() {
                return Err(Error::content(
                    &file,
                    "may be the log of a database that was moved away: move it to that database",
                ));
            }
        }
        let temporary = TemporaryDatabase::claim(path, disk::temporary_path(&target))?;
        let mut database = Self::with(connect(&temporary.path, path)?, path)?;
        // A killed run discards the temporary database, so that its durability does not matter
        // before the rename.
        database.run("PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;")?;
        database.disable_foreign_keys()?;
        fill(&mut database)?;
        database.connection.close().map_err(|(_, cause)| error(path)(cause))?;
        temporary.file.sync().map_err(Error::io(path))?;
        if is_database(&target) {
            checkpoint_if_needed(&target, path)?;
        }
        for suffix in SIDE_FILE_SUFFIXES {
            // SQLite would take them for the log or journal of the new database.
            remove_if_there(&side_file(&target, suffix)).map_err(Error::io(path))?;
        }
        temporary.rename_to(&target).map_err(Error::io(path))?;
        Self::open(path)
    }
}

/// Merges the log or journal of a database into its file.
fn checkpoint_if_needed(file: &Path, path: &Path) -> Result<()> {
    if !SIDE_FILE_SUFFIXES.iter().any(|suffix| side_file(file, suffix).exists()) {
        return Ok(());
    }
    let checkpoint = |connection: &Connection| {
        // The first read rolls a journal of a killed transaction back.
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(()))?;
        checkpoint_log(connection)
    };
    let connection = connect(file, path)?;
    match checkpoint(&connection) {
        // A damaged file is replaced.
        Err(cause)
            if matches!(
                cause.sqlite_error_code(),
                Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt)
            ) => {}
        result => result.map_err(error(path))?,
    }
    connection.close().map_err(|(_, cause)| error(path)(cause))
}

/// Whether a file begins as a database does. SQLite deletes journals beside others.
fn is_database(file: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    File::open(file).and_then(|mut file| file.read_exact(&mut head)).is_ok_and(|()| head == *MAGIC)
}

fn remove_if_there(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(()),
        _ => disk::remove_file(path),
    }
}

/// A database under its temporary name; removed on drop unless it was renamed.
struct TemporaryDatabase {
    path: PathBuf,
    /// Must stay open until SQLite has closed the database: closing any handle of a file releases
    /// all POSIX locks of the process on it.
    file: WrittenFile,
    is_renamed: bool,
}

impl TemporaryDatabase {
    /// Creates and locks an empty file. An existing file without a lock was left by a killed run
    /// and is replaced.
    fn claim(path: &Path, temporary: PathBuf) -> Result<Self> {
        let busy = || Error::content(path, "is being written by another run: wait for it to end");
        match fs::symlink_metadata(&temporary) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {}
            Err(cause) => return Err(Error::io(path)(cause)),
            Ok(found) if !found.is_file() => {
                return Err(Error::content(&temporary, "is in the way: move it away"));
            }
            Ok(_) => {
                let left =
                    OpenOptions::new().write(true).open(&temporary).map_err(Error::io(path))?;
                if let Err(TryLockError::WouldBlock) = left.try_lock() {
                    return Err(busy());
                }
                disk::remove_file(&temporary).map_err(Error::io(path))?;
            }
        }
        for suffix in SIDE_FILE_SUFFIXES {
            remove_if_there(&side_file(&temporary, suffix)).map_err(Error::io(path))?;
        }
        let file = match WrittenFile::create_new(&temporary) {
            Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => return Err(busy()),
            made => made.map_err(Error::io(path))?,
        };
        if !cfg!(windows) {
            // Locks are mandatory on Windows and would block SQLite. File systems without locks are
            // accepted.
            let _ = file.file().try_lock();
        }
        Ok(Self { path: temporary, file, is_renamed: false })
    }

    fn rename_to(mut self, target: &Path) -> io::Result<()> {
        disk::rename(&self.path, target)?;
        self.is_renamed = true;
        disk::sync_folder(disk::folder_of(target))
    }
}

impl Drop for TemporaryDatabase {
    fn drop(&mut self) {
        if !self.is_renamed {
            // An earlier error is the one to report.
            let _ = disk::remove_file(&self.path);
        }
    }
}
