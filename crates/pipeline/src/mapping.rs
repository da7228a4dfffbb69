//! Third stage: poses and points, from the database to `sparse/`, `points.ply` and the report.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::time::Instant;

use tiepoint_io::colmap::Format;
use tiepoint_io::database::Database;
use tiepoint_io::{ply, timestamps};
use tiepoint_sfm::scene::{CorrespondenceGraph, Image, ImageId, Reconstruction};
use tiepoint_sfm::{self as sfm, Finish, MapperOptions, RefineIntrinsics, RigTerm, VerifyOptions, rig_pairs};

use crate::colors::color_points;
use crate::matching::keypoint;
use crate::metric::{ScaleReport, scale_to_baseline};
use crate::output_folder::model_names;
use crate::records::{Progress, Recipe, json};
use crate::rig_file::RigFile;
use crate::rig_report::{Held, History, SplitReport};
use crate::workspace::{POINTS, RIG, SPARSE};
use crate::{Error, Event, MapReport, ModelReport, RigReport, Size, Stage, Watch, Workspace, features, tell};

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
    // Refused, if at all, before hours of work. What is there stays until the new models are.
    let replaced = replaced_names(workspace);
    workspace.folder.refuse_foreign(replaced.iter().map(String::as_str))?;
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
    let staged = stage_models(workspace, &models, &history)?;
    let paths = (0..models.len()).map(model_path);
    let all = paths.zip(&models).zip(scales);
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
    let removed: Vec<String> = replaced.into_iter().filter(|name| !staged.contains(name)).collect();
    workspace.complete(STAGE);
    workspace.publish(staged, &removed, |all| {
        all.stages.map = Some(MapReport { seconds });
        all.models = reports;
    })?;
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
    let times = workspace.timestamps_as_left()?;
    let times = times.map_or(Ok(BTreeMap::new()), |path| timestamps::read(&path))?;
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
    let database = Database::open(&workspace.database())?;
    let matches = database.read_matches()?;
    let best = matches.iter().map(|(_, matches)| matches.len()).max().unwrap_or(0);
    let is_given = |option: &&str| workspace.records.option(Stage::Features, option).is_some();
    let given = [features::INTRINSICS, features::FOCAL_PRIOR];
    let cameras = if given.iter().any(is_given) { vec![] } else { database.read_cameras()? };
    let told = cameras.iter().find(|camera| camera.has_focal_prior);
    let from_exif = told.map(|camera| (camera.intrinsics.mean_focal_px(), Size(camera.width, camera.height)));
    let path = workspace.root().to_owned();
    Ok(Error::NoOverlap { path, pairs: matches.len(), best, required, from_exif })
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

/// The folder of a model, relative to the workspace.
fn model_path(index: usize) -> String {
    format!("{SPARSE}/{index}")
}

/// What new models take the place of: all files of models that are there, and what tells of them.
fn replaced_names(workspace: &Workspace) -> Vec<String> {
    let prefix = format!("{SPARSE}/");
    let earlier = workspace.folder.names().filter(|name| name.starts_with(&prefix));
    let mut names: BTreeSet<String> = earlier.map(str::to_owned).collect();
    let models = (0..).map(model_path).take_while(|model| workspace.root().join(model).is_dir());
    names.extend(models.flat_map(|model| model_names(Some(&model))));
    names.extend([POINTS, RIG].map(str::to_owned));
    names.retain(|name| std::fs::symlink_metadata(workspace.root().join(name)).is_ok());
    names.into_iter().collect()
}

/// Writes all models, the cloud of the largest, and its rig where cameras are held to each other. Gives the files' names.
fn stage_models(
    workspace: &Workspace,
    models: &[Reconstruction],
    history: &History,
) -> Result<Vec<String>, Error> {
    let mut names = Vec::new();
    let Some(largest) = models.first() else { return Ok(names) };
    ply::write(&workspace.folder.stage(POINTS)?, &ply::points(largest))?;
    names.push(POINTS.to_owned());
    let held = history.held.first();
    if let Some(rig) = held.and_then(|held| RigFile::new(largest, &held.cameras)) {
        workspace.folder.stage_bytes(RIG, &json(&rig))?;
        names.push(RIG.to_owned());
    }
    for (index, model) in models.iter().enumerate() {
        names.extend(workspace.folder.stage_model(Some(&model_path(index)), model, Format::Binary)?);
    }
    Ok(names)
}
