//! `report.html`: models to look at, in one file that needs nothing else.
//!
//! This gathers the data, bounded in size whatever the model's; `view.html` draws them. Models are
//! turned upright (up is where the cameras' pictures have it on average) and scaled so that nine
//! points of ten lie within a distance of one. Where the world of the models is known, all get one
//! frame, so that they can be compared by eye.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_eval::geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_eval::geometry::numeric::median;
use tiepoint_eval::geometry::{Rigid3, Sim3};
use tiepoint_io::colmap::read_model;
use tiepoint_sfm::scene::{CameraId, ImageId, Reconstruction};

use crate::evaluate::{model_folder, read_times};
use crate::file_names::RIG;
use crate::output_file::{refuse_foreign_page, write_page};
use crate::workspace::REPORT;
use crate::{Error, Report, Table, TableRow, evaluate_rig};

/// The name of the page.
const PAGE: &str = "report.html";
const TEMPLATE: &str = include_str!("view.html");
/// Where the data stand in the template.
const PLACE: &str = "{{DATA}}";
/// Points shown, of all models together: about 1.2 MB of the file.
const MAX_POINTS: usize = 100_000;
/// Cameras, and moments of a rig, shown of one model.
const MAX_CAMERAS: usize = 2_000;
/// Cells along a side of the matrix; more images share a cell.
const MAX_CELLS: usize = 100;
/// Coordinates are whole multiples of this, in view units, up to 8 of them. `view.html` has the
/// same number.
const UNIT: f64 = 8.0 / 32767.0;
/// Errors beyond this are in the last bar, in pixels.
const MAX_ERROR_PX: f64 = 4.0;
const ERROR_BINS: usize = 40;
const MAX_TRACK_LENGTH: usize = 30;
/// Depth of a drawn camera, as a part of the step from one to the next.
const CAMERA_DEPTH: f64 = 0.5;

/// A model to show.
#[derive(Clone, Copy, Debug)]
pub struct Exhibit<'a> {
    /// What it is called: the heading of its column.
    pub name: &'a str,
    /// The model.
    pub model: &'a Reconstruction,
    /// Where it lies in a world in metres, if that is known: models are then shown in one frame,
    /// and lengths in metres.
    pub world_from_model: Option<Sim3>,
    /// What each stage did.
    pub report: Option<&'a Report>,
    /// Where its cameras are in that world and where they should be, in order of time; empty where
    /// that is not known.
    pub whereabouts: &'a [Whereabouts],
}

/// A camera centre in a world that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Whereabouts {
    /// Number of the camera.
    pub camera: usize,
    /// Where it was found.
    pub found: Vector3<f64>,
    /// Where it was.
    pub truth: Vector3<f64>,
}

#[derive(Serialize)]
struct Page<'a> {
    title: &'a str,
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
    /// Base64 of three 16-bit coordinates a point, in units of [`UNIT`].
    points: String,
    /// Base64 of red, green, blue.
    colours: String,
    cameras: Vec<Frusta>,
    errors: Histogram,
    track_lengths: Histogram,
    shared: Matrix,
    rigs: Vec<RigSeries>,
    way: Option<Way>,
    stages: Vec<(&'static str, f64)>,
    files: Vec<(&'static str, String)>,
}

/// Images of one camera: centre and four corners of each, 15 numbers.
#[derive(Serialize)]
struct Frusta {
    colour: u32,
    corners: Vec<f32>,
}

#[derive(Serialize)]
struct Histogram {
    first: f64,
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
    turns_deg: [Vec<f64>; 3],
}

/// The way of the first camera, found and true. Lengths are in metres, up is the view's.
#[derive(Default, Serialize)]
struct Way {
    /// In view units, three numbers a place.
    truth: Vec<f32>,
    /// Seen from above.
    found_above: Vec<[f32; 2]>,
    truth_above: Vec<[f32; 2]>,
    /// How far it was until there.
    driven: Vec<f32>,
    horizontal: Vec<f32>,
    vertical: Vec<f32>,
}

/// A page with models side by side below tables; `files` are texts to fold out below the first
/// model.
pub fn report_html(
    title: &str,
    exhibits: &[Exhibit],
    tables: &[Table],
    files: Vec<(&'static str, String)>,
) -> String {
    let shared_frame =
        exhibits.first().and_then(|first| first.world_from_model.map(|_| upright(first)));
    let mut files = Some(files);
    let models = exhibits.iter().map(|exhibit| {
        let view_from_world = shared_frame.filter(|_| exhibit.world_from_model.is_some());
        let view_from_world = view_from_world.unwrap_or_else(|| upright(exhibit));
        let files = files.take().unwrap_or_default();
        describe(exhibit, &view_from_world, MAX_POINTS / exhibits.len(), files)
    });
    let page = Page { title, tables, models: models.collect() };
    let data = serde_json::to_string(&page).expect("our own types are JSON: string keys");
    // No text can end the script that the data stand in.
    TEMPLATE.replacen(PLACE, &data.replace('<', "\\u003c"), 1)
}

/// Writes `report.html` into a workspace: its largest model, with what `report.json` and `rig.json`
/// say. `path` may also be a folder with a COLMAP model. Gives the file's path.
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
    let name = path.file_name().map_or_else(|| "model".into(), |name| name.to_string_lossy());
    let exhibit = Exhibit {
        name: &name,
        model: &model,
        world_from_model: None,
        report: report.as_ref(),
        whereabouts: &[],
    };
    let table = Table::of_columns(&[name.to_string()], summary(&model, report.as_ref()));
    let html = report_html(&format!("tiepoint: {name}"), &[exhibit], &[table], files);
    let file = path.join(PAGE);
    write_page(&file, &html)?;
    Ok(file)
}

fn summary(model: &Reconstruction, report: Option<&Report>) -> Vec<TableRow> {
    // A model on disk holds no images without a pose; the report counts them.
    let images = report
        .and_then(|report| report.models.first())
        .map_or(model.images().count(), |m| m.images);
    let registered = format!("{} of {images}", model.num_registered());
    let mut rows = vec![
        ("images with a pose".to_owned(), registered),
        ("points".to_owned(), model.num_tracks().to_string()),
        (
            "observations (a point)".to_owned(),
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
        rows.push((format!("distance {between} (model units)"), baseline));
        let spread = format!("{:.4}°", rig.rotation_rms_deg);
        rows.push((format!("spread of the rotation {between}"), spread));
    }
    rows.into_iter().map(|(what, value)| (what, vec![value])).collect()
}

/// The frame to look at a model in, from its world.
fn upright(exhibit: &Exhibit) -> Sim3 {
    let world_from_model = exhibit.world_from_model.unwrap_or_else(Sim3::identity);
    let poses = exhibit.model.registered().map(|(.., pose)| world_from_model.transform_pose(pose));
    let poses: Vec<Rigid3> = poses.collect();
    let up: Vector3<f64> = poses.iter().map(|pose| pose.rotation.inverse() * -Vector3::y()).sum();
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
    let seen = exhibit.model.tracks().map(|(_, track)| world_from_model * track.xyz);
    let places: Vec<Vector3<f64>> = seen.chain(poses.iter().map(Rigid3::origin_in_a)).collect();
    let middle = |axis: usize| {
        median(&mut places.iter().map(|place| place[axis]).collect::<Vec<f64>>()).unwrap_or(0.0)
    };
    let centre = Vector3::new(middle(0), middle(1), middle(2));
    let mut distances: Vec<f64> = places.iter().map(|place| (place - centre).norm()).collect();
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
    exhibit: &Exhibit<'a>,
    view_from_world: &Sim3,
    max_points: usize,
    files: Vec<(&'static str, String)>,
) -> Model<'a> {
    let Exhibit { name, model, world_from_model, report, whereabouts } = exhibit;
    let view_from_model = *view_from_world * world_from_model.unwrap_or_else(Sim3::identity);
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    for (_, track) in model.tracks().step_by(model.num_tracks().div_ceil(max_points).max(1)) {
        let place = (view_from_model * track.xyz) / UNIT;
        // Points far outside, in the sky say, would only be dots at the rim.
        if place.iter().all(|value| value.abs() <= f64::from(i16::MAX)) {
            points.extend(place.iter().flat_map(|value| (value.round() as i16).to_le_bytes()));
            colours.extend(track.color);
        }
    }
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
        shared: shared_points(model),
        rigs: rigs(model, scale),
        way: way(whereabouts, view_from_world),
        stages: report.map_or_else(Vec::new, stages),
        files,
    }
}

fn way(whereabouts: &[Whereabouts], view_from_world: &Sim3) -> Option<Way> {
    let first = whereabouts.iter().map(|place| place.camera).min()?;
    let places: Vec<&Whereabouts> =
        whereabouts.iter().filter(|place| place.camera == first).collect();
    let (mut way, mut driven_m, step) =
        (Way::default(), 0.0, places.len().div_ceil(MAX_CAMERAS).max(1));
    for (index, Whereabouts { found, truth, .. }) in places.iter().enumerate() {
        driven_m +=
            index.checked_sub(1).map_or(0.0, |before| (truth - places[before].truth).norm());
        if index % step > 0 {
            continue;
        }
        let above = |point: &Vector3<f64>| {
            let upright = view_from_world.rotation * point;
            [upright.x as f32, upright.y as f32]
        };
        let off = view_from_world.rotation * (found - truth);
        way.truth.extend((*view_from_world * *truth).iter().map(|value| *value as f32));
        way.found_above.push(above(found));
        way.truth_above.push(above(truth));
        way.driven.push(driven_m as f32);
        way.horizontal.push(off.xy().norm() as f32);
        way.vertical.push(off.z as f32);
    }
    Some(way)
}

fn frusta(model: &Reconstruction, view_from_model: &Sim3) -> Vec<Frusta> {
    let step = model.num_registered().div_ceil(MAX_CAMERAS).max(1);
    let poses: Vec<_> = model.registered().map(|(_, image, pose)| (image.camera, *pose)).collect();
    let steps =
        poses.windows(2).map(|pair| (pair[1].1.origin_in_a() - pair[0].1.origin_in_a()).norm());
    let mut steps: Vec<f64> = steps.collect();
    let depth = CAMERA_DEPTH * median(&mut steps).unwrap_or(1.0);
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
            // A ten-thousandth of the view is less than a pixel.
            numbers.extend(
                (*view_from_model * point).iter().map(|value| (value * 1e4).round() as f32 / 1e4),
            );
        }
    }
    all.into_iter().map(|(id, corners)| Frusta { colour: id.0, corners }).collect()
}

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

/// How many points images have in common; neighbours by name share a cell where there are many
/// images.
fn shared_points(model: &Reconstruction) -> Matrix {
    let mut order: Vec<(&str, ImageId)> =
        model.registered().map(|(id, image, _)| (image.name.as_str(), id)).collect();
    order.sort_unstable();
    let side = order.len().min(MAX_CELLS);
    let cells: BTreeMap<ImageId, usize> =
        order.iter().enumerate().map(|(k, (_, id))| (*id, k * side / order.len())).collect();
    let mut counts = vec![0; side * side];
    for (_, track) in model.tracks() {
        let seen: BTreeSet<usize> =
            track.observations.iter().filter_map(|o| cells.get(&o.image).copied()).collect();
        for a in &seen {
            for b in seen.iter().filter(|b| *b != a) {
                counts[a * side + b] += 1;
            }
        }
    }
    Matrix { side, counts }
}

fn rigs(model: &Reconstruction, scale: f64) -> Vec<RigSeries> {
    let series = |rig: crate::RigEvaluation| {
        let step = rig.moments.div_ceil(MAX_CAMERAS).max(1);
        let turn = |axis: usize| {
            rig.series.turns_rad.iter().step_by(step).map(|turn| turn[axis].to_degrees()).collect()
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
            turns_deg: [turn(0), turn(1), turn(2)],
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
    fn base64_is_that_of_the_rfc() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
    }

    #[test]
    fn the_template_has_one_place_for_the_data_and_loads_nothing() {
        assert_eq!(TEMPLATE.matches(PLACE).count(), 1);
        assert!(TEMPLATE.contains("8 / 32767"));
        for word in ["src=", "href=", "@import", "fetch(", "https://"] {
            assert!(!TEMPLATE.contains(word), "{word}");
        }
    }
}
