//! What is done at each change of the file system.

use std::io;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use super::operation::Operation;

/// Duration of the retries of a change, and the pause between two. Virus scanners of Windows hold a
/// new file open for a short time.
const RETRY_DURATION: Duration = Duration::from_secs(2);
const RETRY_PAUSE: Duration = Duration::from_millis(10);

/// Makes a change; retries it while permission is denied if `may_be_denied`. On Windows, a file
/// that another process has open can be neither renamed nor removed, nor can its folder.
pub(super) fn retry_while_denied<T>(
    may_be_denied: bool,
    mut change: impl FnMut() -> io::Result<T>,
) -> io::Result<T> {
    let start = Instant::now();
    loop {
        match change() {
            Err(cause)
                if may_be_denied
                    && cause.kind() == io::ErrorKind::PermissionDenied
                    && start.elapsed() < RETRY_DURATION =>
            {
                thread::sleep(RETRY_PAUSE);
            }
            done => return done,
        }
    }
}

/// Called before each change; returns the error that a test asks for. For callers whose changes
/// another library makes, such as the commit of a database.
///
/// # Errors
///
/// That of the fault, with the feature `faults`.
#[cfg_attr(
    not(feature = "faults"),
    expect(clippy::unnecessary_wraps, reason = "only tests make it fail")
)]
#[inline]
pub fn check_fault(operation: Operation, path: &Path) -> io::Result<()> {
    #[cfg(feature = "faults")]
    super::faults::check_fault(operation, path)?;
    #[cfg(not(feature = "faults"))]
    let _ = (operation, path);
    Ok(())
}

/// Whether a test watches the changes under a folder: then what is written from time to time is
/// written each time.
#[inline]
pub fn is_watched(folder: &Path) -> bool {
    #[cfg(feature = "faults")]
    return super::faults::is_watched(folder);
    #[cfg(not(feature = "faults"))]
    {
        let _ = folder;
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn denied_changes_are_retried() {
        let mut tries = 0;
        let mut change = |may_be_denied, kind, passes: usize| {
            tries = 0;
            retry_while_denied(may_be_denied, || {
                tries += 1;
                if tries > passes { Ok(tries) } else { Err(io::Error::from(kind)) }
            })
        };
        let denied = io::ErrorKind::PermissionDenied;
        assert_eq!(change(true, denied, 3).unwrap(), 4);
        assert_eq!(change(false, denied, 1).unwrap_err().kind(), denied);
        let missing = io::ErrorKind::NotFound;
        assert_eq!(change(true, missing, 1).unwrap_err().kind(), missing);
    }
}
