//! Results are correct, and the same on any number of threads.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::scene::Reconstruction;

use crate::{photos, tiepoint_in};

const COUNT: usize = 5;
/// PLY files hold single precision; the scene is some metres large.
const MAX_ROUNDING: f64 = 1e-4;
/// The cameras are 0.35 m apart and see walls 4 m away; 240 lines resolve a tenth of a pixel at
/// best.
const MAX_CENTRE_ERROR_M: f64 = 0.02;
/// Of the focal length, which five views of a corner determine.
const MAX_FOCAL_ERROR: f64 = 0.02;
/// Rendered without noise, located by SIFT.
const MAX_REPROJECTION_ERROR_PX: f64 = 0.8;

fn models(workspace: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for name in ["cameras", "images", "points3D", "rigs", "frames"] {
        let path = format!("sparse/0/{name}.bin");
        files.insert(path.clone(), fs::read(workspace.join(path)).unwrap());
    }
    files.insert("points.ply".to_owned(), fs::read(workspace.join("points.ply")).unwrap());
    files
}

fn count(events: &[Value], kind: &str) -> usize {
    events.iter().filter(|event| event["event"] == kind).count()
}

#[test]
fn photos_become_a_model_and_a_second_run_keeps_it() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    photos::write_truth(&dir.join("truth"), COUNT);
    let line = "reconstruct {}/photos -o {}/ws --json --threads 2";
    let run = tiepoint_in(dir, line).done();
    let (report, events) = (run.json(), run.events());
    let model = &report["models"][0];
    assert_eq!(model["registered"], COUNT, "{report}");
    assert!(
        model["mean_reprojection_error_px"].as_f64().unwrap() < MAX_REPROJECTION_ERROR_PX,
        "{report}"
    );
    assert_eq!(count(&events, "stage_began"), 3);
    assert_eq!(count(&events, "stage_done"), 3);
    assert_eq!(count(&events, "image_done"), COUNT);
    assert_eq!(count(&events, "pair_done"), COUNT * (COUNT - 1) / 2);
    let place = |kind: &str| events.iter().position(|event| event["event"] == kind).unwrap();
    let chosen = &events[place("pairs_chosen")];
    assert!(place("pairs_chosen") < place("pair_done"), "{events:?}");
    assert_eq!(
        (&chosen["selection"], &chosen["pairs"]),
        (&"exhaustive".into(), &(COUNT * (COUNT - 1) / 2).into())
    );
    assert!(chosen["expected_s"].as_f64().unwrap() > 0.0, "{chosen}");
    let matches = &report["stages"]["match"];
    assert_eq!(matches["selection"], "exhaustive");
    assert_eq!(matches["expected_seconds"], chosen["expected_s"]);
    assert_eq!(
        fs::read(dir.join("ws/report.json"))
            .map(|b| serde_json::from_slice::<Value>(&b).unwrap())
            .unwrap(),
        report
    );
    for name in ["database.db-wal", "database.db-shm", ".sparse.new", ".sparse.old"] {
        assert!(!dir.join("ws").join(name).exists(), "{name} is left over");
    }

    let evaluation =
        tiepoint_in(dir, "evaluate poses {}/ws --truth strecha:{}/truth --json").done().json();
    assert_eq!(evaluation["registered"], COUNT);
    assert!(
        evaluation["centre_error"]["max"].as_f64().unwrap() < MAX_CENTRE_ERROR_M,
        "{evaluation}"
    );
    let focal = &evaluation["focal_lengths"][0];
    let focal_error =
        focal["model_px"].as_f64().unwrap() / focal["truth_px"].as_f64().unwrap() - 1.0;
    assert!(focal_error.abs() < MAX_FOCAL_ERROR, "{evaluation}");

    let before = models(&dir.join("ws"));
    let again = tiepoint_in(dir, line).done();
    assert_eq!(count(&again.events(), "stage_kept"), 3);
    assert_eq!(again.json(), report);
    // Touching a photo changes nothing, because the fingerprint depends on its bytes.
    photos::photo(0, 0).save(dir.join("photos/0.png")).unwrap();
    assert_eq!(count(&tiepoint_in(dir, line).done().events(), "stage_kept"), 3);
    // Another option is an error; with --redo the stage is computed again, with the same result.
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --pairs sequential:4")
        .failed(1, &["matches", "pairs exhaustive and not sequential:4", "--redo match"]);
    photos::photo(0, 7).save(dir.join("photos/9.png")).unwrap();
    tiepoint_in(dir, line.trim_end_matches(" --json --threads 2"))
        .failed(1, &["other photos", "--redo features"]);
    fs::remove_file(dir.join("photos/9.png")).unwrap();
    let redone = tiepoint_in(dir, &format!("{line} --redo match")).done().events();
    assert_eq!((count(&redone, "stage_kept"), count(&redone, "stage_done")), (1, 2));
    assert!(models(&dir.join("ws")) == before, "the same bytes");

    for (format, path) in [("colmap-text", "text"), ("ply", "a.ply"), ("kitti", "poses.txt")] {
        tiepoint_in(dir, &format!("export {{}}/ws --to {format} -o {{}}/{path}")).done();
        assert!(dir.join(path).exists());
    }
    for (format, file) in [("openmvs", "scene.mvs"), ("nerfstudio", "transforms.json")] {
        tiepoint_in(dir, &format!("export {{}}/ws --to {format} -o {{}}/{format}")).done();
        assert!(dir.join(format).join(file).is_file());
        for k in 0..COUNT {
            let size =
                image::image_dimensions(dir.join(format!("{format}/images/{k}.png"))).unwrap();
            let photo = image::image_dimensions(dir.join(format!("photos/{k}.png"))).unwrap();
            // Without blank pixels, an undistorted image is a little larger or smaller.
            let change = f64::from(size.0) / f64::from(photo.0) - 1.0;
            let most = if format == "openmvs" { 0.05 } else { 0.0 };
            assert!(change.abs() <= most, "{format}: {size:?} {photo:?}");
        }
        tiepoint_in(dir, &format!("export {{}}/text --to {format} -o {{}}/{format}"))
            .failed(1, &["in no workspace", "the photos are needed"]);
        // The workspace of a model is found.
        tiepoint_in(dir, &format!("export {{}}/ws/sparse/0 --to {format} -o {{}}/{format}")).done();
    }
    let shown = tiepoint_in(dir, "view {}/ws --json").done().json();
    let page = fs::read_to_string(shown["report"].as_str().unwrap()).unwrap();
    assert!(page.contains("report.json") && page.len() < 1 << 20);
    tiepoint_in(dir, "view {}/photos").failed(1, &["photos"]);
    tiepoint_in(dir, "export {}/ws --to colmap --rigid -o {}/rigid")
        .failed(1, &["no two cameras", "leave out --rigid"]);
    let unscaled = tiepoint_in(dir, "map {}/ws --baseline 1m --redo map").done().stdout();
    assert!(
        unscaled.contains("scale     the model was not scaled, because there is only one camera"),
        "{unscaled}"
    );
    tiepoint_in(dir, "map {}/ws --redo map").done();
    // A cloud has no distance to itself with any alignment.
    let cloud = |options: &str| {
        tiepoint_in(dir, &format!("evaluate cloud {{}}/ws {{}}/a.ply {options} --json"))
            .done()
            .json()
    };
    for options in ["--align none", "--align rigid", "", "--truth colmap:{}/ws"] {
        let found = cloud(options);
        assert_eq!(found["points"], model["points"], "{options}");
        assert!(found["distance"]["max"].as_f64().unwrap() < MAX_ROUNDING, "{options}: {found}");
        assert!(
            (found["scale"].as_f64().unwrap() - 1.0).abs() < MAX_ROUNDING,
            "{options}: {found}"
        );
    }
    tiepoint_in(dir, "evaluate cloud {}/a.ply {}/none.ply").failed(1, &["none.ply"]);
    tiepoint_in(dir, "evaluate cloud {}/a.ply {}/a.ply --align free")
        .failed(2, &["similarity, rigid, none"]);
    tiepoint_in(dir, "export {}/ws --to tum -o {}/t.txt")
        .failed(1, &["has a time", "--timestamps"]);
    let text = tiepoint_in(dir, "evaluate poses {}/text --truth colmap:{}/ws --json").done().json();
    assert!(text["centre_error"]["max"].as_f64().unwrap() < 1e-9, "{text}");
    let adjusted = tiepoint_in(dir, "adjust {}/ws -o {}/adjusted --json").done().json();
    let cost =
        |which: &str| adjusted[which].as_f64().unwrap_or_else(|| panic!("no {which}: {adjusted}"));
    assert!(cost("final_cost") > 0.0 && cost("final_cost") <= cost("initial_cost"), "{adjusted}");
    assert!(
        adjusted["seconds"].as_f64().unwrap() > 0.0 && adjusted["iterations"].as_u64().is_some()
    );
    assert!(dir.join("adjusted/images.bin").is_file());
}

/// Checks that what stands beside a model and belongs to another one, or was written by another
/// version, is not used, and that this is said.
fn what_belongs_to_another_model_is_not_used(dir: &Path) {
    let sidecar = dir.join("ws/sparse/0/tiepoint.json");
    let good = fs::read_to_string(&sidecar).unwrap();
    let hash = good.find("\"images.bin\": \"").unwrap() + 15;
    let mut of_another = good.clone();
    of_another.replace_range(hash..hash + 4, "beef");
    for (other, how) in [
        (good.replacen("\"format\": 1", "\"format\": 2", 1), "has format 2"),
        (of_another, "another program has changed the model since"),
    ] {
        assert_ne!(other, good);
        fs::write(&sidecar, &other).unwrap();
        tiepoint_in(dir, "export {}/ws --to kalibr -o {}/other.yaml").failed(1, &["has no rig"]);
        let said = tiepoint_in(dir, "export {}/ws --to colmap -o {}/other").done().stderr();
        assert!(
            said.contains("sparse/0/tiepoint.json is not used") && said.contains(how),
            "{said}"
        );
        assert!(!dir.join("other/tiepoint.json").exists());
        assert_eq!(fs::read_to_string(&sidecar).unwrap(), other);
        assert!(!dir.join("other.yaml").exists());
    }
    fs::write(&sidecar, good).unwrap();
}

/// Checks --baseline and --rigid in a workspace with three frames of two cameras.
fn baseline_sets_the_scale_and_rigid_export_has_frames(dir: &Path) {
    // The cameras are 0.7 m apart; the accuracy at 240 lines is a few millimetres.
    const BASELINE_M: f64 = 0.7;
    const MAX_ERROR_M: f64 = 0.02;
    let line = "map {}/ws --rig RIG --baseline 70cm --redo map --json";
    for rig in ["off", "soft"] {
        let run = tiepoint_in(dir, &line.replace("RIG", rig)).done().json();
        let scale = &run["models"][0]["scale"];
        let reason = scale["reason"].as_str().unwrap();
        assert!(scale["factor"].as_f64().is_some() && reason.ends_with("0.7 m long"), "{run}");
        let measured = run["models"][0]["rig"]["cameras"][0]["median_baseline"].as_f64().unwrap();
        assert!((measured - BASELINE_M).abs() < MAX_ERROR_M, "{run}");
    }
    let said = tiepoint_in(dir, "map {}/ws --rig soft --baseline 0.7m").done().stdout();
    assert!(
        said.contains(
            "scale     the baseline from left to right in the rig extrinsics is 0.7 m long"
        ),
        "{said}"
    );
    tiepoint_in(dir, "map {}/ws --rig soft --baseline 0.8m")
        .failed(1, &["--baseline 0.7m and not 0.8m", "--redo map"]);
    tiepoint_in(dir, "map {}/ws --baseline 7ft").failed(2, &["--baseline", "m, cm or mm"]);
    // Models of soft constraints have no frames; in rigid ones all images are in frames.
    let rigid =
        tiepoint_in(dir, "export {}/ws --to colmap --rigid -o {}/rigid --json").done().json();
    assert_eq!(
        (&rigid["rigid"]["frames"], &rigid["rigid"]["images"]),
        (&3.into(), &6.into()),
        "{rigid}"
    );
    // The two positions on a bent path are not a rig, so that exact extrinsics increase the error.
    let error = |which: &str| rigid["rigid"][which].as_f64().unwrap();
    assert!(
        (error("error_before_px")..MAX_REPROJECTION_ERROR_PX).contains(&error("error_after_px")),
        "{rigid}"
    );
    assert!(read_model(&dir.join("ws/sparse/0")).unwrap().frames.is_empty());
    let model = read_model(&dir.join("rigid")).unwrap();
    assert_eq!((model.frames.len(), model.rigs[0].sensors.len()), (3, 2));
    let right = model.rigs[0].sensors[1].cam_from_rig.unwrap();
    assert!((right.translation.norm() - BASELINE_M).abs() < 1e-9, "{right:?}");
    for frame in &model.frames {
        let pose = |k: usize| *model.image(frame.images[k]).cam_from_world().unwrap();
        let given = right * frame.rig_from_world;
        assert!((given.translation - pose(1).translation).norm() < 1e-9);
        assert!(
            given.rotation.angle_to(&pose(1).rotation) < 1e-9 && frame.rig_from_world == pose(0)
        );
    }
    what_belongs_to_another_model_is_not_used(dir);
    // After adjustment the model is still rigid and valid; --fix-intrinsics keeps the intrinsics.
    for (options, are_fixed) in [("", false), ("--fix-intrinsics", true)] {
        let adjusted = format!("adjusted{options}");
        tiepoint_in(dir, &format!("adjust {{}}/rigid -o {{}}/{adjusted} {options}")).done();
        let adjusted = read_model(&dir.join(adjusted)).unwrap();
        adjusted.validate().unwrap();
        assert_eq!((adjusted.frames.len(), adjusted.rigs.len()), (3, 1));
        assert_ne!(adjusted.frames, model.frames, "something moves");
        let params =
            |model: &Reconstruction| model.cameras().map(|(_, c)| c.intrinsics).collect::<Vec<_>>();
        assert_eq!(params(&adjusted) == params(&model), are_fixed);
    }
    tiepoint_in(dir, "export {}/ws --to kalibr --rigid -o {}/c.yaml")
        .failed(1, &["c.yaml", "leave out --rigid"]);
}

#[test]
fn the_same_bytes_stage_by_stage_and_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let options = format!("--intrinsics {0},{0},160,120", photos::FOCAL_PX);
    tiepoint_in(dir, &format!("reconstruct {{}}/photos -o {{}}/one --threads 1 {options}")).done();
    tiepoint_in(dir, &format!("features {{}}/photos -o {{}}/three --threads 3 {options}")).done();
    tiepoint_in(dir, "match {}/three --threads 3").done();
    tiepoint_in(dir, "map {}/three --threads 3").done();
    assert!(models(&dir.join("one")) == models(&dir.join("three")));
    // Known intrinsics are kept, or refined within stated deviations, also when the stages run one
    // by one.
    let given = [photos::FOCAL_PX, photos::FOCAL_PX, 160.0, 120.0];
    let camera_of = |options: &str| {
        let line = format!("map {{}}/three {options} --redo map --json");
        tiepoint_in(dir, &line).done().json()["models"][0]["cameras"][0].clone()
    };
    let kept = camera_of("");
    assert_eq!(kept["model"], "OPENCV");
    assert_eq!(kept["calibration"]["is_exact"], true, "the photos have these intrinsics: {kept}");
    assert_eq!(kept["params"], serde_json::json!([given.as_slice(), &[0.0; 4]].concat()));
    let refined = camera_of("--calibration-sigma 1");
    assert_eq!(refined["model"], "OPENCV");
    let [params, sigmas, deviations] = [
        &refined["params"],
        &refined["calibration"]["sigmas"],
        &refined["calibration"]["deviations"],
    ]
    .map(|list| list.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect::<Vec<_>>());
    for (index, given) in given.into_iter().chain([0.0; 4]).enumerate() {
        assert_eq!(deviations[index], (params[index] - given) / sigmas[index], "{index}");
        assert!(deviations[index].abs() < MAX_DEVIATIONS, "{index}: {params:?}");
    }
    assert!(deviations[0] != 0.0);
    let closer = camera_of("--calibration-sigma 0.001");
    let focal_px = |camera: &Value| camera["params"][0].as_f64().unwrap() - photos::FOCAL_PX;
    assert!(focal_px(&closer).abs() < 0.1 * focal_px(&refined).abs(), "{closer}, {refined}");
    let exact = camera_of("--refine none");
    assert_eq!(exact["model"], "PINHOLE");
    assert_eq!(exact["params"], serde_json::json!(given));
    assert_eq!(exact["calibration"], Value::Null);
}

/// The photos are of exactly this lens: a deviation beyond three would be one in 400.
const MAX_DEVIATIONS: f64 = 3.0;

/// Two cameras look at a grid of nine points that are seen where they project, but for one that is
/// off: the optimum is known to be near zero once everything may move.
#[test]
fn a_bal_problem_is_adjusted_and_written_in_its_format() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (mut observations, mut points) = (String::new(), String::new());
    for (index, (x, y)) in
        (0..9).map(|i| (f64::from(i % 3) - 1.0, f64::from(i / 3) - 1.0)).enumerate()
    {
        let z = -5.0 - 0.3 * x * y;
        for (camera, offset) in [(0, 0.0), (1, -0.5)] {
            let (u, v) = (500.0 * (x + offset) / -z, 500.0 * y / -z);
            observations += &format!("{camera} {index} {u} {v}\n");
        }
        points += &format!("{}\n{y}\n{z}\n", x + if index == 4 { 0.1 } else { 0.0 });
    }
    let camera = |tx: f64| format!("0\n0\n0\n{tx}\n0\n0\n500\n0\n0\n");
    let text = format!("2 9 18\n{observations}{}{}{points}", camera(0.0), camera(-0.5));
    fs::write(dir.join("problem.txt"), text).unwrap();
    let report = tiepoint_in(dir, "adjust {}/problem.txt -o {}/out.txt --json").done().json();
    // The misplaced point is 10 px off in both images.
    assert!((report["initial_cost"].as_f64().unwrap() - 100.0).abs() < 1.0, "{report}");
    assert!(report["final_cost"].as_f64().unwrap() < 1e-6, "{report}");
    assert_eq!(
        report["steps"].as_array().unwrap().len() as u64,
        report["iterations"].as_u64().unwrap()
    );
    let again = tiepoint_in(dir, "adjust {}/out.txt --json").done().json();
    let (was, is) =
        (report["final_cost"].as_f64().unwrap(), again["initial_cost"].as_f64().unwrap());
    assert!((was - is).abs() <= 1e-9 + 1e-6 * was, "{was} {is}");
}

#[test]
fn folders_are_cameras_and_times_and_masks_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos/left"), 3, 0);
    fs::create_dir_all(dir.join("photos/right")).unwrap();
    fs::create_dir_all(dir.join("masks/left")).unwrap();
    let mut times = "image,seconds\n".to_owned();
    for index in 0..3 {
        photos::photo(index + 2, 0).save(dir.join(format!("photos/right/{index}.png"))).unwrap();
        times += &format!(
            "left/{index}.png,{}\nright/{index}.png,{}\n",
            10 + index,
            10.1 + index as f64
        );
    }
    // Everything but the upper half is masked out in one image.
    let mask = image::GrayImage::from_fn(photos::WIDTH, photos::HEIGHT, |_, y| {
        image::Luma([if y < photos::HEIGHT / 2 { 255 } else { 0 }])
    });
    mask.save(dir.join("masks/left/0.png.png")).unwrap();
    fs::write(dir.join("times.csv"), &times).unwrap();
    let run = tiepoint_in(
        dir,
        "reconstruct {}/photos -o {}/ws --timestamps {}/times.csv --masks {}/masks --pairs \
        sequential:2 --json",
    )
    .done();
    let report = run.json();
    assert_eq!(report["models"][0]["registered"], 6, "{report}");
    assert_eq!(report["models"][0]["cameras"].as_array().unwrap().len(), 2);
    let keypoints = |image: &str| {
        let events = run.events();
        let event =
            events.iter().find(|event| event["event"] == "image_done" && event["image"] == image);
        event.unwrap()["keypoints"].as_f64().unwrap()
    };
    assert!(
        keypoints("left/0.png") < 0.75 * keypoints("left/1.png"),
        "the mask keeps keypoints away"
    );
    let written = fs::read_to_string(dir.join("ws/timestamps.csv")).unwrap();
    let (mut a, mut b): (Vec<&str>, Vec<&str>) =
        (written.lines().collect(), times.lines().collect());
    a.sort();
    b.sort();
    assert_eq!(a, b);
    tiepoint_in(dir, "export {}/ws --to tum -o {}/t.txt").done();
    let tum = fs::read_to_string(dir.join("t.txt")).unwrap();
    assert_eq!(
        tum.lines().filter(|line| !line.starts_with('#')).count(),
        3,
        "the left camera: {tum}"
    );
    let evaluation =
        tiepoint_in(dir, "evaluate poses {}/ws --truth tum:{}/t.txt --json").done().json();
    assert!(evaluation["centre_error"]["max"].as_f64().unwrap() < 1e-9, "{evaluation}");
    baseline_sets_the_scale_and_rigid_export_has_frames(dir);
    fs::write(dir.join("times.csv"), "image,seconds\nother.png,3\n").unwrap();
    tiepoint_in(dir, "features {}/photos -o {}/ws2 --timestamps {}/times.csv")
        .failed(1, &["none of the photos", "left/0.png"]);
}
