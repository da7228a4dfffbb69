//! The table `tiepoint_stages`: the inputs from which the content of the database was computed.
//! COLMAP ignores it.

use std::path::Path;

use rusqlite::{Connection, params};
use tiepoint_store::disk;

use super::connection::{Database, connect, error};
use super::guard::{Guard, side_file};
use super::read_only::{is_read_only, open_to_read};
use super::schema;
use crate::{Error, Result};

const CREATE: &str = "CREATE TABLE IF NOT EXISTS tiepoint_stages \
                      (stage TEXT PRIMARY KEY NOT NULL, is_complete INTEGER NOT NULL, recipe TEXT \
                      NOT NULL)";
const FIND: &str =
    "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = 'tiepoint_stages'";
const READ: &str = "SELECT stage, is_complete, recipe FROM tiepoint_stages ORDER BY rowid";
/// The record of a stage of the pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageRow {
    /// Name of the stage; unique.
    pub stage: String,
    /// Whether the stage is complete.
    pub is_complete: bool,
    /// The inputs of the stage, in the format of the caller.
    pub recipe: String,
}

impl Database {
    /// Reads the records of the stages in the order in which they were written; `None` if the table
    /// does not exist.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn stage_rows(&self) -> Result<Option<Vec<StageRow>>> {
        self.guard.begin();
        read(&self.connection).map_err(error(&self.path))
    }

    /// Replaces all records of stages.
    ///
    /// # Errors
    ///
    /// If two records have the same name, and if the file cannot be written.
    pub fn write_stage_rows(&mut self, rows: &[StageRow]) -> Result<()> {
        self.transaction(|db| db.replace_stage_rows(rows))
    }

    /// Replaces all records of stages inside of a transaction.
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

/// Reads the records of the stages of a database without opening it for writing, in the order in
/// which they were written; `None` if the table does not exist. The file and its folder may be
/// read-only; files beside the database are neither changed nor created.
///
/// # Errors
///
/// If there is no database, and if it cannot be read.
pub fn read_stage_rows(path: &Path) -> Result<Option<Vec<StageRow>>> {
    let file = std::path::absolute(disk::end_of_links(path).map_err(Error::io(path))?);
    let file = file.map_err(Error::io(path))?;
    let rows = open_to_read(&file, path)?.and_then(|mut connection| read_guarded(&mut connection));
    let whole =
        |rows: std::result::Result<_, String>| rows.map_err(|what| Error::content(path, what));
    match rows {
        // A journal of a killed transaction must be rolled back, which writes to the file.
        Err(cause) if is_read_only(&cause) && side_file(&file, "-journal").exists() => {
            read_guarded(&mut connect(&file, path)?).map_err(error(path)).and_then(whole)
        }
        rows => rows.map_err(error(path)).and_then(whole),
    }
}

/// Checks the schema of a database and reads its stages; the inner error says why a table is
/// refused.
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
