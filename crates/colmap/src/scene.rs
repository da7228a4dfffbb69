//! Databases and models as the commands open them.

use std::path::Path;

use rayon::prelude::*;
use tiepoint_pipeline::io::database::{Database, read_stage_rows};
use tiepoint_pipeline::sfm::scene::{
    CorrespondenceGraph, ImageId, ImagePair, OriginalIds, Reconstruction, TwoView,
};
use tiepoint_pipeline::sfm::two_view::VerifyOptions;
use tiepoint_pipeline::stages::ImportedPairs;
use tiepoint_pipeline::{Error, workspace};

/// Opens a database to add to it.
///
/// # Errors
///
/// It is not a database of COLMAP, or that of a workspace, whose records would become wrong.
pub(super) fn open_to_add(path: &Path) -> Result<Database, Error> {
    // Opening it would change its header.
    if read_stage_rows(path)?.is_some() {
        let what = "belongs to a workspace of tiepoint: add to it with `tiepoint features` and \
                    `tiepoint match`, or give another --database_path";
        return Err(Error::Colmap { path: path.to_owned(), what: what.to_owned() });
    }
    Ok(Database::open(path)?)
}

/// Creates an empty database. A database that is there stays as it is.
///
/// # Errors
///
/// The file cannot be written, or is no database.
pub fn create_database(path: &Path) -> Result<(), Error> {
    let database = match path.exists() {
        true => Database::open_read_only(path)?,
        false => Database::create(path)?,
    };
    Ok(database.close()?)
}

/// The scene of a database without poses. Cameras and images have the ids of the database.
pub(super) fn read_scene(database: &Database) -> Result<Reconstruction, Error> {
    let mut scene = workspace::read_scene(database)?;
    scene.original_ids = ids_of(database);
    Ok(scene)
}

/// The ids of a database for models of its images.
pub(super) fn ids_of(database: &Database) -> OriginalIds {
    let wide = |ids: &[i64]| ids.iter().map(|id| id.unsigned_abs()).collect();
    let (cameras, images) = (database.camera_file_ids(), database.image_file_ids());
    OriginalIds::new(wide(cameras), wide(images), Vec::new())
}

/// The correspondences of the verified pairs of a database. Geometries of other programs that are
/// placeholders are estimated from their matches. The scene may have further images.
///
/// # Errors
///
/// The database cannot be read, or has no verified pair.
pub(super) fn read_graph(
    database: &Database,
    scene: &Reconstruction,
    min_matches: usize,
    is_used: &(dyn Fn(ImageId) -> bool + Sync),
    seed: u64,
) -> Result<CorrespondenceGraph, Error> {
    let pairs = ImportedPairs::read(database)?;
    let verify = VerifyOptions::default();
    let tasks: Vec<ImagePair> = pairs
        .all
        .iter()
        .filter(|(pair, view)| view.is_some() && is_used(pair.a) && is_used(pair.b))
        .map(|(pair, _)| *pair)
        .collect();
    let views: Vec<(ImagePair, TwoView)> = tasks
        .into_par_iter()
        .map(|pair| (pair, pairs.verified(pair, &[], &verify, seed).0))
        .filter(|(_, view)| view.matches.len() >= min_matches)
        .collect();
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let graph = CorrespondenceGraph::new(&counts, views);
    if graph.pairs().is_empty() {
        let what = format!(
            "has no pair of images with {min_matches} verified matches: run a matcher first, or \
            take photos that overlap more"
        );
        return Err(Error::Colmap { path: database.path().to_owned(), what });
    }
    Ok(graph)
}
