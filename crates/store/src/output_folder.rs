//! Transactional replacement of files in an output folder that may also hold foreign files.
//!
//! A manifest in the folder lists the files that this program wrote, with the BLAKE3 hashes of
//! their content. A file that is not listed, or has another content, is foreign: it is neither
//! replaced nor deleted.
//!
//! A set of new files replaces old ones as a transaction. The files are first written into a folder
//! of their own (`STAGED`) and synchronised to the disk; then their hashes are added to the
//! manifest; then the folder is renamed to `COMMITTED`, which commits the transaction. Afterwards
//! the old files are moved out and the new ones into place. The next [`OutputFolder::open`]
//! completes a move that was interrupted. During the move the file that readers look for first is
//! missing, so that no reader sees a mix of old and new files.
//!
//! A folder may come from somebody else, with a manifest, staged files and links of their choice.
//! All names are therefore looked up from the folder's own handle, no part of a name may be a
//! symbolic link, and commands that only read a folder never open it here.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::disk::{self, FileId, Folder};
use crate::manifest::{MANIFEST, Manifest, is_inside};
use crate::{AtomicFile, Error};

/// Folder of staged files; also the suffix of the name of a single file before it is compared.
pub(crate) const STAGED: &str = ".tiepoint-new";
const COMMITTED: &str = ".tiepoint-commit";
const REPLACED: &str = ".tiepoint-old";
/// Size of read buffers.
const BUFFER_BYTES: usize = 1 << 16;

/// An output folder, locked by this process.
#[derive(Debug)]
pub struct OutputFolder {
    pub(crate) root: Folder,
    manifest: Manifest,
    /// Files that the command reads.
    inputs: BTreeSet<FileId>,
    /// Names of files that are never foreign, whatever their content.
    always_replaceable: &'static [&'static str],
    /// Names of files that may be replaced, whoever made them.
    replaceable: BTreeSet<String>,
    /// Whether other processes have the folder open, too, and none of them changes listed files.
    is_shared: bool,
    /// Lock on the folder, on systems that can lock folders.
    _lock: Option<File>,
}

/// The owner of a file name.
enum Owner {
    /// The file does not exist.
    Nobody,
    /// This program.
    Us,
    /// The command reads the file.
    Input,
    /// The file is foreign.
    Others,
}

impl OutputFolder {
    /// Opens or creates a folder, and completes the transaction of an interrupted run.
    ///
    /// # Errors
    ///
    /// The folder cannot be written, another run uses it, its manifest is invalid, or a name that
    /// an interrupted transaction moves leads over a link.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let this = Self::locked(root, false)?;
        if this.root.has(COMMITTED) {
            this.put_in_place()?;
        }
        this.remove(STAGED)?;
        this.remove(REPLACED)?;
        Ok(this)
    }

    /// Opens or creates a folder for one of several processes at a time. They write files of their
    /// own beside the listed ones, and publish nothing.
    ///
    /// # Errors
    ///
    /// Those of [`OutputFolder::open`], and an interrupted run has to complete a transaction first.
    pub fn open_shared(root: &Path) -> Result<Self, Error> {
        let this = Self::locked(root, true)?;
        match Self::is_unfinished(root) {
            true => Err(Error::Unfinished { path: root.to_owned() }),
            false => Ok(this),
        }
    }

    fn locked(root: &Path, is_shared: bool) -> Result<Self, Error> {
        disk::create_folders(root).map_err(Error::output(root))?;
        let lock = lock(root, is_shared)?;
        let root = Folder::open(root).map_err(Error::output(root))?;
        for name in [MANIFEST, STAGED, COMMITTED, REPLACED] {
            refuse_link(&root, name)?;
        }
        let manifest = read_manifest(root.path())?.unwrap_or_default();
        Ok(Self {
            root,
            manifest,
            inputs: BTreeSet::new(),
            always_replaceable: &[],
            replaceable: BTreeSet::new(),
            is_shared,
            _lock: lock,
        })
    }

    /// The folder itself, for files of this program's own that take no part in transactions.
    pub fn folder(&self) -> &Folder {
        &self.root
    }

    /// Whether a folder has a manifest of this program.
    pub fn is_ours(root: &Path) -> bool {
        root.join(MANIFEST).is_file()
    }

    /// Whether an interrupted run left a committed transaction incomplete. Whatever has the name of
    /// its folder counts: what cannot be such a folder is refused by [`OutputFolder::open`].
    pub fn is_unfinished(root: &Path) -> bool {
        fs::symlink_metadata(root.join(COMMITTED)).is_ok()
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        self.root.path()
    }

    /// Adds the existing files of these names to the manifest with their current content.
    ///
    /// # Errors
    ///
    /// A file cannot be read, or the manifest cannot be written.
    pub fn claim(&mut self, names: &[String]) -> Result<(), Error> {
        for name in names {
            self.refuse_link(name)?;
            if let Some(hash) = hash_of(&self.root, name)? {
                self.manifest.files.entry(name.clone()).or_default().insert(hash);
            }
        }
        self.manifest.write(self.root.path())
    }

    /// Sets the names of files that are never foreign, whatever their content.
    pub fn always_replaceable(&mut self, names: &'static [&'static str]) {
        self.always_replaceable = names;
    }

    /// Permits that files of these names are replaced, whoever made them. They become ours when a
    /// transaction that replaces them is committed: a run that ends before claims nothing.
    pub fn may_replace(&mut self, names: &[String]) {
        self.replaceable.extend(names.iter().cloned());
    }

    /// Adds files that the command reads, and which it must therefore not write.
    pub fn protect<'a>(&mut self, inputs: impl IntoIterator<Item = &'a Path>) {
        self.inputs.extend(inputs.into_iter().filter_map(FileId::of));
    }

    /// Names of the files in the manifest, but for those that a transaction removed.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let removed: BTreeSet<&String> = self.manifest.removed.iter().collect();
        // A transaction that was interrupted before its commit removed nothing.
        let is_gone = move |name: &&String| removed.contains(name) && !self.exists(name);
        self.manifest.files.keys().filter(move |name| !is_gone(name)).map(String::as_str)
    }

    /// Whether the manifest has a name.
    pub fn contains(&self, name: &str) -> bool {
        self.manifest.files.contains_key(name)
    }

    /// Whether there is a file, or a link, of this name.
    pub fn exists(&self, name: &str) -> bool {
        self.root.has(name)
    }

    /// Checks that no part of a name is a symbolic link.
    fn refuse_link(&self, name: impl AsRef<Path>) -> Result<(), Error> {
        refuse_link(&self.root, name)
    }

    /// Checks before any work is done that these names may be written.
    ///
    /// # Errors
    ///
    /// A file of these names is foreign or an input.
    pub fn ensure_writable<'a>(
        &self,
        names: impl IntoIterator<Item = &'a str>,
    ) -> Result<(), Error> {
        names.into_iter().try_for_each(|name| self.refuse(name, &self.owner(name)?.0))
    }

    /// [`OutputFolder::ensure_writable`] for a staged file; a foreign one may have its content.
    ///
    /// # Errors
    ///
    /// The existing file is foreign or an input, and has another content.
    pub fn ensure_writable_or_equal(&self, name: &str) -> Result<(), Error> {
        let (owner, hash) = self.owner(name)?;
        let staged = hash_of(&self.root, Path::new(STAGED).join(name))?;
        if staged.is_some() && staged == self.hash_there(name, &owner, hash)? {
            return Ok(());
        }
        self.refuse(name, &owner)
    }

    fn refuse(&self, name: &str, owner: &Owner) -> Result<(), Error> {
        let path = || self.root.join(name);
        match owner {
            Owner::Nobody | Owner::Us => Ok(()),
            Owner::Input => Err(Error::IsInput { path: path() }),
            Owner::Others => Err(Error::ForeignFile { path: path() }),
        }
    }

    /// The owner of a file, and the hash of its content if it was computed.
    fn owner(&self, name: &str) -> Result<(Owner, Option<String>), Error> {
        let path = self.root.join(name);
        if let Some(folder) = Path::new(name).parent() {
            self.refuse_link(folder)?;
        }
        let found = match self.root.metadata(name) {
            Ok(None) => return Ok((Owner::Nobody, None)),
            // A parent of the path is a file, so that the path cannot be written.
            Err(cause) => return Err(Error::Output { path, cause }),
            Ok(Some(found)) => found,
        };
        if FileId::of(&path).is_some_and(|id| self.inputs.contains(&id)) {
            return Ok((Owner::Input, None));
        }
        if !found.is_file() {
            return Ok((Owner::Others, None));
        }
        if self.always_replaceable.contains(&name) || self.replaceable.contains(name) {
            return Ok((Owner::Us, None));
        }
        let Some(known) = self.manifest.files.get(name) else { return Ok((Owner::Others, None)) };
        let hash = hash_of(&self.root, name)?;
        let is_known = hash.as_ref().is_some_and(|hash| known.contains(hash));
        Ok((if is_known { Owner::Us } else { Owner::Others }, hash))
    }

    /// The hash of an existing file, computed unless [`OutputFolder::owner`] did so.
    fn hash_there(
        &self,
        name: &str,
        owner: &Owner,
        hash: Option<String>,
    ) -> Result<Option<String>, Error> {
        match (owner, hash) {
            (Owner::Nobody, _) => Ok(None),
            (_, None) => hash_of(&self.root, name),
            (_, hash) => Ok(hash),
        }
    }

    /// Whether a file is unchanged since this program wrote it.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn is_unmodified(&self, name: &str) -> Result<bool, Error> {
        let link = self.root.find_link(name).map_err(Error::output(&self.root.join(name)))?;
        let Some(known) = self.manifest.files.get(name).filter(|_| link.is_none()) else {
            return Ok(false);
        };
        Ok(hash_of(&self.root, name)?.is_some_and(|hash| known.contains(&hash)))
    }

    /// The path at which to write the staged file of a name; creates its folder.
    ///
    /// # Errors
    ///
    /// The name leads out of the folder, or the folder cannot be created.
    pub fn stage(&self, name: &str) -> Result<PathBuf, Error> {
        if !is_inside(name) {
            let path = self.root.path().to_owned();
            return Err(Error::NotInside { path, name: name.to_owned() });
        }
        let staged = Path::new(STAGED).join(name);
        self.root
            .create_folders(disk::folder_of(&staged))
            .map_err(Error::output(&self.root.join(name)))?;
        Ok(self.root.join(staged))
    }

    /// Writes the staged file of a name.
    ///
    /// # Errors
    ///
    /// Those of [`OutputFolder::stage`], and the file cannot be written.
    pub fn stage_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        disk::write_new(&self.stage(name)?, bytes).map_err(Error::output(&self.root.join(name)))
    }

    /// Moves the staged files into place and removes others, as a transaction. `order`: names of
    /// the staged files; the last one is the one that readers look for first. Existing files with
    /// the same content are kept; returns their number.
    ///
    /// # Errors
    ///
    /// A foreign file would be replaced or removed; then nothing changes. A file operation fails;
    /// if the transaction was committed before, the next [`OutputFolder::open`] completes it, and
    /// until then nothing else can be published.
    pub fn publish(&mut self, order: &[String], removed: &[String]) -> Result<usize, Error> {
        if Self::is_unfinished(self.root.path()) {
            return Err(Error::Unfinished { path: self.root.path().to_owned() });
        }
        let staged = Path::new(STAGED);
        let hashes: Vec<Option<String>> = {
            let all: Result<Vec<_>, Error> =
                order.par_iter().map(|name| hash_of(&self.root, staged.join(name))).collect();
            all?
        };
        let owners: Result<Vec<(Owner, Option<String>)>, Error> =
            order.par_iter().map(|name| self.owner(name)).collect();
        let (mut placed, mut kept) = (Vec::new(), 0);
        let mut manifest = self.manifest.clone();
        for ((name, hash), (owner, there)) in order.iter().zip(hashes).zip(owners?) {
            let hash = hash.ok_or_else(|| Error::Output {
                path: self.root.join(name),
                cause: io::Error::other("it was not written"),
            })?;
            let there = self.hash_there(name, &owner, there)?;
            if there.as_ref() == Some(&hash) {
                self.root
                    .remove_file(staged.join(name))
                    .map_err(Error::output(&self.root.join(name)))?;
                kept += 1;
                continue;
            }
            self.refuse(name, &owner)?;
            manifest.files.insert(name.clone(), there.into_iter().chain([hash]).collect());
            placed.push(name.clone());
        }
        self.ensure_writable(removed.iter().map(String::as_str))?;
        let is_there = |name: &&String| self.exists(name);
        // Until a transaction is complete, the manifest has also the files that it removes.
        for name in self.manifest.removed.iter().chain(removed).filter(|name| !is_there(name)) {
            if !placed.contains(name) {
                manifest.files.remove(name);
            }
        }
        let removed: Vec<String> = removed.iter().filter(is_there).cloned().collect();
        for name in removed.iter().filter(|name| self.replaceable.contains(*name)) {
            let hash = hash_of(&self.root, name)?;
            manifest.files.entry(name.clone()).or_default().extend(hash);
        }
        if placed.is_empty() && removed.is_empty() {
            self.remove(STAGED)?;
            return Ok(kept);
        }
        let at_root = || Error::output(self.root.path());
        self.root.create_folders(staged).map_err(at_root())?;
        self.root.sync_folders(staged).map_err(at_root())?;
        (manifest.order, manifest.removed) = (placed, removed);
        self.refuse_link(MANIFEST)?;
        manifest.write(self.root.path())?;
        self.root.rename(staged, COMMITTED).map_err(at_root())?;
        self.root.sync_folder("").map_err(at_root())?;
        self.manifest = manifest;
        self.put_in_place()?;
        Ok(kept)
    }

    /// Moves the files of a committed transaction into place, except those that were moved before.
    fn put_in_place(&self) -> Result<(), Error> {
        self.move_committed().map_err(|error| match error {
            // What failed is in one of the folders that only this program knows.
            Error::Output { cause, .. } => {
                Error::NotInPlace { path: self.root.path().to_owned(), cause }
            }
            other => other,
        })
    }

    fn move_committed(&self) -> Result<(), Error> {
        let (committed, replaced) = (Path::new(COMMITTED), Path::new(REPLACED));
        let Manifest { order, removed, .. } = &self.manifest;
        for name in order {
            self.refuse_link(name)?;
            self.refuse_link(committed.join(name))?;
        }
        removed.iter().try_for_each(|name| self.refuse_link(name))?;
        let all: Vec<&String> = removed.iter().chain(order.iter().rev()).collect();
        let is_old = |(number, name): &(usize, &&String)| {
            (*number < removed.len() || self.root.has(committed.join(name))) && self.exists(name)
        };
        let old: Vec<(usize, &&String)> = all.iter().enumerate().filter(is_old).collect();
        // A foreign file may have been put there since the run was interrupted.
        for (_, name) in &old {
            if !self.is_unmodified(name)? {
                return Err(Error::ForeignFile { path: self.root.join(name) });
            }
        }
        self.root.create_folders(replaced).map_err(Error::output(self.root.path()))?;
        for (number, name) in old {
            let to = replaced.join(number.to_string());
            self.move_file(Path::new(name), &to).map_err(Error::output(&self.root.join(name)))?;
        }
        let mut folders = BTreeSet::new();
        for name in order.iter().map(Path::new) {
            let from = committed.join(name);
            if self.root.has(&from) {
                let path = self.root.join(name);
                let failed = || Error::output(&path);
                self.root.create_folders(name.parent().unwrap_or(name)).map_err(failed())?;
                self.move_file(&from, name).map_err(failed())?;
                folders.extend(name.ancestors().skip(1));
            }
        }
        // Inner folders first.
        for folder in folders.iter().rev() {
            self.root.sync_folder(folder).map_err(Error::output(&self.root.join(folder)))?;
        }
        for name in removed.iter().map(Path::new) {
            if let Some(folder) = name.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                // A folder with foreign files stays.
                let _ = self.root.remove_empty_folder(folder);
            }
        }
        self.remove(COMMITTED)?;
        self.remove(REPLACED)
    }

    /// Renames a file; copies it if the target is on another disk, which may be mounted there.
    fn move_file(&self, from: &Path, to: &Path) -> io::Result<()> {
        match self.root.rename(from, to) {
            Err(cause) if cause.kind() == io::ErrorKind::CrossesDevices => {
                let mut source = self.root.open_file(from)?;
                AtomicFile::write_with(self.root.join(to), |file| {
                    io::copy(&mut source, file).map(drop)
                })
                .map_err(io::Error::other)?;
                self.root.remove_file(from)
            }
            renamed => renamed,
        }
    }

    fn remove(&self, own: &str) -> Result<(), Error> {
        self.root.remove_own_folder(own).map_err(Error::output(&self.root.join(own)))
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        if !self.is_shared {
            // Staged files that were not published. Errors cannot be returned here.
            let _ = self.root.remove_own_folder(STAGED);
        }
    }
}

/// Checks that no part of a name in a folder is a symbolic link.
fn refuse_link(root: &Folder, name: impl AsRef<Path>) -> Result<(), Error> {
    match root.find_link(&name).map_err(Error::output(&root.join(&name)))? {
        Some(path) => Err(Error::LinkInFolder { path }),
        None => Ok(()),
    }
}

fn read_manifest(root: &Path) -> Result<Option<Manifest>, Error> {
    Manifest::read(root).map_err(|error| match error {
        Error::Io { path, cause } => Error::Unreadable { path, cause },
        _ => Error::ForeignFile { path: root.join(MANIFEST) },
    })
}

/// BLAKE3 hash of a regular file in a folder; `None` if there is none.
fn hash_of(root: &Folder, name: impl AsRef<Path>) -> Result<Option<String>, Error> {
    let path = root.join(&name);
    let unreadable = |cause| Error::Unreadable { path: path.clone(), cause };
    match root.metadata(&name) {
        Err(cause) => return Err(unreadable(cause)),
        Ok(Some(found)) if found.is_file() => {}
        Ok(_) => return Ok(None),
    }
    #[cfg(test)]
    tests::HASHED.lock().expect("no test panics with it").push(path.clone());
    let mut file = root.open_file(&name).map_err(unreadable)?;
    let (mut hash, mut buffer) = (blake3::Hasher::new(), vec![0; BUFFER_BYTES]);
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(Some(hash.finalize().to_hex().to_string())),
            Ok(count) => hash.update(&buffer[..count]),
            Err(cause) if cause.kind() == io::ErrorKind::Interrupted => continue,
            Err(cause) => return Err(unreadable(cause)),
        };
    }
}

#[cfg(unix)]
fn lock(root: &Path, is_shared: bool) -> Result<Option<File>, Error> {
    let folder =
        File::open(root).map_err(|cause| Error::Unreadable { path: root.to_owned(), cause })?;
    match if is_shared { folder.try_lock_shared() } else { folder.try_lock() } {
        Err(TryLockError::WouldBlock) => Err(Error::InUse { path: root.to_owned() }),
        // Some network file systems do not support locks; then there is none.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(folder)),
    }
}

#[cfg(not(unix))]
fn lock(_: &Path, _: bool) -> Result<Option<File>, Error> {
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Paths whose hash was computed, in any test.
    pub(super) static HASHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

    fn put(
        folder: &mut OutputFolder,
        files: &[(&str, &str)],
        removed: &[&str],
    ) -> Result<usize, Error> {
        for (name, text) in files {
            folder.stage_bytes(name, text.as_bytes())?;
        }
        let order: Vec<String> = files.iter().map(|(name, _)| (*name).to_owned()).collect();
        folder.publish(&order, &removed.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn removed_file_keeps_its_name_until_it_is_gone() {
        let dir = tempfile::tempdir().unwrap();
        let mut folder = OutputFolder::open(dir.path()).unwrap();
        folder.stage_bytes("a", b"made").unwrap();
        folder.publish(&["a".to_owned()], &[]).unwrap();
        // As after an interruption before the commit.
        folder.manifest.removed = vec!["a".to_owned()];
        assert_eq!(folder.names().collect::<Vec<_>>(), ["a"]);
        folder.publish(&[], &["a".to_owned()]).unwrap();
        assert!(!folder.exists("a") && folder.names().next().is_none());
        folder.stage_bytes("b", b"made").unwrap();
        folder.publish(&["b".to_owned()], &[]).unwrap();
        assert!(!folder.contains("a") && folder.contains("b"));
    }

    #[test]
    fn own_files_are_replaced_and_foreign_ones_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let read = |name: &str| fs::read_to_string(root.join(name)).unwrap();
        let mut folder = OutputFolder::open(root).unwrap();
        assert_eq!(put(&mut folder, &[("a/b", "1"), ("c", "1")], &[]).unwrap(), 0);
        assert!(matches!(OutputFolder::open(root), Err(Error::InUse { .. })) || cfg!(not(unix)));
        drop(folder);
        let mut folder = OutputFolder::open(root).unwrap();
        assert_eq!(
            put(&mut folder, &[("a/b", "2"), ("c", "1")], &[]).unwrap(),
            1,
            "c is there already"
        );
        assert_eq!((read("a/b").as_str(), read("c").as_str()), ("2", "1"));
        fs::write(root.join("mine"), "mine").unwrap();
        fs::write(root.join("c"), "changed").unwrap();
        for name in ["mine", "c"] {
            let error = put(&mut folder, &[("a/b", "3"), (name, "3")], &[]).unwrap_err();
            assert!(matches!(error, Error::ForeignFile { .. }), "{error}");
            drop(folder);
            folder = OutputFolder::open(root).unwrap();
        }
        assert!(put(&mut folder, &[("a/b", "3")], &["mine"]).is_err());
        drop(folder);
        folder = OutputFolder::open(root).unwrap();
        assert_eq!(
            (read("a/b"), read("mine"), read("c")),
            ("2".into(), "mine".into(), "changed".into())
        );
        // A foreign file with the same content is accepted, and stays foreign.
        assert_eq!(put(&mut folder, &[("mine", "mine")], &["a/b"]).unwrap(), 1);
        assert!(!root.join("a").exists());
        assert!(put(&mut folder, &[("mine", "other")], &[]).is_err());
    }

    #[test]
    fn replaced_file_is_hashed_once_before_the_commit() {
        let dir = tempfile::tempdir().unwrap();
        let mut folder = OutputFolder::open(dir.path()).unwrap();
        folder.always_replaceable(&["ours"]);
        let names = ["a", "ours", "theirs"];
        put(&mut folder, &[("a", "1"), ("ours", "1")], &[]).unwrap();
        fs::write(dir.path().join("theirs"), "2").unwrap();
        let paths = names.map(|name| dir.path().join(name));
        let count = || HASHED.lock().unwrap().iter().filter(|path| paths.contains(path)).count();
        let before = count();
        assert_eq!(put(&mut folder, &names.map(|name| (name, "2")), &[]).unwrap(), 1);
        // Each file once, and the two replaced ones again after the commit, because they may have
        // changed.
        assert_eq!(count() - before, 5);
    }

    #[test]
    fn committed_files_wait_until_their_place_is_free() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("out");
        let mut folder = OutputFolder::open(&root).unwrap();
        put(&mut folder, &[("sub/a", "1")], &[]).unwrap();
        drop(folder);
        // The state of a run that was killed after the commit; then a file took the folder's place.
        fs::create_dir(root.join(COMMITTED)).unwrap();
        fs::rename(root.join("sub"), root.join(COMMITTED).join("sub")).unwrap();
        fs::write(root.join("sub"), "mine").unwrap();
        let message = OutputFolder::open(&root).unwrap_err().to_string();
        assert!(message.contains("the results are complete"), "{message}");
        assert!(!message.contains(COMMITTED), "{message}");
        fs::remove_file(root.join("sub")).unwrap();
        drop(OutputFolder::open(&root).unwrap());
        assert_eq!(fs::read(root.join("sub/a")).unwrap(), b"1");
    }

    #[test]
    fn interrupted_transaction_is_completed_and_spares_new_foreign_files() {
        let dir = tempfile::tempdir().unwrap();
        let (root, outside) = (dir.path().join("out"), dir.path().join("keep"));
        fs::write(&outside, "precious").unwrap();
        let mut folder = OutputFolder::open(&root).unwrap();
        put(&mut folder, &[("a", "1"), ("b", "1")], &[]).unwrap();
        put(&mut folder, &[("a", "2")], &["b"]).unwrap();
        drop(folder);
        // The state of a run that was killed after the commit, with `a` as a file at its place.
        let undo = |a: &str| {
            fs::create_dir_all(root.join(COMMITTED)).unwrap();
            fs::write(root.join(COMMITTED).join("a"), "2").unwrap();
            fs::write(root.join("a"), a).unwrap();
        };
        undo("mine");
        assert!(matches!(OutputFolder::open(&root), Err(Error::ForeignFile { .. })));
        assert_eq!(fs::read(root.join("a")).unwrap(), b"mine");
        undo("2");
        drop(OutputFolder::open(&root).unwrap());
        assert_eq!(fs::read(root.join("a")).unwrap(), b"2");
        assert!(!root.join(COMMITTED).exists());
        // A foreign manifest cannot name files outside the folder.
        for name in ["../keep", outside.to_str().unwrap()] {
            let mut manifest = Manifest::default();
            manifest.removed.push(name.to_owned());
            manifest.write(&root).unwrap();
            assert!(matches!(OutputFolder::open(&root), Err(Error::ForeignFile { .. })), "{name}");
        }
        assert_eq!(fs::read(outside).unwrap(), b"precious");
    }

    #[test]
    fn replaceable_file_becomes_ours_only_when_it_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let names = ["a".to_owned(), "b".to_owned()];
        for name in &names {
            fs::write(root.join(name), "mine").unwrap();
        }
        let mut folder = OutputFolder::open(root).unwrap();
        folder.may_replace(&names);
        folder.ensure_writable(["a", "b"]).unwrap();
        folder.stage_bytes("a", b"new").unwrap();
        // The run ends before it publishes.
        drop(folder);
        let mut folder = OutputFolder::open(root).unwrap();
        assert!(put(&mut folder, &[("a", "other")], &[]).is_err(), "the file is still foreign");
        drop(folder);
        let mut folder = OutputFolder::open(root).unwrap();
        folder.may_replace(&names);
        put(&mut folder, &[("a", "new")], &["b"]).unwrap();
        assert!(!root.join("b").exists());
        drop(folder);
        let mut folder = OutputFolder::open(root).unwrap();
        put(&mut folder, &[("a", "newer")], &[]).unwrap();
        assert_eq!(fs::read(root.join("a")).unwrap(), b"newer");
    }

    #[test]
    fn incomplete_transaction_blocks_the_next_one() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let mut folder = OutputFolder::open(root).unwrap();
        put(&mut folder, &[("a", "1"), ("b", "1")], &[]).unwrap();
        // A file at REPLACED prevents that the old files are moved out.
        fs::write(root.join(REPLACED), "").unwrap();
        assert!(put(&mut folder, &[("a", "2"), ("b", "2")], &[]).is_err());
        fs::remove_file(root.join(REPLACED)).unwrap();
        let error = put(&mut folder, &[("c", "3")], &[]).unwrap_err();
        assert!(matches!(error, Error::Unfinished { .. }), "{error}");
        drop(folder);
        drop(OutputFolder::open(root).unwrap());
        for name in ["a", "b"] {
            assert_eq!(fs::read(root.join(name)).unwrap(), b"2", "{name}");
        }
        assert!(!root.join("c").exists());
    }

    #[test]
    fn inputs_and_paths_outside_the_folder_are_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let photos = dir.path().join("photos");
        fs::create_dir(&photos).unwrap();
        fs::write(photos.join("1"), "photo").unwrap();
        let root = dir.path().join("out");
        let mut folder = OutputFolder::open(&root).unwrap();
        put(&mut folder, &[("2", "ours")], &[]).unwrap();
        fs::remove_file(root.join("2")).unwrap();
        fs::hard_link(photos.join("1"), root.join("2")).unwrap();
        folder.protect([photos.join("1").as_path()]);
        let error = put(&mut folder, &[("2", "ours")], &[]).unwrap_err();
        assert!(matches!(error, Error::IsInput { .. }), "{error}");
        assert_eq!(fs::read(photos.join("1")).unwrap(), b"photo");
        for name in ["../x", "/x", "", "a/../../x"] {
            assert!(matches!(folder.stage(name), Err(Error::NotInside { .. })), "{name}");
        }
    }
}
