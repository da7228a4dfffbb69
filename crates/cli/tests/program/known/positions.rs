//! Measured positions of photos: `--position-priors`.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::io::gpx;
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

/// The measured place of a frame. That of frame 5 is wrong.
fn measured((index, centre): (usize, Vector3<f64>)) -> Geodetic {
    let far = if index == 5 { Vector3::new(70.0, 0.0, 0.0) } else { Vector3::zeros() };
    frame().to_geodetic(&(centre.map(|m| (m / GRID_M).round() * GRID_M) + far))
}

/// A file of positions of photos in a folder.
fn positions(dir: &Path, folder: &str) -> String {
    let mut text = String::from("image,lat,lon,alt\n");
    for (index, place) in truth(dir).into_iter().enumerate().map(measured).enumerate() {
        let Geodetic { latitude_deg, longitude_deg, height_m } = place;
        text += &format!("{folder}{index:06}.png,{latitude_deg},{longitude_deg},{height_m}\n");
    }
    text
}

/// Adds a place to a PNG as EXIF.
fn add_exif(photo: &Path, place: &Geodetic) {
    // Degrees to a centimetre, and metres to a tenth of a millimetre.
    let rational = |value: f64, unit: f64| {
        [(value * unit).round() as u32, unit as u32].map(u32::to_le_bytes).concat()
    };
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()]
            .concat()
    };
    let letter = |letter: u8| u32::from(letter);
    const GPS: u32 = 26;
    const DATA: u32 = GPS + 2 + 6 * 12 + 4;
    let exif = [
        b"II*\0\x08\0\0\0\x01\0".to_vec(),
        entry(0x8825, 4, 1, GPS),
        vec![0; 4],
        vec![6, 0],
        entry(1, 2, 2, letter(b'N')),
        entry(2, 5, 3, DATA),
        entry(3, 2, 2, letter(b'E')),
        entry(4, 5, 3, DATA + 24),
        entry(5, 1, 1, 0),
        entry(6, 5, 1, DATA + 48),
        vec![0; 4],
        rational(place.latitude_deg, 1e7),
        rational(0.0, 1.0).repeat(2),
        rational(place.longitude_deg, 1e7),
        rational(0.0, 1.0).repeat(2),
        rational(place.height_m, 1e4),
    ];
    let chunk = [b"eXIf".to_vec(), exif.concat()].concat();
    let mut crc = u32::MAX;
    for byte in &chunk {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        }
    }
    let mut bytes = fs::read(photo).unwrap();
    // Behind the signature and the header.
    let length = (chunk.len() as u32 - 4).to_be_bytes();
    let chunk = [&length[..], &chunk, &(!crc).to_be_bytes()].concat();
    bytes.splice(33..33, chunk);
    fs::write(photo, bytes).unwrap();
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn model_bytes(dir: &Path) -> Vec<Vec<u8>> {
    ["cameras", "images", "points3D"]
        .map(|name| fs::read(dir.join(format!("sparse/0/{name}.bin"))).unwrap())
        .to_vec()
}

/// The path of a georeferenced model is where the truth is.
fn check_path_for_maps(dir: &Path, truth: &[Vector3<f64>]) {
    for format in ["geojson", "gpx"] {
        tiepoint_in(dir, &format!("export {{}}/ws --to {format} -o {{}}/path.{format}")).done();
    }
    // The photos of this drive have no times.
    let gpx = gpx::read(&dir.join("path.gpx"));
    assert!(gpx.unwrap_err().to_string().contains("has no track point with a time"));
    let path = json(&dir.join("path.geojson"));
    let line = path["features"][0]["geometry"]["coordinates"].as_array().unwrap();
    assert_eq!(line.len(), FRAMES);
    for (place, there) in line.iter().zip(truth) {
        let [longitude_deg, latitude_deg, height_m] = [0, 1, 2].map(|k| place[k].as_f64().unwrap());
        let found = frame().to_local(&Geodetic { latitude_deg, longitude_deg, height_m });
        // Four times the root mean square.
        assert!((found - there).norm() < 4.0 * MAX_RMS_M, "{found} {there}");
    }
}

#[test]
fn positions_of_photos_give_scale_north_and_up() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    fs::write(dir.join("p.csv"), positions(dir, "")).unwrap();
    let ws = dir.join("ws");
    tiepoint_in(dir, "reconstruct {}/drive/left -o {}/ws").done();
    let without = model_bytes(&ws);
    assert!(!ws.join("georeference.json").exists());
    // A finished stage is kept only with the same positions.
    let line = "reconstruct {}/drive/left -o {}/ws --position-priors {}/p.csv";
    tiepoint_in(dir, line).failed(1, &["--position-priors", "--redo map"]);
    let text = tiepoint_in(dir, &format!("{line} --redo map")).done().stdout();
    assert!(text.contains("x east, y north, z up: 13 of 14 positions fit"), "{text}");
    assert!(text.contains("1 position deviates by more than 3 deviations: 000005.png"), "{text}");
    assert!(text.contains("georeference.json"), "{text}");
    tiepoint_in(dir, line).done();
    // No baseline scales a single camera.
    let text = tiepoint_in(dir, &format!("{line} --redo map --baseline 9m")).done().stdout();
    assert!(text.contains("the baseline sets no scale, because there is"), "{text}");
    assert!(text.contains("positions fit") && text.contains("its scale is known to"), "{text}");

    let report = &json(&ws.join("report.json"))["models"][0]["positions"];
    assert_eq!(report["outliers"], serde_json::json!(["000005.png"]));
    assert_eq!(report["scale_of"], "positions");
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

    check_path_for_maps(dir, &truth);

    // A model that goes on from it is in its frame.
    let origin = fs::read(ws.join("georeference.json")).unwrap();
    tiepoint_in(dir, "reconstruct {}/drive/left -o {}/next --input-model {}/ws").done();
    assert_eq!(fs::read(dir.join("next/georeference.json")).unwrap(), origin);

    // Without them, the model has its bytes of before.
    let line = "map {}/ws --redo map --position-priors off";
    tiepoint_in(dir, line).done();
    assert_eq!(model_bytes(&ws), without);
    assert!(!ws.join("georeference.json").exists());
    tiepoint_in(dir, "export {}/ws --to gpx -o {}/no.gpx")
        .failed(1, &["nothing tells where on the earth"]);
    // A file of the user is theirs, unless positions would replace it.
    fs::write(ws.join("georeference.json"), "mine").unwrap();
    tiepoint_in(dir, line).done();
    assert_eq!(fs::read_to_string(ws.join("georeference.json")).unwrap(), "mine");
    let line = "map {}/ws --redo map --position-priors {}/p.csv";
    tiepoint_in(dir, line).failed(1, &["georeference.json"]);
}

#[test]
fn positions_in_exif_are_kept_in_the_database() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    for (index, place) in truth(dir).into_iter().enumerate().map(measured).enumerate() {
        add_exif(&dir.join(format!("drive/left/{index:06}.png")), &place);
    }
    let line = "reconstruct {}/drive/left -o {}/ws";
    let text = tiepoint_in(dir, line).done().stdout();
    assert!(text.contains("14 of 14 photos have a position in EXIF"), "{text}");
    assert!(text.contains("x east, y north, z up: 13 of 14 positions fit"), "{text}");
    assert!(text.contains("copies of photos keep their EXIF"), "{text}");
    let with = model_bytes(&dir.join("ws"));
    // With `off`, nothing holds or says them.
    let line_off = "reconstruct {}/drive/left -o {}/off --position-priors off";
    let output = tiepoint_in(dir, line_off).done();
    assert!(!(output.stdout() + &output.stderr()).contains("position in EXIF"));
    let count = |ws: &str| -> i64 {
        let database = rusqlite::Connection::open(dir.join(ws).join("database.db")).unwrap();
        database.query_row("SELECT count(*) FROM pose_priors", [], |row| row.get(0)).unwrap()
    };
    assert_eq!((count("off"), count("ws")), (0, 14));
    let report = fs::read_to_string(dir.join("off/report.json")).unwrap();
    assert!(!report.contains("position"), "{report}");
    // Photos that have moved keep their positions.
    fs::rename(dir.join("drive"), dir.join("moved")).unwrap();
    tiepoint_in(dir, "map {}/ws").done();
    let text = tiepoint_in(dir, "map {}/ws --redo map").done().stdout();
    assert!(text.contains("13 of 14 positions fit"), "{text}");
    // The points have no colours without photos.
    assert_eq!(model_bytes(&dir.join("ws"))[..2], with[..2]);
    // Models that were mapped without positions stay, also of a workspace from before.
    tiepoint_in(dir, "map {}/ws --redo map --position-priors off").done();
    let text = tiepoint_in(dir, &line.replace("drive", "moved")).done().stderr();
    let note = "mapped without the 14 positions in database.db: --redo map uses them";
    assert!(text.contains(note), "{text}");
    let database = rusqlite::Connection::open(dir.join("ws/database.db")).unwrap();
    database.execute_batch("DELETE FROM pose_priors").unwrap();
    drop(database);
    let without = model_bytes(&dir.join("ws"));
    tiepoint_in(dir, &line.replace("drive", "moved")).done();
    assert_eq!(model_bytes(&dir.join("ws")), without);
}

#[test]
fn a_baseline_sets_the_scale_and_positions_tell_what_they_think_of_it() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    fs::write(dir.join("p.csv"), positions(dir, "left/")).unwrap();
    fs::create_dir(dir.join("both")).unwrap();
    for camera in ["left", "right"] {
        fs::rename(dir.join("drive").join(camera), dir.join("both").join(camera)).unwrap();
    }
    // The drive's baseline is 50 cm.
    let line =
        "reconstruct {}/both -o {}/ws --rig rigid --baseline 55cm --position-priors {}/p.csv";
    let text = tiepoint_in(dir, line).done().stdout();
    assert!(text.contains("its scale is that of the baseline (positions give 0.9"), "{text}");
    let report = &json(&dir.join("ws/report.json"))["models"][0];
    assert_eq!(report["positions"]["scale_of"], "baseline");
    let metres = report["rig"]["cameras"][0]["median_baseline"].as_f64().unwrap();
    assert!((metres - 0.55).abs() < 1e-6, "{metres}");
    // Deviations are those of the model as it is, a tenth larger than the drive.
    let sigma_m = report["positions"]["sigma_horizontal_m"].as_f64().unwrap();
    assert!(sigma_m > 2.0 * GRID_M, "{sigma_m}");
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

#[test]
fn tracks_with_a_clock_of_their_own_are_used_where_the_drive_tells_their_offset() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    let times = fs::read_to_string(dir.join("drive/timestamps.csv")).unwrap();
    fs::write(dir.join("times.csv"), times.replace("left/", "")).unwrap();
    tiepoint_in(dir, "reconstruct {}/drive/left -o {}/ws --timestamps {}/times.csv").done();
    let text = fs::read_to_string(dir.join("drive/truth/left.tum")).unwrap();
    let times_s = text.lines().map(|line| line.split(' ').next().unwrap().parse::<f64>().unwrap());
    let fixes: Vec<(f64, Vector3<f64>)> = times_s.zip(truth(dir)).collect();
    let csv = |rows: &[(f64, Vector3<f64>)], offset_s: f64| {
        let row = |(time_s, xyz): &(f64, Vector3<f64>)| {
            format!("{},{},{},{}\n", time_s + offset_s, xyz.x, xyz.y, xyz.z)
        };
        let rows: String = rows.iter().map(row).collect();
        fs::write(dir.join("p.csv"), format!("seconds,x,y,z\n{rows}")).unwrap();
    };
    let line = "map {}/ws --redo map --position-priors {}/p.csv";
    // Exact positions: those of the images in their middle, 100 s later.
    csv(&fixes, 100.0);
    let text = tiepoint_in(dir, line).done().stdout();
    let clock = &json(&dir.join("ws/report.json"))["models"][0]["positions"]["clock"];
    let offset_s = clock["offset_s"].as_f64().unwrap();
    // Poses from images of 320 × 240 are known to some centimetres, and the speed is 6 to 9 m/s.
    assert!((offset_s - 100.0).abs() < 0.02, "{offset_s}: {text}");
    assert!(text.contains("ahead of that of the photos"), "{text}");
    assert!(text.contains("the axes of the positions"), "{text}");
    // Too few, and of another day.
    csv(&fixes[..4], 100.0);
    let text = tiepoint_in(dir, line).done().stdout();
    assert!(text.contains("not used: 4 of them are from the time of the photos"), "{text}");
    let (day, place) = ("2031-01-01T00:00:0", "lat=\"48\" lon=\"11\"");
    let point = |second: u8| format!("<trkpt {place}><time>{day}{second}Z</time></trkpt>");
    let points: String = (0..8).map(point).collect();
    fs::write(dir.join("p.gpx"), format!("<gpx><trk><trkseg>{points}</trkseg></trk></gpx>"))
        .unwrap();
    let text = tiepoint_in(dir, &line.replace("p.csv", "p.gpx")).done().stdout();
    assert!(text.contains("the positions of the photos are not used"), "{text}");
    fs::write(dir.join("p.gpx"), "<gpx></gpx>").unwrap();
    tiepoint_in(dir, &line.replace("p.csv", "p.gpx")).failed(1, &["p.gpx", "has no track point"]);
}
