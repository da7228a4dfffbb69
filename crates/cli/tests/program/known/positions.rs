//! Measured positions of photos: `--position-priors`.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::geometry::geodesy::{Geodetic, LocalFrame};
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;

use crate::tiepoint_in;

const FRAMES: usize = 14;
const SYNTH: &str = "synth -o {}/drive --frames 14 --size 320x240 --rate 2.5 --seed 3";
/// Noise of the positions: they are on a grid of this width, in metres.
const GRID_M: f64 = 0.2;
/// A centre is determined better than by its own position.
const MAX_RMS_M: f64 = GRID_M;

/// Where the drive is, for these tests.
fn frame() -> LocalFrame {
    LocalFrame::new(Geodetic { latitude_deg: 48.1374, longitude_deg: 11.5755, height_m: 519.0 })
}

/// The true centres of the left camera, from lines of time, position and rotation.
fn truth(dir: &Path) -> Vec<Vector3<f64>> {
    let text = fs::read_to_string(dir.join("drive/truth/left.tum")).unwrap();
    let centre = |line: &str| {
        let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        Vector3::from_column_slice(&numbers[1..4])
    };
    text.lines().map(centre).collect()
}

/// A file of positions, of which that of frame 5 is wrong.
fn positions(dir: &Path) -> String {
    let mut text = String::from("image,lat,lon,alt\n");
    for (index, centre) in truth(dir).into_iter().enumerate() {
        let far = if index == 5 { Vector3::new(70.0, 0.0, 0.0) } else { Vector3::zeros() };
        let place = frame().to_geodetic(&(centre.map(|m| (m / GRID_M).round() * GRID_M) + far));
        let Geodetic { latitude_deg, longitude_deg, height_m } = place;
        text += &format!("{index:06}.png,{latitude_deg},{longitude_deg},{height_m}\n");
    }
    text
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn model_bytes(dir: &Path) -> Vec<Vec<u8>> {
    ["cameras", "images", "points3D"]
        .map(|name| fs::read(dir.join(format!("sparse/0/{name}.bin"))).unwrap())
        .to_vec()
}

#[test]
fn positions_of_photos_give_scale_north_and_up() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    fs::write(dir.join("p.csv"), positions(dir)).unwrap();
    let ws = dir.join("ws");
    tiepoint_in(dir, "reconstruct {}/drive/left -o {}/ws").done();
    let without = model_bytes(&ws);
    assert!(!ws.join("georeference.json").exists());
    // A finished stage is kept only with the same positions.
    let line = "reconstruct {}/drive/left -o {}/ws --position-priors {}/p.csv";
    tiepoint_in(dir, line).failed(1, &["--position-priors", "--redo map"]);
    let text = tiepoint_in(dir, &format!("{line} --redo map")).done().stdout();
    assert!(text.contains("x east, y north, z up: 13 of 14 positions fit"), "{text}");
    assert!(text.contains("1 position is wrong: 000005.png"), "{text}");
    assert!(text.contains("georeference.json"), "{text}");
    tiepoint_in(dir, line).done();

    let report = &json(&ws.join("report.json"))["models"][0]["positions"];
    assert_eq!(report["outliers"], serde_json::json!(["000005.png"]));
    assert!(!fs::read_to_string(ws.join("report.json")).unwrap().contains("48.13"), "a place");
    let origin = json(&ws.join("georeference.json"));
    let number = |name: &str| origin[name].as_f64().unwrap();
    let found = LocalFrame::new(Geodetic {
        latitude_deg: number("latitude_deg"),
        longitude_deg: number("longitude_deg"),
        height_m: number("height_m"),
    });
    assert_eq!(origin["frame"], "enu");
    let model = read_model(&ws.join("sparse/0")).unwrap();
    let truth = truth(dir);
    let mut squares = Vec::new();
    for (_, image, pose) in model.registered() {
        let index: usize = image.name.trim_end_matches(".png").parse().unwrap();
        let there = frame().to_local(&found.to_geodetic(&pose.origin_in_a()));
        squares.push((there - truth[index]).norm_squared());
    }
    let rms_m = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(squares.len() == FRAMES && rms_m < MAX_RMS_M, "{rms_m} m of {}", squares.len());

    // Without them, the model has its bytes of before.
    let line = "map {}/ws --redo map --position-priors off";
    tiepoint_in(dir, line).done();
    assert_eq!(model_bytes(&ws), without);
    assert!(!ws.join("georeference.json").exists());
}

#[test]
fn files_of_positions_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, "synth -o {}/drive --frames 6 --size 160x120 --rate 2.5").done();
    tiepoint_in(dir, "reconstruct {}/drive/left -o {}/ws").done();
    let line = "map {}/ws --redo map --position-priors {}/p.csv";
    tiepoint_in(dir, line).failed(1, &["p.csv"]);
    for (text, parts) in [
        ("", ["p.csv", "the header is"]),
        ("image,lat,lon,alt\n", ["p.csv", "has no position"]),
        ("image,lat,lon,alt\na.png,95,1,2\n", ["line 2", "latitude comes before longitude"]),
        ("image,lat,lon,alt\na.png,1,2,3\n", ["none of the 1 positions", "first is of `a.png`"]),
    ] {
        fs::write(dir.join("p.csv"), text).unwrap();
        tiepoint_in(dir, line).failed(1, &parts);
    }
    // One place for all: the model stays as it is, and a sentence says why.
    let place = |index: usize| format!("{index:06}.png,48.1,11.5,519\n");
    let text: String = (0..6).map(place).collect();
    fs::write(dir.join("p.csv"), format!("image,lat,lon,alt\nother.png,1,2,3\n{text}")).unwrap();
    let text = tiepoint_in(dir, line).done().stdout();
    let repeated = "5 positions, from 000001.png on, repeat that of the photo before";
    assert!(text.contains(repeated), "{text}");
    assert!(text.contains("1 of the 7 positions in"), "{text}");
    assert!(text.contains("positions are not used for sparse/0"), "{text}");
    assert!(!dir.join("ws/georeference.json").exists());
}
