//! Rigs with known extrinsics, from both formats.

use std::fs;
use std::path::Path;

use image::{GrayImage, Luma};
use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::sfm::geometry::Rigid3;
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;

use crate::{photos, tiepoint_in};

const FRAMES: usize = 4;
/// Distance of the two cameras, in metres, and the angle between them.
const BASELINE_M: f64 = 0.3;
const TURN_RAD: f64 = 0.05;

fn right_from_left() -> Rigid3 {
    Rigid3::from_axis_angle(Vector3::y() * TURN_RAD, Vector3::new(-BASELINE_M, 0.0, 0.0))
}

/// Photos of a rig in the folders `left` and `right`. The last one of the right camera is grey.
fn write_photos(dir: &Path) {
    for folder in ["left", "right"] {
        fs::create_dir_all(dir.join(folder)).unwrap();
    }
    for index in 0..FRAMES {
        let left = photos::cam_from_world(index);
        let name = |folder: &str| dir.join(folder).join(format!("{index}.png"));
        photos::photo_from(&left, 0).save(name("left")).unwrap();
        let right = if index + 1 == FRAMES {
            GrayImage::from_pixel(photos::WIDTH, photos::HEIGHT, Luma([128]))
        } else {
            photos::photo_from(&(right_from_left() * left), 0)
        };
        right.save(name("right")).unwrap();
    }
}

const LENS: &str = r#""camera_model_name": "PINHOLE", "camera_params": [330, 330, 160, 120]"#;

/// COLMAP's file of the rig.
fn rig_config() -> String {
    let [w, y] = [(0.5 * TURN_RAD).cos(), (0.5 * TURN_RAD).sin()];
    format!(
        "[{{\"cameras\": [\n{{\"image_prefix\": \"left/\", \"ref_sensor\": true, {LENS}}},\n\
        {{\"image_prefix\": \"right/\", \"cam_from_rig_rotation\": [{w}, 0, {y}, 0],\n\
        \"cam_from_rig_translation\": [-{BASELINE_M}, 0, 0], {LENS}}}]}}]"
    )
}

/// Kalibr's file of the rig.
fn camchain() -> String {
    let [cos, sin] = [TURN_RAD.cos(), TURN_RAD.sin()];
    let lens = "  camera_model: pinhole\n  intrinsics: [330, 330, 159.5, 119.5]\n  resolution: \
                [320, 240]\n";
    format!(
        "cam0:\n{lens}cam1:\n{lens}  T_cn_cnm1:\n  - [{cos}, 0, {sin}, -{BASELINE_M}]\n  - [0, 1, \
        0, 0]\n  - [-{sin}, 0, {cos}, 0]\n  - [0, 0, 0, 1]\n"
    )
}

#[test]
fn a_photo_without_matches_is_registered_with_its_frame() {
    let dir = tempfile::tempdir().unwrap();
    write_photos(&dir.path().join("photos"));
    fs::write(dir.path().join("rig.json"), rig_config()).unwrap();
    fs::write(dir.path().join("chain.yaml"), camchain()).unwrap();
    let off = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws --rig off --json").done();
    assert_eq!(off.json()["models"][0]["registered"], 2 * FRAMES - 1);
    tiepoint_in(dir.path(), "map {}/ws --rig-calibration {}/rig.json").failed(1, &["--redo map"]);
    let model = |report: &Value| {
        let model = &report["models"][0];
        assert_eq!(model["registered"], 2 * FRAMES, "{report}");
        assert_eq!(model["rig"]["mode"], "known");
        let baseline_m = model["rig"]["cameras"][0]["median_baseline"].as_f64().unwrap();
        assert!((baseline_m - BASELINE_M).abs() < 1e-9, "{baseline_m}");
        let params = model["cameras"][0]["params"].as_array().unwrap();
        params.iter().map(|p| p.as_f64().unwrap()).collect::<Vec<f64>>()
    };
    for file in ["rig.json", "chain.yaml"] {
        let options = "--refine none --redo map --json";
        let line = format!("map {{}}/ws --rig-calibration {{}}/{file} {options}");
        let report = tiepoint_in(dir.path(), &line).done().json();
        assert_eq!(model(&report), [330.0, 330.0, 160.0, 120.0], "the intrinsics of the file");
        assert!(dir.path().join("ws/sparse/0/rigs.bin").exists());
        // The same command keeps the stage.
        let again = tiepoint_in(dir.path(), &line.replace("--redo map ", "")).done();
        assert!(again.events().iter().any(|event| event["event"] == "stage_kept"));
    }
    let line =
        "map {}/ws --rig-calibration {}/rig.json --refine focal,extrinsics --redo map --json";
    let refined = model(&tiepoint_in(dir.path(), line).done().json());
    assert_ne!(refined[0], 330.0);
    assert_eq!(refined[2..], [160.0, 120.0]);
}

#[test]
fn a_rig_that_contradicts_the_photos_is_not_recorded_as_known() {
    let dir = tempfile::tempdir().unwrap();
    write_photos(&dir.path().join("photos"));
    let upright = rig_config().replace(&format!("[-{BASELINE_M}, 0, 0]"), "[0, 0.3, 0]");
    fs::write(dir.path().join("rig.json"), upright).unwrap();
    let line = "reconstruct {}/photos -o {}/ws --rig-calibration {}/rig.json --json";
    let report = tiepoint_in(dir.path(), line).done().json();
    let model = &report["models"][0];
    assert_eq!(model["rig"]["mode"], "off", "{model}");
    assert!(model["failed"][0].as_str().unwrap().contains("known rig was not used"), "{model}");
}

#[test]
fn the_database_has_the_rigs_of_the_model() {
    let dir = tempfile::tempdir().unwrap();
    write_photos(&dir.path().join("photos"));
    fs::write(dir.path().join("rig.json"), rig_config()).unwrap();
    let rigs = || {
        let database = Database::open_read_only(&dir.path().join("ws/database.db")).unwrap();
        let (rigs, frames) = database.read_rigs().unwrap();
        (rigs, frames.into_iter().map(|frame| frame.images).collect::<Vec<_>>())
    };
    let line = "reconstruct {}/photos -o {}/ws --rig-calibration {}/rig.json";
    tiepoint_in(dir.path(), line).done();
    let model = read_model(&dir.path().join("ws/sparse/0")).unwrap();
    let frames: Vec<_> = model.frames.iter().map(|frame| frame.images.clone()).collect();
    assert_eq!(frames.len(), FRAMES);
    assert_eq!(rigs(), (model.rigs, frames));
    tiepoint_in(dir.path(), "map {}/ws --rig off --redo map").done();
    assert_eq!(rigs(), (vec![], vec![]));
    // Those of the scaled model.
    tiepoint_in(dir.path(), "map {}/ws --rig rigid --baseline 60cm --redo map").done();
    let model = read_model(&dir.path().join("ws/sparse/0")).unwrap();
    let baseline_m = model.rigs[0].sensors[1].cam_from_rig.unwrap().origin_in_a().norm();
    assert!((baseline_m - 0.6).abs() < 1e-9, "{baseline_m}");
    assert_eq!(rigs().0, model.rigs);
}

#[test]
fn rigs_that_do_not_fit() {
    let dir = tempfile::tempdir().unwrap();
    write_photos(&dir.path().join("photos"));
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    tiepoint_in(dir.path(), "match {}/ws --pairs sequential:1").done();
    let wrong = |name: &str, text: &str, parts: &[&str]| {
        fs::write(dir.path().join(name), text).unwrap();
        let line = format!("map {{}}/ws --rig-calibration {{}}/{name}");
        let run = tiepoint_in(dir.path(), &line).failed(1, parts);
        let last = run.stderr().lines().last().unwrap().to_owned();
        assert!(last.contains(name) && last.len() < 500, "{last}");
    };
    let (json, yaml) = (rig_config(), camchain());
    let changed = |text: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    };
    wrong("a.json", &changed(&json, "\"right/", "\"rear/"), &["\"rear/\"", "left, right"]);
    wrong("a.json", &changed(&json, "\"right/", "\"left/"), &["\"left/\" twice", "one rig"]);
    wrong(
        "a.json",
        &changed(&json, "\"right/", "\"left/1"),
        &["of one camera", "a folder of its own"],
    );
    wrong("a.json", &changed(&json, ", \"ref_sensor\": true", ""), &["rig 1", "0 reference"]);
    wrong("a.json", &changed(&json, "160, 120", "500, 120"), &["principal point", "left", "320 x"]);
    let quaternion = json.find("rotation\": [").unwrap() + 12;
    let rest = &json[quaternion + json[quaternion..].find(']').unwrap()..];
    for (numbers, says) in [("0, 0, 0, 0", "norm 0"), ("NaN, 0, 0, 0", "line 3")] {
        wrong("a.json", &format!("{}{numbers}{rest}", &json[..quaternion]), &[says]);
    }
    wrong("a.json", "[]", &["has no rig"]);
    let one = format!(
        "[{{\"cameras\": [{{\"image_prefix\": \"left/\", \"ref_sensor\": true, {LENS}}}]}}]"
    );
    wrong("a.json", &one, &["no rig in it has two cameras"]);
    wrong("a.json", "{", &["line 1", "rig_config.json"]);
    wrong("a.yaml", "a: 1", &["is no known rig", "camchain"]);
    wrong("a.yaml", &changed(&yaml, "320, 240", "640, 480"), &["640 x 480", "320 x 240"]);
    wrong("a.yaml", &changed(&yaml, "T_cn_cnm1", "T"), &["cam1 has no T_cn_cnm1"]);
    let third = format!("{yaml}{}", changed(&yaml[yaml.find("cam1").unwrap()..], "cam1", "cam2"));
    wrong("a.yaml", &third, &["cam0, cam1, cam2", "left, right"]);
    let usage = |options: &str, parts: &[&str]| {
        tiepoint_in(dir.path(), &format!("map {{}}/ws {options}")).failed(2, parts)
    };
    usage("--rig-calibration x --rig rigid", &["--rig-calibration", "--rig"]);
    usage("--rig-calibration x --baseline 1m", &["--baseline"]);
    usage("--refine extrinsics", &["--rig-calibration", "give both"]);
    tiepoint_in(dir.path(), "map {}/ws --rig-calibration {}/no.json").failed(1, &["no.json"]);
}

#[test]
fn frames_need_names_or_times() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    write_photos(&photos);
    for index in 0..FRAMES {
        // Other numbers than those of the left camera.
        let name = |shift: usize| photos.join(format!("right/{}.png", index + shift));
        fs::rename(name(0), name(100)).unwrap();
    }
    fs::write(dir.path().join("rig.json"), rig_config()).unwrap();
    let times: Vec<String> = (0..FRAMES)
        .flat_map(|i| [format!("left/{i}.png,{i}.5\n"), format!("right/{}.png,{i}.501\n", i + 100)])
        .collect();
    fs::write(dir.path().join("t.csv"), format!("image,seconds\n{}", times.concat())).unwrap();
    let line = "reconstruct {}/photos -o {}/ws --rig-calibration {}/rig.json";
    tiepoint_in(dir.path(), line)
        .failed(1, &["rig.json", "no two of", "same name", "--timestamps"]);
    let line = format!("{line} --timestamps {{}}/t.csv --redo features --json");
    let report = tiepoint_in(dir.path(), &line).done().json();
    assert_eq!(report["models"][0]["registered"], 2 * FRAMES);
}
