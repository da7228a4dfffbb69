//! Positions of images: lines `name x y z`, as COLMAP's `model_aligner` reads them.

use std::collections::BTreeMap;
use std::path::Path;

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_store::require_regular_file;

use crate::Result;
use crate::text::Lines;
use crate::text::excerpt::Excerpt;

/// Reads the positions of images, by name. Names may contain spaces: the last three words of a line
/// are the numbers. Lines that start with `#` are comments.
///
/// # Errors
///
/// If the file cannot be read, if a line is not a name and three finite numbers, and if a name is
/// listed twice.
pub fn read(path: &Path) -> Result<BTreeMap<String, Vector3<f64>>> {
    require_regular_file(path)?;
    let mut lines = Lines::open(path)?;
    let mut positions = BTreeMap::new();
    while let Some(mut line) = lines.next()? {
        // Columns may be aligned with several spaces.
        let mut rest = line.rest().trim();
        let mut xyz = [0.0; 3];
        for (axis, value) in [(2, "z"), (1, "y"), (0, "x")] {
            let (before, word) = rest.rsplit_once(char::is_whitespace).unwrap_or(("", rest));
            rest = before.trim_end();
            let number = word.parse().ok().filter(|number: &f64| number.is_finite());
            xyz[axis] = number.ok_or_else(|| {
                line.error(format!(
                    "{value} is `{}`, not a number: expected `name x y z`",
                    Excerpt(word)
                ))
            })?;
        }
        if rest.is_empty() {
            return Err(line.error("has no name: expected `name x y z`"));
        }
        if positions.insert(rest.to_owned(), Vector3::from(xyz)).is_some() {
            return Err(line.error(format!("the image {} is listed twice", Excerpt(rest))));
        }
    }
    Ok(positions)
}
