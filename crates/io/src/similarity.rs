//! Similarity transforms in the format of COLMAP's `model_transformer`: one line `scale qw qx qy qz
//! tx ty tz` of new_from_old (`Sim3d::ToFile`).

use std::io::Write;
use std::path::Path;

use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_store::require_regular_file;

use crate::Result;
use crate::atomic::write_atomic;
use crate::text::{Lines, Number, Numbers};

/// Reads a similarity.
///
/// # Errors
///
/// If the file cannot be read, and if it is not eight numbers of a similarity whose scale is
/// positive.
pub fn read(path: &Path) -> Result<Sim3> {
    require_regular_file(path)?;
    let mut lines = Lines::open(path)?;
    let mut line = lines.expect("`scale qw qx qy qz tx ty tz`")?;
    let scale = line.f64("the scale")?;
    if !(scale.is_normal() && scale > 0.0) {
        return Err(line.error(format!("the scale is {}, and not above zero", Number(scale))));
    }
    let Rigid3 { rotation, translation } = line.pose("the rotation and translation")?;
    line.end()?;
    match lines.next()? {
        None => Ok(Sim3 { scale, rotation, translation }),
        Some(line) => Err(line.error("follows the only similarity of the file")),
    }
}

/// Writes a similarity. Numbers have as many digits as identify them.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write(path: &Path, new_from_old: &Sim3) -> Result<()> {
    let Sim3 { scale, rotation: q, translation: t } = new_from_old;
    write_atomic(path, |file| {
        writeln!(file, "{}", Numbers(&[*scale, q.w, q.i, q.j, q.k, t.x, t.y, t.z]))
    })
}
