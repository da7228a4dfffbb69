//! Folders into which results go, beside files of others.
//!
//! A manifest in the folder lists the files that this program made, with the BLAKE3 hash of their
//! content. A file that is not in it, or has another content, is somebody's: it is refused by name
//! and neither replaced nor deleted.
//!
//! New files replace old ones together. They are first written into a folder of their own
//! (`STAGED`) and brought to the disk; then the manifest learns their hashes; then that folder
//! takes another name (`COMMITTED`), which is the moment that decides. After it the files move to
//! their places, the old ones being moved out before. What a killed run left undone of that, the
//! next one does ([`OutputFolder::open`]). While it is done, the file that readers look for first
//! is missing: nobody reads a mix of old and new.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tiepoint_io::colmap::{self, Format, MODEL_FILES};
use tiepoint_io::disk::{self, FileId};
use tiepoint_io::{AtomicFile, MANIFEST, Manifest, is_inside};
use tiepoint_sfm::scene::Reconstruction;

use crate::Error;

/// Where new files are written first; new single files have names that end so.
pub(crate) const STAGED: &str = ".tiepoint-new";
const COMMITTED: &str = ".tiepoint-commit";
const REPLACED: &str = ".tiepoint-old";
/// Bytes read at once.
const BUFFER_BYTES: usize = 1 << 16;

/// A folder for results, held by this process.
#[derive(Debug)]
pub(crate) struct OutputFolder {
    root: PathBuf,
    manifest: Manifest,
    /// What the command reads.
    inputs: BTreeSet<FileId>,
    /// Files whose content does not count: they are this program's in a folder of its own.
    always_ours: &'static [&'static str],
    /// Locked for as long as it lives, where folders can be.
    _lock: Option<File>,
}

/// Whose a file is.
enum Owner {
    Nobody,
    Us,
    /// It is read by this command.
    Input,
    Others,
}

impl OutputFolder {
    /// Opens a folder, or makes one where there is none, and ends what a killed run left undone.
    ///
    /// # Errors
    ///
    /// Where it cannot be written, is in use by another run, or its manifest is not one.
    pub(crate) fn open(root: &Path) -> Result<Self, Error> {
        disk::create_folders(root).map_err(output(root))?;
        let lock = lock(root)?;
        let manifest = read_manifest(root)?.unwrap_or_default();
        let root = root.to_owned();
        let this = Self { root, manifest, inputs: BTreeSet::new(), always_ours: &[], _lock: lock };
        if this.root.join(COMMITTED).is_dir() {
            this.put_in_place()?;
        }
        this.remove(STAGED)?;
        this.remove(REPLACED)?;
        Ok(this)
    }

    /// Whether a folder has files of this program.
    pub(crate) fn is_ours(root: &Path) -> bool {
        root.join(MANIFEST).is_file()
    }

    /// Whether a killed run left files on their way to their places.
    pub(crate) fn is_unfinished(root: &Path) -> bool {
        root.join(COMMITTED).is_dir()
    }

    /// Takes the folder, and the files of these names as they are.
    pub(crate) fn claim(&mut self, names: &[String]) -> Result<(), Error> {
        for name in names {
            if let Some(hash) = hash_of(&self.root.join(name))? {
                self.manifest.files.entry(name.clone()).or_default().insert(hash);
            }
        }
        Ok(self.manifest.write(&self.root)?)
    }

    /// Names of files that are this program's whatever they hold.
    pub(crate) fn always_ours(&mut self, names: &'static [&'static str]) {
        self.always_ours = names;
    }

    /// Names what the command reads: it is never written.
    pub(crate) fn protect<'a>(&mut self, inputs: impl IntoIterator<Item = &'a Path>) {
        self.inputs.extend(inputs.into_iter().filter_map(FileId::of));
    }

    /// The files of this program, by their names.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.manifest.files.keys().map(String::as_str)
    }

    /// Refuses, before any work is done, to replace what is somebody's.
    pub(crate) fn refuse_foreign<'a>(
        &self,
        names: impl IntoIterator<Item = &'a str>,
    ) -> Result<(), Error> {
        names.into_iter().try_for_each(|name| self.refuse(name, &self.owner(name)?.0))
    }

    /// The same for a staged file: it may have the content that is there.
    pub(crate) fn refuse_unless_same(&self, name: &str) -> Result<(), Error> {
        let (owner, hash) = self.owner(name)?;
        let staged = hash_of(&self.root.join(STAGED).join(name))?;
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

    /// Whose a file is, and the hash of its content where that was asked.
    fn owner(&self, name: &str) -> Result<(Owner, Option<String>), Error> {
        let path = self.root.join(name);
        let found = match fs::symlink_metadata(&path) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {
                return Ok((Owner::Nobody, None));
            }
            // A part of the path is a file: it cannot be written either.
            Err(cause) => return Err(Error::Output { path, cause }),
            Ok(found) => found,
        };
        if FileId::of(&path).is_some_and(|id| self.inputs.contains(&id)) {
            return Ok((Owner::Input, None));
        }
        if !found.is_file() {
            return Ok((Owner::Others, None));
        }
        if self.always_ours.contains(&name) {
            return Ok((Owner::Us, None));
        }
        let Some(known) = self.manifest.files.get(name) else { return Ok((Owner::Others, None)) };
        let hash = hash_of(&path)?;
        let is_known = hash.as_ref().is_some_and(|hash| known.contains(hash));
        Ok((if is_known { Owner::Us } else { Owner::Others }, hash))
    }

    /// The hash of a file that is there, with what [`OutputFolder::owner`] found: no file is read
    /// twice.
    fn hash_there(
        &self,
        name: &str,
        owner: &Owner,
        hash: Option<String>,
    ) -> Result<Option<String>, Error> {
        match (owner, hash) {
            (Owner::Nobody, _) => Ok(None),
            (_, None) => hash_of(&self.root.join(name)),
            (_, hash) => Ok(hash),
        }
    }

    /// Whether a file is as this program left it: it has a content that this program gave it.
    pub(crate) fn is_as_left(&self, name: &str) -> Result<bool, Error> {
        let path = self.root.join(name);
        let is_link = fs::symlink_metadata(&path).is_ok_and(|found| found.is_symlink());
        let Some(known) = self.manifest.files.get(name).filter(|_| !is_link) else {
            return Ok(false);
        };
        Ok(hash_of(&path)?.is_some_and(|hash| known.contains(&hash)))
    }

    /// The path at which to write a file that shall have this name; its folder is made.
    pub(crate) fn stage(&self, name: &str) -> Result<PathBuf, Error> {
        if !is_inside(name) {
            return Err(Error::NotInside { path: self.root.clone(), name: name.to_owned() });
        }
        let path = self.root.join(STAGED).join(name);
        disk::create_folders(disk::folder_of(&path)).map_err(output(&self.root.join(name)))?;
        Ok(path)
    }

    /// Writes a file that shall have this name.
    pub(crate) fn stage_bytes(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        disk::write_new(&self.stage(name)?, bytes).map_err(output(&self.root.join(name)))
    }

    /// Writes a COLMAP model into a folder of this name (none: the folder itself). Gives the names
    /// of its files, in the order for [`OutputFolder::publish`].
    pub(crate) fn stage_model(
        &self,
        folder: Option<&str>,
        model: &Reconstruction,
        format: Format,
    ) -> Result<Vec<String>, Error> {
        let own = folder.unwrap_or("model");
        let path = self.stage(own)?;
        colmap::write_model(&path, model, format)
            .map_err(|error| self.renamed(error, own, folder))?;
        let mut names = Vec::new();
        for name in MODEL_FILES {
            let file = format!("{name}.{}", format.suffix());
            match folder {
                Some(folder) => names.push(format!("{folder}/{file}")),
                None => {
                    let to = self.root.join(STAGED).join(&file);
                    disk::rename(&path.join(&file), &to).map_err(output(&self.root.join(&file)))?;
                    names.push(file);
                }
            }
        }
        if folder.is_none() {
            disk::remove_empty_folder(&path).map_err(output(&self.root))?;
        }
        Ok(names)
    }

    /// An error that names the place that was asked for, and not the one in between.
    fn renamed(&self, error: tiepoint_io::Error, staged: &str, folder: Option<&str>) -> Error {
        let asked = folder.map_or_else(|| self.root.clone(), |folder| self.root.join(folder));
        let staged = self.root.join(STAGED).join(staged);
        let rename = |path: PathBuf| match path.strip_prefix(&staged) {
            Ok(rest) if rest.as_os_str().is_empty() => asked.clone(),
            Ok(rest) => asked.join(rest),
            Err(_) => path,
        };
        Error::File(match error {
            tiepoint_io::Error::Io { path, cause } => {
                tiepoint_io::Error::Io { path: rename(path), cause }
            }
            tiepoint_io::Error::Content { path, what } => {
                tiepoint_io::Error::Content { path: rename(path), what }
            }
            tiepoint_io::Error::Model { path, cause } => {
                tiepoint_io::Error::Model { path: rename(path), cause }
            }
            other => other,
        })
    }

    /// Puts the staged files in their places, together, and removes others; in this order, the one
    /// that readers look for first being the last. Those that are there already with the same
    /// content stay. Gives how many those are.
    ///
    /// # Errors
    ///
    /// Where a file of somebody would be replaced or removed; then nothing is. Where the system
    /// refuses: if that comes after the moment that decides, the next [`OutputFolder::open`] goes
    /// on, and until then nothing else is published.
    pub(crate) fn publish(&mut self, order: &[String], removed: &[String]) -> Result<usize, Error> {
        if Self::is_unfinished(&self.root) {
            return Err(Error::Unfinished { path: self.root.clone() });
        }
        let staged = self.root.join(STAGED);
        let hashes: Vec<Option<String>> = {
            let all: Result<Vec<_>, Error> =
                order.par_iter().map(|name| hash_of(&staged.join(name))).collect();
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
                disk::remove_file(&staged.join(name)).map_err(output(&self.root.join(name)))?;
                kept += 1;
                continue;
            }
            self.refuse(name, &owner)?;
            manifest.files.insert(name.clone(), there.into_iter().chain([hash]).collect());
            placed.push(name.clone());
        }
        self.refuse_foreign(removed.iter().map(String::as_str))?;
        let is_there = |name: &&String| fs::symlink_metadata(self.root.join(name)).is_ok();
        let removed: Vec<String> = removed.iter().filter(is_there).cloned().collect();
        if placed.is_empty() && removed.is_empty() {
            self.remove(STAGED)?;
            return Ok(kept);
        }
        disk::create_folders(&staged).map_err(output(&self.root))?;
        sync_folders(&staged).map_err(output(&self.root))?;
        (manifest.order, manifest.removed) = (placed, removed);
        manifest.write(&self.root)?;
        self.manifest = manifest;
        disk::rename(&staged, &self.root.join(COMMITTED)).map_err(output(&self.root))?;
        disk::sync_folder(&self.root).map_err(output(&self.root))?;
        self.put_in_place()?;
        Ok(kept)
    }

    /// Moves files from `COMMITTED` to their places. What of that was done before is passed over.
    fn put_in_place(&self) -> Result<(), Error> {
        let (committed, replaced) = (self.root.join(COMMITTED), self.root.join(REPLACED));
        let Manifest { order, removed, .. } = &self.manifest;
        let all: Vec<&String> = removed.iter().chain(order.iter().rev()).collect();
        let is_old = |(number, name): &(usize, &&String)| {
            (*number < removed.len() || committed.join(name).exists())
                && fs::symlink_metadata(self.root.join(name)).is_ok()
        };
        let old: Vec<(usize, &&String)> = all.iter().enumerate().filter(is_old).collect();
        // Somebody may have put a file there since a run was killed.
        for (_, name) in &old {
            if !self.is_as_left(name)? {
                return Err(Error::ForeignFile { path: self.root.join(name) });
            }
        }
        disk::create_folders(&replaced).map_err(output(&self.root))?;
        for (number, name) in old {
            let path = self.root.join(name);
            move_file(&path, &replaced.join(number.to_string())).map_err(output(&path))?;
        }
        let mut folders = BTreeSet::new();
        for name in order {
            let (from, path) = (committed.join(name), self.root.join(name));
            if from.exists() {
                disk::create_folders(disk::folder_of(&path)).map_err(output(&path))?;
                move_file(&from, &path).map_err(output(&path))?;
                let own = Path::new(name).ancestors().skip(1).map(|folder| self.root.join(folder));
                folders.extend(own);
            }
        }
        // From the innermost outwards.
        for folder in folders.iter().rev() {
            disk::sync_folder(folder).map_err(output(folder))?;
        }
        for name in removed {
            let folder = self.root.join(name);
            if let Some(folder) =
                folder.parent().filter(|folder| *folder != self.root && folder.is_dir())
            {
                // A link, or a folder of somebody: it may stay.
                let _ = disk::remove_empty_folder(folder);
            }
        }
        self.remove(COMMITTED)?;
        self.remove(REPLACED)
    }

    fn remove(&self, own: &str) -> Result<(), Error> {
        let path = self.root.join(own);
        disk::remove_own_folder(&path).map_err(output(&path))
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        // What was not published; nobody is left to tell.
        let _ = disk::remove_own_folder(&self.root.join(STAGED));
    }
}

fn read_manifest(root: &Path) -> Result<Option<Manifest>, Error> {
    Manifest::read(root).map_err(|error| match error {
        tiepoint_io::Error::Io { path, cause } => Error::Unreadable { path, cause },
        _ => Error::ForeignFile { path: root.join(MANIFEST) },
    })
}

/// The names that a COLMAP model in this folder may have, in both formats.
pub(crate) fn model_names(folder: Option<&str>) -> Vec<String> {
    let prefix = folder.map_or_else(String::new, |folder| format!("{folder}/"));
    let names =
        |format: Format| MODEL_FILES.map(|name| format!("{prefix}{name}.{}", format.suffix()));
    Format::ALL.into_iter().flat_map(names).collect()
}

pub(crate) fn output(path: &Path) -> impl FnOnce(io::Error) -> Error {
    let path = path.to_owned();
    move |cause| Error::Output { path, cause }
}

/// BLAKE3 of a regular file; `None` where there is none.
fn hash_of(path: &Path) -> Result<Option<String>, Error> {
    let unreadable = |cause| Error::Unreadable { path: path.to_owned(), cause };
    match fs::metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(cause) => return Err(unreadable(cause)),
        Ok(found) if !found.is_file() => return Ok(None),
        Ok(_) => {}
    }
    #[cfg(test)]
    tests::HASHED.lock().expect("no test panics with it").push(path.to_owned());
    let mut file = File::open(path).map_err(unreadable)?;
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

/// Renames, or copies where a folder on the way is a link to another disk.
fn move_file(from: &Path, to: &Path) -> io::Result<()> {
    match disk::rename(from, to) {
        Err(cause) if cause.kind() == io::ErrorKind::CrossesDevices => {
            let copied = File::open(from).and_then(|mut source| {
                AtomicFile::write_with(to, |file| io::copy(&mut source, file).map(drop))
                    .map_err(io::Error::other)
            });
            copied.and_then(|()| disk::remove_file(from))
        }
        renamed => renamed,
    }
}

/// Brings the names in a folder and below to the disk.
fn sync_folders(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_folders(&entry.path())?;
        }
    }
    disk::sync_folder(folder)
}

#[cfg(unix)]
fn lock(root: &Path) -> Result<Option<File>, Error> {
    let folder =
        File::open(root).map_err(|cause| Error::Unreadable { path: root.to_owned(), cause })?;
    match folder.try_lock() {
        Err(TryLockError::WouldBlock) => Err(Error::InUse { path: root.to_owned() }),
        // Some network disks have no locks: a lock is a help and not a promise there.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(folder)),
    }
}

#[cfg(not(unix))]
fn lock(_: &Path) -> Result<Option<File>, Error> {
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Files whose hash was taken, in any test.
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
    fn own_files_are_replaced_and_those_of_others_refused() {
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
        // The same content is no harm, and stays theirs.
        assert_eq!(put(&mut folder, &[("mine", "mine")], &["a/b"]).unwrap(), 1);
        assert!(!root.join("a").exists());
        assert!(put(&mut folder, &[("mine", "other")], &[]).is_err());
    }

    #[test]
    fn a_file_that_is_replaced_is_read_once_before() {
        let dir = tempfile::tempdir().unwrap();
        let mut folder = OutputFolder::open(dir.path()).unwrap();
        folder.always_ours(&["ours"]);
        let names = ["a", "ours", "theirs"];
        put(&mut folder, &[("a", "1"), ("ours", "1")], &[]).unwrap();
        fs::write(dir.path().join("theirs"), "2").unwrap();
        let paths = names.map(|name| dir.path().join(name));
        let count = || HASHED.lock().unwrap().iter().filter(|path| paths.contains(path)).count();
        let before = count();
        assert_eq!(put(&mut folder, &names.map(|name| (name, "2")), &[]).unwrap(), 1);
        // Each once, and the two that are replaced again before they go, since they may have
        // changed meanwhile.
        assert_eq!(count() - before, 5);
    }

    #[test]
    fn what_a_killed_run_left_is_ended_and_spares_what_came_since() {
        let dir = tempfile::tempdir().unwrap();
        let (root, outside) = (dir.path().join("out"), dir.path().join("keep"));
        fs::write(&outside, "precious").unwrap();
        let mut folder = OutputFolder::open(&root).unwrap();
        put(&mut folder, &[("a", "1"), ("b", "1")], &[]).unwrap();
        put(&mut folder, &[("a", "2")], &["b"]).unwrap();
        drop(folder);
        // Killed before the files took their places; somebody brought one back.
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
        // A list from somebody else leads nowhere out of the folder.
        for name in ["../keep", outside.to_str().unwrap()] {
            let mut manifest = Manifest::default();
            manifest.removed.push(name.to_owned());
            manifest.write(&root).unwrap();
            assert!(matches!(OutputFolder::open(&root), Err(Error::ForeignFile { .. })), "{name}");
        }
        assert_eq!(fs::read(outside).unwrap(), b"precious");
    }

    #[test]
    fn what_is_on_its_way_to_its_place_is_not_dropped_for_what_comes_next() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let mut folder = OutputFolder::open(root).unwrap();
        put(&mut folder, &[("a", "1"), ("b", "1")], &[]).unwrap();
        // The old files cannot be moved out.
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
    fn an_input_is_never_an_output_and_nothing_leaves_the_folder() {
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
