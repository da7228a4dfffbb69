/// A change of the file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// A new, empty file.
    Create,
    /// Bytes of a file.
    Write,
    /// A file's content reaches the disk.
    Sync,
    /// A file or folder takes another name.
    Rename,
    /// A file or an empty folder goes.
    Remove,
    /// A new folder.
    CreateFolder,
    /// The names in a folder reach the disk.
    SyncFolder,
    /// A transaction of a database.
    Commit,
}
