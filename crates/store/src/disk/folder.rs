//! A folder that is opened once. Names below it are looked up from its handle, and lead to no place
//! outside of it.
//!
//! Whoever sent a folder may have put links into it. The functions here refuse to leave the folder
//! even if links appear while they run, and [`Folder::find_link`] tells of links that are there.

use std::fs::File;
use std::io;
use std::path::{Component, Path, PathBuf};

use cap_std::ambient_authority;
use cap_std::fs::{Dir, Metadata};

use super::change::{check_fault, retry_while_denied};
use super::operation::Operation;

/// An open folder.
#[derive(Debug)]
pub struct Folder {
    dir: Dir,
    path: PathBuf,
}

impl Folder {
    /// Opens a folder. Links in `path` are followed: the caller named it.
    ///
    /// # Errors
    ///
    /// If the path leads to no folder, and if the system reports an error.
    pub fn open(path: &Path) -> io::Result<Self> {
        let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        Ok(Self { dir: Dir::open_ambient_dir(path, ambient_authority())?, path: path.to_owned() })
    }

    /// The path that the folder was opened with.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a name, for messages.
    pub fn join(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }

    /// The first part of a name that is a symbolic link, as a path; `None` if no part is one. Parts
    /// that do not exist are no links.
    ///
    /// # Errors
    ///
    /// If the system reports an error.
    pub fn find_link(&self, name: impl AsRef<Path>) -> io::Result<Option<PathBuf>> {
        let mut part = PathBuf::new();
        for component in name.as_ref().components() {
            if !matches!(component, Component::Normal(_)) {
                return Err(io::Error::from(io::ErrorKind::InvalidInput));
            }
            part.push(component);
            match self.metadata(&part)? {
                Some(found) if found.is_symlink() => return Ok(Some(self.path.join(part))),
                Some(found) if found.is_dir() => {}
                _ => break,
            }
        }
        Ok(None)
    }

    /// The metadata of a name, of the link itself if it is one; `None` if nothing is there.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn metadata(&self, name: impl AsRef<Path>) -> io::Result<Option<Metadata>> {
        match self.dir.symlink_metadata(name) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(None),
            found => found.map(Some),
        }
    }

    /// Whether anything has this name: a file, a folder, a link.
    pub fn has(&self, name: impl AsRef<Path>) -> bool {
        self.metadata(name).is_ok_and(|found| found.is_some())
    }

    /// Opens a file for reading.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn open_file(&self, name: impl AsRef<Path>) -> io::Result<File> {
        Ok(self.dir.open(name)?.into_std())
    }

    /// Renames a file or folder; replaces a file at `to`.
    ///
    /// # Errors
    ///
    /// If a name leads out of the folder, and if the system reports an error.
    pub fn rename(&self, from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<()> {
        check_fault(Operation::Rename, &self.join(&to))?;
        retry_while_denied(cfg!(windows), || self.dir.rename(&from, &self.dir, &to))
    }

    /// Removes a file or link if it exists.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn remove_file(&self, name: impl AsRef<Path>) -> io::Result<()> {
        check_fault(Operation::Remove, &self.join(&name))?;
        match retry_while_denied(cfg!(windows), || self.dir.remove_file(&name)) {
            Err(cause) if cause.kind() != io::ErrorKind::NotFound => Err(cause),
            _ => Ok(()),
        }
    }

    /// Removes a folder if it exists and is empty.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn remove_empty_folder(&self, name: impl AsRef<Path>) -> io::Result<()> {
        check_fault(Operation::Remove, &self.join(&name))?;
        match retry_while_denied(cfg!(windows), || self.dir.remove_dir(&name)) {
            Err(cause)
                if !matches!(
                    cause.kind(),
                    io::ErrorKind::NotFound | io::ErrorKind::DirectoryNotEmpty
                ) =>
            {
                Err(cause)
            }
            _ => Ok(()),
        }
    }

    /// Removes a folder with its content if it exists; links are removed and not followed. Only for
    /// folders that this program created under a name of its own.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn remove_own_folder(&self, name: impl AsRef<Path>) -> io::Result<()> {
        let name = name.as_ref();
        match self.metadata(name)? {
            None => return Ok(()),
            Some(found) if !found.is_dir() => return self.remove_file(name),
            Some(_) => {}
        }
        for entry in self.dir.read_dir(name)? {
            let entry = entry?;
            let inner = name.join(entry.file_name());
            if entry.file_type()?.is_dir() {
                self.remove_own_folder(&inner)?;
            } else {
                self.remove_file(&inner)?;
            }
        }
        self.remove_empty_folder(name)
    }

    /// Creates a folder and its missing parents. An empty name is the folder itself.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn create_folders(&self, name: impl AsRef<Path>) -> io::Result<()> {
        let name = name.as_ref();
        let is_there =
            || self.metadata(name).is_ok_and(|found| found.is_some_and(|it| it.is_dir()));
        if name.as_os_str().is_empty() || is_there() {
            return Ok(());
        }
        if let Some(parent) = name.parent() {
            self.create_folders(parent)?;
        }
        check_fault(Operation::CreateFolder, &self.join(name))?;
        match self.dir.create_dir(name) {
            // Another thread or process created it meanwhile.
            Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists && is_there() => Ok(()),
            made => made,
        }
    }

    /// Waits until the entries of a folder are on the disk (fsync), as
    /// [`sync_folder`](super::sync_folder). An empty name is the folder itself.
    ///
    /// # Errors
    ///
    /// If the name leads out of the folder, and if the system reports an error.
    pub fn sync_folder(&self, name: impl AsRef<Path>) -> io::Result<()> {
        check_fault(Operation::SyncFolder, &self.join(&name))?;
        #[cfg(unix)]
        {
            let name = name.as_ref();
            let name = if name.as_os_str().is_empty() { Path::new(".") } else { name };
            self.dir.open(name)?.sync_all()?;
        }
        Ok(())
    }

    /// [`Folder::sync_folder`] for a folder and all folders in it.
    ///
    /// # Errors
    ///
    /// Those of [`Folder::sync_folder`].
    pub fn sync_folders(&self, name: impl AsRef<Path>) -> io::Result<()> {
        for entry in self.dir.read_dir(&name)? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                self.sync_folders(name.as_ref().join(entry.file_name()))?;
            }
        }
        self.sync_folder(name)
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn names_do_not_lead_out_of_the_folder() {
        let dir = tempfile::tempdir().unwrap();
        let (root, outside) = (dir.path().join("root"), dir.path().join("outside"));
        fs::create_dir_all(root.join("real/deep")).unwrap();
        fs::create_dir(&outside).unwrap();
        fs::write(outside.join("precious"), "mine").unwrap();
        fs::write(root.join("own"), "ours").unwrap();
        symlink(&outside, root.join("link")).unwrap();
        symlink("../../outside", root.join("real/up")).unwrap();
        symlink("nowhere", root.join("dangling")).unwrap();
        symlink("real", root.join("within")).unwrap();
        let folder = Folder::open(&root).unwrap();
        for name in ["link", "real/up", "dangling", "within"] {
            assert_eq!(folder.find_link(name).unwrap(), Some(root.join(name)), "{name}");
            let below = format!("{name}/x/y");
            assert_eq!(folder.find_link(below).unwrap(), Some(root.join(name)), "{name}");
        }
        for name in ["own", "own/x", "real", "real/deep/x", "none/x"] {
            assert_eq!(folder.find_link(name).unwrap(), None, "{name}");
        }
        for name in ["../outside/precious", "/etc/passwd", "real/../../outside/precious"] {
            assert!(folder.find_link(name).is_err(), "{name}");
            assert!(folder.open_file(name).is_err(), "{name}");
        }
        for name in ["link/precious", "real/up/precious", "../outside/precious"] {
            folder.open_file(name).unwrap_err();
            folder.rename(name, "stolen").unwrap_err();
            folder.rename("own", name).unwrap_err();
            folder.remove_file(name).unwrap_err();
            folder.remove_own_folder(name).unwrap_err();
            folder.create_folders(format!("{name}/new")).unwrap_err();
        }
        folder.create_folders("link/new").unwrap_err();
        folder.remove_own_folder("link").unwrap();
        folder.remove_own_folder("real").unwrap();
        assert!(!root.join("link").exists() && !root.join("real").exists());
        assert_eq!(fs::read(outside.join("precious")).unwrap(), b"mine");
        assert_eq!(fs::read_dir(&outside).unwrap().count(), 1);
        folder.create_folders("a/b").unwrap();
        folder.sync_folders(".").unwrap();
        folder.sync_folder("a/b").unwrap();
    }
}
