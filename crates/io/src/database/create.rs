//! New databases: complete or not at all.

use std::fs::{self, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode};

use super::connection::{Database, connect, error, fold_log};
use super::guard::beside;
use super::schema;
use crate::disk::{self, WrittenFile};
use crate::{Error, Result};

/// The ends of the names of files that SQLite keeps beside a database.
const BESIDE: [&str; 3] = ["-wal", "-shm", "-journal"];

impl Database {
    /// Makes a new, empty database; one of that name is replaced.
    ///
    /// # Errors
    ///
    /// Those of [`Database::create_with`].
    pub fn create(path: &Path) -> Result<Self> {
        Self::create_with(path, |_| Ok(()))
    }

    /// Makes a new database: `fill` writes its first content, and only then does it take its name
    /// and replace the one that was there. The folder must exist; symbolic links are followed. What
    /// a killed run left under the temporary name goes.
    ///
    /// # Errors
    ///
    /// Where `fill` fails, where another run is making the database or has the old one open, and
    /// where the system refuses. The old database is then as it was.
    pub fn create_with(path: &Path, fill: impl FnOnce(&mut Self) -> Result<()>) -> Result<Self> {
        if path.file_name().is_none() {
            return Err(Error::content(path, "is not the name of a file"));
        }
        let target = disk::end_of_links(path).map_err(Error::io(path))?;
        let is_there = match fs::metadata(&target) {
            Ok(found) if !found.is_file() => {
                return Err(Error::content(path, "is there and is no file"));
            }
            Ok(_) => true,
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => false,
            Err(cause) => return Err(Error::io(path)(cause)),
        };
        let part = Part::claim(path, disk::part_of(&target))?;
        let mut this = Self::with(connect(&part.path, path)?, path)?;
        // A run that is killed throws the part away, so nothing of it need be kept in order on the
        // disk before its end.
        this.run("PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;")?;
        this.keep_rows_apart()?;
        this.transaction(|db| db.run(schema::CREATE))?;
        fill(&mut this)?;
        this.connection.close().map_err(|(_, cause)| error(path)(cause))?;
        part.file.sync().map_err(Error::io(path))?;
        if is_there {
            fold(&target, path)?;
        }
        for suffix in BESIDE {
            // SQLite would take them for files of the new database.
            remove_if_there(&beside(&target, suffix)).map_err(Error::io(path))?;
        }
        part.take_name(&target).map_err(Error::io(path))?;
        Self::open(path)
    }
}

/// Brings what is in the log or journal of a database into its file; a file that is no database
/// stays as it is.
fn fold(file: &Path, path: &Path) -> Result<()> {
    if !BESIDE.iter().any(|suffix| beside(file, suffix).exists()) {
        return Ok(());
    }
    let fold = |connection: &Connection| {
        // Reading rolls back what a killed transaction left.
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(()))?;
        fold_log(connection)
    };
    let connection = connect(file, path)?;
    match fold(&connection) {
        Err(cause)
            if matches!(
                cause.sqlite_error_code(),
                Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt)
            ) => {}
        folded => folded.map_err(error(path))?,
    }
    connection.close().map_err(|(_, cause)| error(path)(cause))
}

fn remove_if_there(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(()),
        _ => disk::remove_file(path),
    }
}

/// A database under its temporary name; dropped, it goes.
struct Part {
    path: PathBuf,
    /// Is open until SQLite has closed the database: to close it ends all of the process's locks on
    /// it.
    file: WrittenFile,
    has_name: bool,
}

impl Part {
    /// Makes an empty file and locks it. One that is there and not locked was left by a run that
    /// was killed.
    fn claim(path: &Path, part: PathBuf) -> Result<Self> {
        let busy = || Error::content(path, "is being written by another run: wait for it to end");
        match fs::symlink_metadata(&part) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {}
            Err(cause) => return Err(Error::io(path)(cause)),
            Ok(found) if !found.is_file() => {
                return Err(Error::content(&part, "is in the way: move it away"));
            }
            Ok(_) => {
                let left = OpenOptions::new().write(true).open(&part).map_err(Error::io(path))?;
                if let Err(TryLockError::WouldBlock) = left.try_lock() {
                    return Err(busy());
                }
                disk::remove_file(&part).map_err(Error::io(path))?;
            }
        }
        for suffix in BESIDE {
            remove_if_there(&beside(&part, suffix)).map_err(Error::io(path))?;
        }
        let file = match WrittenFile::create_new(&part) {
            Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => return Err(busy()),
            made => made.map_err(Error::io(path))?,
        };
        if !cfg!(windows) {
            // Locks bind SQLite on Windows; systems without locks go without.
            let _ = file.file().try_lock();
        }
        Ok(Self { path: part, file, has_name: false })
    }

    fn take_name(mut self, target: &Path) -> io::Result<()> {
        disk::rename(&self.path, target)?;
        self.has_name = true;
        disk::sync_folder(disk::folder_of(target))
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if !self.has_name {
            // The first error is the one to report, or nobody is left to tell.
            let _ = disk::remove_file(&self.path);
        }
    }
}
