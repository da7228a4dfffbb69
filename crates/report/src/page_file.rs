//! The file of a page.

use std::fs;
use std::io::Write;
use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::store::{AtomicFile, Error as StoreError, Mark, Replace, may_be_replaced};

/// Marks a page as written by this program.
const MARK: Mark = Mark::Inside("<title>tiepoint</title>");

/// Writes an HTML page. An existing page is replaced only if this program wrote it.
///
/// # Errors
///
/// A foreign page or a link exists, or the page cannot be written.
pub fn write_page(path: &Path, html: &str) -> Result<(), Error> {
    refuse_foreign_page(path)?;
    Ok(AtomicFile::write_with(path, |file| file.write_all(html.as_bytes()))?)
}

/// Checks before any work is done that [`write_page`] may write.
///
/// # Errors
///
/// A foreign page exists, or a link: the program chose the name, and the folder may be somebody
/// else's.
pub fn refuse_foreign_page(path: &Path) -> Result<(), Error> {
    refuse_link(path)?;
    if may_be_replaced(path, Replace::Marked(MARK))? {
        Ok(())
    } else {
        Err(StoreError::ForeignFile { path: path.to_owned() }.into())
    }
}

fn refuse_link(path: &Path) -> Result<(), Error> {
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_symlink() => {
            Err(StoreError::LinkInFolder { path: path.to_owned() }.into())
        }
        _ => Ok(()),
    }
}
