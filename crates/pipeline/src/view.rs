//! `report.html`: a page without external resources that shows models in a browser.
//!
//! This module samples the data, so that the size of the page is bounded; `view.html` draws them.
//! The view frame has the mean up direction of the images as z and unit length such that 90 % of
//! the points lie within a distance of 1 of the median. Models with a known world frame share one
//! view frame, so that they can be compared.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_eval::geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_eval::geometry::numeric::median;
use tiepoint_eval::geometry::{Rigid3, Sim3};
use tiepoint_io::colmap::read_model;
use tiepoint_sfm::scene::{CameraId, ImageId, Reconstruction};

use crate::depth_pictures::DenseView;
use crate::evaluate::{model_folder, read_times};
use crate::file_names::RIG;
use crate::output_file::{refuse_foreign_page, write_page};
use crate::workspace::REPORT;
use crate::{Error, Report, Table, TableRow, evaluate_rig};

const PAGE: &str = "report.html";
const TEMPLATE: &str = include_str!("view.html");
/// Placeholder of the data in the template.
const PLACEHOLDER: &str = "{{DATA}}";
/// Points of all models together: about 1.2 MB of the file.
const MAX_POINTS: usize = 100_000;
/// Images, and frames of a rig, shown per model.
const MAX_IMAGES: usize = 2_000;
/// Largest number of rows of the covisibility matrix; with more images, neighbours share a row.
const MAX_MATRIX_ROWS: usize = 100;
/// Quantisation step of point coordinates, in view units: an `i16` reaches ±8. `view.html` has the
/// same number.
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
    /// The report of the run, for the times of the stages.
    pub report: Option<&'a Report>,
    /// Estimated and true camera centres in the world frame, in order of time; empty without ground
    /// truth.
    pub camera_errors: &'a [CameraError],
    /// The dense cloud and depth maps, if there are any.
    pub dense: Option<&'a DenseView>,
}

/// Models of the same scene, which the page compares with each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReportSection<'a> {
    /// Heading; may be empty.
    pub heading: &'a str,
    /// A sentence below the heading; may be empty.
    pub note: &'a str,
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

#[derive(Serialize)]
struct Page<'a> {
    title: &'a str,
    sections: Vec<Section<'a>>,
    /// Name and text of each file.
    files: Vec<(&'static str, String)>,
}

#[derive(Serialize)]
struct Section<'a> {
    heading: &'a str,
    note: &'a str,
    tables: &'a [Table],
    models: Vec<Model<'a>>,
}

#[derive(Serialize)]
struct Model<'a> {
    name: &'a str,
    unit: &'static str,
    num_images: usize,
    num_points: usize,
    points_shown: usize,
    /// Base64 of three little-endian `i16` per point: view coordinates in units of [`UNIT`].
    points: String,
    /// Base64 of red, green and blue per point.
    colours: String,
    cameras: Vec<Frusta>,
    errors: Histogram,
    track_lengths: Histogram,
    covisibility: Matrix,
    rigs: Vec<RigSeries>,
    trajectory: Option<Trajectory>,
    /// Name and seconds of each stage.
    stages: Vec<(&'static str, f64)>,
    dense: Option<Dense<'a>>,
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
struct Frusta {
    colour: u32,
    corners: Vec<f32>,
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
    let num_models: usize = sections.iter().map(|section| section.models.len()).sum();
    let max_points = MAX_POINTS / num_models.max(1);
    let sections = sections.iter().map(|section| describe_section(section, max_points));
    let page = Page { title, sections: sections.collect(), files };
    let data = serde_json::to_string(&page).expect("our own types are JSON: string keys");
    // Escaped, so that a name cannot close the script element of the data.
    TEMPLATE.replacen(PLACEHOLDER, &data.replace('<', "\\u003c"), 1)
}

/// The data of one section, with at most `max_points` points a model.
fn describe_section<'a>(section: &ReportSection<'a>, max_points: usize) -> Section<'a> {
    let ReportSection { heading, note, tables, models } = *section;
    let shared_frame =
        models.first().and_then(|first| first.world_from_model.map(|_| upright(first)));
    let models = models.iter().map(|report_model| {
        let view_from_world = shared_frame.filter(|_| report_model.world_from_model.is_some());
        let view_from_world = view_from_world.unwrap_or_else(|| upright(report_model));
        describe(report_model, &view_from_world, max_points)
    });
    Section { heading, note, tables, models: models.collect() }
}

/// Writes `report.html` for the largest model of a workspace, with the texts of `report.json` and
/// `rig.json`. `path` may also be a folder with a COLMAP model. Returns the path of the page.
///
/// # Errors
///
/// The model or a file beside it cannot be read, or the page cannot be written.
pub fn view(path: &Path) -> Result<PathBuf, Error> {
    refuse_foreign_page(&path.join(PAGE))?;
    let folder = model_folder(path)?;
    let mut model = read_model(&folder)?;
    read_times(&mut model, &path.join("timestamps.csv"))?;
    let report = path.join("report.json");
    let report = if report.is_file() { Some(Report::read(&report)?) } else { None };
    let mut files = Vec::new();
    for name in [RIG, REPORT] {
        if let Ok(text) = std::fs::read_to_string(path.join(name)) {
            files.push((name, text));
        }
    }
    let cloud = report.as_ref().and_then(|report| report.dense_cloud(path));
    let dense = cloud.map(|cloud| DenseView::read(&cloud, path, &model)).transpose()?;
    let name = path.file_name().map_or_else(|| "model".into(), |name| name.to_string_lossy());
    let report_model = ReportModel {
        name: &name,
        model: &model,
        world_from_model: None,
        report: report.as_ref(),
        camera_errors: &[],
        dense: dense.as_ref(),
    };
    let table = Table::of_columns(&[name.to_string()], summary(&model, report.as_ref()));
    let section =
        ReportSection { tables: &[table], models: &[report_model], ..ReportSection::default() };
    let html = report_html(&format!("tiepoint: {name}"), &[section], files);
    let file = path.join(PAGE);
    write_page(&file, &html)?;
    Ok(file)
}

fn summary(model: &Reconstruction, report: Option<&Report>) -> Vec<TableRow> {
    // A COLMAP model holds only registered images; the report counts all.
    let images = report
        .and_then(|report| report.models.first())
        .map_or(model.images().count(), |m| m.images);
    let registered = format!("{} of {images}", model.num_registered());
    let mut rows = vec![
        ("images with a pose".to_owned(), registered),
        ("points".to_owned(), model.num_tracks().to_string()),
        (
            "observations (per point)".to_owned(),
            format!("{} ({:.2})", model.num_observations(), model.mean_track_length()),
        ),
        (
            "mean reprojection error".to_owned(),
            format!("{:.3} px", model.mean_reprojection_error_px()),
        ),
    ];
    for rig in evaluate_rig(model, 1.0) {
        let between = format!("{} – {}", rig.cameras[0], rig.cameras[1]);
        let baseline = format!("{:.4} ± {:.4}", rig.baseline.mean, rig.baseline.std);
        rows.push((format!("baseline {between} (model units)"), baseline));
        let rotation_rms = format!("{:.4}°", rig.rotation_rms_deg);
        rows.push((format!("relative rotation {between}, RMS"), rotation_rms));
    }
    rows.into_iter().map(|(name, value)| (name, vec![value])).collect()
}

/// `view_from_world` of a model: z up, the median of points and cameras at the origin, 90 % of them
/// within a distance of 1.
fn upright(report_model: &ReportModel) -> Sim3 {
    let world_from_model = report_model.world_from_model.unwrap_or_else(Sim3::identity);
    let poses =
        report_model.model.registered().map(|(.., pose)| world_from_model.transform_pose(pose));
    let poses: Vec<Rigid3> = poses.collect();
    let up: Vector3<f64> = poses.iter().map(|pose| pose.rotation.inverse() * -Vector3::y()).sum();
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
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

/// The data of one model, with at most `max_points` points.
fn describe<'a>(
    report_model: &ReportModel<'a>,
    view_from_world: &Sim3,
    max_points: usize,
) -> Model<'a> {
    let ReportModel { name, model, world_from_model, report, camera_errors, dense } = report_model;
    let view_from_model = *view_from_world * world_from_model.unwrap_or_else(Sim3::identity);
    // The dense cloud gets three quarters.
    let share = if dense.is_some() { max_points / 4 } else { max_points };
    let step = model.num_tracks().div_ceil(share.max(1)).max(1);
    let tracks = model.tracks().map(|(_, track)| (track.xyz, track.color)).step_by(step);
    let (points, colours) = coded(tracks, &view_from_model);
    let dense = dense.map(|dense| {
        let step = dense.points.len().div_ceil((max_points - share).max(1)).max(1);
        let thinned = dense.points.iter().map(|vertex| (vertex.xyz, vertex.color)).step_by(step);
        let (points, colours) = coded(thinned, &view_from_model);
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
        unit: if world_from_model.is_some() { "m" } else { "model units" },
        num_images: model.num_registered(),
        num_points: model.num_tracks(),
        points_shown: colours.len() / 3,
        points: base64(&points),
        colours: base64(&colours),
        cameras: frusta(model, &view_from_model),
        errors: errors(model),
        track_lengths: track_lengths(model),
        covisibility: covisibility(model),
        rigs: rigs(model, scale),
        trajectory: trajectory(camera_errors, view_from_world),
        stages: report.map_or_else(Vec::new, stages),
        dense,
    }
}

/// Positions and colours of points, as [`Model`] has them.
fn coded(
    vertices: impl Iterator<Item = (Vector3<f64>, [u8; 3])>,
    view_from_model: &Sim3,
) -> (Vec<u8>, Vec<u8>) {
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    for (xyz, color) in vertices {
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

/// View frusta of the images of each camera, at most [`MAX_IMAGES`] in all.
fn frusta(model: &Reconstruction, view_from_model: &Sim3) -> Vec<Frusta> {
    let step = model.num_registered().div_ceil(MAX_IMAGES).max(1);
    let poses: Vec<_> = model.registered().map(|(_, image, pose)| (image.camera, *pose)).collect();
    let steps =
        poses.windows(2).map(|pair| (pair[1].1.origin_in_a() - pair[0].1.origin_in_a()).norm());
    let mut steps: Vec<f64> = steps.collect();
    let depth = FRUSTUM_DEPTH * median(&mut steps).unwrap_or(1.0);
    let mut all: BTreeMap<CameraId, Vec<f32>> = BTreeMap::new();
    for (id, pose) in poses.iter().step_by(step) {
        let camera = model.camera(*id);
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)].map(|(x, y)| {
            let ray = camera.intrinsics.unproject(&Vector2::new(x, y)).unwrap_or_else(Vector3::z);
            pose.inverse() * (ray * (depth / ray.z.abs().max(0.2)))
        });
        let numbers = all.entry(*id).or_default();
        for point in std::iter::once(pose.origin_in_a()).chain(corners) {
            // 1e-4 view units are less than a pixel on the screen.
            numbers.extend(
                (*view_from_model * point).iter().map(|value| (value * 1e4).round() as f32 / 1e4),
            );
        }
    }
    all.into_iter().map(|(id, corners)| Frusta { colour: id.0, corners }).collect()
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
fn rigs(model: &Reconstruction, scale: f64) -> Vec<RigSeries> {
    let series = |rig: crate::RigEvaluation| {
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
        }
    };
    evaluate_rig(model, scale).into_iter().map(series).collect()
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

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let bits =
            (0..3).fold(0u32, |bits, k| bits << 8 | u32::from(chunk.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= chunk.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_rfc_4648() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
    }

    #[test]
    fn template_has_one_placeholder_and_no_external_resources() {
        assert_eq!(TEMPLATE.matches(PLACEHOLDER).count(), 1);
        assert!(TEMPLATE.contains("8 / 32767"));
        for word in ["src=", "href=", "@import", "fetch(", "https://"] {
            assert!(!TEMPLATE.contains(word), "{word}");
        }
    }
}
