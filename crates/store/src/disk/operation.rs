/// A change of the file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// An empty file is created.
    Create,
    /// Bytes are written to a file.
    Write,
    /// The content of a file is synchronised (fsync).
    Sync,
    /// A file or folder is renamed.
    Rename,
    /// A file or an empty folder is removed.
    Remove,
    /// A folder is created.
    CreateFolder,
    /// The entries of a folder are synchronised (fsync).
    SyncFolder,
    /// A transaction of a database is committed.
    Commit,
}
