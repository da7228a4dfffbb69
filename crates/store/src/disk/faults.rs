//! Injected faults of the file system, for tests: one change under a folder can be made to fail,
//! and all changes can be recorded.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::operation::Operation;
use super::paths::folder_of;

/// Error codes of the system for a device error and for a full disk.
const BROKEN: i32 = if cfg!(windows) { 1117 } else { 5 };
const FULL: i32 = if cfg!(windows) { 112 } else { 28 };

/// How a change fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The program is killed: this change and all later ones fail without an effect. If this change
    /// is a write, half of its bytes are written.
    Stop,
    /// The disk is full from this change on: files and folders can be neither created nor written;
    /// renames and removals work.
    Full,
    /// This change alone fails.
    Fail,
}

/// Watches the changes under a folder until it is dropped. Tests that run at the same time use
/// different folders.
#[derive(Debug)]
pub struct Faults {
    id: u64,
}

struct Watch {
    id: u64,
    root: PathBuf,
    at: Option<(usize, Kind)>,
    log: Vec<(Operation, PathBuf)>,
    hit: bool,
    /// The path of a failed write of which half is still to be written.
    half: Option<PathBuf>,
}

static WATCHES: Mutex<Vec<Watch>> = Mutex::new(Vec::new());

impl Faults {
    /// Records the changes under `root`, which exists.
    pub fn count(root: &Path) -> Self {
        Self::watch(root, None)
    }

    /// Makes the `n`-th change under `root` fail, counted from 0.
    pub fn at(root: &Path, n: usize, kind: Kind) -> Self {
        Self::watch(root, Some((n, kind)))
    }

    fn watch(root: &Path, at: Option<(usize, Kind)>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        let root = root.canonicalize().unwrap_or_else(|_| root.to_owned());
        watches().push(Watch { id, root, at, log: vec![], hit: false, half: None });
        Self { id }
    }

    /// All changes so far, including the failed ones.
    pub fn log(&self) -> Vec<(Operation, PathBuf)> {
        self.with(|watch| watch.log.clone())
    }

    /// Whether a change was made to fail.
    pub fn hit(&self) -> bool {
        self.with(|watch| watch.hit)
    }

    fn with<T: Default>(&self, get: impl FnOnce(&Watch) -> T) -> T {
        watches().iter().find(|watch| watch.id == self.id).map(get).unwrap_or_default()
    }
}

impl Drop for Faults {
    fn drop(&mut self) {
        watches().retain(|watch| watch.id != self.id);
    }
}

fn watches() -> MutexGuard<'static, Vec<Watch>> {
    WATCHES.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn is_watched(folder: &Path) -> bool {
    let watches = watches();
    if watches.is_empty() {
        return false;
    }
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    watches.iter().any(|watch| folder.starts_with(&watch.root))
}

pub(super) fn check_fault(operation: Operation, path: &Path) -> io::Result<()> {
    let mut watches = watches();
    if watches.is_empty() {
        return Ok(());
    }
    let path = resolved(path);
    watches.iter_mut().filter(|watch| path.starts_with(&watch.root)).try_for_each(|watch| {
        let index = watch.log.len();
        watch.log.push((operation, path.clone()));
        let Some((n, kind)) = watch.at.filter(|(n, _)| *n <= index) else { return Ok(()) };
        let needs_space =
            matches!(operation, Operation::Create | Operation::Write | Operation::CreateFolder);
        let failed = match kind {
            Kind::Stop => io::Error::other("stopped"),
            Kind::Full if needs_space => io::Error::from_raw_os_error(FULL),
            Kind::Fail if index == n => io::Error::from_raw_os_error(BROKEN),
            Kind::Full | Kind::Fail => return Ok(()),
        };
        watch.hit = true;
        let writes_half = operation == Operation::Write && (index == n || kind == Kind::Full);
        watch.half = writes_half.then(|| path.clone());
        Err(failed)
    })
}

/// Number of bytes of a failed write that reach the file, of `length` bytes.
pub fn partial_write_len(path: &Path, length: usize) -> usize {
    let path = resolved(path);
    let is_partial =
        watches().iter_mut().any(|watch| watch.half.take_if(|half| *half == path).is_some());
    if is_partial { length / 2 } else { 0 }
}

/// The absolute path with the links of its folders resolved; nothing need exist there.
fn resolved(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let Some(name) = path.file_name() else { return path };
    let folder = folder_of(&path);
    folder.canonicalize().unwrap_or_else(|_| resolved(folder)).join(name)
}
