//! The state of an unfinished run, in a file of its own beside the results.

use std::io::Read;
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
    /// The file cannot be written; then the earlier state stays.
    pub fn keep_state(&self, content: &[u8]) -> Result<(), Error> {
        let failed = Error::output(&self.root.join(STATE));
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

    /// The state that an unfinished run kept; `None` without one, and for what is no file.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn state(&self) -> Result<Option<Vec<u8>>, Error> {
        let failed = || Error::unreadable(&self.root.join(STATE));
        let found = self.root.metadata(STATE).map_err(failed())?;
        if !found.is_some_and(|found| found.is_file()) {
            return Ok(None);
        }
        let mut content = Vec::new();
        let mut file = self.root.open_file(STATE).map_err(failed())?;
        file.read_to_end(&mut content).map_err(failed())?;
        Ok(Some(content))
    }

    /// Removes the state of a run that is finished, and what a killed one left of it.
    ///
    /// # Errors
    ///
    /// The file cannot be removed.
    pub fn remove_state(&self) -> Result<(), Error> {
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

    #[test]
    fn a_state_is_replaced_read_and_removed() {
        let dir = tempfile::tempdir().unwrap();
        let folder = OutputFolder::open(dir.path()).unwrap();
        assert_eq!(folder.state().unwrap(), None);
        folder.keep_state(b"longer").unwrap();
        // A killed run leaves a part.
        fs::write(dir.path().join(part()), b"half").unwrap();
        folder.keep_state(b"new").unwrap();
        assert_eq!(folder.state().unwrap().unwrap(), b"new");
        drop(folder);
        let folder = OutputFolder::open(dir.path()).unwrap();
        assert_eq!(folder.state().unwrap().unwrap(), b"new");
        fs::write(dir.path().join(part()), b"half").unwrap();
        folder.remove_state().unwrap();
        folder.remove_state().unwrap();
        assert_eq!(folder.state().unwrap(), None);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
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
        assert_eq!(folder.state().unwrap(), None);
        folder.keep_state(b"state").unwrap();
        assert_eq!(folder.state().unwrap().unwrap(), b"state");
        assert_eq!(fs::read(&mine).unwrap(), b"mine");
        // A folder of that name stays.
        folder.remove_state().unwrap();
        fs::create_dir(root.join(STATE)).unwrap();
        assert_eq!(folder.state().unwrap(), None);
        assert!(folder.keep_state(b"state").is_err());
        assert_eq!(fs::read_dir(&root).unwrap().count(), 1);
    }
}
