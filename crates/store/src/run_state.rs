//! The state of an unfinished run, in a file of its own beside the results.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::disk;
use crate::{Error, OutputFolder};

/// The file; a name of this program's own, which no result has.
const STATE: &str = ".tiepoint-state";

impl OutputFolder {
    /// Keeps the state of an unfinished run in place of an earlier one: written under another name,
    /// synchronised to the disk, renamed. Takes no part in transactions. A link of that name is
    /// replaced, and not followed.
    ///
    /// # Errors
    ///
    /// The file cannot be written; then the earlier state stays. A file of that name that does not
    /// begin with `magic` is somebody else's, and stays, too.
    pub fn keep_state(&self, content: &[u8], magic: &[u8]) -> Result<(), Error> {
        let failed = Error::output(&self.root.join(STATE));
        if self.is_foreign(magic)? {
            return Err(failed(io::ErrorKind::AlreadyExists.into()));
        }
        let part = part();
        let written = self
            .root
            .remove_file(&part)
            .and_then(|()| disk::write_new(&self.root.join(&part), content))
            .and_then(|()| self.root.rename(&part, STATE))
            .and_then(|()| self.root.sync_folder(""));
        written.map_err(|cause| {
            // Half of a state would take the space of the results.
            let _ = self.root.remove_file(&part);
            failed(cause)
        })
    }

    /// The state that an unfinished run kept; `None` without one, and for what is no file or does
    /// not begin with `magic`.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn state(&self, magic: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        let Some((mut content, mut rest)) = self.opened(magic)?.filter(|(first, _)| first == magic)
        else {
            return Ok(None);
        };
        rest.read_to_end(&mut content).map_err(Error::unreadable(&self.root.join(STATE)))?;
        Ok(Some(content))
    }

    /// Whether there is a file of that name that is not empty and does not begin with `magic`.
    fn is_foreign(&self, magic: &[u8]) -> Result<bool, Error> {
        let opened = self.opened(magic)?;
        Ok(opened.is_some_and(|(first, _)| !first.is_empty() && first != magic))
    }

    /// The file of that name, if it is a file: as many bytes of its begin as `magic` has, and the
    /// rest.
    fn opened(&self, magic: &[u8]) -> Result<Option<(Vec<u8>, File)>, Error> {
        let failed = || Error::unreadable(&self.root.join(STATE));
        let found = self.root.metadata(STATE).map_err(failed())?;
        if !found.is_some_and(|found| found.is_file()) {
            return Ok(None);
        }
        let mut file = self.root.open_file(STATE).map_err(failed())?;
        let mut first = Vec::new();
        file.by_ref().take(magic.len() as u64).read_to_end(&mut first).map_err(failed())?;
        Ok(Some((first, file)))
    }

    /// Removes the state of a run that is finished, and what a killed one left of it.
    ///
    /// # Errors
    ///
    /// The file cannot be removed.
    pub fn remove_state(&self, magic: &[u8]) -> Result<(), Error> {
        if self.is_foreign(magic)? {
            return Ok(());
        }
        for name in [part(), PathBuf::from(STATE)] {
            if self.root.has(&name) {
                self.root.remove_file(&name).map_err(Error::output(&self.root.join(STATE)))?;
            }
        }
        Ok(())
    }
}

/// The name of the file while it is written.
fn part() -> PathBuf {
    disk::temporary_path(Path::new(STATE))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const MAGIC: &[u8] = b"s ";

    #[test]
    fn a_state_is_replaced_read_and_removed() {
        let dir = tempfile::tempdir().unwrap();
        let folder = OutputFolder::open(dir.path()).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap(), None);
        folder.keep_state(b"s longer", MAGIC).unwrap();
        // A killed run leaves a part.
        fs::write(dir.path().join(part()), b"half").unwrap();
        folder.keep_state(b"s new", MAGIC).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap().unwrap(), b"s new");
        drop(folder);
        let folder = OutputFolder::open(dir.path()).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap().unwrap(), b"s new");
        fs::write(dir.path().join(part()), b"half").unwrap();
        folder.remove_state(MAGIC).unwrap();
        folder.remove_state(MAGIC).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap(), None);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_file_of_somebody_else_stays() {
        let dir = tempfile::tempdir().unwrap();
        let folder = OutputFolder::open(dir.path()).unwrap();
        fs::write(dir.path().join(STATE), "mine").unwrap();
        assert_eq!(folder.state(MAGIC).unwrap(), None);
        assert!(folder.keep_state(b"s state", MAGIC).is_err());
        folder.remove_state(MAGIC).unwrap();
        assert_eq!(fs::read(dir.path().join(STATE)).unwrap(), b"mine");
        fs::write(dir.path().join(STATE), "").unwrap();
        folder.keep_state(b"s state", MAGIC).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap().unwrap(), b"s state");
    }

    #[cfg(unix)]
    #[test]
    fn no_link_is_followed() {
        let dir = tempfile::tempdir().unwrap();
        let mine = dir.path().join("mine");
        fs::write(&mine, "mine").unwrap();
        let root = dir.path().join("root");
        let folder = OutputFolder::open(&root).unwrap();
        for name in [PathBuf::from(STATE), part()] {
            std::os::unix::fs::symlink("../mine", root.join(name)).unwrap();
        }
        assert_eq!(folder.state(MAGIC).unwrap(), None);
        folder.keep_state(b"s state", MAGIC).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap().unwrap(), b"s state");
        assert_eq!(fs::read(&mine).unwrap(), b"mine");
        // A folder of that name stays.
        folder.remove_state(MAGIC).unwrap();
        fs::create_dir(root.join(STATE)).unwrap();
        assert_eq!(folder.state(MAGIC).unwrap(), None);
        assert!(folder.keep_state(b"s state", MAGIC).is_err());
        assert_eq!(fs::read_dir(&root).unwrap().count(), 1);
    }
}
