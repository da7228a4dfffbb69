//! Surveyed points that are marked in photos: `reconstruct --control-points`.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;

use crate::tiepoint_in;

const SYNTH: &str = "synth -o {}/drive --frames 14 --size 320x240 --rate 2.5 --seed 3";
/// The last two are check points.
const NUM_POINTS: usize = 8;
/// From a frame to the next one the camera moves by 4 m.
const MIN_MARKS: usize = 3;
/// Errors of centres of a model of these photos that fits positions well (`positions.rs`).
const MAX_RMS_M: f64 = 0.2;
/// Fifteen times that.
const WRONG_M: f64 = 3.0;

/// Points beside the road, 8 m ahead of frames 2 to 9, with their true pixels in the photos of the
/// left camera.
fn csv(dir: &Path, error_m: &dyn Fn(usize) -> Vector3<f64>) -> String {
    let truth = read_model(&dir.join("drive/truth/model")).unwrap();
    let left: Vec<_> =
        truth.registered().filter(|(_, image, _)| image.name.starts_with("left/")).collect();
    let mut text = String::from("point,x,y,z,image,px,py,sigma,sigma_px\n");
    for index in 0..NUM_POINTS {
        let side_m = [-3.0, 2.5][index % 2];
        let in_camera = Vector3::new(side_m, [1.0, -1.5, 0.5][index % 3], 8.0);
        let xyz = left[index + 2].2.inverse() * in_camera;
        let kind = if index < NUM_POINTS - 2 { "p" } else { "CHK-" };
        let [x, y, z] = (xyz + error_m(index)).into();
        let mut marks = 0;
        for (id, image, pose) in &left {
            let intrinsics = truth.camera_of(*id).intrinsics;
            let Some(pixel) = intrinsics.project(&(**pose * xyz)) else { continue };
            let is_in_photo = (0.0..320.0).contains(&pixel.x) && (0.0..240.0).contains(&pixel.y);
            if is_in_photo && (**pose * xyz).z > 1.0 {
                let (name, px, py) = (&image.name["left/".len()..], pixel.x, pixel.y);
                text += &format!("{kind}{index},{x},{y},{z},{name},{px},{py},0.01,0.5\n");
                marks += 1;
            }
        }
        assert!(marks >= MIN_MARKS, "{index}: {marks}");
    }
    text + "lone,0,0,0,000003.png,100,100,0.01,0.5\n"
}

fn report(dir: &Path) -> Value {
    let bytes = fs::read(dir.join("ws/report.json")).unwrap();
    serde_json::from_slice::<Value>(&bytes).unwrap()["models"][0]["control_points"].clone()
}

#[test]
fn photos_become_a_model_in_the_frame_of_control_points() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, SYNTH).done();
    fs::write(dir.join("gcp.csv"), csv(dir, &|_| Vector3::zeros())).unwrap();
    let line = "reconstruct {}/drive/left -o {}/ws --control-points {}/gcp.csv";
    let text = tiepoint_in(dir, line).done().stdout();
    assert!(text.contains("in the frame of the control points"), "{text}");
    assert!(text.contains("may go unnoticed"), "{text}");
    assert!(text.contains("in different directions: lone (1 mark)\n"), "{text}");
    let found = report(dir);
    let points = found["points"].as_array().unwrap();
    assert!(points.iter().all(|point| point["is_wrong"] == false), "{found}");
    let rms_m = |kind: &str| -> f64 {
        let axes = found[kind]["rms_m"].as_array().unwrap().iter();
        axes.map(|axis| axis.as_f64().unwrap().powi(2)).sum::<f64>().sqrt()
    };
    assert_eq!(found["check"]["points"], 2, "{found}");
    assert!(rms_m("check") < MAX_RMS_M, "{found}");

    // A wrong one is named, and no right one, in the report and in words.
    let error_m = |index| Vector3::y() * if index == 2 { WRONG_M } else { 0.0 };
    fs::write(dir.join("gcp.csv"), csv(dir, &error_m)).unwrap();
    let text = tiepoint_in(dir, "map {}/ws --redo map --control-points {}/gcp.csv").done().stdout();
    assert!(text.contains("the control point p2 is wrong by"), "{text}");
    let found = report(dir);
    let wrong = |point: &&Value| point["is_wrong"] == true;
    let wrong: Vec<&Value> = found["points"].as_array().unwrap().iter().filter(wrong).collect();
    assert!(wrong.len() == 1 && wrong[0]["name"] == "p2", "{found}");
}
