//! `mapper`: models of the images of a database.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use tiepoint_pipeline::input::ImageFolder;
use tiepoint_pipeline::io::colmap::{Format, read_model};
use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::sfm::model_tools::{Transferred, transfer_model};
use tiepoint_pipeline::sfm::scene::KnownRigs;
use tiepoint_pipeline::sfm::scene::rig::KnownFrame;
use tiepoint_pipeline::sfm::scene::{CorrespondenceGraph, ImageId, Reconstruction};
use tiepoint_pipeline::sfm::{self as sfm, ExistingPoses, MappedModel, Mapper, MapperOptions};
use tiepoint_pipeline::stages::{color_points, named_event};
use tiepoint_pipeline::{Error, Event, Stage, Watch, emit};

use super::output::{ModelFolders, write_model_with_project};
use super::scene::{ids_of, read_graph, read_scene};

/// Options of [`map`].
#[derive(Clone, Debug)]
pub struct MapDatabaseOptions {
    /// Options of the mapper.
    pub mapper: MapperOptions,
    /// The images to map, by their names; all if `None`.
    pub names: Option<BTreeSet<String>>,
    /// Fewest verified matches of a pair.
    pub min_matches: usize,
    /// Most models that are written.
    pub max_models: usize,
    /// Whether points get colours.
    pub extract_colors: bool,
    /// Whether the extrinsics of the rigs of the database are refined.
    pub refine_extrinsics: bool,
    /// The model to go on from; the result is then one model, in the output folder itself.
    pub input: Option<PathBuf>,
    /// Whether its poses are constant.
    pub constant_poses: bool,
    /// Text of the file `project.ini` beside each model.
    pub project: Option<String>,
}

/// A model that was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MappedFolder {
    /// Its folder.
    pub path: PathBuf,
    /// Number of images with a pose.
    pub images: usize,
    /// Number of points.
    pub points: usize,
    /// Mean reprojection error, in pixels.
    pub mean_reprojection_error_px: f64,
}

/// Maps the images of a database, which stays as it is, and writes the models into the sub-folders
/// `0`, `1`, ... of a folder, the largest first. Rigs of the database with known extrinsics are
/// used. `images`: the folder of the images, for colours.
///
/// # Errors
///
/// The database or the model cannot be read; no pair of images overlaps; the mapper fails; an
/// output folder has a model that is not this program's; writing fails; `watch` returns `Break`.
pub fn map(
    database: &Path,
    images: Option<&Path>,
    output: &Path,
    options: &MapDatabaseOptions,
    watch: Watch,
) -> Result<Vec<MappedFolder>, Error> {
    let start = Instant::now();
    options.mapper.validate()?;
    // Before any work is done. Named folders are replaced.
    let folder = |index: usize| match options.input {
        Some(_) => output.to_owned(),
        None => output.join(index.to_string()),
    };
    let folders = match options.input {
        Some(_) => None,
        None => Some(ModelFolders::open(output)?),
    };
    let database = Database::open_read_only(database)?;
    let scene = read_scene(&database)?;
    let is_asked = |id: ImageId| match &options.names {
        None => true,
        Some(names) => names.contains(&scene.image(id).name),
    };
    let (seed, min_matches) = (options.mapper.seed, options.min_matches);
    let graph = read_graph(&database, &scene, min_matches, &is_asked, seed)?;
    let total = scene.images().filter(|(id, _)| is_asked(*id)).count();
    emit(watch, &Event::StageBegan { stage: Stage::Map, total, done: 0 })?;
    let mut models = run(&database, &graph, &scene, options, watch)?;
    let is_extended = options.input.is_some();
    models.truncate(if is_extended { 1 } else { options.max_models.max(1) });
    for model in &mut models {
        // Images of the input model that the database lacks are behind its own.
        model.reconstruction.original_ids = ids_of(&database);
    }
    drop(database);
    if let (Some(images), true) = (images, options.extract_colors) {
        let colored =
            ImageFolder::as_stored(images, None).map_err(Error::from).and_then(|folder| {
                color_points(&folder, models.iter_mut().map(|model| &mut model.reconstruction))
            });
        if let Err(error) = colored {
            emit(watch, &Event::ColorsMissing { reason: &error.to_string() })?;
        }
    }
    let (reconstructions, project) =
        (models.iter().map(|model| &model.reconstruction), options.project.as_deref());
    match folders {
        Some(folders) => folders.write(reconstructions.clone(), Format::Binary, project)?,
        None => reconstructions.clone().try_for_each(|model| {
            write_model_with_project(output, model, Format::Binary, project)
        })?,
    }
    let written = reconstructions.enumerate().map(|(index, model)| MappedFolder {
        path: folder(index),
        images: model.num_registered(),
        points: model.num_tracks(),
        mean_reprojection_error_px: model.mean_reprojection_error_px(),
    });
    let written = written.collect();
    let seconds = start.elapsed().as_secs_f64();
    emit(watch, &Event::StageDone { stage: Stage::Map, seconds })?;
    Ok(written)
}

fn run(
    database: &Database,
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    options: &MapDatabaseOptions,
    watch: Watch,
) -> Result<Vec<MappedModel>, Error> {
    let extended = options.input.as_deref().map(|path| transferred(scene, path)).transpose()?;
    let scene = extended.as_ref().map_or(scene, |extended| &extended.scene);
    let name = |id| scene.image(id).name.as_str();
    let mut notified = |event: &sfm::Event| {
        named_event(event, &name).map_or(ControlFlow::Continue(()), |event| watch(&event))
    };
    let Some(path) = &options.input else {
        let rigs = known_rigs(database, options.refine_extrinsics)?;
        let mut mapper = Mapper::new(graph, scene).watch(&mut notified);
        if let Some(rigs) = &rigs {
            mapper = mapper.known_rigs(rigs);
        }
        return Ok(mapper.run(&options.mapper)?);
    };
    let poses = match options.constant_poses {
        true => ExistingPoses::Constant,
        false => ExistingPoses::Refined,
    };
    let graph = &for_scene(graph, scene);
    let mapper = Mapper::new(graph, scene).existing(poses).watch(&mut notified);
    let models = mapper.run(&options.mapper);
    models.map_err(|cause| Error::InputModel { path: path.clone(), cause })
}

/// The scene with the poses and points of a model.
pub(super) fn transferred(scene: &Reconstruction, path: &Path) -> Result<Transferred, Error> {
    transfer_model(scene, &read_model(path)?)
        .map_err(|cause| Error::InputModel { path: path.to_owned(), cause })
}

/// The correspondences of a database for a scene that also has the images of a model, which the
/// database may lack.
pub(super) fn for_scene(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
) -> CorrespondenceGraph {
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    CorrespondenceGraph::new(&counts, graph.pairs().clone())
}

/// The rigs of a database if all their extrinsics are known.
fn known_rigs(database: &Database, refine_extrinsics: bool) -> Result<Option<KnownRigs>, Error> {
    let (rigs, frames) = database.read_rigs()?;
    let is_known = rigs
        .iter()
        .flat_map(|rig| rig.sensors.iter().skip(1))
        .all(|sensor| sensor.cam_from_rig.is_some());
    if rigs.is_empty() || !is_known {
        return Ok(None);
    }
    let frames = frames.into_iter();
    let frames = frames.map(|frame| KnownFrame { rig: frame.rig, images: frame.images }).collect();
    Ok(Some(KnownRigs { rigs, frames, refine_extrinsics }))
}
