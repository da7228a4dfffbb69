//! Measured positions of the photos: where they come from, and models in their frame.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tiepoint_input::fingerprint::hash_bytes;
use tiepoint_input::{Exif, ImageFolder};
use tiepoint_io::database::Database;
use tiepoint_io::names::ByName;
use tiepoint_io::position_priors;
use tiepoint_sfm::MappedModel;
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::geometry::{Sim3, nalgebra::Vector3};
use tiepoint_sfm::positions::{
    Comparison, MeasuredPosition, Misfit, PositionAlignment, PositionTerm, align, compare, held_out,
};
use tiepoint_sfm::scene::{Georeference, Image, ImageId, Place, Position, Reconstruction};

use crate::stages::scale::scale_extrinsics;
use crate::workspace::file_names::model_path;
use crate::workspace::option_names;
use crate::workspace::report::PositionReport;
use crate::{Error, Stage, Workspace};

/// Where measured positions of the photos come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PositionPriors {
    /// From EXIF, or from the database of another program.
    #[default]
    Auto,
    /// There are none.
    Off,
    /// From a file of [`position_priors`].
    File(PathBuf),
}

/// Positions by the names of photos.
pub(crate) struct FoundPositions {
    /// The file, if they are from one.
    file: Option<PathBuf>,
    by_name: BTreeMap<String, Position>,
}

impl FoundPositions {
    /// Reads the positions; `None` if there are none.
    ///
    /// # Errors
    ///
    /// A file cannot be read.
    pub(crate) fn read(
        workspace: &Workspace,
        from: &PositionPriors,
    ) -> Result<Option<Self>, Error> {
        let (file, by_name) = match from {
            PositionPriors::Off => return Ok(None),
            PositionPriors::File(path) => (Some(path.clone()), position_priors::read(path)?),
            PositionPriors::Auto => {
                let is_imported =
                    workspace.records.option(Stage::Features, option_names::DATABASE).is_some();
                let mut found = of_photos(&workspace.records.inputs);
                if found.is_empty() && is_imported {
                    found = of_database(&workspace.database())?;
                }
                (None, found)
            }
        };
        Ok((!by_name.is_empty()).then_some(Self { file, by_name }))
    }

    /// Their hash, for the record of the stage.
    pub(crate) fn hash(&self) -> String {
        let line = |(name, position): (&String, &Position)| format!("{name} {position:?}\n");
        let text: String = self.by_name.iter().map(line).collect();
        hash_bytes(text.as_bytes())
    }

    /// The positions of the images of a scene, without those that a receiver without a fix gave,
    /// and what is to be said of them.
    ///
    /// # Errors
    ///
    /// No name in a file is that of an image.
    pub(crate) fn of_scene(&self, scene: &Reconstruction) -> Result<ScenePositions, Error> {
        let count = self.by_name.len();
        let by_name = ByName::new(self.by_name.clone());
        let of_image = |(id, image): (ImageId, &Image)| Some((id, *by_name.get(&image.name)?));
        let mut found: Vec<(ImageId, Position)> = scene.images().filter_map(of_image).collect();
        let mut notes = Vec::new();
        if let Some(path) = &self.file {
            if found.is_empty() {
                let first = self.by_name.keys().next().cloned().unwrap_or_default();
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
        drop_repeated(&mut found, scene, &mut notes);
        drop_without_altitude(&mut found, &mut notes);
        let georeference = Georeference::near(found.iter().map(|(_, position)| &position.place));
        let sigmas = common_sigmas(&found);
        let measured = found.iter().filter_map(|(image, position)| {
            let xyz = georeference?.to_local(&position.place)?;
            Some(MeasuredPosition { image: *image, xyz, sigmas_m: sigmas(position) })
        });
        Ok(ScenePositions { measured: measured.collect(), georeference, notes })
    }
}

/// The positions in EXIF. Photos that have moved have none.
fn of_photos(inputs: &[PathBuf]) -> BTreeMap<String, Position> {
    let Ok(folder) = ImageFolder::open(inputs, None) else { return BTreeMap::new() };
    let position = |(index, image): (usize, &tiepoint_input::images::SourceImage)| {
        let position = Exif::read(folder.path(index)).ok()?.position?;
        Some((image.name.clone(), position))
    };
    folder.images().iter().enumerate().filter_map(position).collect()
}

fn of_database(path: &Path) -> Result<BTreeMap<String, Position>, Error> {
    let database = Database::open_read_only(path)?;
    let images = database.read_images()?;
    let priors = database.read_pose_priors()?.into_iter();
    Ok(priors.map(|(image, position)| (images[image.index()].name.clone(), position)).collect())
}

/// Fewest consecutive photos with the same position that are no chance.
const MIN_REPEATED: usize = 3;

fn drop_null(found: &mut Vec<(ImageId, Position)>, notes: &mut Vec<String>) {
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
fn drop_repeated(
    found: &mut Vec<(ImageId, Position)>,
    scene: &Reconstruction,
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
            "{dropped} positions, from {} on, repeat that of the photo before, as of a receiver \
             that lost its fix, and are not used",
            scene.image(first).name
        ));
    }
}

/// Drops positions without an altitude, if others have one.
fn drop_without_altitude(found: &mut Vec<(ImageId, Position)>, notes: &mut Vec<String>) {
    let is_level = |place: &Place| matches!(place, Place::Geodetic { altitude_m: None, .. });
    let level = found.iter().filter(|(_, position)| is_level(&position.place)).count();
    if level == 0 {
        return;
    }
    if level < found.len() {
        found.retain(|(_, position)| !is_level(&position.place));
        notes.push(format!("{level} positions have no altitude and are not used"));
    } else {
        notes.push("the positions have no altitudes: the path is taken as level".to_owned());
    }
}

/// Of satellites, heights are about twice as uncertain as places.
const VERTICAL_FACTOR: f64 = 2.0;

/// Deviations of a position along a horizontal axis and of the height. Where half of the positions
/// state one, the others have their median; else none counts.
fn common_sigmas(found: &[(ImageId, Position)]) -> impl Fn(&Position) -> Option<[f64; 2]> + use<> {
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
}

/// What became of the positions.
#[derive(Default)]
pub(crate) struct Placed {
    /// For each model, if it is in the frame of the positions.
    pub(crate) reports: Vec<Option<PositionReport>>,
    /// A sentence each.
    pub(crate) notes: Vec<String>,
}

impl Placed {
    pub(crate) fn unused(reason: &str) -> Self {
        let notes = vec![format!("the positions of the photos are not used: {reason}")];
        Self { reports: Vec::new(), notes }
    }
}

impl ScenePositions {
    /// The similarity of a model to the positions.
    pub(crate) fn align(
        &self,
        mapped: &MappedModel,
        seed: u64,
    ) -> Result<PositionAlignment, Misfit> {
        align(&mapped.reconstruction, &self.measured, seed)
    }

    /// Whether the path of the model deviates from the positions by more than their stated
    /// deviations: then they may correct it. Those that state none may be as wrong as they deviate.
    pub(crate) fn tell_more_than(&self, largest: &PositionAlignment) -> bool {
        let stated: Option<Vec<f64>> = self
            .measured
            .iter()
            .map(|one| one.sigmas_m.map(|[horizontal, _]| horizontal))
            .collect();
        let usual = stated.and_then(|mut stated| median(&mut stated));
        usual.is_some_and(|usual| largest.sigmas_m[0] > usual)
    }

    /// The term of those that are not held out.
    pub(crate) fn term(&self, largest: &PositionAlignment, seed: u64) -> PositionTerm {
        PositionTerm::new(&held_out(&self.measured).0, largest.sigmas_m, seed)
    }

    /// Compares models without and with the term.
    pub(crate) fn compare<'a>(
        &self,
        without: &'a [MappedModel],
        with: &'a [MappedModel],
        largest: &PositionAlignment,
        seed: u64,
    ) -> Option<Comparison> {
        let similarity = |mapped: &MappedModel| match mapped.is_in_frame_of_terms {
            true => Some(Sim3::identity()),
            false => Some(self.align(mapped, seed).ok()?.term_from_model),
        };
        let placed = |models: &'a [MappedModel]| -> Vec<(&'a Reconstruction, Sim3)> {
            let of = |mapped: &'a MappedModel| Some((&mapped.reconstruction, similarity(mapped)?));
            models.iter().filter_map(of).collect()
        };
        let (without, with) = (placed(without), placed(with));
        compare(&without, &with, &self.measured, largest.sigmas_m)
    }

    /// Moves models into the frame of the positions. With a known scale their lengths stay.
    pub(crate) fn place(
        &self,
        models: &mut [MappedModel],
        has_known_scale: bool,
        comparison: Option<&Comparison>,
        seed: u64,
    ) -> Placed {
        let mut placed = Placed { reports: Vec::new(), notes: self.notes.clone() };
        let Some(georeference) = self.georeference else { return placed };
        for (index, mapped) in models.iter_mut().enumerate() {
            let found = match self.align(mapped, seed) {
                Ok(found) => found,
                Err(misfit) => {
                    let model = model_path(index);
                    placed.notes.push(format!("positions are not used for {model}: {misfit}"));
                    placed.reports.push(None);
                    continue;
                }
            };
            if !mapped.is_in_frame_of_terms {
                transform(mapped, similarity(&found, mapped, has_known_scale));
            }
            mapped.reconstruction.georeference = Some(georeference);
            let report = report(mapped, &found, comparison);
            placed.notes.extend(sentences(&model_path(index), &report, &georeference));
            placed.reports.push(Some(report));
        }
        if placed.reports.iter().any(Option::is_some) {
            placed.notes.push(
                "georeference.json and tiepoint.json hold where the photos were taken, and exports \
                 do not"
                    .to_owned(),
            );
        }
        placed
    }
}

/// The similarity of an alignment, without its scale if lengths are known.
fn similarity(found: &PositionAlignment, mapped: &MappedModel, has_known_scale: bool) -> Sim3 {
    let similarity = found.term_from_model;
    if !has_known_scale {
        return similarity;
    }
    let model = &mapped.reconstruction;
    let sum: Vector3<f64> = model.registered().map(|(_, _, pose)| pose.origin_in_a()).sum();
    let centre = sum / model.num_registered().max(1) as f64;
    let translation = similarity * centre - similarity.rotation * centre;
    Sim3 { scale: 1.0, translation, ..similarity }
}

/// Moves a model, and the lengths of its rig.
fn transform(mapped: &mut MappedModel, similarity: Sim3) {
    mapped.reconstruction.transform(&similarity);
    for rows in mapped.row_poses.values_mut() {
        rows.velocity_in_world = similarity.scale * (similarity.rotation * rows.velocity_in_world);
    }
    let cameras = mapped.rig.iter_mut().flat_map(|rig| &mut rig.cameras);
    cameras.for_each(|camera| scale_extrinsics(camera, similarity.scale, false));
}

fn report(
    mapped: &MappedModel,
    found: &PositionAlignment,
    comparison: Option<&Comparison>,
) -> PositionReport {
    let name = |id: &ImageId| mapped.reconstruction.image(*id).name.clone();
    PositionReport {
        positions: found.num_compared,
        outliers: found.outliers.iter().map(name).collect(),
        sigma_horizontal_m: found.sigmas_m[0],
        sigma_vertical_m: found.sigmas_m[1],
        scale_sd: found.scale_sd,
        heading_sd_deg: found.heading_sd_rad.to_degrees(),
        is_levelled: found.is_levelled,
        is_adjusted: mapped.is_in_frame_of_terms,
        held_out_median_m: comparison.map(|found| found.median_m),
        held_out_t: comparison.map(|found| found.t),
    }
}

/// Names of outliers that a sentence lists.
const MAX_NAMES: usize = 5;

/// What is to be said of a model in the frame of positions.
fn sentences(model: &str, report: &PositionReport, georeference: &Georeference) -> Vec<String> {
    let frame = match georeference {
        Georeference::Enu(_) => "x east, y north, z up",
        Georeference::Cartesian { .. } => "the axes of the positions",
    };
    let right = report.positions - report.outliers.len();
    let mut sentences = vec![format!(
        "{model} is in metres, {frame}: {right} of {} positions fit, with deviations of {:.2} m \
         horizontally and {:.2} m in height; its scale is known to {:.2} % and its heading to \
         {:.2}°",
        report.positions,
        report.sigma_horizontal_m,
        report.sigma_vertical_m,
        100.0 * report.scale_sd,
        report.heading_sd_deg,
    )];
    if report.is_levelled {
        sentences.push(format!(
            "the positions of {model} are on a line: that the photos are level on average tells \
             which side is up"
        ));
    }
    if let Some([without, with]) = report.held_out_median_m {
        let (verb, but) = match report.is_adjusted {
            true => ("took part in the adjustments", "with the others"),
            false => ("took no part in the adjustments", "with the others, which is no better"),
        };
        sentences.push(format!(
            "positions {verb}: cameras are {without:.3} m (median) from held-out ones without, and \
             {with:.3} m {but}"
        ));
    }
    if !report.outliers.is_empty() {
        let names: Vec<&str> = report.outliers.iter().take(MAX_NAMES).map(String::as_str).collect();
        let more = if report.outliers.len() > MAX_NAMES { ", …" } else { "" };
        let what = match report.outliers.len() {
            1 => "1 position is wrong".to_owned(),
            count => format!("{count} positions are wrong"),
        };
        sentences.push(format!("{what}: {}{more}", names.join(", ")));
    }
    sentences
}
