//! Third stage: poses and points, from the database to `sparse/`, `points.ply` and the report.

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use tiepoint_io::colmap::{Format, write_model};
use tiepoint_io::database::Database;
use tiepoint_io::{ply, timestamps};
use tiepoint_sfm::scene::{CorrespondenceGraph, Image, ImageId, Reconstruction};
use tiepoint_sfm::{self as sfm, Finish, MapperOptions, RefineIntrinsics, RigTerm, VerifyOptions, rig_pairs};

use crate::colors::color_points;
use crate::matching::keypoint;
use crate::metric::{ScaleReport, scale_to_baseline};
use crate::records::{Progress, Recipe, write_json};
use crate::rig_file::RigFile;
use crate::rig_report::{Held, History, SplitReport};
use crate::{Error, Event, MapReport, ModelReport, RigReport, Stage, Watch, Workspace, features, tell};

/// How to map.
#[derive(Clone, Copy, Debug, Default)]
pub struct MapOptions {
    /// The mapper.
    pub mapper: MapperOptions,
    /// Distance of the first camera and the next, in metres: it sets the size of the models.
    pub baseline_m: Option<f64>,
}

/// Maps a workspace that has matches: models of everything that hangs together, the largest first.
pub fn map(
    workspace: &mut Workspace,
    options: &MapOptions,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    const STAGE: Stage = Stage::Map;
    let MapOptions { mapper: mut options, baseline_m } = *options;
    if workspace.records.option(Stage::Features, features::INTRINSICS).is_some() {
        options.refine = RefineIntrinsics::NONE;
    }
    let words =
        [("mapper", Some(format!("{options:?}"))), ("baseline", baseline_m.map(|b| format!("{b} m")))];
    let words = words.into_iter().filter_map(|(name, word)| Some((name, word?)));
    let recipe = Recipe::new(workspace.fingerprint(Stage::Match)?, words);
    let progress = workspace.begin(STAGE, &recipe, redo)?;
    if progress == Progress::Kept {
        return tell(watch, &Event::StageKept { stage: STAGE });
    }
    let start = Instant::now();
    let (graph, scene) = load(workspace)?;
    let total = scene.images().filter(|(_, image)| !image.keypoints.is_empty()).count();
    tell(watch, &Event::StageBegan { stage: STAGE, total, done: 0 })?;
    if graph.pairs().is_empty() {
        let required = VerifyOptions::default().min_num_inliers;
        return Err(no_overlap(workspace, required)?);
    }
    match options.rig {
        RigTerm::Off | RigTerm::Auto => {}
        term => require_moments(workspace, &scene, term)?,
    }
    if options.readout.is_some() && !is_timed(&scene) {
        return Err(Error::NoMotion { path: workspace.root().to_owned() });
    }
    let name = |id| scene.image(id).name.as_str();
    let (mut began, mut bad_pairs, mut held) = (Vec::new(), Vec::new(), Vec::new());
    let (mut cameras, mut split, mut shutters) = (Vec::new(), None, Vec::new());
    let (mut loops, mut failed) = (Vec::new(), Vec::new());
    let database = Database::open(&workspace.database())?;
    let mut unreadable = None;
    let mut descriptors = |image| match database.read_features(image) {
        Ok(features) => features.descriptors,
        Err(error) => {
            unreadable.get_or_insert(error);
            Vec::new()
        }
    };
    let mut models = sfm::map(&graph, &scene, &mut descriptors, &options, &mut |event| {
        match event {
            sfm::Event::Initialised { image1, image2, .. } => began.push((*image1, *image2)),
            sfm::Event::BadPair { left, right } => bad_pairs.push((*left, *right)),
            sfm::Event::Joined { .. } => {
                held.clear();
                bad_pairs.clear();
            }
            sfm::Event::Shutter(shutter) => shutters.push(*shutter),
            sfm::Event::LoopClosed { num_pairs } => {
                loops.extend(began.last().map(|&(image, _)| (image, *num_pairs)));
            }
            sfm::Event::Failed { finish, why } => {
                if *finish == Finish::Held {
                    (cameras, split) = (Vec::new(), None);
                }
                failed.extend(began.last().map(|&(image, _)| (image, what_failed(*finish, why))));
            }
            sfm::Event::SplitClosed { num_images, num_pairs } => {
                split = Some(SplitReport { images: *num_images, pairs_matched_again: *num_pairs });
            }
            sfm::Event::MountedCamera(camera) => cameras.push((**camera).clone()),
            sfm::Event::Mounted { hold, error_off_px, error_px, .. } => {
                let (hold, error_off_px, error_px) = (*hold, *error_off_px, *error_px);
                let (cameras, split) = (std::mem::take(&mut cameras), split.take());
                held.push(Held { hold, error_off_px, error_px, cameras, split });
            }
            _ => {}
        }
        translate(event, &name).map_or(ControlFlow::Continue(()), |event| watch(&event))
    })?;
    if let Some(error) = unreadable {
        return Err(error.into());
    }
    database.finish()?;
    if let Err(error) = color_points(&workspace.records.inputs, &mut models) {
        // The photos may have moved since; the model does not need them.
        tell(watch, &Event::PointsGrey { why: &error.to_string() })?;
    }
    let scales = baseline_m.map(|baseline_m| scale_to_baseline(&mut models, &mut held, baseline_m));
    let scales: Vec<Option<ScaleReport>> =
        scales.map_or(vec![None; models.len()], |scales| scales.into_iter().map(Some).collect());
    let history = History { began, bad_pairs, held };
    let paths = write_models(workspace, &models)?;
    write_rig(workspace, models.first(), &history)?;
    let all = paths.into_iter().zip(&models).zip(scales);
    let reports = all.map(|((path, model), scale)| {
        let metres_per_unit = scale.as_ref().and_then(|scale| scale.factor).unwrap_or(1.0);
        let rig = RigReport::new(options.rig, model, &history, metres_per_unit);
        let is_here = |image: ImageId| model.image(image).cam_from_world().is_some();
        let loop_pairs = loops.iter().filter(|(image, _)| is_here(*image)).map(|(_, pairs)| pairs).sum();
        let failed =
            failed.iter().filter(|(image, _)| is_here(*image)).map(|(_, what)| what.clone()).collect();
        ModelReport { scale, loop_pairs, failed, ..ModelReport::new(path, model, &shutters, rig) }
    });
    let reports = reports.collect();
    let seconds = start.elapsed().as_secs_f64();
    workspace.update_report(|all| {
        all.stages.map = Some(MapReport { seconds });
        all.models = reports;
    })?;
    workspace.complete(STAGE)?;
    tell(watch, &Event::StageDone { stage: STAGE, seconds })
}

/// A sentence.
fn what_failed(finish: Finish, why: &str) -> String {
    let what = match finish {
        Finish::Straightened => "what a rolling shutter did could not be taken off the keypoints",
        Finish::Held => "the cameras could not be held to each other",
    };
    format!("{what}, and the model is as it was before: {why}")
}

/// The scene without poses, and what relates its images, as they stand in the database.
fn load(workspace: &Workspace) -> Result<(CorrespondenceGraph, Reconstruction), Error> {
    let database = Database::open(&workspace.database())?;
    let mut scene = Reconstruction::default();
    for camera in database.read_cameras()? {
        scene.add_camera(camera);
    }
    let path = workspace.timestamps();
    let times = if path.is_file() { timestamps::read(&path)? } else { BTreeMap::new() };
    for (index, image) in database.read_images()?.into_iter().enumerate() {
        let keypoints = database.read_keypoints(ImageId::from_index(index))?;
        let mut image = Image::new(image.name, image.camera, keypoints.iter().map(keypoint).collect());
        image.time_s = times.get(&image.name).copied();
        scene.add_image(image);
    }
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let graph = CorrespondenceGraph::new(&counts, database.read_two_views()?);
    database.finish()?;
    Ok((graph, scene))
}

fn no_overlap(workspace: &Workspace, required: usize) -> Result<Error, Error> {
    let matches = Database::open(&workspace.database())?.read_matches()?;
    let best = matches.iter().map(|(_, matches)| matches.len()).max().unwrap_or(0);
    Ok(Error::NoOverlap { path: workspace.root().to_owned(), pairs: matches.len(), best, required })
}

/// What the mapper tells, with names for ids.
fn translate<'a>(event: &sfm::Event, name: &dyn Fn(ImageId) -> &'a str) -> Option<Event<'a>> {
    Some(match *event {
        sfm::Event::Initialised { image1, image2, num_points } => {
            Event::ModelBegan { image1: name(image1), image2: name(image2), points: num_points }
        }
        sfm::Event::Registered { image, num_registered, num_points, .. } => {
            Event::ImageRegistered { image: name(image), registered: num_registered, points: num_points }
        }
        sfm::Event::Adjusted { num_images, num_observations, cost, iterations } => {
            Event::ModelAdjusted { images: num_images, observations: num_observations, cost, iterations }
        }
        sfm::Event::LoopClosed { num_pairs } => Event::LoopClosed { pairs: num_pairs },
        // These are for the report.
        sfm::Event::BadPair { .. }
        | sfm::Event::Failed { .. }
        | sfm::Event::Joined { .. }
        | sfm::Event::Shutter(_)
        | sfm::Event::SplitClosed { .. }
        | sfm::Event::MountedCamera(_)
        | sfm::Event::Mounted { .. } => return None,
    })
}

/// A rig term joins moments at which two cameras took an image; without two of them it would silently be nothing. With times on
/// clocks of their own, images need no partner.
fn require_moments(workspace: &Workspace, scene: &Reconstruction, term: RigTerm) -> Result<(), Error> {
    let has_times = term != RigTerm::Paper
        && scene.cameras().count() > 1
        && scene.images().all(|(_, i)| i.time_s.is_some());
    if has_times || rig_pairs(scene).iter().any(|rig| rig.pairs.len() >= 2) {
        return Ok(());
    }
    let cameras = scene.cameras().count();
    Err(Error::NoMoments { path: workspace.root().to_owned(), cameras })
}

/// Whether some camera has enough images with times to be followed through them.
fn is_timed(scene: &Reconstruction) -> bool {
    const MIN_TIMES: usize = 4;
    let times = |id| scene.images().filter(|(_, i)| i.camera == id && i.time_s.is_some()).count();
    scene.cameras().any(|(id, _)| times(id) >= MIN_TIMES)
}

/// Writes all models beside the old ones, then puts them in their place. Returns their folders, relative to the workspace.
fn write_models(workspace: &Workspace, models: &[Reconstruction]) -> Result<Vec<String>, Error> {
    let sparse = workspace.sparse();
    let (new, old) = (workspace.root().join(".sparse.new"), workspace.root().join(".sparse.old"));
    remove(&new)?;
    for (index, model) in models.iter().enumerate() {
        write_model(&new.join(index.to_string()), model, Format::Binary)?;
    }
    if sparse.exists() {
        remove(&old)?;
        rename(&sparse, &old)?;
    }
    rename(&new, &sparse)?;
    remove(&old)?;
    if let Some(largest) = models.first() {
        ply::write(&workspace.points(), &ply::points(largest))?;
    }
    Ok((0..models.len()).map(|index| format!("sparse/{index}")).collect())
}

/// `rig.json` of the largest model; gone where no camera is held to another.
fn write_rig(workspace: &Workspace, model: Option<&Reconstruction>, history: &History) -> Result<(), Error> {
    let path = workspace.rig();
    let held = history.held.first();
    match model.zip(held).and_then(|(model, held)| RigFile::new(model, &held.cameras)) {
        Some(rig) => write_json(&path, &rig),
        None => match fs::remove_file(&path) {
            Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => Err(Error::Output { path, cause }),
            _ => Ok(()),
        },
    }
}

fn rename(from: &Path, to: &Path) -> Result<(), Error> {
    fs::rename(from, to).map_err(|cause| Error::Output { path: to.to_owned(), cause })
}

fn remove(dir: &Path) -> Result<(), Error> {
    match fs::remove_dir_all(dir) {
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::Output { path: dir.to_owned(), cause })
        }
        _ => Ok(()),
    }
}
