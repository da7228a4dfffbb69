//! Grouping of photos into cameras: photos of several sizes, turns and lenses in one folder.

use std::fs;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::imageops;
use serde_json::Value;

use crate::{photos, tiepoint_in};

/// The cameras of the feature stage as width and height, and the camera (from 0) of each image in
/// the order of their names.
fn cameras_and_images(dir: &Path) -> (Vec<[u64; 2]>, Vec<i64>) {
    let report = fs::read(dir.join("ws/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let cameras = report["stages"]["features"]["cameras"].as_array().unwrap();
    let size = |camera: &Value| ["width", "height"].map(|side| camera[side].as_u64().unwrap());
    let database = rusqlite::Connection::open(dir.join("ws/database.db")).unwrap();
    let mut query = database.prepare("SELECT camera_id - 1 FROM images ORDER BY name").unwrap();
    let images = query.query_map([], |row| row.get(0)).unwrap();
    (cameras.iter().map(size).collect(), images.map(Result::unwrap).collect())
}

/// Eight photos; a third is turned by 90°, and one has half the size.
fn write_mixed(dir: &Path) {
    photos::write(dir, 8, 0);
    for index in [1, 4, 7] {
        let turned = imageops::rotate90(&photos::photo(index, 0));
        turned.save(dir.join(format!("{index}.png"))).unwrap();
    }
    let half = imageops::thumbnail(&photos::photo(5, 0), photos::WIDTH / 2, photos::HEIGHT / 2);
    half.save(dir.join("5.png")).unwrap();
}

#[test]
fn a_folder_of_turned_and_smaller_photos() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    write_mixed(&photos);
    photos::write_truth(&dir.path().join("truth"), 8);
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws").done();
    let (cameras, images) = cameras_and_images(dir.path());
    assert_eq!(cameras, [[320, 240], [240, 320], [160, 120]]);
    assert_eq!(images, [0, 1, 0, 0, 1, 2, 0, 1]);
    // One folder is no rig, so that the default --rig auto has nothing to constrain.
    assert!(!dir.path().join("ws/rig.json").exists());
    let found =
        tiepoint_in(dir.path(), "evaluate poses {}/ws --truth strecha:{}/truth --json").json();
    assert_eq!(found["registered"], 8);
    // The cameras stand on an arc of 2.5 m.
    let error_m = found["centre_error"]["rmse"].as_f64().unwrap();
    assert!(error_m < 0.02, "{error_m}");
}

#[test]
fn groups_of_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    for folder in ["a", "b"] {
        photos::write(&dir.path().join("photos").join(folder), 2, 0);
    }
    for (grouping, expected) in [
        ("auto", [0, 0, 1, 1]),
        ("folder", [0, 0, 1, 1]),
        ("image", [0, 1, 2, 3]),
        ("single", [0, 0, 0, 0]),
    ] {
        let line = format!(
            "features {{}}/photos -o {{}}/ws --cameras {grouping} --max-megapixels 1 --redo \
            features"
        );
        tiepoint_in(dir.path(), &line).done();
        assert_eq!(cameras_and_images(dir.path()).1, expected, "{grouping}");
    }
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws --max-megapixels 1")
        .failed(1, &["--cameras single and not auto", "--redo features"]);
}

/// Two standard deviations of the calibrations, which are exact.
const NEAR_PX: f64 = 2.0;

#[test]
fn known_calibrations_of_single_cameras_are_priors() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos/left"), 4, 0);
    photos::write(&dir.path().join("photos/right"), 6, 0);
    for index in 0..4 {
        fs::remove_file(dir.path().join(format!("photos/right/{index}.png"))).unwrap();
    }
    photos::write(&dir.path().join("photos/rear"), 8, 0);
    for index in 0..6 {
        fs::remove_file(dir.path().join(format!("photos/rear/{index}.png"))).unwrap();
    }
    // The same lens in three formats; the first pixel is at (0, 0) in two of them.
    fs::write(dir.path().join("c.txt"), "1 PINHOLE 320 240 330 330 160 120\n").unwrap();
    let kalibr = "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n  \
                  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  intrinsics: [330, 330, 159.5, \
                  119.5]\n  resolution: [320, 240]\n";
    fs::write(dir.path().join("k.yaml"), kalibr).unwrap();
    let line = "reconstruct {}/photos -o {}/ws --rig off --calibration left={}/c.txt \
                --calibration *ight={}/k.yaml#cam0";
    let params = |report: Value| -> Vec<(String, Vec<f64>)> {
        let cameras = report["models"][0]["cameras"].as_array().unwrap().clone();
        let numbers = |camera: &Value| camera["params"].as_array().unwrap().clone();
        cameras
            .iter()
            .map(|camera| {
                let model = camera["model"].as_str().unwrap().to_owned();
                (model, numbers(camera).iter().map(|n| n.as_f64().unwrap()).collect())
            })
            .collect()
    };
    let report = tiepoint_in(dir.path(), &format!("{line} --json")).done().json();
    assert_eq!(report["models"][0]["registered"], 8);
    let found = params(report);
    let left = [330.0, 330.0, 160.0, 120.0];
    // The distortion is refined, too.
    for index in [0, 2] {
        let (model, params) = &found[index];
        assert_eq!(model, "OPENCV");
        assert!((params[0] - 330.0).abs() < NEAR_PX, "{found:?}");
    }
    // The camera without a calibration is estimated.
    let rear = &found[1];
    assert_eq!(rear.0, "SIMPLE_RADIAL");
    assert!((rear.1[0] - photos::FOCAL_PX).abs() < 0.02 * photos::FOCAL_PX, "{rear:?}");
    // The same command keeps all stages, and a changed file is named.
    let again = tiepoint_in(dir.path(), &format!("{line} --json")).done();
    assert!(again.events().iter().any(|event| event["event"] == "stage_kept"));
    tiepoint_in(dir.path(), "map {}/ws --rig off --refine focal")
        .failed(1, &["distortion refined and not fixed (--refine)", "--redo map"]);
    tiepoint_in(dir.path(), "map {}/ws --rig off --calibration-sigma 2")
        .failed(1, &["--calibration-sigma", "--redo map"]);
    let map = |options: &str| {
        let line = format!("map {{}}/ws --rig off {options} --redo map --json");
        params(tiepoint_in(dir.path(), &line).done().json())
    };
    let refined = map("--refine focal");
    assert_ne!(refined[0].1[0], 330.0, "--refine holds for known intrinsics");
    assert_eq!(refined[0].1[2..], left[2..]);
    let exact = map("--refine focal --calibration-sigma 1e-6");
    assert!((exact[0].1[0] - 330.0).abs() < 1e-3, "{exact:?}");
    fs::write(dir.path().join("c.txt"), "1 PINHOLE 320 240 331 331 160 120\n").unwrap();
    tiepoint_in(dir.path(), line).failed(1, &["another --calibration", "--redo features"]);
}

/// Photo `index` as a JPEG file that stores it turned by 180°, or as it is, with the EXIF
/// orientation that says so.
fn jpeg(index: usize, is_turned: bool) -> Vec<u8> {
    let photo = photos::photo(index, 0);
    let (photo, orientation) =
        if is_turned { (imageops::rotate180(&photo), 3) } else { (photo, 1) };
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, 98).encode_image(&photo).unwrap();
    let tiff = [
        b"MM\0*\0\0\0\x08".as_slice(),
        // One field, a short.
        &[0, 1, 0x01, 0x12, 0, 3, 0, 0, 0, 1, 0, orientation, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let length = (2 + 6 + tiff.len() as u16).to_be_bytes();
    [&jpeg[..2], &[0xFF, 0xE1], &length, b"Exif\0\0", &tiff, &jpeg[2..]].concat()
}

#[test]
fn photos_held_upside_down_are_another_camera_with_the_calibration_turned() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("photos")).unwrap();
    for index in 0..4 {
        let path = dir.path().join(format!("photos/{index}.jpg"));
        fs::write(path, jpeg(index, index % 2 == 1)).unwrap();
    }
    fs::write(dir.path().join("c.txt"), "1 PINHOLE 320 240 330 330 165 118\n").unwrap();
    for options in ["", "--calibration {}/c.txt", "--intrinsics 330,330,165,118"] {
        let line = format!("features {{}}/photos -o {{}}/ws --redo features {options}");
        let run = tiepoint_in(dir.path(), &line).done();
        assert_eq!(cameras_and_images(dir.path()).1, [0, 1, 0, 1], "{options}");
        let said = run.stderr().contains("the camera of 1.jpg is calibrated by ");
        assert_eq!(said, options.contains("calibration"), "{}", run.stderr());
        if !options.is_empty() {
            let report = fs::read(dir.path().join("ws/report.json")).unwrap();
            let report: Value = serde_json::from_slice(&report).unwrap();
            let cameras = &report["stages"]["features"]["cameras"];
            assert_eq!(cameras[0]["params"], serde_json::json!([330.0, 330.0, 165.0, 118.0]));
            assert_eq!(cameras[1]["params"], serde_json::json!([330.0, 330.0, 155.0, 122.0]));
        }
    }
}

/// Largest mean difference of an image that is encoded anew as JPEG, in grey levels: 1 was
/// measured, of an image turned by 180° 40.
const MAX_JPEG_DIFFERENCE: f64 = 4.0;

#[test]
fn exports_have_the_pixels_that_the_model_is_of() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let photo = |index: usize| dir.join(format!("proj/images/{index}.jpg"));
    fs::create_dir_all(dir.join("proj/images")).unwrap();
    for index in 0..4 {
        fs::write(photo(index), jpeg(index, index % 2 == 1)).unwrap();
    }
    tiepoint_in(dir, "reconstruct {}/proj/images -o {}/ws --cameras single").done();
    let upright = |path: &Path, index: usize| {
        let (found, expected) = (image::open(path).unwrap().into_luma8(), photos::photo(index, 0));
        assert_eq!(found.dimensions(), expected.dimensions());
        let differences = found.iter().zip(expected.iter()).map(|(a, b)| f64::from(a.abs_diff(*b)));
        let mean = differences.sum::<f64>() / found.len() as f64;
        assert!(mean < MAX_JPEG_DIFFERENCE, "{}: {mean}", path.display());
    };
    tiepoint_in(dir, "export {}/ws --to nerfstudio -o {}/nerf").done();
    for index in 0..4 {
        // `image` ignores EXIF, as nerfstudio does.
        upright(&dir.join(format!("nerf/images/{index}.jpg")), index);
    }
    // Photos that need no turning are copied.
    assert!(fs::read(dir.join("nerf/images/0.jpg")).unwrap() == fs::read(photo(0)).unwrap());
    // Photos in their places are not changed.
    tiepoint_in(dir, "export {}/ws --to nerfstudio -o {}/proj")
        .failed(1, &["images/1.jpg is stored turned", "another folder"]);
    assert!(fs::read(photo(1)).unwrap() == jpeg(1, true));
    // A model in no workspace names its photos.
    fs::create_dir(dir.join("model")).unwrap();
    for name in ["cameras", "images", "points3D"] {
        let file = format!("{name}.bin");
        fs::copy(dir.join("ws/sparse/0").join(&file), dir.join("model").join(&file)).unwrap();
    }
    let line = "export {}/model --to nerfstudio -o {}/out";
    tiepoint_in(dir, line).failed(1, &["--images"]);
    tiepoint_in(dir, &format!("{line} --images {{}}/proj/images")).done();
    upright(&dir.join("out/images/3.jpg"), 3);
    // Photos that were replaced since.
    let mut small = Vec::new();
    let resized = imageops::resize(&photos::photo(2, 0), 200, 150, imageops::FilterType::Nearest);
    JpegEncoder::new(&mut small).encode_image(&resized).unwrap();
    let cut = fs::read(photo(2)).unwrap()[..900].to_vec();
    // Of the same size.
    let other = jpeg(3, false);
    for bytes in [cut, other, small, Vec::new(), b"hello".to_vec()] {
        fs::write(photo(2), bytes).unwrap();
        for line in [
            "export {}/ws --to nerfstudio -o {}/changed",
            "export {}/ws --to openmvs -o {}/changed",
            "undistort {}/ws -o {}/changed",
            "dense {}/ws",
        ] {
            tiepoint_in(dir, line).failed(1, &["2.jpg"]);
        }
    }
}

#[test]
fn the_images_ask_for_a_camera_model_unless_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let drive = "synth -o {}/drive --carrier handheld --frames 8 --size 320x240 --rate 3 --effects \
        lens";
    tiepoint_in(dir.path(), drive).done();
    let reconstruct = "reconstruct {}/drive -o {}/ws --rig off";
    let camera_models = || {
        let report = fs::read(dir.path().join("ws/report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let cameras = report["models"][0]["cameras"].as_array().unwrap().clone();
        cameras
            .iter()
            .map(|camera| camera["model"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let selected = "lens      camera 1: OPENCV_FISHEYE in place of SIMPLE_RADIAL";
    let summary = tiepoint_in(dir.path(), reconstruct).done().stdout();
    assert!(summary.contains(selected), "{summary}");
    assert_eq!(camera_models(), ["OPENCV_FISHEYE"; 2]);
    for name in ["SIMPLE_RADIAL", "RADIAL"] {
        let named = format!("{reconstruct} --camera-model {name}");
        tiepoint_in(dir.path(), &named).failed(1, &["--redo features"]);
        let summary = tiepoint_in(dir.path(), &format!("{named} --redo features")).done().stdout();
        assert!(!summary.contains("in place of"), "{summary}");
        assert_eq!(camera_models(), [name; 2]);
    }
}
