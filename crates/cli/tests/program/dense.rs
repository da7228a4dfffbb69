//! The stage `dense`: its files, resumption, threads and bad input.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use image::GrayImage;
use serde_json::Value;
use tiepoint_pipeline::io::colmap::{Format, read_model, write_model};
use tiepoint_pipeline::io::dense::DenseMap;
use tiepoint_pipeline::io::ply;
use tiepoint_pipeline::sfm::scene::ImageId;

use crate::{photos, tiepoint_in};

const COUNT: usize = 5;
/// Share of the pixels with a depth: walls of a textured corner, of which each image sees a part
/// that two others see.
const MIN_SHARE: f64 = 0.3;

fn reconstructed(dir: &Path) {
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
}

pub(crate) fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// All files below a folder, by name.
fn files(folder: &Path, within: &str, found: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = format!("{within}{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            files(&entry.path(), &format!("{name}/"), found);
        } else {
            found.insert(name, fs::read(entry.path()).unwrap());
        }
    }
}

fn results(workspace: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    files(&workspace.join("dense"), "", &mut found);
    found
}

#[test]
fn dense_gives_a_workspace_of_colmap_and_resumes_with_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir);
    for copy in ["killed", "single"] {
        copy_folder(&dir.join("ws"), &dir.join(copy));
    }
    let run =
        tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps --threads 2 --json").done();
    let (report, events) = (run.json(), run.events());
    let stage = &report["stages"]["dense"];
    assert_eq!(stage["depth_maps"], COUNT, "{report}");
    let count = |kind: &str| events.iter().filter(|event| event["event"] == kind).count();
    assert_eq!((count("stage_began"), count("stage_done")), (1, 1));
    assert_eq!(count("dense_done"), 3 * COUNT);
    let dense = dir.join("ws/dense");
    let model = read_model(&dense.join("sparse")).unwrap();
    let mut names = vec!["fused.ply".to_owned(), "fused.ply.vis".to_owned()];
    for (_, image) in model.images() {
        let camera = model.camera(image.camera);
        assert_eq!((camera.width.max(camera.height), model.num_images()), (200, COUNT));
        let map = |kind: &str| format!("stereo/{kind}_maps/{}.geometric.bin", image.name);
        let photo = format!("images/{}", image.name);
        let of_image = [photo, map("depth"), map("normal"), map("confidence")];
        let size = (camera.width, camera.height);
        assert_eq!(image::image_dimensions(dense.join(&of_image[0])).unwrap(), size);
        let depths = DenseMap::read(&dense.join(&of_image[1])).unwrap();
        assert_eq!(
            (depths.width as u32, depths.height as u32, depths.channels),
            (size.0, size.1, 1)
        );
        let found = depths.values.iter().filter(|depth| **depth > 0.0).count();
        assert!(found as f64 > MIN_SHARE * depths.values.len() as f64, "{found}");
        assert_eq!(DenseMap::read(&dense.join(&of_image[2])).unwrap().channels, 3);
        names.extend(of_image);
    }
    names.extend(["stereo/patch-match.cfg", "stereo/fusion.cfg"].map(str::to_owned));
    names.extend(
        ["cameras", "images", "points3D", "rigs", "frames"].map(|n| format!("sparse/{n}.bin")),
    );
    names.sort();
    let expected = results(&dir.join("ws"));
    assert_eq!(expected.keys().cloned().collect::<Vec<_>>(), names);
    let points = ply::read(&dense.join("fused.ply")).unwrap();
    assert_eq!(stage["points"], points.len());
    assert!(points.len() > 1000, "{}", points.len());
    // A second run keeps the results, and other options are refused by name.
    let events =
        tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps --json").done().events();
    assert_eq!(events[0]["event"], "stage_kept");
    tiepoint_in(dir, "dense {}/ws --normal-maps").failed(1, &["--max-size", "--redo dense"]);
    // Files that somebody removed are made again, and those alone.
    for name in [&names[0], names.last().unwrap()] {
        fs::remove_file(dense.join(name)).unwrap();
    }
    let events =
        tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps --json").done().events();
    assert_eq!(events[0]["done"], 3 * COUNT);
    assert!(results(&dir.join("ws")) == expected, "removed files come back with other bytes");
    fs::remove_dir_all(dir.join("ws/sparse")).unwrap();
    tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps").failed(1, &["tiepoint map"]);
    tiepoint_in(dir, "map {}/ws").done();
    let events =
        tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps --json").done().events();
    assert_eq!((&events[0]["event"], &events[0]["done"]), (&"stage_began".into(), &0.into()));
    assert!(results(&dir.join("ws")) == expected, "the model is the same again");
    let events =
        tiepoint_in(dir, "dense {}/ws --max-size 200 --normal-maps --json").done().events();
    assert_eq!(events[0]["event"], "stage_kept");
    // One thread.
    tiepoint_in(dir, "dense {}/single --max-size 200 --normal-maps --threads 1").done();
    assert!(results(&dir.join("single")) == expected, "one thread gives other bytes");
    // Killed in each of the three passes.
    for events in [2, COUNT + 2, 2 * COUNT + 3] {
        kill_after(&dir.join("killed"), events);
    }
    let run = tiepoint_in(dir, "dense {}/killed --max-size 200 --normal-maps --json").done();
    let began = &run.events()[0];
    assert!(began["done"].as_u64().unwrap() >= 2 * COUNT as u64 + 3, "{began}");
    assert!(results(&dir.join("killed")) == expected, "a resumed run gives other bytes");
}

/// Kills a run after this number of steps, those of earlier runs included.
fn kill_after(workspace: &Path, steps: usize) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_tiepoint"))
        .arg("dense")
        .arg(workspace)
        .args(["--max-size", "200", "--normal-maps", "--json"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut seen = 0;
    for line in BufReader::new(child.stderr.take().unwrap()).lines() {
        let event: Value = serde_json::from_str(&line.unwrap()).unwrap();
        match event["event"].as_str() {
            Some("stage_began") => seen += event["done"].as_u64().unwrap() as usize,
            Some("dense_done") => seen += 1,
            _ => {}
        }
        if seen >= steps {
            break;
        }
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(seen >= steps, "{seen}");
}

#[test]
fn dense_names_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    tiepoint_in(dir, "dense {}/nothing").failed(1, &["nothing", "is not a workspace"]);
    reconstructed(dir);
    tiepoint_in(dir, "dense {}/ws --redo map").failed(2, &["--redo", "dense"]);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo dense").failed(2, &["--dense"]);
    tiepoint_in(dir, "export {}/ws --to las -o {}/a.las").failed(1, &["tiepoint dense"]);
    // Another's file in the way.
    fs::create_dir_all(dir.join("ws/dense")).unwrap();
    fs::write(dir.join("ws/dense/fused.ply"), "theirs").unwrap();
    tiepoint_in(dir, "dense {}/ws").failed(1, &["fused.ply", "did not make it"]);
    assert_eq!(fs::read(dir.join("ws/dense/fused.ply")).unwrap(), b"theirs");
    fs::remove_dir_all(dir.join("ws/dense")).unwrap();
    // One image, then cameras of one pixel, which the photos are not of.
    let sparse = dir.join("ws/sparse/0");
    let model = read_model(&sparse).unwrap();
    let mut changed = model.clone();
    for index in 1..COUNT {
        changed.deregister(ImageId::from_index(index));
    }
    write_model(&sparse, &changed, Format::Binary).unwrap();
    tiepoint_in(dir, "dense {}/ws").failed(1, &["the 1 registered images", "overlap"]);
    let mut changed = model.clone();
    let cameras: Vec<_> = changed.cameras().map(|(id, _)| id).collect();
    for id in cameras {
        let camera = changed.camera_mut(id);
        (camera.width, camera.height) = (1, 1);
    }
    write_model(&sparse, &changed, Format::Binary).unwrap();
    tiepoint_in(dir, "dense {}/ws").failed(1, &["photos/0.png", "320 × 240", "1 × 1"]);
    write_model(&sparse, &model, Format::Binary).unwrap();
    // A folder without masks, and a mask of another size.
    fs::create_dir_all(dir.join("masks")).unwrap();
    tiepoint_in(dir, "dense {}/ws --masks {}/masks").failed(1, &["masks", "holds no mask"]);
    tiepoint_in(dir, "dense {}/ws --max-size 100").done();
    let old = results(&dir.join("ws"));
    let name = &model.images().next().unwrap().1.name;
    GrayImage::new(7, 7).save(dir.join(format!("masks/{name}.png"))).unwrap();
    tiepoint_in(dir, "dense {}/ws --masks {}/masks --redo dense").failed(1, &["masks", "pixels"]);
    tiepoint_in(dir, "dense {}/ws --max-size 1").failed(2, &["--max-size", "16"]);
    // A photo of another size, then no photos.
    let first = fs::read_dir(dir.join("photos")).unwrap().next().unwrap().unwrap().path();
    let small = image::open(&first).unwrap().thumbnail(50, 50);
    small.save(&first).unwrap();
    let name = first.file_name().unwrap().to_str().unwrap();
    tiepoint_in(dir, "dense {}/ws --redo dense").failed(1, &[name, "is not the photo"]);
    fs::remove_dir_all(dir.join("photos")).unwrap();
    tiepoint_in(dir, "dense {}/ws --redo dense").failed(1, &["photos"]);
    assert!(results(&dir.join("ws")) == old, "failed runs have changed the dense workspace");
}

/// Depths alone have confidences, and these are the same in the map and in the picture.
fn check_confidences(dense: &Path, image: &str, depths: &DenseMap) {
    let map = dense.join(format!("stereo/confidence_maps/{image}.geometric.bin"));
    let map = DenseMap::read(&map).unwrap();
    assert_eq!((map.width, map.height, map.channels), (depths.width, depths.height, 1));
    let png = image::open(dense.join(format!("confidence_png/{image}.png"))).unwrap();
    let png = png.as_luma8().expect("8 bits").as_raw();
    for (index, (depth, confidence)) in depths.values.iter().zip(map.values).enumerate() {
        assert!((0.0..1.0).contains(&confidence), "pixel {index}: {confidence}");
        assert_eq!(confidence > 0.0, *depth > 0.0, "pixel {index}");
        assert_eq!(png[index], (255.0 * confidence).round() as u8, "pixel {index}");
    }
}

/// Masks, 16-bit depth maps, the page, and the stage as a part of `reconstruct`.
#[test]
fn dense_uses_masks_and_writes_what_it_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let run = "reconstruct {}/photos -o {}/ws --dense --max-size 240 --json";
    let report = tiepoint_in(dir, run).done().json();
    assert_eq!(report["stages"]["dense"]["depth_maps"], COUNT, "{report}");
    let model = read_model(&dir.join("ws/dense/sparse")).unwrap();
    let name = &model.images().next().unwrap().1.name;
    let map = |name: &str| {
        let file = format!("ws/dense/stereo/depth_maps/{name}.geometric.bin");
        DenseMap::read(&dir.join(file)).unwrap()
    };
    let unmasked = map(name);
    // The left half of the first photo is not used.
    fs::create_dir_all(dir.join("masks")).unwrap();
    let mask = GrayImage::from_fn(photos::WIDTH, photos::HEIGHT, |x, _| {
        image::Luma([if x < photos::WIDTH / 2 { 0 } else { 255 }])
    });
    mask.save(dir.join(format!("masks/{name}.png"))).unwrap();
    let masked = "dense {}/ws --max-size 240 --masks {}/masks --depth-pngs";
    tiepoint_in(dir, masked).failed(1, &["--depth-pngs", "--redo dense"]);
    let told = tiepoint_in(dir, &format!("{masked} --redo dense")).done().stdout();
    let next = format!("--masks {}/masks --max-size 240", dir.display());
    assert!(told.lines().any(|it| it.contains("undistort") && it.contains(&next)), "{told}");
    let (depths, mask) = (map(name), dir.join(format!("ws/dense/masks/{name}.png")));
    let mask = image::open(mask).unwrap().into_luma8();
    let png = image::open(dir.join(format!("ws/dense/depth_png/{name}.png"))).unwrap();
    let png = png.as_luma16().expect("16 bits").as_raw();
    let scale = fs::read(dir.join("ws/dense/depth_png/scale.json")).unwrap();
    let scale: Value = serde_json::from_slice(&scale).unwrap();
    let scale = scale["depth_unit_scale_factor"].as_f64().unwrap();
    let mut removed = 0;
    for (index, depth) in depths.values.iter().enumerate() {
        let is_used = mask.as_raw()[index] != 0;
        assert!(is_used || *depth == 0.0, "pixel {index}");
        removed += usize::from(!is_used && unmasked.values[index] > 0.0);
        let from_png = f64::from(png[index]) * scale;
        assert!((from_png - f64::from(*depth)).abs() <= 0.51 * scale, "pixel {index}");
    }
    check_confidences(&dir.join("ws/dense"), name, &depths);
    let share = removed as f64 / mask.as_raw().len() as f64;
    assert!(share > 0.5 * MIN_SHARE, "{share}");
    // Without a mask, nothing is masked.
    let other = &model.images().nth(1).unwrap().1.name;
    assert!(!dir.join(format!("ws/dense/masks/{other}.png")).exists());
    let page = tiepoint_in(dir, "view {}/ws --json").done().json();
    let page = fs::read_to_string(page["report"].as_str().unwrap()).unwrap();
    let data = page.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: Value = serde_json::from_str(data).unwrap();
    let shown = &data["sections"][0]["models"][0]["dense"];
    assert_eq!(shown["pictures"].as_array().unwrap().len(), COUNT);
    assert!(shown["points_shown"].as_u64().unwrap() > 100, "{}", shown["points_shown"]);
    // The second export replaces the first one.
    let points = ply::read(&dir.join("ws/dense/fused.ply")).unwrap();
    for _ in 0..2 {
        let found = tiepoint_in(dir, "export {}/ws --to gltf -o {}/a.glb --json").done().json();
        let model = &data["sections"][0]["models"][0];
        let sparse = model["num_points"].as_u64().unwrap() as usize;
        assert_eq!(found["points"], sparse + points.len(), "{found}");
        assert_eq!(found["poses"], COUNT, "{found}");
    }
    for _ in 0..2 {
        let run = tiepoint_in(dir, "export {}/ws --to las -o {}/cloud.laz");
        // Cargo joins the features of the packages that it builds together, so that the program may
        // have LAS whatever the features of this package are.
        if cfg!(feature = "las") || run.code() == 0 {
            run.done();
            let compare = "evaluate cloud {}/cloud.laz {}/ws/dense/fused.ply --json";
            let found = tiepoint_in(dir, compare).done().json();
            assert_eq!(found["points"], points.len(), "{found}");
            assert_eq!(found["reference_points"], points.len(), "{found}");
            let extent = points.iter().map(|point| point.xyz.amax()).fold(0.0, f64::max);
            assert!(found["distance"]["mean"].as_f64().unwrap() < 1e-3 * extent, "{found}");
        } else {
            run.failed(1, &["the feature las", "fused.ply"]);
        }
    }
    // Other masks are another input.
    mask.save(dir.join(format!("masks/{other}.png"))).unwrap();
    tiepoint_in(dir, masked).failed(1, &["masks"]);
}

/// All depth maps of a drive with a rolling shutter have poses of rows, and none of another drive.
#[test]
fn a_rolling_shutter_is_seen_from_the_poses_of_its_rows() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let drive = "synth -o {}/drive --frames 6 --size 320x240 --view-direction right";
    tiepoint_in(dir, &format!("{drive} --effects rolling-shutter")).done();
    let run = "reconstruct {}/drive --timestamps {}/drive/timestamps.csv --max-size 160 --dense";
    let report = |options: &str| tiepoint_in(dir, &format!("{run} --json {options}")).done().json();
    let rolling = report("-o {}/rolling --rolling-shutter 16ms");
    let dense = &rolling["stages"]["dense"];
    assert!(dense["depth_maps"].as_u64() > Some(0), "{rolling}");
    assert_eq!(dense["depth_maps_with_row_poses"], dense["depth_maps"], "{rolling}");
    let global = report("-o {}/global");
    assert!(global["stages"]["dense"].get("depth_maps_with_row_poses").is_none(), "{global}");
}
