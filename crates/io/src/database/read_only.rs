//! Opening a database such that no file is changed or created.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OpenFlags};
use tiepoint_store::{disk, require_regular_file};

use super::connection::{Database, error};
use super::guard::{self, side_file};
use crate::{Error, Result};

/// Range of the file format versions for writing and reading in the header of a database, and their
/// values in WAL mode (<https://www.sqlite.org/fileformat.html>, section 1.3).
const VERSIONS: std::ops::Range<usize> = 18..20;
const WAL: [u8; 2] = [2, 2];
/// SQLite's VFS without locks.
const LOCKLESS: &str = if cfg!(windows) { "win32-none" } else { "unix-none" };

impl Database {
    /// Opens a database for reading. The file and its folder may be read-only; no file is changed
    /// or created, and writing fails.
    ///
    /// # Errors
    ///
    /// Those of [`Database::open`], and if a transaction of another program was interrupted, which
    /// only writing can roll back.
    pub fn open_read_only(path: &Path) -> Result<Self> {
        let mut database = Self::with(read_connection(path)?, path)?;
        database.index_tables()?;
        Ok(database)
    }
}

/// A connection that changes no file.
pub(super) fn read_connection(path: &Path) -> Result<Connection> {
    std::fs::metadata(path).map_err(Error::io(path))?;
    let file = std::path::absolute(disk::end_of_links(path).map_err(Error::io(path))?);
    let file = file.map_err(Error::io(path))?;
    let connection = open_to_read(&file, path)?.map_err(error(path))?;
    let first = connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(()));
    match first {
        Err(cause) if is_read_only(&cause) && side_file(&file, "-journal").exists() => {
            Err(Error::content(
                path,
                "a program was interrupted while it wrote to it: open it with that program once, \
                or give a copy without its journal",
            ))
        }
        first => first.map_err(error(path)).map(|()| connection),
    }
}

/// Opens a database such that reading changes no file.
pub(super) fn open_to_read(file: &Path, path: &Path) -> Result<rusqlite::Result<Connection>> {
    std::fs::metadata(file).map_err(Error::io(path))?;
    require_regular_file(path)?;
    let has_wal = std::fs::metadata(side_file(file, "-wal")).is_ok_and(|found| found.len() > 0);
    // A process with an open database in WAL mode keeps the index of the log (`-shm`).
    let has_shm = side_file(file, "-shm").exists();
    let would_create_wal = !has_wal && !has_shm && uses_wal(file).map_err(Error::io(path))?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || -> rusqlite::Result<Connection> {
        let connection = if would_create_wal {
            Connection::open_with_flags(immutable_uri(file), flags | OpenFlags::SQLITE_OPEN_URI)?
        } else if has_wal && !has_shm {
            // In exclusive mode SQLite keeps the index of the log in memory. Locks would need a
            // writable file.
            let connection = Connection::open_with_flags_and_vfs(file, flags, LOCKLESS)?;
            connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
            connection
        } else {
            Connection::open_with_flags(file, flags)?
        };
        guard::restrict_schema(&connection)?;
        // No checkpoint on close: it would write to the file.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        Ok(connection)
    };
    Ok(open())
}

/// Whether a database is in WAL mode. Only for a database that this process does not have open:
/// closing a file releases all POSIX locks of the process on it.
fn uses_wal(file: &Path) -> std::io::Result<bool> {
    let mut header = [0; VERSIONS.end];
    match File::open(file)?.read_exact(&mut header) {
        Err(cause) if cause.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| header[VERSIONS] == WAL),
    }
}

pub(super) fn is_read_only(cause: &rusqlite::Error) -> bool {
    matches!(cause.sqlite_error_code(), Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen))
}

/// The URI of an absolute path with `immutable=1`: SQLite then takes no locks and looks for no log.
fn immutable_uri(file: &Path) -> String {
    #[cfg(unix)]
    let bytes = std::os::unix::ffi::OsStrExt::as_bytes(file.as_os_str()).to_vec();
    #[cfg(not(unix))]
    let bytes = format!("/{}", file.to_string_lossy().replace('\\', "/")).into_bytes();
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-".contains(&byte);
    let escaped =
        |byte| if is_plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    format!("file://{}?immutable=1", bytes.into_iter().map(escaped).collect::<String>())
}
