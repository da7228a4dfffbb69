//! Rendered drives and collections: their files, and the reconstruction of drives.

use std::fs;
use std::path::Path;

use crate::tiepoint_in;

/// Up to the second corner of the block, so that the demo stays short here.
const FRAMES: usize = 24;
/// Distance of the two cameras of the program's drives.
const BASELINE_M: f64 = 0.5;
/// The true focal length: 0.6 image widths.
const FOCAL_PX: f64 = 0.6 * 320.0;
/// Limit of the ATE over half a loop with a quarter of the demo's pixels and 2 m between images;
/// 0.12 m were measured. A wrong focal length or initial pair costs metres.
const MAX_ATE_M: f64 = 0.3;
/// Relative error of the rig's baseline. Half a loop of 2 m between images determines it to 2 %.
const MAX_BASELINE_ERROR: f64 = 0.05;
/// Relative difference of the mean distance on the page and the baseline of `rig.json`, to which
/// the soft constraint ties the frames: a sigma of a hundredth of the baseline and less. Images
/// nearest in time are up to half an interval apart: a metre, two baselines.
const MAX_SHOWN_ERROR: f64 = 0.03;
/// Limit of the median surface distance over its error floor: at this image size keypoint errors
/// cause decimetres, and pose errors of centimetres add little.
const MAX_OVER_FLOOR: f64 = 4.0;
/// Limit of the relative error of the focal length, whose initial value is 1.2 / 0.6 times too
/// long; 0.3 % were measured.
const MAX_FOCAL_ERROR: f64 = 0.03;

#[test]
fn drive_has_images_times_and_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let line = "synth -o {}/deep/drive --frames 3 --size 64x48 --view-direction right --effects \
    photometry --scan --json";
    let run = tiepoint_in(dir, line).done();
    let (rendered, events) = (run.json(), run.events());
    assert_eq!(events.len(), 6);
    assert_eq!(events[5]["image"], "right/000002.jpg");
    let drive = dir.join("deep/drive");
    let times = fs::read_to_string(drive.join("timestamps.csv")).unwrap();
    assert_eq!(times.lines().next(), Some("image,seconds"));
    for (index, name) in ["left", "right"].into_iter().enumerate() {
        assert_eq!(rendered["cameras"][index]["name"], name);
        assert_eq!(rendered["cameras"][index]["images"], 3);
        assert_eq!(fs::read_dir(drive.join(name)).unwrap().count(), 3);
        for frame in 0..3 {
            let image = format!("{name}/{frame:06}.jpg");
            assert!(times.contains(&image), "{times}");
            assert_eq!(image::image_dimensions(drive.join(image)).unwrap(), (64, 48));
        }
        let trajectory = fs::read_to_string(drive.join(format!("truth/{name}.tum"))).unwrap();
        assert_eq!(trajectory.lines().count(), 3);
    }
    // The scan has no distance to itself, and has the size of a street of 200 m.
    let scan = "evaluate cloud {}/deep/drive/truth/scan.ply {}/deep/drive/truth/scan.ply --align \
    none --json";
    let scan = tiepoint_in(dir, scan).done().json();
    assert!(scan["points"].as_u64().unwrap() > 100_000 && scan["distance"]["max"] == 0.0, "{scan}");
    // The true model has no error against itself.
    let truth = rendered["truth"].as_str().unwrap();
    let evaluation =
        tiepoint_in(dir, &format!("evaluate poses {truth} --truth colmap:{truth} --json"));
    let evaluation = evaluation.done().json();
    assert_eq!(evaluation["registered"], 6);
    assert!(
        (evaluation["focal_lengths"][1]["truth_px"].as_f64().unwrap() - 0.6 * 64.0).abs() < 1e-9
    );

    let image = || fs::read(drive.join("left/000001.jpg")).unwrap();
    let before = image();
    // Only missing images are rendered again.
    fs::remove_file(drive.join("left/000001.jpg")).unwrap();
    fs::write(drive.join("left/000002.jpg"), "of another's").unwrap();
    tiepoint_in(dir, line).done();
    assert!(image() == before, "the same bytes");
    assert_eq!(fs::read(drive.join("left/000002.jpg")).unwrap(), b"of another's");
    tiepoint_in(dir, "synth -o {}/deep/drive --frames 3 --size 64x48")
        .failed(1, &["other options", "-o"]);
    assert!(image() == before, "left alone");
}

/// Its photos have the cameras of the truth; those with EXIF data have their focal lengths to the
/// half millimetre of rounding, which is 2 % of 26 mm.
#[test]
fn collection_has_photos_of_several_cameras_and_ground_truth() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let line = "synth -o {}/room --collection room --photos 6 --json";
    let rendered = tiepoint_in(dir, line).done().json();
    tiepoint_in(dir, line).done();
    assert_eq!(fs::read_dir(dir.join("room/photos")).unwrap().count(), 6);
    let truth = rendered["truth"].as_str().unwrap();
    let evaluation =
        tiepoint_in(dir, &format!("evaluate poses {truth} --truth colmap:{truth} --json"));
    assert_eq!(evaluation.done().json()["registered"], 6);
    tiepoint_in(dir, "features {}/room/photos -o {}/ws").done();
    let database = rusqlite::Connection::open(dir.join("ws/database.db")).unwrap();
    let query = "SELECT width, params, prior_focal_length FROM cameras";
    let mut query = database.prepare(query).unwrap();
    let mut rows = query.query([]).unwrap();
    let mut found = 0;
    while let Some(row) = rows.next().unwrap() {
        let (width, params, has_prior): (i64, Vec<u8>, bool) =
            (row.get(0).unwrap(), row.get(1).unwrap(), row.get(2).unwrap());
        let focal_px = f64::from_le_bytes(params[..8].try_into().unwrap());
        let cameras = rendered["cameras"].as_array().unwrap();
        let camera = cameras.iter().find(|camera| camera["width"] == width).unwrap();
        assert_eq!(has_prior, camera["name"] != "long");
        let error = focal_px / camera["focal_px"].as_f64().unwrap() - 1.0;
        assert!(!has_prior || error.abs() < 0.02, "{focal_px}");
        found += usize::from(camera["images"] != 0);
    }
    assert!(found >= 2, "{found}");
    tiepoint_in(dir, "synth -o {}/no --collection room --frames 3").failed(2, &["--frames"]);
    tiepoint_in(dir, "synth -o {}/no --photos 3").failed(2, &["--collection"]);
    tiepoint_in(dir, "synth -o {}/no --collection room --photos 1").failed(2, &["photos = 1"]);
}

#[test]
fn foreign_folders_are_not_changed() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("drive")).unwrap();
    fs::write(dir.path().join("drive/mine.txt"), "mine").unwrap();
    tiepoint_in(dir.path(), "synth -o {}/drive").failed(1, &["drive is not empty", "-o"]);
    fs::create_dir(dir.path().join("street")).unwrap();
    fs::rename(dir.path().join("drive"), dir.path().join("street/drive")).unwrap();
    tiepoint_in(dir.path(), "demo -o {}").failed(1, &["drive is not empty", "-o"]);
    assert_eq!(fs::read_dir(dir.path().join("street/drive")).unwrap().count(), 1);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn invalid_drive_options() {
    let dir = tempfile::tempdir().unwrap();
    for (options, parts) in [
        ("--size 64", ["--size", "640x480"]),
        ("--size 1x1", ["width = 1", "2 to 20000"]),
        ("--rate 0", ["rate_hz = 0", "0.01 to 1000"]),
        ("--frames 0", ["--frames", "0"]),
        ("--view-direction under", ["under", "front-right"]),
        ("--effects rain", ["rain", "rolling-shutter"]),
    ] {
        tiepoint_in(dir.path(), &format!("synth -o {{}}/drive {options}")).failed(2, &parts);
    }
    assert!(!dir.path().join("drive").exists(), "nothing was begun");
}

#[test]
fn the_demo_reconstructs_what_it_rendered() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let line = format!("demo -o {{}}/demo --frames {FRAMES} --size 320x240");
    let text = tiepoint_in(dir, &line).done().stdout();
    // A second run keeps all stages.
    let again = tiepoint_in(dir, &format!("{line} --json")).done();
    assert_eq!(again.events().iter().filter(|event| event["event"] == "stage_kept").count(), 15);
    let outcome = again.json();
    let drives = &outcome["drives"];
    assert_eq!([&drives[0]["name"], &drives[1]["name"]], ["street", "loop"]);
    for (drive, rigs) in
        drives.as_array().unwrap().iter().zip([&["off", "paper", "auto"][..], &["off", "auto"]])
    {
        let runs = drive["runs"].as_array().unwrap();
        assert_eq!(runs.len(), rigs.len());
        for (run, rig) in runs.iter().zip(rigs) {
            assert_eq!(run["rig"], *rig);
            assert_eq!(run["report"]["models"][0]["registered"], 2 * FRAMES, "{run}");
        }
    }
    let paper = &drives[0]["runs"][1];
    let [off, auto] = [0, 1].map(|index| &drives[1]["runs"][index]);
    let rig = fs::read(dir.join("demo/loop/auto/rig.json")).unwrap();
    let rig: serde_json::Value = serde_json::from_slice(&rig).unwrap();
    let centre = [0, 1, 2].map(|axis| rig["cameras"][0]["centre_in_rig"][axis].as_f64().unwrap());
    let length = centre.iter().map(|value| value * value).sum::<f64>().sqrt();
    let baseline_m = length * auto["poses"]["scale"].as_f64().unwrap();
    assert!((baseline_m / BASELINE_M - 1.0).abs() < MAX_BASELINE_ERROR, "{baseline_m} m");
    let mean = shown_baseline(dir);
    assert!((mean / length - 1.0).abs() < MAX_SHOWN_ERROR, "{mean} and {length}");
    for run in [off, paper] {
        let model = &run["report"]["models"][0];
        assert_eq!(model["rig"]["mode"], run["rig"]);
        // The clock offset is less than a frame interval.
        assert!(
            model["rig"]["cameras"][0]["pairs"].as_u64().unwrap() >= FRAMES as u64 - 1,
            "{model}"
        );
    }
    // The first images of the street, which is straight, do not determine a focal length.
    let surface = |which: &str| off["surface"][which]["median"].as_f64().unwrap();
    assert!(surface("near") < MAX_OVER_FLOOR * surface("near_floor"), "{}", off["surface"]);
    assert_eq!(paper["report"]["models"][0]["rig"]["paper"]["lambda"], 500.0);
    let evaluation = &off["poses"];
    assert_eq!(
        (&evaluation["images"], &evaluation["registered"]),
        (&(2 * FRAMES).into(), &(2 * FRAMES).into())
    );
    assert!(evaluation["centre_error"]["rmse"].as_f64().unwrap() < MAX_ATE_M, "{evaluation}");
    for camera in 0..2 {
        let focal = &evaluation["focal_lengths"][camera];
        assert!((focal["truth_px"].as_f64().unwrap() - FOCAL_PX).abs() < 1e-9, "{evaluation}");
        assert!(
            (focal["model_px"].as_f64().unwrap() / FOCAL_PX - 1.0).abs() < MAX_FOCAL_ERROR,
            "{evaluation}"
        );
    }

    // The table has the same numbers.
    let registered = format!("{0} of {0}", 2 * FRAMES);
    let ate = format!("{:.4} m", evaluation["centre_error"]["rmse"].as_f64().unwrap());
    for part in [registered.as_str(), &ate, "--rig paper", "surface distance", "demo/street/paper"]
    {
        assert!(text.contains(part), "no {part} in {text}");
    }
    // The printed commands give the same results.
    let printed = |command: &str| -> Vec<String> {
        let lines = text.lines().filter_map(|line| line.trim().strip_prefix("tiepoint "));
        lines.filter(|line| line.starts_with(command)).map(str::to_owned).collect()
    };
    let synths = printed("synth ");
    assert_eq!(synths.len(), 2);
    // They are taken for the drives that are there: the options are the same.
    synths.iter().for_each(|line| drop(tiepoint_in(dir, line).done()));
    let alone = tiepoint_in(dir, &format!("{} --json", printed("evaluate ")[3])).done().json();
    assert_eq!(&alone, evaluation);
}

/// The mean baseline on the page of the loop, which shows relative poses at the times of the clock
/// and not of the stamps.
fn shown_baseline(dir: &Path) -> f64 {
    let page = tiepoint_in(dir, "view {}/demo/loop/auto --json").done().json();
    let page = fs::read_to_string(page["report"].as_str().unwrap()).unwrap();
    let data = page.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    let shown = &data["sections"][0]["models"][0]["rigs"][0];
    assert_eq!(shown["has_clock"], true);
    let baselines = shown["baselines"].as_array().unwrap();
    baselines.iter().map(|value| value.as_f64().unwrap()).sum::<f64>() / baselines.len() as f64
}
