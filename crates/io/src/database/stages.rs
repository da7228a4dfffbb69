//! What the database was made from: a table of ours, which COLMAP passes by.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OpenFlags, params};

use super::connection::{Database, connect, error};
use super::guard::{self, Guard, beside};
use super::schema;
use crate::{Error, Result, disk};

const CREATE: &str = "CREATE TABLE IF NOT EXISTS tiepoint_stages \
                      (stage TEXT PRIMARY KEY NOT NULL, is_complete INTEGER NOT NULL, recipe TEXT \
                      NOT NULL)";
const FIND: &str =
    "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = 'tiepoint_stages'";
const READ: &str = "SELECT stage, is_complete, recipe FROM tiepoint_stages ORDER BY rowid";
/// Bytes 18 and 19 of a database tell how it is written and read: 2 with a write-ahead log.
const VERSIONS: std::ops::Range<usize> = 18..20;
const WITH_LOG: [u8; 2] = [2, 2];
/// SQLite's file system without locks.
const LOCKLESS: &str = if cfg!(windows) { "win32-none" } else { "unix-none" };

/// What a stage of the pipeline left in the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageRow {
    /// Its name; no two rows have the same.
    pub stage: String,
    /// Whether it ran to its end.
    pub is_complete: bool,
    /// What it was made from, in the words of the one who writes it.
    pub recipe: String,
}

impl Database {
    /// Reads the rows on stages, in the order in which they were written; `None` where nobody wrote
    /// any.
    ///
    /// # Errors
    ///
    /// Where the file cannot be read.
    pub fn stage_rows(&self) -> Result<Option<Vec<StageRow>>> {
        self.guard.begin();
        read(&self.connection).map_err(error(&self.path))
    }

    /// Replaces all rows on stages.
    ///
    /// # Errors
    ///
    /// Where two rows have the same name, and where the file cannot be written.
    pub fn write_stage_rows(&mut self, rows: &[StageRow]) -> Result<()> {
        self.transaction(|db| db.replace_stage_rows(rows))
    }

    /// The same inside of a transaction.
    pub(super) fn replace_stage_rows(&self, rows: &[StageRow]) -> Result<()> {
        self.run(CREATE)?;
        self.run("DELETE FROM tiepoint_stages")?;
        for row in rows {
            let sql = "INSERT INTO tiepoint_stages(stage, is_complete, recipe) VALUES (?1, ?2, ?3)";
            self.execute(sql, params![row.stage, row.is_complete, row.recipe])?;
        }
        Ok(())
    }
}

/// Reads the rows on stages of a database, in the order in which they were written; `None` where
/// nobody wrote any. Neither the file nor its folder need be writable; files beside the database
/// stay as they are, and none are added.
///
/// # Errors
///
/// Where there is no database, and where it cannot be read.
pub fn read_stage_rows(path: &Path) -> Result<Option<Vec<StageRow>>> {
    let file = std::path::absolute(disk::end_of_links(path).map_err(Error::io(path))?);
    let file = file.map_err(Error::io(path))?;
    let rows = open_to_read(&file, path)?.and_then(|mut connection| read_guarded(&mut connection));
    let whole =
        |rows: std::result::Result<_, String>| rows.map_err(|what| Error::content(path, what));
    match rows {
        // What a killed transaction of somebody else left must be rolled back, which is a change.
        Err(cause) if is_read_only(&cause) && beside(&file, "-journal").exists() => {
            read_guarded(&mut connect(&file, path)?).map_err(error(path)).and_then(whole)
        }
        rows => rows.map_err(error(path)).and_then(whole),
    }
}

/// Opens a database so that reading it changes no file.
fn open_to_read(file: &Path, path: &Path) -> Result<rusqlite::Result<Connection>> {
    std::fs::metadata(file).map_err(Error::io(path))?;
    let has_log = std::fs::metadata(beside(file, "-wal")).is_ok_and(|found| found.len() > 0);
    // Who has the database and its log open has the index of the log, too.
    let has_index = beside(file, "-shm").exists();
    let would_make_log = !has_log && !has_index && wants_log(file).map_err(Error::io(path))?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || -> rusqlite::Result<Connection> {
        let connection = if would_make_log {
            Connection::open_with_flags(unchanging(file), flags | OpenFlags::SQLITE_OPEN_URI)?
        } else if has_log && !has_index {
            // Alone with the log, SQLite keeps the index in memory. Locks would need a file that
            // can be written.
            let connection = Connection::open_with_flags_and_vfs(file, flags, LOCKLESS)?;
            connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
            connection
        } else {
            Connection::open_with_flags(file, flags)?
        };
        guard::distrust(&connection)?;
        // The log stays for the next one who writes.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        Ok(connection)
    };
    Ok(open())
}

/// Whether a database is written with a log. Only for one that this process does not have open: to
/// close a file ends all of the process's locks on it.
fn wants_log(file: &Path) -> std::io::Result<bool> {
    let mut header = [0; VERSIONS.end];
    match File::open(file)?.read_exact(&mut header) {
        Err(cause) if cause.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| header[VERSIONS] == WITH_LOG),
    }
}

/// The same of a database that nobody has looked at; why not, where its tables are not what they
/// seem.
fn read_guarded(
    connection: &mut Connection,
) -> rusqlite::Result<std::result::Result<Option<Vec<StageRow>>, String>> {
    let _guard = Guard::new(connection)?;
    match schema::check(connection)? {
        Ok(()) => read(connection).map(Ok),
        Err(what) => Ok(Err(what)),
    }
}

fn read(connection: &Connection) -> rusqlite::Result<Option<Vec<StageRow>>> {
    if connection.query_row(FIND, [], |row| row.get::<_, i64>(0))? == 0 {
        return Ok(None);
    }
    let mut statement = connection.prepare(READ)?;
    let rows = statement.query_map([], |row| {
        Ok(StageRow { stage: row.get(0)?, is_complete: row.get(1)?, recipe: row.get(2)? })
    });
    rows?.collect::<rusqlite::Result<_>>().map(Some)
}

fn is_read_only(cause: &rusqlite::Error) -> bool {
    matches!(cause.sqlite_error_code(), Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen))
}

/// SQLite's address of an absolute path, as that of a file that does not change.
fn unchanging(file: &Path) -> String {
    #[cfg(unix)]
    let bytes = std::os::unix::ffi::OsStrExt::as_bytes(file.as_os_str()).to_vec();
    #[cfg(not(unix))]
    let bytes = format!("/{}", file.to_string_lossy().replace('\\', "/")).into_bytes();
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-".contains(&byte);
    let escaped =
        |byte| if is_plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    format!("file://{}?immutable=1", bytes.into_iter().map(escaped).collect::<String>())
}
