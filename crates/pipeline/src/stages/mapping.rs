//! Stage 3: incremental mapping from the database to `sparse/`, `points.ply`, `rig.json` and the
//! report.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::PathBuf;

use tiepoint_input::cameras::{Calibration, CalibrationFacts};
use tiepoint_input::fingerprint::hash_file;
use tiepoint_input::{ImageFolder, Size};
use tiepoint_io::colmap::Format;
use tiepoint_io::database::{Database, DatabaseFrame};
use tiepoint_io::features::Descriptors;
use tiepoint_io::{ply, timestamps};
use tiepoint_sfm::adjust::{RefineIntrinsics, Term};
use tiepoint_sfm::geometry::OptionError;
use tiepoint_sfm::rigs::{have_numbered_frames, rig_candidates, rig_pairs};
use tiepoint_sfm::scene::KnownRigs;
use tiepoint_sfm::scene::{
    Camera, CameraId, CorrespondenceGraph, Georeference, Image, ImageId, Reconstruction,
    TwoViewKind,
};
use tiepoint_sfm::two_view::VerifyOptions;
use tiepoint_sfm::{
    self as sfm, ExistingPoses, Failure, MappedModel, Mapper, MapperOptions, OptionalStage, RigMode,
};

use crate::shard::Shard;
use crate::stages::calibration_priors::{calibrations_of, set_calibration_priors};
use crate::stages::checkpoint::{CheckpointFile, MAGIC, key_of};
use crate::stages::colors::color_points;
use crate::stages::control_points::{ControlPoints, PlacedByPoints};
use crate::stages::foreign_database::require_descriptors;
use crate::stages::input_model::{InputModel, OpenedModel};
use crate::stages::option_keys;
use crate::stages::positions::{FoundPositions, Placed, PositionPriors, ScaleOf, ScenePositions};
use crate::stages::rig_calibration::known_rigs;
use crate::stages::rig_hints::why_no_rig;
use crate::stages::scale::scale_to_baseline;
use crate::stages::submaps::{Parts, Submaps};
use crate::stages::unregistered::{gaps, unregistered_images};
use crate::stages::warnings::warnings_of_models;
use crate::workspace::database_scene::read_scene;
use crate::workspace::file_names::{GEOREFERENCE, SPARSE, is_rig_name, model_path, rig_name};
use crate::workspace::folder::{POINTS, rigs_in};
use crate::workspace::format;
use crate::workspace::image_names::stream_of;
use crate::workspace::model_output::{model_names, stage_with_sidecar};
use crate::workspace::option_names;
use crate::workspace::records::Recipe;
use crate::workspace::report::{MapReport, ModelReport, PositionReport, ScaleReport};
use crate::workspace::rig_file::RigFile;
use crate::workspace::rig_report::RigReport;
use crate::workspace::shards::ShardReport;
use crate::workspace::sidecar::GeoreferenceFacts;
use crate::workspace::stage_run::{StageRequest, StageResult, StageRun};
use crate::workspace::warning::Warning;
use crate::{Error, Event, Stage, Watch, Workspace, emit};

/// Options of mapping.
#[derive(Clone, Debug, Default)]
pub struct MapOptions {
    /// Options of the mapper.
    pub mapper: MapperOptions,
    /// Intrinsics to refine, calibrated ones with a prior at the calibration; `None`: those of
    /// [`MapOptions::mapper`], calibrated ones only if the images contradict them.
    pub refine: Option<RefineIntrinsics>,
    /// Standard deviation of calibrated intrinsics: how far the error of each parameter moves
    /// pixels at the border of the image ([`sfm::scene::IntrinsicsPrior::new`]), in pixels. `None`:
    /// it is 1 px, and calibrations are kept unless the images contradict them or
    /// [`MapOptions::refine`] is given.
    pub calibration_sigma_px: Option<f64>,
    /// Known distance between the first two cameras, in metres: it determines the scale of the
    /// models.
    pub baseline_m: Option<f64>,
    /// The model to go on from.
    pub input_model: Option<InputModel>,
    /// Known rigs: COLMAP's `rig_config.json` or Kalibr's camchain. Frames are registered as a
    /// whole, and [`MapperOptions::rig`] has no effect.
    pub rig_calibration: Option<PathBuf>,
    /// Whether the extrinsics of the known rigs are initial values, which are refined.
    pub refine_extrinsics: bool,
    /// Measured positions of the photos. The models are moved into their frame; in adjustments they
    /// take part if held-out ones say that it helps.
    pub position_priors: PositionPriors,
    /// A file of control points: the models are moved into their frame, and adjusted together with
    /// them. [`MapOptions::position_priors`] are then not used.
    pub control_points: Option<PathBuf>,
    /// Whether the images are mapped in parts.
    pub submaps: Submaps,
    /// Memory for sub-maps, in bytes, which decides how many are mapped at once; `None`: half of
    /// what is free. The result does not depend on it.
    pub max_memory_bytes: Option<u64>,
    /// Whether all sub-maps must be there ([`map_submap`]); else those that are missing are mapped.
    pub merges_submaps: bool,
}

/// Value of [`MapOptions::calibration_sigma_px`] if none is given: an assumption, not an estimate.
/// Calibration boards are detected to a tenth of a pixel, but lenses change with focus and
/// temperature, and lens models leave some tenths. `docs/benchmarks/drives.md` has half, double and
/// less.
const CALIBRATION_SIGMA_PX: f64 = 1.0;

/// Maps a workspace that has matches and writes its models, the largest first.
///
/// # Errors
///
/// The workspace has no matches; the stage was run with other options, and `redo` does not ask for
/// it; the input model cannot be read, has no image in common with the workspace, or contradicts
/// another option; a focal length is to be constant and is not known; no image pair overlaps; a rig
/// constraint or a rolling shutter is asked for and the capture times do not suffice; the mapper
/// fails; a file cannot be read or written; `watch` returns `Break`.
pub fn map(
    workspace: &mut Workspace,
    map_options: &MapOptions,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    let is_redone = redo == Some(Stage::Map);
    let mut request = MapRequest::new(workspace, map_options, is_redone, watch)?;
    let recipe = Recipe::new(workspace.fingerprint(Stage::Match)?, request.take_texts());
    let fingerprint = recipe.fingerprint();
    let stage = StageRequest { stage: Stage::Map, recipe: recipe.clone(), redo, inputs: None };
    workspace.run_stage(stage, watch, |run| {
        // Foreign files are detected before mapping. Old models stay until the new ones are
        // complete.
        let may_be_on_earth = request.positions.is_some()
            || request.control_points.is_some()
            || request.input_model.is_some();
        let replaced = replaced_names(run.workspace, may_be_on_earth);
        run.workspace.folder.ensure_writable(replaced.iter().map(String::as_str))?;
        let mut input = request.read(run.workspace, run.watch)?;
        run.began(num_images(&input.scene), 0)?;
        request.check(run.workspace, &input)?;
        input.submaps = request.submaps(run, &input, &recipe)?;
        let key = key_of(&fingerprint, &input.scene, &input.graph);
        let mapped = request.map(run, &input, key)?;
        request.finish(run, &input, mapped, replaced)
    })?;
    // What cannot be removed is not used.
    let _ = workspace.folder.remove_state(MAGIC);
    Ok(())
}

/// Maps a part of the images of a workspace that has matches into its tile, from which [`map`] with
/// the same options takes it. The first part comes first: the others begin with its intrinsics.
///
/// # Errors
///
/// Those of [`map`]; there is no part of this number; the first part is not mapped; an existing
/// tile is damaged, or of other matches or options.
pub fn map_submap(
    workspace: &mut Workspace,
    map_options: &MapOptions,
    number: NonZeroUsize,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<ShardReport, Error> {
    let (stage, is_redone) = (Stage::Map, redo == Some(Stage::Map));
    let mut request = MapRequest::new(workspace, map_options, is_redone, watch)?;
    let recipe = Recipe::new(workspace.fingerprint(Stage::Match)?, request.take_texts());
    let input = request.read(workspace, watch)?;
    request.check(workspace, &input)?;
    let path = || workspace.root().to_owned();
    let parts = request.parts(&input).ok_or_else(|| Error::NoSubmaps { path: path() })?;
    let count = parts.count();
    let shard = Shard::all(count).nth(number.get() - 1);
    let shard = shard.ok_or_else(|| Error::NoSubmap { path: path(), number, count })?;
    let first = Shard::all(count).next().filter(|first| *first != shard);
    let name = |id| input.scene.image(id).name.as_str();
    let workspace = &*workspace;
    workspace.run_shard(stage, (shard, &recipe), redo, watch, |tile, watch| {
        // Only now: the tiles of a complete stage are gone.
        let missing = || Error::MissingFirstSubmap { path: path() };
        let of_first = |first| workspace.state_of(first, &recipe)?.ok_or_else(missing);
        let first = first.map(of_first).transpose()?;
        let total = parts.images(number.get() - 1);
        emit(watch, &Event::StageBegan { stage, total, done: 0 })?;
        let mut named = |event: &sfm::Event| {
            named_event(event, &name).map_or(ControlFlow::Continue(()), |event| watch(&event))
        };
        let state = parts.map(number.get() - 1, first.as_deref(), &mut named)?;
        Ok(tile.write_state(&state)?)
    })
}

/// What a mapping is asked to do, with what the workspace decides.
struct MapRequest<'a> {
    given: &'a MapOptions,
    options: MapperOptions,
    input_model: Option<OpenedModel>,
    /// The options for the record.
    texts: Vec<(&'static str, String)>,
    /// Whether the features came with the database of another program.
    is_imported: bool,
    positions: Option<FoundPositions>,
    control_points: Option<ControlPoints>,
    /// The number of images of a sub-map; `None` for one map.
    submap_size: Option<usize>,
}

/// What is mapped.
struct MapInput {
    scene: Reconstruction,
    graph: CorrespondenceGraph,
    known_rigs: Option<KnownRigs>,
    positions: Option<ScenePositions>,
    /// Where on the earth the frame of the input model is.
    georeference: Option<Georeference>,
    /// The states of sub-maps; none for one map.
    submaps: Vec<Vec<u8>>,
}

/// What a run of the mapper has besides the input.
enum MapperWith<'a> {
    /// Checkpoints with this key. They do not hold the state of terms.
    Checkpoints([u8; 32]),
    Term(&'a mut dyn Term),
}

/// What mapping gives.
struct Mapped {
    models: Vec<MappedModel>,
    scales: Vec<Option<ScaleReport>>,
    placed: Placed,
    controlled: PlacedByPoints,
    /// What was noted of checkpoints.
    notes: Vec<String>,
}

impl<'a> MapRequest<'a> {
    fn new(
        workspace: &mut Workspace,
        given: &'a MapOptions,
        is_redone: bool,
        watch: Watch,
    ) -> Result<Self, Error> {
        let &MapOptions { mut mapper, refine, baseline_m, refine_extrinsics, .. } = given;
        let rig_calibration = given.rig_calibration.as_deref();
        let input_model = given.input_model.as_ref().map(InputModel::open).transpose()?;
        let of_features = |option| workspace.records.option(Stage::Features, option).is_some();
        if let Some(refine) = refine {
            mapper.refine = refine;
        }
        mapper.validate()?;
        // Who states a deviation or what to refine means it.
        let is_stated = given.calibration_sigma_px.is_some() || refine.is_some();
        mapper.keep_calibrations &= !is_stated;
        if let Some(sigma_px) = given.calibration_sigma_px {
            OptionError::check_positive("calibration_sigma_px", sigma_px)?;
        }
        let is_imported = of_features(option_names::DATABASE);
        // Only an unknown lens of photos: a database, a model and the user state camera models.
        let recorded = workspace.records.option(Stage::Features, option_names::CAMERA_MODEL);
        let is_default = recorded == Some(Calibration::DEFAULT_MODEL.name())
            && !of_features(option_names::KEEPS_CAMERA_MODEL);
        mapper.select_camera_models &= !is_imported && input_model.is_none() && is_default;
        let mut texts = option_keys::mapping_options(&mapper, baseline_m);
        let has_known = input_model.is_some()
            || rig_calibration.is_some()
            || [option_names::INTRINSICS, CalibrationFacts::CALIBRATED]
                .into_iter()
                .any(of_features);
        let is_refined = has_known && mapper.refine != RefineIntrinsics::NONE;
        let sigma_px = given.calibration_sigma_px.unwrap_or(CALIBRATION_SIGMA_PX);
        let sigma_px = (is_refined && !mapper.keep_calibrations).then_some(sigma_px);
        texts.push(option_keys::calibration_sigma_option(sigma_px));
        if let Some(model) = &input_model {
            let with = "`mapper.input_model`";
            if rig_calibration.is_some() {
                return Err(Error::MovesPoses { option: "`mapper.rig_calibration`", with });
            }
            if given.control_points.is_some() {
                return Err(Error::MovesPoses { option: "`mapper.control_points`", with });
            }
            texts.extend(model.texts());
            mapper = model.options(mapper)?;
            workspace.folder.protect(model.files());
        }
        let positions_file = match &given.position_priors {
            PositionPriors::File(file) => Some(file.as_path()),
            PositionPriors::Auto | PositionPriors::Off => None,
        };
        let points_file = given.control_points.as_deref();
        let files = [rig_calibration, positions_file, points_file];
        workspace.protect_sources(files.into_iter().flatten());
        let hash = rig_calibration.map(hash_file).transpose()?;
        texts.extend(option_keys::rig_calibration_options(hash, refine_extrinsics));
        let control_points =
            given.control_points.as_deref().map(ControlPoints::read).transpose()?;
        let hash = control_points.as_ref().map(ControlPoints::hash);
        texts.push(option_keys::control_points_option(hash));
        let positions = match control_points {
            Some(_) => None,
            None => FoundPositions::read(workspace, &given.position_priors, is_redone, watch)?,
        };
        let hash = positions.as_ref().map(FoundPositions::hash);
        texts.push(option_keys::position_priors_option(hash));
        let has_frame =
            input_model.is_some() || rig_calibration.is_some() || mapper.rig == RigMode::Paper;
        // What is wrong with a database is said where it is read.
        let num_images = Database::open_read_only(&workspace.database());
        let num_images = num_images.map_or(0, |database| database.num_images());
        let submap_size = given.submaps.size(num_images, has_frame)?;
        texts.push(option_keys::submaps_option(submap_size));
        Ok(Self {
            given,
            options: mapper,
            input_model,
            texts,
            is_imported,
            positions,
            control_points,
            submap_size,
        })
    }

    /// The parts of the images; `None` for one map.
    fn parts<'i>(&'i self, input: &'i MapInput) -> Option<Parts<'i>> {
        // Parts of other photos were measured on one kind: they are for who asks for them.
        let only_sequences = self.given.submaps == Submaps::Auto;
        Parts::new(&input.graph, &input.scene, &self.options, self.submap_size?, only_sequences)
    }

    /// The states of all sub-maps, which are mapped unless they must be there.
    fn submaps(
        &self,
        run: &mut StageRun,
        input: &MapInput,
        recipe: &Recipe,
    ) -> Result<Vec<Vec<u8>>, Error> {
        let merges_submaps = self.given.merges_submaps;
        let Some(parts) = self.parts(input) else {
            let path = run.workspace.root().to_owned();
            return if merges_submaps { Err(Error::NoSubmaps { path }) } else { Ok(Vec::new()) };
        };
        if run.is_redone {
            run.workspace.remove_own_tiles(Stage::Map)?;
        }
        let found = parts.found(run.workspace, recipe)?;
        if merges_submaps {
            run.workspace.require_all(Stage::Map, &found)?;
        }
        parts.states(found, run.workspace, recipe, self.given.max_memory_bytes, run.watch)
    }

    fn take_texts(&mut self) -> Vec<(&'static str, String)> {
        std::mem::take(&mut self.texts)
    }

    /// Reads what is mapped, without sub-maps.
    fn read(&self, workspace: &Workspace, watch: Watch) -> Result<MapInput, Error> {
        let &MapOptions { refine, refine_extrinsics, .. } = self.given;
        let mut scene = load_scene(workspace)?;
        let mut calibrations = calibrations_of(&scene);
        let mut constant = BTreeSet::new();
        let refines = self.options.refine != RefineIntrinsics::NONE;
        if let Some(model) = &self.input_model {
            let keeps = model.fix_existing_frames && refine.is_none();
            let existing = apply_input_model(&mut scene, model, refines && !keeps, watch)?;
            if keeps {
                constant = existing;
            }
        }
        let georeference = scene.georeference.take();
        let graph = load_graph(workspace, &scene)?;
        let rig_calibration = self.given.rig_calibration.as_deref();
        let known_rigs = rig_calibration
            .map(|path| known_rigs(path, &mut scene, refine_extrinsics))
            .transpose()?;
        // The focal lengths of an input model or a foreign database are those that it has.
        let is_foreign = self.input_model.is_some() || self.is_imported;
        if refine.is_some_and(|refine| !refine.focal)
            && !is_foreign
            && let Some(image) = image_without_focal(&scene)
        {
            return Err(Error::UnknownFocal {
                path: workspace.root().to_owned(),
                image: image.name.clone(),
            });
        }
        if refines {
            for (camera, intrinsics) in calibrations_of(&scene) {
                calibrations.entry(camera).or_insert(intrinsics);
            }
            scene.calibrated.clear();
            calibrations.retain(|camera, _| !constant.contains(camera));
            let distortion = self.options.refine.distortion;
            let sigma_px = self.given.calibration_sigma_px.unwrap_or(CALIBRATION_SIGMA_PX);
            set_calibration_priors(&mut scene, &calibrations, distortion, sigma_px);
        }
        scene.calibrated.extend(constant);
        let positions = self.positions.as_ref().map(|found| found.of_scene(&scene)).transpose()?;
        let submaps = Vec::new();
        Ok(MapInput { scene, graph, known_rigs, positions, georeference, submaps })
    }

    /// Checks that what is asked for can be estimated from this input.
    fn check(&self, workspace: &Workspace, input: &MapInput) -> Result<(), Error> {
        let MapInput { scene, graph, .. } = input;
        if graph.pairs().is_empty() {
            let required = VerifyOptions::default().min_num_inliers;
            return Err(no_overlap(workspace, required)?);
        }
        check_times(workspace, scene, self.given)
    }

    /// Maps, sets scale and frame, and colours the points. `key` is that of the run's checkpoints.
    fn map(&self, run: &mut StageRun, input: &MapInput, key: [u8; 32]) -> Result<Mapped, Error> {
        let (mut models, notes) = self.run_mapper(run, input, MapperWith::Checkpoints(key))?;
        // One that has no initial pair went on from the input model, in its frame.
        let extended = models.iter_mut().filter(|model| model.initial_pair.is_none());
        extended.for_each(|model| model.reconstruction.georeference = input.georeference);
        let mut scales: Vec<Option<ScaleReport>> = match self.given.baseline_m {
            Some(baseline_m) => {
                let has_positions = input.positions.is_some();
                let scales = scale_to_baseline(&mut models, baseline_m, has_positions);
                scales.into_iter().map(Some).collect()
            }
            None => vec![None; models.len()],
        };
        let placed = match &input.positions {
            Some(positions) => self.place(run, input, &mut models, &scales, positions)?,
            None => Placed::default(),
        };
        // Positions may give other models.
        scales.resize(models.len(), None);
        let controlled = match &self.control_points {
            Some(points) => {
                let rigs = input.known_rigs.as_ref();
                points.place(&mut models, &self.options, rigs, run.watch)?
            }
            None => PlacedByPoints::default(),
        };
        color(run, &mut models)?;
        Ok(Mapped { models, scales, placed, controlled, notes })
    }

    /// Moves the models into the frame of measured positions. Those that were mapped with the
    /// positions replace them if held-out ones say that they are better.
    fn place(
        &self,
        run: &mut StageRun,
        input: &MapInput,
        models: &mut Vec<MappedModel>,
        scales: &[Option<ScaleReport>],
        positions: &ScenePositions,
    ) -> Result<Placed, Error> {
        if self.input_model.is_some() {
            return Ok(Placed::unused("the model of `mapper.input_model` keeps its frame"));
        }
        let seed = self.options.seed;
        let by_clock = models.first().and_then(|it| positions.by_clock(&it.reconstruction, seed));
        let by_clock = match by_clock.transpose() {
            Ok(by_clock) => by_clock,
            Err(misfit) => return Ok(Placed::unused(&misfit.to_string())),
        };
        let positions = by_clock.as_ref().unwrap_or(positions);
        let (mut comparison, mut failure) = (None, None);
        let rigs = input.known_rigs.as_ref();
        let scale_of = |model: &MappedModel| ScaleOf::model(model, None, rigs);
        let largest = models.first().map(|model| positions.align(model, scale_of(model), seed));
        if let Some(Ok(largest)) = largest
            && self.given.baseline_m.is_none()
            && positions.tell_more_than(&largest)
        {
            run.emit(&Event::Noted { what: "mapping once more, with the positions" })?;
            let mut term = positions.term(&largest, seed);
            match self.run_mapper(run, input, MapperWith::Term(&mut term)) {
                Ok((with, _)) => {
                    comparison = positions.compare(models, &with, scale_of, &largest, seed);
                    match comparison {
                        Some(found) if found.is_better() => *models = with,
                        Some(_) => {}
                        None => failure = Some(
                            "positions took no part in the adjustments: too few are held out to \
                             tell whether they help"
                                .to_owned(),
                        ),
                    }
                }
                Err(error) => failure = Some(why_not_adjusted(error)?),
            }
        }
        let of_baseline = scales.iter().map(Option::as_ref).chain(std::iter::repeat(None));
        let scales_of: Vec<ScaleOf> = models
            .iter()
            .zip(of_baseline)
            .map(|(model, scale)| ScaleOf::model(model, scale, rigs))
            .collect();
        let mut placed = positions.place(models, &scales_of, comparison.as_ref(), seed);
        placed.notes.extend(failure);
        Ok(placed)
    }

    /// Runs the mapper. Returns also what was noted of checkpoints.
    fn run_mapper(
        &self,
        run: &mut StageRun,
        input: &MapInput,
        with: MapperWith,
    ) -> Result<(Vec<MappedModel>, Vec<String>), Error> {
        let MapInput { scene, graph, known_rigs, .. } = input;
        let name = |id| scene.image(id).name.as_str();
        let database = Database::open(&run.workspace.database())?;
        // Those of another program may be missing, or of a kind that is not known.
        let has_descriptors =
            !self.is_imported || require_descriptors(run.workspace, &database).is_ok();
        let mut unreadable = None;
        let mut descriptors = |image: ImageId| {
            // The images of an input model come behind those of the database.
            if !has_descriptors || image.index() >= database.num_images() {
                return Descriptors::default();
            }
            database.read_features(image).map_or_else(
                |error| {
                    unreadable.get_or_insert(error);
                    Descriptors::default()
                },
                |features| features.descriptors,
            )
        };
        let watch = &mut *run.watch;
        let (pending, mut notes) = (RefCell::new(Vec::<String>::new()), Vec::new());
        let mut notified = |event: &sfm::Event| {
            for what in pending.take() {
                watch(&Event::Noted { what: &what })?;
                notes.push(what);
            }
            named_event(event, &name).map_or(ControlFlow::Continue(()), |event| watch(&event))
        };
        let folder = &run.workspace.folder;
        let mut checkpoints;
        let mapper = Mapper::new(graph, scene).submaps(&input.submaps);
        let mut mapper = mapper.descriptors(&mut descriptors).watch(&mut notified);
        match with {
            MapperWith::Checkpoints(key) => {
                checkpoints = CheckpointFile::new(folder, key, num_images(scene), &pending);
                mapper = mapper.checkpoints(&mut checkpoints);
            }
            MapperWith::Term(term) => mapper = mapper.term(term),
        }
        if let Some(rigs) = known_rigs {
            mapper = mapper.known_rigs(rigs);
        }
        if let Some(model) = &self.input_model {
            mapper = mapper.existing(match model.fix_existing_frames {
                true => ExistingPoses::Constant,
                false => ExistingPoses::Refined,
            });
        }
        let models = mapper.run(&self.options);
        let models = models.map_err(|cause| match (&self.input_model, known_rigs) {
            (Some(model), _) => model.error(cause),
            (None, Some(_)) => cause.into(),
            (None, None) => without_depth(run.workspace, graph, cause),
        })?;
        if let Some(error) = unreadable {
            return Err(error.into());
        }
        database.close()?;
        for what in pending.take() {
            emit(run.watch, &Event::Noted { what: &what })?;
            notes.push(what);
        }
        Ok((models, notes))
    }

    /// Stages the models, and writes the rigs into the database.
    fn finish(
        &self,
        run: &mut StageRun,
        input: &MapInput,
        mapped: Mapped,
        replaced: Vec<String>,
    ) -> Result<StageResult, Error> {
        let Mapped { models, scales, placed, controlled, mut notes } = mapped;
        let files = stage_models(run.workspace, &models)?;
        let is_known = input.known_rigs.is_some();
        let Placed { reports, factors, notes: mut of_models } = placed;
        let PlacedByPoints { reports: points, factors: of_points, notes: of_control } = controlled;
        of_models.extend(of_control);
        let factors = if of_points.is_empty() { factors } else { of_points };
        let mut reports = self.reports(&models, scales, (reports, factors), is_known);
        for (report, points) in reports.iter_mut().zip(points) {
            report.control_points = points;
        }
        let may_be_rig = self.options.rig != RigMode::Off && !is_known;
        if let Some(first) = models.first()
            && may_be_rig
            && reports.iter().all(|report| report.rig.is_none())
            && let Some(what) = why_no_rig(&first.reconstruction)
        {
            of_models.push(what);
        }
        for what in of_models {
            run.emit(&Event::Noted { what: &what })?;
            notes.push(what);
        }
        let reported = models.iter().map(|model| &model.reconstruction).zip(&reports);
        let unregistered = unregistered_images(&input.graph, &models, &self.options);
        let gaps = gaps(&input.graph, &models);
        let warnings = warnings_of_models(&input.scene, reported, gaps);
        // The rigs are written after every step that may fail: a run that ends before the stage is
        // complete repeats it and writes them again.
        if let Some(first) = models.first()
            && let Err(error) = write_rigs(run.workspace, &first.reconstruction)
            && !self.is_imported
        {
            // Tables of another program may have other columns; the model is valid without them.
            return Err(error);
        }
        let removed = replaced.into_iter().filter(|name| !files.contains(name)).collect();
        Ok(StageResult {
            files,
            removed,
            database: None,
            report: Box::new(move |all, seconds| {
                all.stages.map = Some(MapReport { seconds, notes, unregistered });
                all.models = reports;
                all.warnings.retain(Warning::is_of_matches);
                all.warnings.extend(warnings);
            }),
        })
    }

    fn reports(
        &self,
        models: &[MappedModel],
        scales: Vec<Option<ScaleReport>>,
        (mut positions, mut factors): (Vec<Option<PositionReport>>, Vec<f64>),
        is_known: bool,
    ) -> Vec<ModelReport> {
        positions.resize(models.len(), None);
        factors.resize(models.len(), 1.0);
        type Of<'a> = ((&'a MappedModel, Option<ScaleReport>), Option<PositionReport>);
        let report = |(index, ((model, scale), positions)): (usize, Of)| {
            let has_failed =
                model.failures.iter().any(|failure| failure.stage == OptionalStage::Rig);
            let mode = if is_known { RigMode::Off } else { self.options.rig };
            let by_baseline = scale.as_ref().and_then(|scale| scale.factor).unwrap_or(1.0);
            let metres_per_unit = by_baseline * factors[index];
            ModelReport {
                scale,
                loop_pairs: model.num_loop_pairs,
                other_place: names_of(&model.reconstruction, &other_images(model)),
                failed: model.failures.iter().map(|failure| describe(failure, is_known)).collect(),
                rig: RigReport::new(mode, is_known && !has_failed, model, metres_per_unit),
                positions,
                ..ModelReport::new(model_path(index), model)
            }
        };
        models.iter().zip(scales).zip(positions).enumerate().map(report).collect()
    }
}

/// Names of images, in order.
fn names_of(scene: &Reconstruction, images: &BTreeSet<ImageId>) -> Vec<String> {
    let mut names: Vec<String> =
        images.iter().map(|image| scene.image(*image).name.clone()).collect();
    names.sort();
    names
}

/// That the mapper failed with positions, as a sentence; the models without them stay.
///
/// # Errors
///
/// Any other error.
fn why_not_adjusted(error: Error) -> Result<String, Error> {
    match error {
        Error::Mapping(_) | Error::OneSpot { .. } | Error::NoModel { .. } => Ok(format!(
            "positions took no part in the adjustments: mapping with them failed: {error}"
        )),
        error => Err(error),
    }
}

/// Number of images that may get a pose.
fn num_images(scene: &Reconstruction) -> usize {
    scene.images().filter(|(_, image)| !image.keypoints.is_empty()).count()
}

/// Colours the points of models from the photos. A database of another program may come without
/// photos.
fn color(run: &mut StageRun, models: &mut [MappedModel]) -> Result<(), Error> {
    let inputs = &run.workspace.records.inputs;
    if inputs.is_empty() {
        return Ok(());
    }
    let models = models.iter_mut().map(|model| &mut model.reconstruction);
    let folder = ImageFolder::open(inputs, None).map_err(Error::from);
    match folder.and_then(|folder| color_points(&folder, models)) {
        Ok(()) => Ok(()),
        // The photos may have moved; the model is valid without colours.
        Err(error) => run.emit(&Event::ColorsMissing { reason: &error.to_string() }),
    }
}

/// A failed optional stage, as a sentence. `has_known_rigs`: rigs are not estimated.
fn describe(Failure { stage, reason }: &Failure, has_known_rigs: bool) -> String {
    let stage = match stage {
        OptionalStage::RollingShutter => "the rolling-shutter correction failed",
        OptionalStage::Rig if has_known_rigs => {
            return format!("the known rig was not used, and the scale is arbitrary: {reason}");
        }
        OptionalStage::Rig => "the estimation of rig extrinsics failed",
    };
    format!("{stage}, and the model is the one before it: {reason}")
}

/// Writes the rigs and frames of the largest model into the database, so that COLMAP can go on from
/// both. It compares them by their ids.
fn write_rigs(workspace: &Workspace, model: &Reconstruction) -> Result<(), Error> {
    let mut database = Database::open(&workspace.database())?;
    let in_database = |image: &ImageId| image.index() < database.num_images();
    let is_of_database = model.frames.iter().flat_map(|frame| &frame.images).all(in_database);
    let has_rigs =
        !model.rigs.is_empty() || database.read_rigs().is_ok_and(|(rigs, _)| !rigs.is_empty());
    if is_of_database && has_rigs && database.has_rig_tables()? {
        let frames: Vec<DatabaseFrame> = model
            .frames
            .iter()
            .map(|frame| DatabaseFrame { rig: frame.rig, images: frame.images.clone() })
            .collect();
        database.write_rigs(&model.rigs, &frames)?;
    }
    database.close()?;
    Ok(())
}

/// An image of a camera whose focal length is neither given nor in EXIF.
fn image_without_focal(scene: &Reconstruction) -> Option<&Image> {
    let is_guessed = |image: &Image| {
        let camera = scene.camera(image.camera);
        !camera.has_focal_prior
            && !camera.intrinsics.kind().focal_indices().is_empty()
            && !scene.calibrated.contains(&image.camera)
    };
    scene.images().map(|(_, image)| image).find(|image| is_guessed(image))
}

/// Replaces the scene by one with the poses and points of a model. Known intrinsics must be those
/// of the model, unless they are refined. Returns the cameras of the model.
fn apply_input_model(
    scene: &mut Reconstruction,
    model: &OpenedModel,
    refines_known_intrinsics: bool,
    watch: Watch,
) -> Result<BTreeSet<CameraId>, Error> {
    let found = model.transfer(scene)?;
    let is_replaced = |(id, image): &(ImageId, &Image)| {
        !refines_known_intrinsics
            && scene.calibrated.contains(&image.camera)
            && found.existing.contains(id)
            && found.scene.camera_of(*id).intrinsics != scene.camera(image.camera).intrinsics
    };
    if let Some((_, image)) = scene.images().find(is_replaced) {
        return Err(Error::TwoCalibrations { image: image.name.clone() });
    }
    *scene = found.scene;
    emit(
        watch,
        &Event::ModelExtended {
            images: found.existing.len(),
            absent: found.num_added_images,
            other_keypoints: found.num_other_keypoints,
            points: scene.num_tracks(),
        },
    )?;
    Ok(found.cameras)
}

/// Reads the scene without poses from the database.
pub(crate) fn load_scene(workspace: &Workspace) -> Result<Reconstruction, Error> {
    let database = Database::open_read_only(&workspace.database())?;
    let mut scene = read_scene(&database)?;
    let value = |key: &str| workspace.records.option(Stage::Features, key);
    CalibrationFacts::read(value).add_to(&mut scene);
    if value(option_names::INTRINSICS).is_some() {
        scene.calibrated = scene.cameras().map(|(id, _)| id).collect();
    }
    let times = workspace.verified_timestamps()?;
    let times = times.map_or(Ok(BTreeMap::new()), |path| timestamps::read(&path))?;
    for id in (0..scene.num_images()).map(ImageId::from_index) {
        let time_s = times.get(&scene.image(id).name).copied();
        scene.set_time(id, time_s);
    }
    Ok(scene)
}

/// Reads the correspondence graph from the database. The scene may have further images.
fn load_graph(workspace: &Workspace, scene: &Reconstruction) -> Result<CorrespondenceGraph, Error> {
    let database = Database::open_read_only(&workspace.database())?;
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    Ok(CorrespondenceGraph::new(&counts, database.read_two_views()?))
}

/// [`Error::OneSpot`] if no image got a pose and most pairs agree with a homography,
/// [`Error::NoModel`] if fewer do and there is nothing to adjust, else `cause`.
fn without_depth(workspace: &Workspace, graph: &CorrespondenceGraph, cause: sfm::Error) -> Error {
    use sfm::adjust::Error::NothingToAdjust;
    let is_turn = |kind| matches!(kind, TwoViewKind::Panoramic | TwoViewKind::PlanarOrPanoramic);
    let turned = graph.pairs().values().filter(|view| is_turn(view.kind)).count();
    let verified = graph.pairs().len();
    let path = workspace.root().to_owned();
    match cause {
        sfm::Error::NoInitialPair { .. }
        | sfm::Error::Adjustment(NothingToAdjust { images: 0, .. })
            if 2 * turned > verified =>
        {
            Error::OneSpot { path, turned, verified }
        }
        sfm::Error::Adjustment(NothingToAdjust { images: 0, .. }) => {
            Error::NoModel { path, turned, verified }
        }
        cause => cause.into(),
    }
}

/// [`Error::NoOverlap`] with the numbers of the database.
fn no_overlap(workspace: &Workspace, required: usize) -> Result<Error, Error> {
    let database = Database::open(&workspace.database())?;
    let matches = database.read_matches()?;
    let best = matches.iter().map(|(_, matches)| matches.len()).max().unwrap_or(0);
    let is_given = |option: &&str| workspace.records.option(Stage::Features, option).is_some();
    let given = [option_names::INTRINSICS, option_names::FOCAL_PRIOR];
    let cameras = if given.iter().any(is_given) { vec![] } else { database.read_cameras()? };
    let value = |key: &str| workspace.records.option(Stage::Features, key);
    let calibrated = CalibrationFacts::read(value).calibrated;
    let is_from_exif = |(index, camera): &(usize, &Camera)| {
        camera.has_focal_prior
            && !camera.intrinsics.kind().focal_indices().is_empty()
            && !calibrated.contains(&CameraId::from_index(*index))
    };
    let camera = cameras.iter().enumerate().find(is_from_exif).map(|(_, camera)| camera);
    let from_exif =
        camera.map(|camera| (camera.intrinsics.mean_focal_px(), Size(camera.width, camera.height)));
    let path = workspace.root().to_owned();
    Ok(Error::NoOverlap { path, pairs: matches.len(), best, required, from_exif })
}

/// An event of the mapper with image names in place of ids.
pub fn named_event<'a>(event: &sfm::Event, name: &dyn Fn(ImageId) -> &'a str) -> Option<Event<'a>> {
    Some(match *event {
        sfm::Event::Initialised { image1, image2, num_points } => Event::ModelInitialised {
            image1: name(image1),
            image2: name(image2),
            points: num_points,
        },
        sfm::Event::Registered { image, num_registered, num_points, .. } => {
            Event::ImageRegistered {
                image: name(image),
                registered: num_registered,
                points: num_points,
            }
        }
        sfm::Event::Adjusted { num_images, num_observations, cost, iterations } => {
            Event::ModelAdjusted {
                images: num_images,
                observations: num_observations,
                cost,
                iterations,
            }
        }
        sfm::Event::LoopClosed { num_pairs } => Event::LoopClosed { pairs: num_pairs },
        // The report has these.
        sfm::Event::Failed(_) | sfm::Event::Merged { .. } | sfm::Event::Divided { .. } => {
            return None;
        }
    })
}

/// Checks that the cameras and the capture times suffice for what is asked for. The images need no
/// keypoints.
///
/// # Errors
///
/// [`Error::NoSynchronousImages`], [`Error::NoTimedSequence`].
pub(crate) fn check_times(
    workspace: &Workspace,
    scene: &Reconstruction,
    options: &MapOptions,
) -> Result<(), Error> {
    match options.mapper.rig {
        RigMode::Off | RigMode::Auto => {}
        _ if options.rig_calibration.is_some() => {}
        mode => require_synchronous_images(workspace, scene, mode)?,
    }
    if options.mapper.readout.is_some() && !is_timed(scene) {
        return Err(Error::NoTimedSequence { path: workspace.root().to_owned() });
    }
    Ok(())
}

/// Checks that a rig constraint has something to constrain: two cameras with two pairs of
/// synchronous images, or, except for `paper`, times of all images of two cameras, whose clocks
/// need not be synchronised, or numbers of their frames.
///
/// # Errors
///
/// [`Error::NoSynchronousImages`].
fn require_synchronous_images(
    workspace: &Workspace,
    scene: &Reconstruction,
    mode: RigMode,
) -> Result<(), Error> {
    let has_times =
        rig_candidates(scene).len() > 1 && scene.images().all(|(_, i)| i.time_s.is_some());
    let has_clocks = mode != RigMode::Paper && (has_times || have_numbered_frames(scene));
    if has_clocks || rig_pairs(scene).iter().any(|rig| rig.pairs.len() >= 2) {
        return Ok(());
    }
    let path = workspace.root().to_owned();
    let candidates = rig_candidates(scene);
    let mut names = candidates.keys().map(|camera| stream_of(scene, *camera));
    match (names.next(), candidates.len()) {
        (Some(camera), 1) => Err(Error::OneCamera { camera }),
        (_, cameras) => Err(Error::NoSynchronousImages { path, cameras }),
    }
}

/// Whether a camera has enough images with times for the interpolation of its motion.
fn is_timed(scene: &Reconstruction) -> bool {
    const MIN_TIMES: usize = 4;
    let times = |id| scene.images().filter(|(_, i)| i.camera == id && i.time_s.is_some()).count();
    scene.cameras().any(|(id, _)| times(id) >= MIN_TIMES)
}

/// Names of all existing files of models, which new models replace. A georeference that is not ours
/// is replaced only if there may be a new one.
fn replaced_names(workspace: &Workspace, may_be_on_earth: bool) -> Vec<String> {
    let prefix = format!("{SPARSE}/");
    let earlier = workspace.folder.names().filter(|name| name.starts_with(&prefix));
    let mut names: BTreeSet<String> = earlier.map(str::to_owned).collect();
    let models = (0..).map(model_path).take_while(|model| workspace.root().join(model).is_dir());
    names.extend(models.flat_map(|model| model_names(Some(&model))));
    names.insert(POINTS.to_owned());
    // One that cannot be read is refused before mapping.
    if may_be_on_earth || workspace.folder.is_unmodified(GEOREFERENCE).unwrap_or(true) {
        names.insert(GEOREFERENCE.to_owned());
    }
    names.extend(workspace.folder.names().filter(|name| is_rig_name(name)).map(str::to_owned));
    // Also foreign files, which are then rejected before mapping.
    names.extend(rigs_in(workspace.root()));
    names.retain(|name| std::fs::symlink_metadata(workspace.root().join(name)).is_ok());
    names.into_iter().collect()
}

/// Stages all models, their rig extrinsics, and the cloud of the largest. Returns the file names.
///
/// # Errors
///
/// A file cannot be written.
fn stage_models(workspace: &Workspace, models: &[MappedModel]) -> Result<Vec<String>, Error> {
    let mut names = Vec::new();
    let Some(largest) = models.first() else { return Ok(names) };
    ply::write(&workspace.folder.stage(POINTS)?, &ply::points(&largest.reconstruction))?;
    names.push(POINTS.to_owned());
    // All models are in one frame.
    let georeference = models.iter().find_map(|model| model.reconstruction.georeference.as_ref());
    if let Some(georeference) = georeference {
        let facts = GeoreferenceFacts::from(georeference);
        workspace.folder.stage_bytes(GEOREFERENCE, &format::to_json(&facts))?;
        names.push(GEOREFERENCE.to_owned());
    }
    for (index, MappedModel { reconstruction, rig, shutters, .. }) in models.iter().enumerate() {
        let rig = rig.as_ref().and_then(|rig| RigFile::new(reconstruction, rig));
        if let Some(rig) = &rig {
            let name = rig_name(index);
            workspace.folder.stage_bytes(&name, &rig.to_json())?;
            names.push(name);
        }
        names.extend(stage_with_sidecar(
            &workspace.folder,
            Some(&model_path(index)),
            reconstruction,
            Format::Binary,
            Some(&(shutters.clone(), rig)),
        )?);
    }
    Ok(names)
}

/// The images of all places that look like the one of a model.
fn other_images(model: &MappedModel) -> BTreeSet<ImageId> {
    model.other_places.iter().flat_map(|place| place.images.iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use sfm::adjust::Error::NothingToAdjust;
    use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector3};
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_sfm::rigs::{CalibratedCamera, CalibratedRig, RigConstraint, RigPair, SensorPair};
    use tiepoint_sfm::scene::{Camera, Frame, ImagePair, Match, Rig, RigId, RigSensor, TwoView};

    use super::*;
    use crate::workspace::located_model::LocatedModel;

    /// A model of two cameras with this baseline and rig extrinsics.
    fn model(baseline: f64, has_bad_pair: bool) -> MappedModel {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
        let cam_from_rig =
            Rigid3::new(UnitQuaternion::identity(), Vector3::new(-baseline, 0.0, 0.0));
        let [left, right] = ["left", "right"].map(|folder| {
            let camera = model.add_camera(camera);
            model.add_image(Image::new(format!("{folder}/0.png"), camera, Vec::new()))
        });
        model.register(left, Rigid3::identity());
        model.register(right, cam_from_rig);
        let sensor_pair =
            SensorPair::synchronised(model.image(left).camera, model.image(right).camera);
        let constraint = RigConstraint::Soft { sigma_translation: 0.1, sigma_rotation_rad: 0.1 };
        let camera = CalibratedCamera {
            sensor_pair,
            cam_from_rig,
            covariance: None,
            constraint,
            num_referenced_images: 1,
            statistics: None,
        };
        MappedModel {
            initial_pair: ImagePair::new(left, right),
            is_in_frame_of_terms: false,
            rig: Some(CalibratedRig {
                constraint: Some(constraint),
                cameras: vec![camera],
                bad_pairs: if has_bad_pair {
                    vec![RigPair { reference: left, other: right }]
                } else {
                    Vec::new()
                },
                split: None,
                error_off_px: 1.0,
                error_px: 1.0,
                held_out_change: None,
                unconstrained: Vec::new(),
                limit: None,
            }),
            reconstruction: model,
            calibration_evidence: BTreeMap::new(),
            intrinsics_sds: BTreeMap::new(),
            shutters: Vec::new(),
            row_poses: BTreeMap::new(),
            num_loop_pairs: 0,
            other_places: Vec::new(),
            failures: Vec::new(),
        }
    }

    #[test]
    fn what_sets_the_scale_is_decided_for_each_model() {
        let with = |translation: Vector3<f64>, refine_extrinsics: bool| {
            let mut mapped = model(1.0, false);
            let pose = Rigid3::new(UnitQuaternion::identity(), translation);
            let sensor =
                |camera, cam_from_rig| RigSensor { camera: CameraId(camera), cam_from_rig };
            let rig = Rig { sensors: vec![sensor(0, None), sensor(1, Some(pose))] };
            mapped.reconstruction.rigs = vec![rig.clone()];
            let images = vec![ImageId(0), ImageId(1)];
            let (rig_from_world, of_rig) = (Rigid3::identity(), RigId(0));
            mapped.reconstruction.frames = vec![Frame { rig: of_rig, rig_from_world, images }];
            (mapped, KnownRigs { rigs: vec![rig], refine_extrinsics, ..KnownRigs::default() })
        };
        let report = |factor| ScaleReport { factor, ..ScaleReport::default() };
        let (mut mapped, rigs) = with(Vector3::x(), true);
        let of = |mapped: &MappedModel, factor, rigs| {
            ScaleOf::model(mapped, Some(&report(factor)), rigs)
        };
        assert_eq!(of(&mapped, Some(2.0), None), ScaleOf::Baseline);
        // Rigs that were estimated have no scale, and a baseline without two cameras sets none.
        assert_eq!(of(&mapped, None, None), ScaleOf::Positions);
        assert_eq!(of(&mapped, None, Some(&rigs)), ScaleOf::Rig);
        mapped.is_in_frame_of_terms = true;
        assert_eq!(of(&mapped, None, Some(&rigs)), ScaleOf::Positions, "extrinsics are refined");
        let (mut mapped, rigs) = with(Vector3::x(), false);
        mapped.is_in_frame_of_terms = true;
        assert_eq!(of(&mapped, None, Some(&rigs)), ScaleOf::Rig);
        mapped.reconstruction.frames.clear();
        assert_eq!(of(&mapped, None, Some(&rigs)), ScaleOf::Positions, "no frame is in this model");
        let (mapped, rigs) = with(Vector3::zeros(), false);
        assert_eq!(of(&mapped, None, Some(&rigs)), ScaleOf::Positions, "one centre");
    }

    #[test]
    fn a_mapping_with_positions_that_fails_leaves_the_models_without() {
        assert!(matches!(why_not_adjusted(Error::Cancelled), Err(Error::Cancelled)));
        let error = Error::NoWorkspace { path: PathBuf::from("ws") };
        assert!(why_not_adjusted(error).is_err(), "not an error of the mapper");
        let error = Error::Mapping(sfm::Error::RigsOfExistingModel);
        let says = why_not_adjusted(error).unwrap();
        assert!(
            says.starts_with("positions took no part in the adjustments: mapping with"),
            "{says}"
        );
    }

    #[test]
    fn a_mapper_that_poses_no_image_is_a_sentence_on_the_photos() {
        let dir = tempfile::tempdir().unwrap();
        let workspace = Workspace::create(&dir.path().join("ws")).unwrap();
        let message = |kinds: [TwoViewKind; 3]| {
            let views = kinds.into_iter().zip(1..).map(|(kind, b)| {
                let matches = vec![Match { a: 0, b: 0 }];
                let pair = ImagePair::new(ImageId(0), ImageId(b)).unwrap();
                (pair, TwoView { kind, matches, ..TwoView::default() })
            });
            let graph = CorrespondenceGraph::new(&[1; 4], views);
            let nothing = NothingToAdjust { images: 0, points: 0, observations: 0 };
            without_depth(&workspace, &graph, nothing.into()).to_string()
        };
        let (turned, general) = (TwoViewKind::PlanarOrPanoramic, TwoViewKind::Calibrated);
        let found = message([turned, turned, general]);
        assert!(found.contains("2 of the 3 pairs that match agree with a camera that"), "{found}");
        let found = message([turned, general, general]);
        assert!(found.contains("give no model: of the 3 pairs that match, 1 agree"), "{found}");
    }

    #[test]
    fn each_model_has_its_own_rig_file() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("ws");
        let mut workspace = Workspace::create(&root).unwrap();
        let mut without = model(3.0, false);
        without.rig = None;
        let names =
            stage_models(&workspace, &[model(1.0, false), without, model(2.0, true)]).unwrap();
        workspace.publish(names, &[], |_| {}).unwrap();
        let rig = |index| {
            let path = root.join(rig_name(index));
            let text = path.is_file().then(|| std::fs::read(&path).unwrap());
            let file = text.map(|text| serde_json::from_slice(&text).unwrap());
            let located = LocatedModel::open(&root.join(model_path(index))).unwrap();
            assert_eq!((&located.rig, located.note()), (&file, None));
            file
        };
        let centre = |rig: &RigFile| rig.cameras[0].centre_in_rig[0];
        let [first, second, third] = [0, 1, 2].map(rig);
        assert_eq!(centre(&first.clone().unwrap()), 1.0);
        assert_eq!(first.unwrap().bad_pairs, [[""; 2]; 0]);
        assert_eq!(second, None);
        assert_eq!(centre(&third.clone().unwrap()), 2.0);
        let pair = ["left/0.png", "right/0.png"].map(str::to_owned);
        assert_eq!(third.unwrap().bad_pairs, [pair]);
        // New models replace all files of the old ones.
        let replaced = replaced_names(&workspace, false);
        for name in ["rig.json", "rig-2.json", "sparse/2/images.bin"] {
            assert!(replaced.iter().any(|other| other == name), "{name}: {replaced:?}");
        }
        // Also if the user has deleted a model, or if a foreign file has such a name.
        std::fs::remove_dir_all(root.join("sparse/2")).unwrap();
        std::fs::write(root.join(GEOREFERENCE), "mine").unwrap();
        let has_georeference = |has_positions| {
            replaced_names(&workspace, has_positions).iter().any(|name| name == GEOREFERENCE)
        };
        assert!(!has_georeference(false) && has_georeference(true), "without positions it stays");
        std::fs::write(root.join("rig-7.json"), "mine").unwrap();
        let replaced = replaced_names(&workspace, false);
        assert!(
            ["rig-2.json", "rig-7.json"]
                .iter()
                .all(|name| replaced.iter().any(|other| other == name))
        );
        assert!(workspace.folder.ensure_writable(replaced.iter().map(String::as_str)).is_err());
    }
}
