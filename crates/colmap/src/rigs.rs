//! `rig_configurator`: the rigs and frames of a database from a `rig_config.json`.

use std::path::Path;

use tiepoint_pipeline::Error;
use tiepoint_pipeline::io::database::DatabaseFrame;
use tiepoint_pipeline::stages::known_rigs;

use super::scene::{open_to_add, read_scene};

/// Writes the rigs of a file, and the frames of their images, into a database, in place of those
/// that it has. Cameras for which the file has intrinsics get these. Returns the number of rigs and
/// frames.
///
/// # Errors
///
/// The file does not fit the images of the database, or one of them cannot be read or written.
pub fn configure_rigs(database: &Path, config: &Path) -> Result<[usize; 2], Error> {
    let mut database = open_to_add(database)?;
    let mut scene = read_scene(&database)?;
    let before: Vec<_> = scene.cameras().map(|(_, camera)| *camera).collect();
    let known = known_rigs(config, &mut scene, true)?;
    let frames: Vec<DatabaseFrame> = known
        .frames
        .iter()
        .map(|frame| DatabaseFrame { rig: frame.rig, images: frame.images.clone() })
        .collect();
    if !database.has_rig_tables()? {
        let what = "has no tables of rigs, which COLMAP has since 3.12: make the database again \
                    with feature_extractor";
        return Err(Error::Colmap { path: database.path().to_owned(), what: what.to_owned() });
    }
    for ((id, camera), before) in scene.cameras().zip(before) {
        if *camera != before {
            database.set_camera(id, camera)?;
        }
    }
    database.write_rigs(&known.rigs, &frames)?;
    database.close()?;
    Ok([known.rigs.len(), frames.len()])
}
