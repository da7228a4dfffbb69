//! `point_triangulator` and `image_registrator`: points and further images for a model whose poses
//! are constant.

use std::collections::BTreeSet;
use std::path::Path;

use tiepoint_pipeline::input::ImageFolder;
use tiepoint_pipeline::io::colmap::Format;
use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::sfm;
use tiepoint_pipeline::sfm::adjust::{AdjustOptions, RefineIntrinsics, Scope};
use tiepoint_pipeline::sfm::geometry::Rng;
use tiepoint_pipeline::sfm::register::{RegisterOptions, register_image};
use tiepoint_pipeline::sfm::scene::{CorrespondenceGraph, ImageId, PointId, Reconstruction};
use tiepoint_pipeline::sfm::tracks::{
    FilterOptions, TrackOptions, complete_tracks, filter_all_points, merge_tracks, retriangulate,
    triangulate_image,
};
use tiepoint_pipeline::stages::color_points;
use tiepoint_pipeline::{Error, Event, Stage, Watch, emit};

use super::map::{MappedFolder, for_scene, transferred};
use super::output::write_model;
use super::scene::{ids_of, read_graph, read_scene};

/// Rounds of completion, adjustment of the points and filtering, as in COLMAP.
const ROUNDS: usize = 5;
/// Rounds end when fewer than this share of the observations changes.
const MIN_CHANGE: f64 = 0.0005;

/// Options of [`triangulate`].
#[derive(Clone, Copy, Debug)]
pub struct TriangulateOptions {
    /// Whether the points of the model are dropped first.
    pub clears_points: bool,
    /// Intrinsics that are refined with the points.
    pub refine: RefineIntrinsics,
    /// Options of track creation.
    pub tracks: TrackOptions,
    /// Options of the point filter.
    pub filter: FilterOptions,
    /// Fewest verified matches of a pair.
    pub min_matches: usize,
    /// Whether points get colours.
    pub extract_colors: bool,
}

/// Triangulates the points of a model from the matches of a database. Poses are constant. Writes
/// the model to `output`. `images`: the folder of the images, for colours.
///
/// # Errors
///
/// The database or the model cannot be read, they have no image in common, the adjustment fails,
/// writing fails, or `watch` returns `Break`.
pub fn triangulate(
    database: &Path,
    images: Option<&Path>,
    input: &Path,
    output: &Path,
    options: &TriangulateOptions,
    watch: Watch,
) -> Result<MappedFolder, Error> {
    options.tracks.validate()?;
    options.filter.validate()?;
    let Opened { mut model, graph } = open(database, input, options.min_matches)?;
    if options.clears_points {
        let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
        points.into_iter().for_each(|point| model.delete_track(point));
    }
    let posed: BTreeSet<ImageId> = model.registered().map(|(id, ..)| id).collect();
    let (stage, total) = (Stage::Map, posed.len());
    emit(watch, &Event::StageBegan { stage, total, done: 0 })?;
    for (index, &image) in posed.iter().enumerate() {
        triangulate_image(&graph, &mut model, image, &options.tracks);
        let (registered, points) = (index + 1, model.num_tracks());
        let image = model.image(image).name.as_str();
        emit(watch, &Event::ImageRegistered { image, registered, points })?;
    }
    let adjust = AdjustOptions {
        refine: options.refine,
        constant_poses: Some(&posed),
        constant_rigs: true,
        ..AdjustOptions::default()
    };
    for _ in 0..ROUNDS {
        let before = model.num_observations();
        retriangulate(&graph, &mut model, &options.tracks);
        let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
        let completed = complete_tracks(&graph, &mut model, &points, &options.tracks);
        let merged = merge_tracks(&graph, &mut model, &points, &options.tracks);
        if model.num_tracks() == 0 {
            break;
        }
        sfm::adjust::adjust(&mut model, &Scope::Global, &adjust, &mut [], &mut |step| {
            watch(&Event::AdjustmentStep { step: step.number, cost: step.cost })
        })
        .map_err(Error::adjusting(input))?;
        let filtered = filter_all_points(&mut model, &options.filter);
        let changed = completed + merged + filtered;
        if (changed as f64) < MIN_CHANGE * before.max(1) as f64 {
            break;
        }
    }
    if let (Some(images), true) = (images, options.extract_colors) {
        let folder = ImageFolder::as_stored(images, None).map_err(Error::from);
        if let Err(error) =
            folder.and_then(|folder| color_points(&folder, [&mut model].into_iter()))
        {
            emit(watch, &Event::ColorsMissing { reason: &error.to_string() })?;
        }
    }
    write(&model, output)
}

/// Registers the images of a database that a model lacks, and writes the model to `output`. Its
/// poses and points stay where they are.
///
/// # Errors
///
/// The database or the model cannot be read, they have no image in common, writing fails, or
/// `watch` returns `Break`.
pub fn register(
    database: &Path,
    input: &Path,
    output: &Path,
    options: &RegisterOptions,
    min_matches: usize,
    seed: u64,
    watch: Watch,
) -> Result<MappedFolder, Error> {
    let Opened { mut model, graph } = open(database, input, min_matches)?;
    let absent: Vec<ImageId> = model
        .images()
        .filter(|(_, image)| image.cam_from_world().is_none())
        .map(|(id, _)| id)
        .collect();
    let (stage, total) = (Stage::Map, absent.len());
    emit(watch, &Event::StageBegan { stage, total, done: 0 })?;
    for (index, image) in absent.into_iter().enumerate() {
        let seed = Rng::stream(seed, &[u64::from(image.0)]).next_u64();
        register_image(&graph, &mut model, image, options, seed);
        let (registered, points) = (index + 1, model.num_tracks());
        let image = model.image(image).name.as_str();
        emit(watch, &Event::ImageRegistered { image, registered, points })?;
    }
    write(&model, output)
}

/// A model with the images of a database, and their correspondences.
struct Opened {
    model: Reconstruction,
    graph: CorrespondenceGraph,
}

fn open(database: &Path, input: &Path, min_matches: usize) -> Result<Opened, Error> {
    let database = Database::open_read_only(database)?;
    let scene = read_scene(&database)?;
    let graph = read_graph(&database, &scene, min_matches, &|_| true, 0)?;
    let mut model = transferred(&scene, input)?.scene;
    model.original_ids = ids_of(&database);
    let graph = for_scene(&graph, &model);
    Ok(Opened { model, graph })
}

fn write(model: &Reconstruction, output: &Path) -> Result<MappedFolder, Error> {
    write_model(output, model, Format::Binary)?;
    Ok(MappedFolder {
        path: output.to_owned(),
        images: model.num_registered(),
        points: model.num_tracks(),
        mean_reprojection_error_px: model.mean_reprojection_error_px(),
    })
}
