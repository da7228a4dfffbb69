//! `report.html`: a page without external resources that shows models in a browser.
//!
//! This module samples the data, so that the size of the page is bounded: it has at most 2 million
//! points (24 MB) and 1 million keypoints (5 MB), and 8 MB of photos. The scripts beside it draw
//! them, with three.js.
//!
//! The view frame has the mean up direction of the images as z and unit length such that 90 % of
//! the points lie within a distance of 1 of the median. Models with a known world frame share one
//! view frame, so that they can be compared.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use serde::Serialize;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::eval::geometry::numeric::median;
use tiepoint_pipeline::eval::geometry::{Rigid3, Sim3, so3};
use tiepoint_pipeline::evaluation::evaluate_rig;
use tiepoint_pipeline::input::SkippedImage;
use tiepoint_pipeline::sfm::scene::{CameraId, ImageId, Reconstruction};
use tiepoint_pipeline::workspace::{
    LocatedModel, ModelReport, REPORT, RIG, RigFile, SPARSE, UnregisteredImage, model_path, verdict,
};
use tiepoint_pipeline::{Error, Report};

use crate::Table;
use crate::camera_table::camera_table;
use crate::coding::{base64, evenly};
use crate::depth_pictures::DenseView;
use crate::page_file::{refuse_foreign_page, write_page};
use crate::photos::{ShownImage, Thumbnails};
use crate::rig_table::{relative_poses, rig_table};

const PAGE: &str = "report.html";
const TEMPLATE: &str = include_str!("page.html");
/// The program of the page, in one element: the library, and ours.
const THREE: &str = include_str!("three/three.min.js");
const SCRIPTS: [&str; 3] =
    [include_str!("plots.js"), include_str!("scene.js"), include_str!("page.js")];
/// Placeholders of the data and of the program in the template.
const PLACEHOLDERS: [&str; 2] = ["{{DATA}}", "{{SCRIPT}}"];
/// Points of all models together: about 24 MB of the file.
const MAX_POINTS: usize = 2_000_000;
/// Keypoints of all models together: about 5 MB of the file.
const MAX_KEYPOINTS: usize = 1_000_000;
/// Images, and frames of a rig, shown per model.
const MAX_IMAGES: usize = 2_000;
/// Largest number of rows of the covisibility matrix; with more images, neighbours share a row.
const MAX_MATRIX_ROWS: usize = 100;
/// Quantisation step of point coordinates, in view units: an `i16` reaches ±8. The error of a
/// coordinate is at most half of it, 1.2e-4 of the radius around 90 % of the points. `scene.js` has
/// the same number.
const UNIT: f64 = 8.0 / 32767.0;
/// Larger reprojection errors are counted in the last bin, in pixels.
const MAX_ERROR_PX: f64 = 4.0;
const ERROR_BINS: usize = 40;
/// Longer tracks are counted in the last bin.
const MAX_TRACK_LENGTH: usize = 30;
/// Depth of a drawn frustum over the median distance of consecutive images.
const FRUSTUM_DEPTH: f64 = 0.5;

/// A model that the page shows.
#[derive(Clone, Copy, Debug)]
pub struct ReportModel<'a> {
    /// Heading of its column.
    pub name: &'a str,
    /// The model.
    pub model: &'a Reconstruction,
    /// Similarity to a metric world frame, if it is known. The page then shows lengths in metres.
    pub world_from_model: Option<Sim3>,
    /// Extrinsics and clocks of its rig: relative poses are shown at the times of the clocks.
    pub rig: Option<&'a RigFile>,
    /// The report of the run, for the times of the stages.
    pub report: Option<&'a Report>,
    /// Estimated and true camera centres in the world frame, in order of time; empty without ground
    /// truth.
    pub camera_errors: &'a [CameraError],
    /// The error of the dense cloud along the drive; empty if it is not known.
    pub cloud_errors: &'a [CloudError],
    /// The dense cloud and depth maps, if there are any.
    pub dense: Option<&'a DenseView>,
    /// The photos of its images, if there are any. Models of the same images share them.
    pub photos: Option<&'a Thumbnails>,
}

/// Models of the same scene, which the page compares with each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReportSection<'a> {
    /// Heading; may be empty.
    pub heading: &'a str,
    /// A sentence below the heading; may be empty.
    pub note: &'a str,
    /// Sentences that ask for attention, above all else.
    pub alerts: &'a [String],
    /// Tables of results.
    pub tables: &'a [Table],
    /// The models, side by side. Models with ground truth are also drawn over each other.
    pub models: &'a [ReportModel<'a>],
}

/// The estimated and the true centre of a camera, in a metric world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraError {
    /// Index of the camera.
    pub camera: usize,
    /// Estimated centre, in metres.
    pub estimated_centre: Vector3<f64>,
    /// True centre, in metres.
    pub true_centre: Vector3<f64>,
}

/// The error of the part of a cloud that a place of the drive is nearest to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudError {
    /// Length of the drive up to this place, in metres.
    pub path_length_m: f64,
    /// Mean absolute distance of the points to the reference, in metres.
    pub mean_m: f64,
}

#[derive(Serialize)]
struct Page<'a> {
    title: &'a str,
    sections: Vec<Section<'a>>,
    /// Base64 of JPEG files by the names of the images, for each set of photos.
    photos: Vec<BTreeMap<&'a str, String>>,
    /// Name and text of each file.
    files: Vec<(&'static str, String)>,
}

#[derive(Serialize)]
struct Section<'a> {
    heading: &'a str,
    note: &'a str,
    alerts: &'a [String],
    tables: &'a [Table],
    models: Vec<Model<'a>>,
}

#[derive(Serialize)]
struct Model<'a> {
    name: &'a str,
    unit: &'static str,
    /// Units per unit of view coordinates.
    unit_per_view: f64,
    /// The axes of the model in view coordinates.
    axes: [[f64; 3]; 3],
    num_images: usize,
    num_points: usize,
    points_shown: usize,
    /// Base64 of three little-endian `i16` per point: view coordinates in units of [`UNIT`].
    points: String,
    /// Base64 of red, green and blue per point.
    colours: String,
    cameras: Vec<Frusta<'a>>,
    errors: Histogram,
    track_lengths: Histogram,
    covisibility: Matrix,
    rigs: Vec<RigSeries>,
    trajectory: Option<Trajectory>,
    /// Length of the drive and mean distance of the dense cloud to the reference, in metres.
    cloud_errors: [Vec<f64>; 2],
    /// Name and seconds of each stage.
    stages: Vec<(&'static str, f64)>,
    dense: Option<Dense<'a>>,
    /// Index of its set of photos.
    photos: Option<usize>,
}

/// A dense cloud in the coding of the points of [`Model`], and pictures of depth maps.
#[derive(Serialize)]
struct Dense<'a> {
    num_points: usize,
    points_shown: usize,
    points: String,
    colours: String,
    /// Name of the image, and base64 of a PNG file.
    pictures: Vec<(&'a str, String)>,
}

/// The images of one camera: centre and four image corners, 15 view coordinates per image.
#[derive(Serialize)]
struct Frusta<'a> {
    name: String,
    colour: u32,
    corners: Vec<f32>,
    images: Vec<ShownImage<'a>>,
}

#[derive(Serialize)]
struct Histogram {
    /// Lower bound of the first bin.
    first: f64,
    /// Upper bound of the last bin.
    last: f64,
    counts: Vec<usize>,
}

#[derive(Serialize)]
struct Matrix {
    side: usize,
    counts: Vec<u32>,
}

#[derive(Serialize)]
struct RigSeries {
    cameras: [String; 2],
    has_clock: bool,
    /// Whether `times_s` are times, and not numbers of images.
    has_times: bool,
    times_s: Vec<f64>,
    baselines: Vec<f64>,
    rotations_deg: [Vec<f64>; 3],
}

/// Estimated and true trajectory of the first camera. Lengths are in metres except where noted; up
/// is the view's z axis.
#[derive(Default, Serialize)]
struct Trajectory {
    /// True centres in view coordinates, three numbers each.
    truth: Vec<f32>,
    /// Horizontal coordinates of the estimated centres.
    estimated_above: Vec<[f32; 2]>,
    /// Horizontal coordinates of the true centres.
    truth_above: Vec<[f32; 2]>,
    /// Length of the true trajectory up to each centre.
    path_length: Vec<f32>,
    /// Length of the horizontal component of the error.
    horizontal: Vec<f32>,
    /// Vertical component of the error.
    vertical: Vec<f32>,
}

/// The HTML text of a page with these sections. `files` (name and text) can be unfolded at its end.
pub fn report_html(
    title: &str,
    sections: &[ReportSection],
    files: Vec<(&'static str, String)>,
) -> String {
    let models = || sections.iter().flat_map(|section| section.models);
    let num_images: usize =
        models().map(|model| model.model.num_registered().min(MAX_IMAGES)).sum();
    let limits = Limits {
        points: MAX_POINTS / models().count().max(1),
        keypoints: MAX_KEYPOINTS / num_images.max(1),
    };
    let mut photos: Vec<&Thumbnails> = Vec::new();
    for set in models().filter_map(|model| model.photos) {
        if !photos.iter().any(|other| std::ptr::eq(*other, set)) {
            photos.push(set);
        }
    }
    let sections = sections.iter().map(|section| describe_section(section, limits, &photos));
    let sections = sections.collect();
    let photos = photos
        .iter()
        .map(|set| set.by_name.iter().map(|(name, jpeg)| (name.as_str(), base64(jpeg))).collect());
    let page = Page { title, sections, photos: photos.collect(), files };
    let data = serde_json::to_string(&page).expect("our own types are JSON: string keys");
    // Escaped, so that a name cannot close the script element of the data.
    let data = data.replace('<', "\\u003c");
    let (before, rest) = TEMPLATE.split_once(PLACEHOLDERS[0]).expect("the template has it");
    let (between, after) = rest.split_once(PLACEHOLDERS[1]).expect("the template has it");
    let mut page = [before, &data, between, "'use strict';\n", THREE].concat();
    SCRIPTS.iter().for_each(|script| page.push_str(script));
    page + after
}

/// The largest numbers of points of a model and of keypoints of an image.
#[derive(Clone, Copy)]
struct Limits {
    points: usize,
    keypoints: usize,
}

fn describe_section<'a>(
    section: &ReportSection<'a>,
    limits: Limits,
    photos: &[&Thumbnails],
) -> Section<'a> {
    let ReportSection { heading, note, alerts, tables, models } = *section;
    let shared_frame =
        models.first().and_then(|first| first.world_from_model.map(|_| upright(first)));
    let models = models.iter().map(|report_model| {
        let view_from_world = shared_frame.filter(|_| report_model.world_from_model.is_some());
        let view_from_world = view_from_world.unwrap_or_else(|| upright(report_model));
        let set = report_model.photos;
        let photos = set.and_then(|set| photos.iter().position(|other| std::ptr::eq(*other, set)));
        Model { photos, ..describe(report_model, &view_from_world, limits) }
    });
    Section { heading, note, alerts, tables, models: models.collect() }
}

/// Writes the page of a model. That of a workspace's model is `report.html` in the workspace: it
/// has the other models of the workspace, too, small copies of the photos, the images without a
/// pose, and the texts of `report.json` and `rig.json`. That of another model is `NAME.html` in the
/// folder `elsewhere`, since the folder of the model is its owner's. `shown` gives a warning the
/// names of options that its readers know. Returns the path of the page.
///
/// # Errors
///
/// A file beside the model cannot be read, `elsewhere` is the folder of the model, or the page
/// cannot be written.
pub fn view(
    located: &LocatedModel,
    elsewhere: &Path,
    shown: &dyn Fn(&str) -> String,
) -> Result<PathBuf, Error> {
    let Some((root, report)) = workspace_of(located)? else {
        let folder = located.folder();
        if is_same(elsewhere, folder) {
            return Err(Error::PageInModel { model: folder.to_owned() });
        }
        let name = name_of(folder);
        let page = elsewhere.join(format!("{name}.html"));
        return write_view(located, &name, None, &page, shown);
    };
    let name = root.file_name().map_or_else(|| "model".into(), |name| name.to_string_lossy());
    let page = root.join(PAGE);
    let workspace = Some((root, report.as_ref()));
    if located.is_largest() {
        return write_view(located, &name, workspace, &page, shown);
    }
    // The page shows all models, the largest one first, whichever is asked for.
    let largest = LocatedModel::open(&root.join(model_path(0)))?;
    write_view(&largest, &name, workspace, &page, shown)
}

fn is_same(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

/// The workspace that made a model, and its report. One that another program put there is not the
/// workspace's.
///
/// # Errors
///
/// The report cannot be read.
fn workspace_of(located: &LocatedModel) -> Result<Option<(&Path, Option<Report>)>, Error> {
    let Some(root) = located.workspace() else { return Ok(None) };
    let file = root.join(REPORT);
    let report = if file.is_file() { Some(Report::read(&file)?) } else { None };
    let others = report.iter().flat_map(|report| &report.models).map(|model| model.path.clone());
    let mut own = others.chain([model_path(0)]);
    let is_own = own.any(|path| is_same(&root.join(path), located.folder()));
    Ok(is_own.then_some((root, report)))
}

/// The name of a model that is in no workspace: that of its folder, or of COLMAP's project folder
/// in `PROJECT/sparse/0`; with the number of another model, so that each has a page of its own.
fn name_of(folder: &Path) -> String {
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let mut names = folder.components().rev().filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy()),
        _ => None,
    });
    let is_name = |name: &Cow<str>| name != SPARSE && name.parse::<u64>().is_err();
    let name = names.find(is_name).map_or_else(|| "model".to_owned(), Cow::into_owned);
    let number = folder.file_name().and_then(|it| it.to_str()?.parse::<u64>().ok());
    match number {
        None | Some(0) => name,
        Some(number) => format!("{name}-{number}"),
    }
}

/// Writes the page of a model, or that of a workspace whose largest model it is.
fn write_view(
    located: &LocatedModel,
    name: &str,
    workspace: Option<(&Path, Option<&Report>)>,
    page: &Path,
    shown: &dyn Fn(&str) -> String,
) -> Result<PathBuf, Error> {
    refuse_foreign_page(page)?;
    let (root, report) = workspace.unzip();
    let report = report.flatten();
    let cloud = root.zip(located.dense_cloud());
    let dense = cloud
        .map(|(root, cloud)| DenseView::read(&cloud, root, &located.reconstruction))
        .transpose()?;
    let mut reports = report.iter().flat_map(|report| &report.models);
    let first = reports.next();
    // Another model may have been deleted since.
    let others = reports
        .filter_map(|other| Some((LocatedModel::open(&root?.join(&other.path)).ok()?, other)));
    let others: Vec<(LocatedModel, &ModelReport)> = others.collect();
    let models: Vec<(&LocatedModel, Option<&ModelReport>)> = std::iter::once((located, first))
        .chain(others.iter().map(|(other, report)| (other, Some(*report))))
        .collect();
    let photos = models.iter().map(|(one, _)| {
        let max_bytes = Thumbnails::MAX_BYTES / models.len();
        root.map(|root| Thumbnails::of_workspace(root, &one.reconstruction, max_bytes))
    });
    let photos: Vec<Option<Thumbnails>> = photos.collect();
    let report_models = models.iter().zip(&photos).enumerate().map(|(k, ((one, of), photos))| {
        let scale = of.and_then(|model| model.scale.as_ref());
        ReportModel {
            name: of.map_or(name, |model| &model.path),
            model: &one.reconstruction,
            rig: one.rig.as_ref(),
            // A model that was scaled is in metres.
            world_from_model: scale.and_then(|scale| scale.factor).map(|_| Sim3::identity()),
            report: report.filter(|_| k == 0),
            camera_errors: &[],
            cloud_errors: &[],
            dense: dense.as_ref().filter(|_| k == 0),
            photos: photos.as_ref(),
        }
    });
    let report_models: Vec<ReportModel> = report_models.collect();
    let tables: Vec<Vec<Table>> =
        report_models.iter().zip(&models).map(|(model, (_, of))| tables(model, *of)).collect();
    let heading = |model: &ReportModel| match report_models.len() {
        1 => String::new(),
        _ => format!("Model {}", model.name),
    };
    let headings: Vec<String> = report_models.iter().map(heading).collect();
    let warnings = report.iter().flat_map(|report| &report.warnings);
    let alerts: Vec<String> = warnings.map(|warning| shown(&warning.to_string())).collect();
    let note = report.map(|report| note(&verdict(report))).unwrap_or_default();
    let section = |k: usize| ReportSection {
        heading: &headings[k],
        note: if k == 0 { &note } else { "" },
        alerts: if k == 0 { &alerts } else { &[] },
        tables: &tables[k],
        models: &report_models[k..=k],
    };
    let mut sections: Vec<ReportSection> = (0..report_models.len()).map(section).collect();
    let map = report.and_then(|report| report.stages.map.as_ref());
    let missing = map.map(|map| [missing(&map.unregistered)]);
    if let Some(tables) = missing.as_ref().filter(|[table]| !table.rows.is_empty()) {
        sections.push(ReportSection { tables, ..ReportSection::default() });
    }
    let features = report.and_then(|report| report.stages.features.as_ref());
    let left_out = features.map(|features| [left_out(&features.skipped)]);
    if let Some(tables) = left_out.as_ref().filter(|[table]| !table.rows.is_empty()) {
        sections.push(ReportSection { tables, ..ReportSection::default() });
    }
    let texts = root.map(texts).unwrap_or_default();
    write_page(page, &report_html(&format!("tiepoint: {name}"), &sections, texts))?;
    Ok(page.to_owned())
}

/// The texts of `rig.json` and `report.json`.
fn texts(path: &Path) -> Vec<(&'static str, String)> {
    let mut files = Vec::new();
    for name in [RIG, REPORT] {
        // What a link leads to would become part of a page that is handed on.
        let file = path.join(name);
        let is_file = std::fs::symlink_metadata(&file).is_ok_and(|found| found.is_file());
        if is_file && let Ok(text) = std::fs::read_to_string(&file) {
            files.push((name, text));
        }
    }
    files
}

/// Sentences with capital letters and full stops.
fn note(sentences: &[String]) -> String {
    let capital = |sentence: &String| {
        let mut letters = sentence.chars();
        let first = letters.next().into_iter().flat_map(char::to_uppercase);
        first.chain(letters).chain(['.']).collect::<String>()
    };
    sentences.iter().map(capital).collect::<Vec<_>>().join(" ")
}

/// The images without a pose, each with its reason.
fn missing(images: &[UnregisteredImage]) -> Table {
    let rows = images.iter().map(|image| (image.image.clone(), vec![image.why()])).collect();
    Table { caption: "Images without a pose in sparse/0".to_owned(), head: Vec::new(), rows }
}

/// The files of the input that no image was made of, each with its reason.
fn left_out(skipped: &[SkippedImage]) -> Table {
    let rows = skipped.iter().map(|file| (file.image.clone(), vec![file.reason.clone()])).collect();
    Table { caption: "Files of the input that were left out".to_owned(), head: Vec::new(), rows }
}

/// The facts of a model, its cameras and its rig.
fn tables(report_model: &ReportModel, report: Option<&ModelReport>) -> Vec<Table> {
    let ReportModel { model, rig, world_from_model, .. } = *report_model;
    // A COLMAP model holds only registered images; the report counts all.
    let images = report.map_or(model.images().count(), |report| report.images);
    let rows = [
        ("images with a pose", format!("{} of {images}", model.num_registered())),
        ("points", model.num_tracks().to_string()),
        (
            "observations (per point)",
            format!("{} ({:.2})", model.num_observations(), model.mean_track_length()),
        ),
        ("mean reprojection error", format!("{:.3} px", model.mean_reprojection_error_px())),
    ];
    let rows = rows.map(|(name, value)| (name.to_owned(), vec![value])).to_vec();
    let unit = if world_from_model.is_some() { "m" } else { "units" };
    let facts = Table { rows, ..Table::default() };
    let relative = evaluate_rig(model, rig, 1.0);
    let rig = rig_table(report.and_then(|report| report.rig.as_ref()), rig, unit);
    let cameras = camera_table(model, report, |id| camera_name(model, id));
    let tables = [Some(facts), cameras, rig, relative_poses(&relative, unit)];
    tables.into_iter().flatten().collect()
}

/// The stream of a camera's images, and its number if it is one of several.
fn camera_name(model: &Reconstruction, id: CameraId) -> String {
    let images = || model.registered().map(|(_, image, _)| image);
    let stream = images().find(|image| image.camera == id).map_or("", |image| &*image.stream);
    let is_one = images().filter(|image| *image.stream == *stream).all(|image| image.camera == id);
    let number = model.original_ids.camera(id);
    match stream {
        "" => format!("camera {number}"),
        stream if is_one => stream.to_owned(),
        stream => format!("{stream}, camera {number}"),
    }
}

/// `view_from_world` of a model: z up, the median of points and cameras at the origin, 90 % of them
/// within a distance of 1.
fn upright(report_model: &ReportModel) -> Sim3 {
    let world_from_model = report_model.world_from_model.unwrap_or_else(Sim3::identity);
    let poses =
        report_model.model.registered().map(|(.., pose)| world_from_model.transform_pose(pose));
    let poses: Vec<Rigid3> = poses.collect();
    let rotation = so3::upright(poses.iter().map(|pose| &pose.rotation), &Vector3::z());
    let points = report_model.model.tracks().map(|(_, track)| world_from_model * track.xyz);
    let positions: Vec<Vector3<f64>> =
        points.chain(poses.iter().map(Rigid3::origin_in_a)).collect();
    let median_of = |axis: usize| {
        median(&mut positions.iter().map(|position| position[axis]).collect::<Vec<f64>>())
            .unwrap_or(0.0)
    };
    let centre = Vector3::new(median_of(0), median_of(1), median_of(2));
    let mut distances: Vec<f64> =
        positions.iter().map(|position| (position - centre).norm()).collect();
    distances.sort_by(f64::total_cmp);
    let radius = distances
        .get(distances.len() * 9 / 10)
        .copied()
        .filter(|radius| *radius > 0.0)
        .unwrap_or(1.0);
    let scale = 1.0 / radius;
    Sim3 { scale, rotation, translation: -(rotation * centre) * scale }
}

fn describe<'a>(
    report_model: &ReportModel<'a>,
    view_from_world: &Sim3,
    limits: Limits,
) -> Model<'a> {
    let ReportModel { name, model, world_from_model, report, camera_errors, cloud_errors, .. } =
        report_model;
    let dense = report_model.dense;
    let view_from_model = *view_from_world * world_from_model.unwrap_or_else(Sim3::identity);
    // The dense cloud gets three quarters or more.
    let share = if dense.is_some() { limits.points / 4 } else { limits.points };
    let share = share.min(model.num_tracks());
    let tracks = model.tracks().map(|(_, track)| (track.xyz, track.color));
    let (points, colours) = coded(tracks, share, model.num_tracks(), &view_from_model);
    let dense = dense.map(|dense| {
        let all = dense.points.iter().map(|vertex| (vertex.xyz, vertex.color));
        let share = limits.points - share;
        let (points, colours) = coded(all, share, dense.points.len(), &view_from_model);
        let pictures = dense.pictures.iter();
        Dense {
            num_points: dense.points.len(),
            points_shown: colours.len() / 3,
            points: base64(&points),
            colours: base64(&colours),
            pictures: pictures.map(|(name, png)| (name.as_str(), base64(png))).collect(),
        }
    });
    let scale = world_from_model.map_or(1.0, |world_from_model| world_from_model.scale);
    Model {
        name,
        unit: if world_from_model.is_some() { "m" } else { "units" },
        unit_per_view: 1.0 / view_from_world.scale,
        axes: [Vector3::x(), Vector3::y(), Vector3::z()]
            .map(|axis| (view_from_model.rotation * axis).into()),
        num_images: model.num_registered(),
        num_points: model.num_tracks(),
        points_shown: colours.len() / 3,
        points: base64(&points),
        colours: base64(&colours),
        cameras: frusta(model, &view_from_model, limits.keypoints),
        errors: errors(model),
        track_lengths: track_lengths(model),
        covisibility: covisibility(model),
        rigs: rigs(model, report_model.rig, scale),
        trajectory: trajectory(camera_errors, view_from_world),
        cloud_errors: [
            cloud_errors.iter().map(|error| error.path_length_m).collect(),
            cloud_errors.iter().map(|error| error.mean_m).collect(),
        ],
        stages: report.map_or_else(Vec::new, stages),
        dense,
        photos: None,
    }
}

/// Positions and colours of `kept` of `count` points, as [`Model`] has them.
fn coded(
    vertices: impl Iterator<Item = (Vector3<f64>, [u8; 3])>,
    kept: usize,
    count: usize,
    view_from_model: &Sim3,
) -> (Vec<u8>, Vec<u8>) {
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    let is_kept = evenly(count, kept);
    for (_, (xyz, color)) in vertices.enumerate().filter(|(index, _)| is_kept(*index)) {
        let position = (*view_from_model * xyz) / UNIT;
        // Points outside the range of `i16`, such as points of the sky, are left out.
        if position.iter().all(|value| value.abs() <= f64::from(i16::MAX)) {
            points.extend(position.iter().flat_map(|value| (value.round() as i16).to_le_bytes()));
            colours.extend(color);
        }
    }
    (points, colours)
}

/// Estimated and true trajectory of the camera with the smallest index; `None` without ground
/// truth.
fn trajectory(camera_errors: &[CameraError], view_from_world: &Sim3) -> Option<Trajectory> {
    let first = camera_errors.iter().map(|error| error.camera).min()?;
    let errors: Vec<&CameraError> =
        camera_errors.iter().filter(|error| error.camera == first).collect();
    let (mut trajectory, mut path_length_m, step) =
        (Trajectory::default(), 0.0, errors.len().div_ceil(MAX_IMAGES).max(1));
    for (index, CameraError { estimated_centre, true_centre, .. }) in errors.iter().enumerate() {
        path_length_m += index
            .checked_sub(1)
            .map_or(0.0, |previous| (true_centre - errors[previous].true_centre).norm());
        if index % step > 0 {
            continue;
        }
        let above = |point: &Vector3<f64>| {
            let upright = view_from_world.rotation * point;
            [upright.x as f32, upright.y as f32]
        };
        let error = view_from_world.rotation * (estimated_centre - true_centre);
        let in_view = *view_from_world * *true_centre;
        trajectory.truth.extend(in_view.iter().map(|value| *value as f32));
        trajectory.estimated_above.push(above(estimated_centre));
        trajectory.truth_above.push(above(true_centre));
        trajectory.path_length.push(path_length_m as f32);
        trajectory.horizontal.push(error.xy().norm() as f32);
        trajectory.vertical.push(error.z as f32);
    }
    Some(trajectory)
}

/// View frusta of the images of each camera, at most [`MAX_IMAGES`] in all, with at most
/// `max_keypoints` keypoints each.
fn frusta<'a>(
    model: &'a Reconstruction,
    view_from_model: &Sim3,
    max_keypoints: usize,
) -> Vec<Frusta<'a>> {
    let step = model.num_registered().div_ceil(MAX_IMAGES).max(1);
    let poses: Vec<_> = model.registered().map(|(_, image, pose)| (image, *pose)).collect();
    let steps =
        poses.windows(2).map(|pair| (pair[1].1.origin_in_a() - pair[0].1.origin_in_a()).norm());
    let mut steps: Vec<f64> = steps.collect();
    let depth = FRUSTUM_DEPTH * median(&mut steps).unwrap_or(1.0);
    let mut all: BTreeMap<CameraId, Frusta> = BTreeMap::new();
    for (image, pose) in poses.iter().step_by(step) {
        let (id, camera) = (image.camera, model.camera(image.camera));
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)].map(|(x, y)| {
            let ray = camera.intrinsics.unproject(&Vector2::new(x, y)).unwrap_or_else(Vector3::z);
            pose.inverse() * (ray * (depth / ray.z.abs().max(0.2)))
        });
        let frusta = all.entry(id).or_insert_with(|| Frusta {
            name: camera_name(model, id),
            colour: id.0,
            corners: Vec::new(),
            images: Vec::new(),
        });
        frusta.images.push(ShownImage::of(image, camera, max_keypoints));
        for point in std::iter::once(pose.origin_in_a()).chain(corners) {
            // 1e-4 view units are less than a pixel on the screen.
            frusta.corners.extend(
                (*view_from_model * point).iter().map(|value| (value * 1e4).round() as f32 / 1e4),
            );
        }
    }
    all.into_values().collect()
}

/// Histogram of the reprojection errors of all observations, in pixels.
fn errors(model: &Reconstruction) -> Histogram {
    let mut counts = vec![0; ERROR_BINS];
    for (_, track) in model.tracks() {
        for error in
            track.observations.iter().filter_map(|o| model.observation_error_px(o, &track.xyz))
        {
            let bin = (error / MAX_ERROR_PX * ERROR_BINS as f64) as usize;
            counts[bin.min(ERROR_BINS - 1)] += 1;
        }
    }
    Histogram { first: 0.0, last: MAX_ERROR_PX, counts }
}

fn track_lengths(model: &Reconstruction) -> Histogram {
    const SHORTEST: usize = 2;
    let mut counts = vec![0; MAX_TRACK_LENGTH - SHORTEST + 1];
    for (_, track) in model.tracks() {
        counts[track.observations.len().clamp(SHORTEST, MAX_TRACK_LENGTH) - SHORTEST] += 1;
    }
    Histogram { first: SHORTEST as f64, last: MAX_TRACK_LENGTH as f64 + 1.0, counts }
}

/// Number of points that two images observe both, with the images in order of their names. With
/// more than [`MAX_MATRIX_ROWS`] images, neighbours share a row and a column.
fn covisibility(model: &Reconstruction) -> Matrix {
    let mut order: Vec<(&str, ImageId)> =
        model.registered().map(|(id, image, _)| (image.name.as_str(), id)).collect();
    order.sort_unstable();
    let side = order.len().min(MAX_MATRIX_ROWS);
    let row_of: BTreeMap<ImageId, usize> =
        order.iter().enumerate().map(|(k, (_, id))| (*id, k * side / order.len())).collect();
    let mut counts = vec![0; side * side];
    for (_, track) in model.tracks() {
        let rows: BTreeSet<usize> =
            track.observations.iter().filter_map(|o| row_of.get(&o.image).copied()).collect();
        for a in &rows {
            for b in rows.iter().filter(|b| *b != a) {
                counts[a * side + b] += 1;
            }
        }
    }
    Matrix { side, counts }
}

/// Baseline and relative rotation over time of each pair of cameras. `scale`: unit of the lengths
/// per unit of the model.
fn rigs(model: &Reconstruction, rig: Option<&RigFile>, scale: f64) -> Vec<RigSeries> {
    let series = |rig: tiepoint_pipeline::evaluation::RigEvaluation| {
        let step = rig.frames.div_ceil(MAX_IMAGES).max(1);
        let rotations = |axis: usize| {
            let rotations = rig.series.rotations_rad.iter().step_by(step);
            rotations.map(|rotation| rotation[axis].to_degrees()).collect()
        };
        RigSeries {
            times_s: rig.times_s.iter().step_by(step).copied().collect(),
            baselines: rig
                .series
                .centres
                .iter()
                .step_by(step)
                .map(|centre| centre.norm() * scale)
                .collect(),
            rotations_deg: [rotations(0), rotations(1), rotations(2)],
            cameras: rig.cameras,
            has_clock: rig.has_clock,
            has_times: rig.has_times,
        }
    };
    evaluate_rig(model, rig, scale).into_iter().map(series).collect()
}

fn stages(report: &Report) -> Vec<(&'static str, f64)> {
    let stages = &report.stages;
    let times = [
        ("features", stages.features.as_ref().map(|stage| stage.seconds)),
        ("match", stages.matches.as_ref().map(|stage| stage.seconds)),
        ("map", stages.map.as_ref().map(|stage| stage.seconds)),
        ("dense", stages.dense.as_ref().map(|stage| stage.seconds)),
    ];
    times.into_iter().filter_map(|(name, seconds)| Some((name, seconds?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_has_no_external_resources() {
        for placeholder in PLACEHOLDERS {
            assert_eq!(TEMPLATE.matches(placeholder).count(), 1);
        }
        assert!(SCRIPTS[1].contains("8 / 32767"));
        for part in [[TEMPLATE].as_slice(), &SCRIPTS].concat() {
            for word in ["src=", "href=", "@import", "fetch(", "https://"] {
                assert!(!part.contains(word), "{word}");
            }
        }
        // The policy forbids the rest: the page may load nothing.
        assert!(TEMPLATE.contains("default-src 'none'"));
        for word in ["</script", "<!--", "fetch(", "XMLHttpRequest", "import("] {
            assert!(!THREE.contains(word) && !SCRIPTS.concat().contains(word), "{word}");
        }
        assert!(THREE.contains("The MIT License"));
    }
}
