//! Measured positions of the photos: where they come from, and models in their frame.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};

use tiepoint_input::fingerprint::hash_bytes;
use tiepoint_io::database::Database;
use tiepoint_io::names::ByName;
use tiepoint_io::timestamps::is_absolute;
use tiepoint_io::{gpx, position_priors};
use tiepoint_sfm::MappedModel;
use tiepoint_sfm::geometry::Sim3;
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::positions::{
    Comparison, MeasuredPosition, Misfit, PositionAlignment, PositionTerm, TimedPosition,
    TrackMisfit, align, align_track, compare, held_out,
};
use tiepoint_sfm::scene::{
    Georeference, Image, ImageId, KnownRigs, Place, Position, PositionTrack, Reconstruction,
};

use crate::stages::scale::scale_extrinsics;
use crate::workspace::file_names::model_path;
use crate::workspace::option_names::POSITION_PRIORS_KEY;
use crate::workspace::report::{ClockReport, PositionReport, ScaleReport};
use crate::{Error, Event, Stage, Watch, Workspace, emit};

/// Where measured positions of the photos come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PositionPriors {
    /// Those in the database: of EXIF, or of another program.
    #[default]
    Auto,
    /// There are none.
    Off,
    /// From a file of [`position_priors`] or [`gpx`]: of images, or along the time of a clock.
    File(PathBuf),
}

/// Positions, and where they come from.
pub(crate) enum FoundPositions {
    /// By the names of photos, in the database.
    InDatabase(BTreeMap<String, Position>),
    /// By the names of photos, in a file.
    InFile(PathBuf, BTreeMap<String, Position>),
    /// By the time of a clock of their own.
    Track(PositionTrack),
}

impl FoundPositions {
    /// Reads the positions; `None` if there are none. Models that were mapped without those in the
    /// database stay so, unless the stage is redone; a note says so.
    ///
    /// # Errors
    ///
    /// A file cannot be read; `watch` returns `Break`.
    pub(crate) fn read(
        workspace: &Workspace,
        from: &PositionPriors,
        is_redone: bool,
        watch: Watch,
    ) -> Result<Option<Self>, Error> {
        let path = match from {
            PositionPriors::Off => return Ok(None),
            PositionPriors::File(path) => path,
            PositionPriors::Auto if workspace.records.is_complete(Stage::Features) => {
                let by_name = of_database(&workspace.database())?;
                return Self::unless_mapped_without(workspace, by_name, is_redone, watch);
            }
            PositionPriors::Auto => return Ok(None),
        };
        let is_gpx =
            path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gpx"));
        Ok(Some(match is_gpx {
            true => Self::Track(gpx::read(path)?),
            false if position_priors::is_track(path)? => {
                Self::Track(position_priors::read_track(path)?)
            }
            false => Self::InFile(path.clone(), position_priors::read(path)?),
        }))
    }

    /// Those in the database, unless models were mapped without.
    fn unless_mapped_without(
        workspace: &Workspace,
        by_name: BTreeMap<String, Position>,
        is_redone: bool,
        watch: Watch,
    ) -> Result<Option<Self>, Error> {
        let is_mapped_without = !is_redone
            && workspace.records.is_begun(Stage::Map)
            && workspace.records.option(Stage::Map, POSITION_PRIORS_KEY).is_none();
        if !by_name.is_empty() && is_mapped_without {
            let what = format!(
                "the models were mapped without the {} positions in database.db: `stage.redo` map \
                 uses them",
                by_name.len()
            );
            emit(watch, &Event::Noted { what: &what })?;
            return Ok(None);
        }
        Ok((!by_name.is_empty()).then_some(Self::InDatabase(by_name)))
    }

    /// Their hash, for the record of the stage.
    pub(crate) fn hash(&self) -> String {
        let line = |key: &dyn Display, position: &Position| format!("{key} {position:?}\n");
        let text: String = match self {
            Self::InDatabase(by_name) | Self::InFile(_, by_name) => {
                by_name.iter().map(|(name, position)| line(name, position)).collect()
            }
            Self::Track(track) => {
                let fixes = track.times_s().iter().zip(track.positions());
                fixes.map(|(time_s, position)| line(time_s, position)).collect()
            }
        };
        hash_bytes(text.as_bytes())
    }

    /// The positions of the images of a scene, without those that a receiver without a fix gave,
    /// and what is to be said of them.
    ///
    /// # Errors
    ///
    /// No name in a file is that of an image.
    pub(crate) fn of_scene(&self, scene: &Reconstruction) -> Result<ScenePositions, Error> {
        let (file, by_name) = match self {
            Self::InDatabase(by_name) => (None, by_name),
            Self::InFile(path, by_name) => (Some(path), by_name),
            Self::Track(track) => return Ok(ScenePositions::of_track(track)),
        };
        let count = by_name.len();
        let named = ByName::new(by_name.clone());
        let of_image = |(id, image): (ImageId, &Image)| Some((id, *named.get(&image.name)?));
        let mut found: Vec<(ImageId, Position)> = scene.images().filter_map(of_image).collect();
        let mut notes = Vec::new();
        if let Some(path) = file {
            if found.is_empty() {
                let first = by_name.keys().next().cloned().unwrap_or_default();
                let path = path.clone();
                return Err(Error::PositionsOfOthers { path, count, first });
            }
            if found.len() < count {
                let others = count - found.len();
                notes.push(format!(
                    "{others} of the {count} positions in {} are of no photo here",
                    path.display()
                ));
            }
        }
        drop_null(&mut found, &mut notes);
        drop_repeated(&mut found, &|image| scene.image(*image).name.clone(), "photo", &mut notes);
        note_missing_altitudes(&found, &mut notes);
        in_order_of_time(&mut found, scene);
        let georeference = Georeference::near(found.iter().map(|(_, position)| &position.place));
        let sigmas = common_sigmas(&found);
        let measured = found.iter().filter_map(|(image, position)| {
            let xyz = georeference?.to_local(&position.place)?;
            let has_height = !is_without_altitude(&position.place);
            Some(MeasuredPosition { image: *image, xyz, has_height, sigmas_m: sigmas(position) })
        });
        let measured = measured.collect();
        Ok(ScenePositions { measured, georeference, notes, track: Vec::new(), clock: None })
    }
}

/// The positions that the first stage put into the database: the photos may have moved since.
fn of_database(path: &Path) -> Result<BTreeMap<String, Position>, Error> {
    let database = Database::open_read_only(path)?;
    let images = database.read_images()?;
    let priors = database.read_pose_priors()?.into_iter();
    Ok(priors.map(|(image, position)| (images[image.index()].name.clone(), position)).collect())
}

/// Fewest consecutive photos with the same position that are no chance.
const MIN_REPEATED: usize = 3;

fn drop_null<K>(found: &mut Vec<(K, Position)>, notes: &mut Vec<String>) {
    let before = found.len();
    found.retain(|(_, position)| !position.place.is_null());
    if found.len() < before {
        notes.push(format!(
            "{} positions are at latitude 0 and longitude 0, as of a receiver without a fix, and \
             are not used",
            before - found.len()
        ));
    }
}

/// Of consecutive photos with the same position, as of a receiver that lost its fix or is slower
/// than the camera, keeps that of the first.
fn drop_repeated<K: Copy>(
    found: &mut Vec<(K, Position)>,
    name: &dyn Fn(&K) -> String,
    of_what: &str,
    notes: &mut Vec<String>,
) {
    let (mut kept, mut dropped, mut first) = (Vec::new(), 0, None);
    for run in found.chunk_by(|a, b| a.1.place == b.1.place) {
        if run.len() >= MIN_REPEATED {
            dropped += run.len() - 1;
            first.get_or_insert(run[1].0);
            kept.push(run[0]);
        } else {
            kept.extend_from_slice(run);
        }
    }
    *found = kept;
    if let Some(first) = first {
        notes.push(format!(
            "{dropped} positions, from {} on, repeat that of the {of_what} before, as of a \
             receiver that lost its fix, and are not used",
            name(&first)
        ));
    }
}

fn is_without_altitude(place: &Place) -> bool {
    matches!(place, Place::Geodetic { altitude_m: None, .. })
}

fn note_missing_altitudes<K>(found: &[(K, Position)], notes: &mut Vec<String>) {
    let without = found.iter().filter(|(_, position)| is_without_altitude(&position.place)).count();
    if without > 0 && without < found.len() {
        notes.push(format!(
            "{without} of {} positions have no altitude: only their places count",
            found.len()
        ));
    }
}

/// Brings positions into the order in which they were measured. Where times are missing, the images
/// of each folder follow its path, and the folders go along it side by side.
fn in_order_of_time(found: &mut [(ImageId, Position)], scene: &Reconstruction) {
    let time_s = |id: &ImageId| scene.image(*id).time_s;
    if found.iter().all(|(id, _)| time_s(id).is_some()) {
        found.sort_by(|(a, _), (b, _)| {
            time_s(a).unwrap_or(0.0).total_cmp(&time_s(b).unwrap_or(0.0))
        });
        return;
    }
    let folder = |id: &ImageId| scene.image(*id).name.rsplit_once('/').map_or("", |(f, _)| f);
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for (_, image) in scene.images() {
        *counts.entry(image.name.rsplit_once('/').map_or("", |(f, _)| f)).or_default() += 1;
    }
    let mut begun: BTreeMap<&str, usize> = BTreeMap::new();
    let mut places: BTreeMap<ImageId, f64> = BTreeMap::new();
    for (id, _) in scene.images() {
        let folder = folder(&id);
        let index = begun.entry(folder).or_default();
        places.insert(id, *index as f64 / counts[folder] as f64);
        *index += 1;
    }
    found.sort_by(|(a, _), (b, _)| places[a].total_cmp(&places[b]));
}

/// Of satellites, heights are about twice as uncertain as places.
const VERTICAL_FACTOR: f64 = 2.0;

/// Deviations of a position along a horizontal axis and of the height. Where half of the positions
/// state one, the others have their median; else none counts.
fn common_sigmas<K>(found: &[(K, Position)]) -> impl Fn(&Position) -> Option<[f64; 2]> + use<K> {
    let mut stated: Vec<f64> =
        found.iter().filter_map(|(_, position)| position.sigma_horizontal_m).collect();
    let common = (2 * stated.len() >= found.len()).then(|| median(&mut stated)).flatten();
    move |position| {
        let horizontal = position.sigma_horizontal_m.or(common).filter(|_| common.is_some())?;
        Some([horizontal, position.sigma_vertical_m.unwrap_or(VERTICAL_FACTOR * horizontal)])
    }
}

/// The positions of the images of a scene, in a frame near them.
pub(crate) struct ScenePositions {
    pub(crate) measured: Vec<MeasuredPosition>,
    pub(crate) georeference: Option<Georeference>,
    /// What is to be said of them, a sentence each.
    pub(crate) notes: Vec<String>,
    /// Those with a clock of their own, which a model makes to those of images.
    track: Vec<TimedPosition>,
    clock: Option<ClockReport>,
}

/// Of absolute times, clocks of cameras differ by the zone and what it lacks, in seconds.
const MAX_ABSOLUTE_OFFSET_S: f64 = 15.0 * 3600.0;

impl ScenePositions {
    /// Those of a track.
    fn of_track(track: &PositionTrack) -> Self {
        let fixes = track.times_s().iter().copied().zip(track.positions().iter().copied());
        let (mut found, mut notes): (Vec<(f64, Position)>, _) = (fixes.collect(), Vec::new());
        drop_null(&mut found, &mut notes);
        drop_repeated(&mut found, &|time_s| format!("{time_s} s"), "time", &mut notes);
        note_missing_altitudes(&found, &mut notes);
        let georeference = Georeference::near(found.iter().map(|(_, position)| &position.place));
        let sigmas = common_sigmas(&found);
        let timed = found.iter().filter_map(|(time_s, position)| {
            let xyz = georeference?.to_local(&position.place)?;
            let has_height = !is_without_altitude(&position.place);
            Some(TimedPosition { time_s: *time_s, xyz, has_height, sigmas_m: sigmas(position) })
        });
        let track = timed.collect();
        Self { measured: Vec::new(), georeference, notes, track, clock: None }
    }

    /// With positions of images in place of those with a clock of their own, whose offset this
    /// model determines; `None` if there are no such.
    pub(crate) fn by_clock(
        &self,
        model: &Reconstruction,
        seed: u64,
    ) -> Option<Result<Self, TrackMisfit>> {
        let first_s = self.track.first()?.time_s;
        let of_images = || model.registered().filter_map(|(_, image, _)| image.time_s);
        let offsets_s = match is_absolute(first_s) && of_images().all(is_absolute) {
            true => -MAX_ABSOLUTE_OFFSET_S..MAX_ABSOLUTE_OFFSET_S,
            false => f64::NEG_INFINITY..f64::INFINITY,
        };
        Some(align_track(model, &self.track, offsets_s, seed).map(|found| {
            let clock = ClockReport {
                offset_s: found.offset_s,
                offset_sd_s: found.offset_sd_s,
                arm_m: found.arm_m.into(),
                arm_sds_m: found.arm_sds_m.into(),
            };
            let mut notes = self.notes.clone();
            notes.extend(sentences_of_clock(&clock));
            Self {
                measured: found.positions,
                georeference: self.georeference,
                notes,
                track: Vec::new(),
                clock: Some(clock),
            }
        }))
    }
}

/// What is to be said of the clock of positions and their antenna.
fn sentences_of_clock(clock: &ClockReport) -> [String; 2] {
    let side = if clock.offset_s < 0.0 { "behind" } else { "ahead of" };
    let offset = format!(
        "the clock of the positions is {:.3} s {side} that of the photos (known to {:.3} s)",
        clock.offset_s.abs(),
        clock.offset_sd_s
    );
    let axis = |(k, name): (usize, &str)| {
        format!("{name} {:.2} m (known to {:.2} m)", clock.arm_m[k], clock.arm_sds_m[k])
    };
    let axes = ["x", "y", "z"].into_iter().enumerate().map(axis).collect::<Vec<_>>().join(", ");
    let arm =
        format!("their antenna is at {axes} in the axes of the camera, where 1 m is an assumption");
    [offset, arm]
}

/// What sets the scale of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ScaleOf {
    /// The positions.
    Positions,
    /// The known distance of its first two cameras.
    Baseline,
    /// Known rigs.
    Rig,
}

impl ScaleOf {
    /// Of a model that was mapped with `rigs`, and scaled to the baseline if `report` says so.
    pub(crate) fn model(
        mapped: &MappedModel,
        report: Option<&ScaleReport>,
        rigs: Option<&KnownRigs>,
    ) -> Self {
        let model = &mapped.reconstruction;
        let sensors = model.rigs.iter().flat_map(|rig| &rig.sensors);
        let has_baseline = sensors
            .filter_map(|sensor| sensor.cam_from_rig)
            .any(|pose| pose.translation.norm() > 0.0);
        // Terms set the scale of rigs that are refined.
        let is_rigid = |rigs: &KnownRigs| !rigs.refine_extrinsics || !mapped.is_in_frame_of_terms;
        let has_frames = has_baseline && !model.frames.is_empty();
        match report.is_some_and(|report| report.factor.is_some()) {
            true => Self::Baseline,
            false if has_frames && rigs.is_some_and(is_rigid) => Self::Rig,
            false => Self::Positions,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Positions => "positions",
            Self::Baseline => "baseline",
            Self::Rig => "rig",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Positions => "the positions",
            Self::Baseline => "the baseline",
            Self::Rig => "the known rig",
        }
    }
}

/// What became of the positions.
#[derive(Default)]
pub(crate) struct Placed {
    /// For each model, if it is in the frame of the positions.
    pub(crate) reports: Vec<Option<PositionReport>>,
    /// For each model, the length of the unit that it had before.
    pub(crate) factors: Vec<f64>,
    /// A sentence each.
    pub(crate) notes: Vec<String>,
}

impl Placed {
    pub(crate) fn unused(reason: &str) -> Self {
        let notes = vec![format!("the positions of the photos are not used: {reason}")];
        Self { notes, ..Self::default() }
    }
}

impl ScenePositions {
    /// The similarity of a model to the positions.
    pub(crate) fn align(
        &self,
        mapped: &MappedModel,
        scale_of: ScaleOf,
        seed: u64,
    ) -> Result<PositionAlignment, Misfit> {
        let keeps_scale = scale_of != ScaleOf::Positions;
        align(&mapped.reconstruction, &self.measured, keeps_scale, seed)
    }

    /// Whether the path of the model deviates from the positions by more than their stated
    /// deviations: then they may correct it. Those that state none may be as wrong as they deviate.
    /// Those without heights take no part.
    pub(crate) fn tell_more_than(&self, largest: &PositionAlignment) -> bool {
        let stated: Option<Vec<f64>> = self
            .measured
            .iter()
            .map(|one| one.sigmas_m.map(|[horizontal, _]| horizontal))
            .collect();
        let usual = stated.and_then(|mut stated| median(&mut stated));
        largest.has_heights() && usual.is_some_and(|usual| largest.sigmas_m[0] > usual)
    }

    /// The term of those that are not held out.
    pub(crate) fn term(&self, largest: &PositionAlignment, seed: u64) -> PositionTerm {
        PositionTerm::new(&held_out(&self.measured).0, largest.sigmas_m, seed)
    }

    /// Compares models without and with the term. `scale_of` tells what sets the scale of a model.
    pub(crate) fn compare<'a>(
        &self,
        without: &'a [MappedModel],
        with: &'a [MappedModel],
        scale_of: impl Fn(&MappedModel) -> ScaleOf,
        largest: &PositionAlignment,
        seed: u64,
    ) -> Option<Comparison> {
        let similarity = |mapped: &MappedModel| match mapped.is_in_frame_of_terms {
            true => Some(Sim3::identity()),
            false => Some(self.align(mapped, scale_of(mapped), seed).ok()?.term_from_model),
        };
        let placed = |models: &'a [MappedModel]| -> Vec<(&'a Reconstruction, Sim3)> {
            let of = |mapped: &'a MappedModel| Some((&mapped.reconstruction, similarity(mapped)?));
            models.iter().filter_map(of).collect()
        };
        let (without, with) = (placed(without), placed(with));
        compare(&without, &with, &self.measured, largest.sigmas_m)
    }

    /// Moves models into the frame of the positions. Lengths that something else set stay.
    pub(crate) fn place(
        &self,
        models: &mut [MappedModel],
        scales_of: &[ScaleOf],
        comparison: Option<&Comparison>,
        seed: u64,
    ) -> Placed {
        let mut placed = Placed { notes: self.notes.clone(), ..Placed::default() };
        let Some(georeference) = self.georeference else { return placed };
        for (index, (mapped, scale_of)) in models.iter_mut().zip(scales_of).enumerate() {
            let found = self.align(mapped, *scale_of, seed);
            // What the positions say of a scale that is not theirs.
            let free = match scale_of {
                ScaleOf::Positions => found.clone().ok(),
                _ => self.align(mapped, ScaleOf::Positions, seed).ok(),
            };
            let found = match found {
                Ok(found) => found,
                Err(misfit) => {
                    let model = model_path(index);
                    let scale = free.map_or(String::new(), |free| {
                        let scale = free.term_from_model.scale;
                        format!(
                            "; they fit {scale:.4} of the scale that {} gives",
                            scale_of.words()
                        )
                    });
                    placed
                        .notes
                        .push(format!("positions are not used for {model}: {misfit}{scale}"));
                    placed.reports.push(None);
                    placed.factors.push(1.0);
                    continue;
                }
            };
            let similarity = match mapped.is_in_frame_of_terms {
                true => Sim3::identity(),
                false => found.term_from_model,
            };
            transform(mapped, similarity);
            mapped.reconstruction.georeference = Some(georeference);
            let clock = self.clock.clone();
            let report = PositionReport {
                clock,
                ..report(mapped, *scale_of, &found, free.as_ref(), comparison)
            };
            let model = model_path(index);
            placed.notes.extend(sentences(&model, *scale_of, &report, &georeference));
            let of_comparison = comparison.map(|found| compared(&model, &report, found));
            // One that is of all models is said once.
            placed.notes.extend(of_comparison.filter(|note| !placed.notes.contains(note)));
            placed.reports.push(Some(report));
            placed.factors.push(similarity.scale);
        }
        if placed.reports.iter().any(Option::is_some) {
            placed.notes.push(
                "georeference.json and tiepoint.json tell where the photos were taken, as \
                 database.db does of positions in EXIF; exported models do not, but copies of \
                 photos keep their EXIF"
                    .to_owned(),
            );
        }
        placed
    }
}

/// Moves a model, and the lengths of its rig.
pub(crate) fn transform(mapped: &mut MappedModel, similarity: Sim3) {
    mapped.reconstruction.transform(&similarity);
    for rows in mapped.row_poses.values_mut() {
        rows.velocity_in_world = similarity.scale * (similarity.rotation * rows.velocity_in_world);
    }
    let cameras = mapped.rig.iter_mut().flat_map(|rig| &mut rig.cameras);
    cameras.for_each(|camera| scale_extrinsics(camera, similarity.scale, false));
}

fn report(
    mapped: &MappedModel,
    scale_of: ScaleOf,
    found: &PositionAlignment,
    free: Option<&PositionAlignment>,
    comparison: Option<&Comparison>,
) -> PositionReport {
    let name = |id: &ImageId| mapped.reconstruction.image(*id).name.clone();
    // In the frame of the positions, that of the model is theirs.
    let relative = |free: &PositionAlignment| match scale_of {
        ScaleOf::Positions => 1.0,
        _ => free.term_from_model.scale,
    };
    PositionReport {
        positions: found.num_compared,
        outliers: found.outliers.iter().map(name).collect(),
        sigma_horizontal_m: found.sigmas_m[0],
        sigma_vertical_m: found.has_heights().then_some(found.sigmas_m[1]),
        scale_of: scale_of.name().to_owned(),
        scale: free.map(relative),
        scale_sd: free.map(|free| free.scale_sd),
        heading_sd_deg: found.heading_sd_rad.to_degrees(),
        level_sd_deg: found.level_sd_rad.map(f64::to_degrees),
        is_adjusted: mapped.is_in_frame_of_terms,
        held_out_median_m: comparison.map(|found| found.median_m),
        held_out_t: comparison.map(|found| found.t).filter(|t| t.is_finite()),
        clock: None,
    }
}

/// Names of outliers that a sentence lists.
const MAX_NAMES: usize = 5;

/// What is to be said of a model in the frame of positions.
fn sentences(
    model: &str,
    scale_of: ScaleOf,
    report: &PositionReport,
    georeference: &Georeference,
) -> Vec<String> {
    let frame = match georeference {
        Georeference::Enu { .. } => "x east, y north, z up",
        Georeference::Cartesian { .. } => "the axes of the positions",
    };
    let right = report.positions - report.outliers.len();
    let heights = report
        .sigma_vertical_m
        .map_or(String::new(), |sigma_m| format!(" horizontally and {sigma_m:.2} m in height"));
    let mut sentences = vec![format!(
        "{model} is in metres, {frame}: {right} of {} positions fit, with deviations of {:.2} \
         m{heights}; {}, and its heading is known to {:.2}°",
        report.positions,
        report.sigma_horizontal_m,
        scale_in_words(scale_of, report),
        report.heading_sd_deg,
    )];
    if let Some(sd_deg) = report.level_sd_deg {
        let why = match report.sigma_vertical_m {
            Some(_) => "are on a line",
            None => "have no altitudes, and heights are those of the images from their mean",
        };
        sentences.push(format!(
            "the positions of {model} {why}: which side is up is the assumption that the photos \
             are level on average, good to some {sd_deg:.0}°"
        ));
    }
    if !report.outliers.is_empty() {
        let names: Vec<&str> = report.outliers.iter().take(MAX_NAMES).map(String::as_str).collect();
        let more = if report.outliers.len() > MAX_NAMES { ", …" } else { "" };
        let what = match report.outliers.len() {
            1 => "1 position deviates by more than 3 deviations".to_owned(),
            count => format!("{count} positions deviate by more than 3 deviations"),
        };
        sentences.push(format!("{what}: {}{more}", names.join(", ")));
    }
    sentences
}

/// Whether positions took part in the adjustments of a model, and why.
fn compared(model: &str, report: &PositionReport, comparison: &Comparison) -> String {
    let [without, with] = comparison.median_m;
    let distances = format!(
        "cameras are {without:.3} m (median) from held-out ones without, and {with:.3} m with the \
         others"
    );
    match (report.is_adjusted, comparison.why_not_better()) {
        (true, _) => format!("positions took part in the adjustments of {model}: {distances}"),
        (false, Some(why)) => {
            format!("positions took no part in the adjustments: {distances}, {why}")
        }
        (false, None) => format!(
            "positions took no part in the adjustments of {model}, which did not lie reliably in \
             their frame as it grew"
        ),
    }
}

/// What gives the scale of a model, and how well it is known by positions.
fn scale_in_words(scale_of: ScaleOf, report: &PositionReport) -> String {
    let source = scale_of.words();
    match (report.scale, report.scale_sd) {
        (_, Some(sd)) if scale_of == ScaleOf::Positions => {
            format!("its scale is known to {:.2} %", 100.0 * sd)
        }
        (Some(scale), Some(sd)) => format!(
            "its scale is that of {source} (positions give {scale:.4} of it, known to {:.2} %)",
            100.0 * sd
        ),
        _ => format!("its scale is that of {source} (positions do not tell it)"),
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
    use tiepoint_sfm::scene::Camera;

    use super::*;

    /// Ten images of each of two cameras, with positions.
    fn two_cameras() -> (Reconstruction, Vec<(ImageId, Position)>) {
        let mut scene = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let place = Place::Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: None };
        let position = Position { place, sigma_horizontal_m: None, sigma_vertical_m: None };
        let mut found = Vec::new();
        for folder in ["left", "right"] {
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
            let camera = scene.add_camera(camera);
            for index in 0..10 {
                let image = Image::new(format!("{folder}/{index}.png"), camera, Vec::new());
                found.push((scene.add_image(image), position));
            }
        }
        (scene, found)
    }

    fn names<'a>(scene: &'a Reconstruction, found: &[(ImageId, Position)]) -> Vec<&'a str> {
        found.iter().map(|(id, _)| scene.image(*id).name.as_str()).collect()
    }

    #[test]
    fn positions_are_held_out_in_blocks_of_time() {
        let (mut scene, mut found) = two_cameras();
        // Without times, both cameras follow the same path.
        in_order_of_time(&mut found, &scene);
        assert_eq!(
            names(&scene, &found)[..4],
            ["left/0.png", "right/0.png", "left/1.png", "right/1.png"]
        );
        // The second camera begins after the first one has ended, from its last image on.
        for id in (0..20).map(ImageId::from_index) {
            let time_s = if id.index() < 10 { id.index() } else { 100 - id.index() };
            scene.set_time(id, Some(time_s as f64));
        }
        in_order_of_time(&mut found, &scene);
        let ordered = names(&scene, &found);
        assert_eq!(ordered[..2], ["left/0.png", "left/1.png"]);
        assert_eq!(ordered[9..11], ["left/9.png", "right/9.png"]);
    }
}
