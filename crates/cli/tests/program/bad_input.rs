//! Error messages for invalid input: one sentence with the problem, the file and the remedy.

use std::fs;
use std::path::Path;

use image::{DynamicImage, ImageFormat, imageops};

use crate::{photos, tiepoint, tiepoint_in};

fn reconstruct(dir: &Path) -> crate::Run {
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws")
}

#[test]
fn an_empty_folder() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("photos")).unwrap();
    reconstruct(dir.path()).failed(1, &["photos", "holds no images"]);
    assert!(!dir.path().join("ws").exists(), "nothing was begun");
}

#[test]
fn a_folder_that_is_not_there() {
    let dir = tempfile::tempdir().unwrap();
    reconstruct(dir.path()).failed(1, &["photos", "No such file"]);
}

#[test]
fn one_photo() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 1, 0);
    reconstruct(dir.path()).failed(1, &["photos", "1 usable photo of 1", "at least two"]);
}

#[test]
fn photos_without_overlap() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 1, 0);
    photos::photo(1, 77).save(folder.join("1.png")).unwrap();
    reconstruct(dir.path()).failed(1, &["none of the 1 pairs", "ws", "overlap more"]);
    assert!(dir.path().join("ws/database.db").is_file(), "what was computed is kept");
}

#[test]
fn truncated_photos_and_other_files_are_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 4, 0);
    let mut bytes = std::io::Cursor::new(Vec::new());
    // Of a size, and so of a camera, of its own.
    let cropped = DynamicImage::from(photos::photo(4, 0)).crop_imm(0, 0, 320, 200);
    cropped.write_to(&mut bytes, ImageFormat::Jpeg).unwrap();
    let bytes = bytes.into_inner();
    fs::write(folder.join("4.jpg"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(folder.join("5.jpg"), "these are words").unwrap();
    fs::write(folder.join("notes.txt"), "no photo, and not named like one").unwrap();

    let run = reconstruct(dir.path()).done();
    let said = run.stderr();
    assert_eq!(said.lines().count(), 3, "{said}");
    assert!(said.contains("matching 10 pairs (exhaustive), about "), "{said}");
    let line = |name: &str| {
        said.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("{said}"))
    };
    assert!(line("4.jpg").starts_with("skipped") && line("4.jpg").contains("truncated"), "{said}");
    assert!(line("5.jpg").contains("is no JPEG"), "{said}");
    assert!(run.stdout().contains("4 of 4 images"), "{}", run.stdout());
    let report = fs::read(dir.path().join("ws/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let skipped = report["stages"]["features"]["skipped"].as_array().unwrap();
    assert_eq!(skipped.len(), 2);
    // Nor has a photo a camera that is not read.
    let cameras = report["stages"]["features"]["cameras"].as_array().unwrap();
    assert_eq!((cameras.len(), run.stdout().contains("cameras")), (1, false), "{}", run.stdout());
    assert_eq!(report["models"][0]["registered"], 4);
}

#[test]
fn only_damaged_photos() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    for name in ["0.jpg", "1.png", "2.tif"] {
        fs::write(folder.join(name), "words").unwrap();
    }
    reconstruct(dir.path()).failed(1, &["0 usable photos of 3", "at least two"]);
}

#[test]
fn two_sizes_in_one_camera() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 2, 0);
    imageops::rotate90(&photos::photo(2, 0)).save(folder.join("2.png")).unwrap();
    for grouping in ["folder", "single"] {
        tiepoint_in(
            dir.path(),
            &format!("reconstruct {{}}/photos -o {{}}/ws --cameras {grouping}"),
        )
        .failed(
            1,
            &[
                &format!("--cameras {grouping}"),
                "0.png",
                "320 x 240",
                "2.png",
                "240 x 320",
                "--cameras image",
            ],
        );
    }
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws --cameras none")
        .failed(2, &["none", "auto, folder, image, single"]);
}

#[test]
fn an_output_that_cannot_be_written() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    fs::write(dir.path().join("file"), "").unwrap();
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/file/ws")
        .failed(1, &["cannot write", "file/ws"]);
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/file")
        .failed(1, &["cannot write", "file"]);
}

#[test]
fn foreign_colmap_project_is_not_changed() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    fs::create_dir(dir.path().join("ws")).unwrap();
    fs::write(dir.path().join("ws/database.db"), "theirs").unwrap();
    reconstruct(dir.path()).failed(1, &["database.db", "did not make it"]);
    assert_eq!(fs::read(dir.path().join("ws/database.db")).unwrap(), b"theirs");
}

#[test]
fn wrong_command_lines() {
    let dir = tempfile::tempdir().unwrap();
    let wrong = |line: &str, parts: &[&str]| {
        let run = tiepoint_in(dir.path(), line).failed(2, parts);
        assert_eq!(run.stderr().lines().count(), 1, "{}", run.stderr());
    };
    wrong(
        "reconstruct {} -o {}/ws --pair exhaustive",
        &["unexpected argument '--pair'", "'--pairs'"],
    );
    wrong("reconstruct {}", &["required", "--output <WORKSPACE>"]);
    wrong(
        "reconstruct {} -o {}/ws --pairs sequential:",
        &["sequential", "exhaustive", "sequential:20"],
    );
    for value in [
        "auto:20",
        "Auto",
        "all",
        "similar",
        "similar:0",
        "similar:-3",
        "similar:9999999999",
        "sequential:10+loops",
        "sequential:10+loops:0",
        "sequential:10+loops:2+ends",
    ] {
        let line = format!("match {{}}/ws --pairs {value}");
        wrong(&line, &[&format!("\"{value}\""), "use auto, exhaustive, sequential:N"]);
    }
    wrong("reconstruct {} -o {}/ws --rig tight", &["tight", "rigid, auto"]);
    wrong("reconstruct {} -o {}/ws --redo all", &["'all'", "features, match, map"]);
    wrong(
        "reconstruct {} -o {}/ws --intrinsics 1,2,3",
        &["--intrinsics has 3 numbers", "fx,fy,cx,cy"],
    );
    wrong("reconstruct {} -o {}/ws --intrinsics 0,2,3,4", &["--intrinsics", "fx"]);
    wrong("reconstruct {} -o {}/ws --intrinsics 9,9,3,3 --focal-prior 4", &["cannot be used with"]);
    wrong("reconstruct {} -o {}/ws --focal-prior -4", &["-4"]);
    wrong("reconstruct {} -o {}/ws --calibration =x", &["PATTERN=FILE#CAMERA"]);
    wrong("reconstruct {} -o {}/ws --intrinsics 9,9,3,3 --calibration x", &["cannot be used with"]);
    wrong("reconstruct {} -o {}/ws --refine lens", &["'lens'", "principal-point, distortion"]);
    wrong("map {}/ws --refine prism", &["prism with distortion"]);
    wrong("reconstruct {} -o {}/ws --camera-model LENS", &["LENS", "SIMPLE_RADIAL"]);
    wrong("reconstruct {} -o {}/ws --threads 0", &["--threads"]);
    wrong("map {}/ws --redo match", &["--redo can only be map"]);
    wrong("evaluate poses {} --truth {}", &["FORMAT:PATH", "strecha, kitti, tum, colmap"]);
    wrong("export {} --to dwg -o {}/x", &["dwg", "colmap-text"]);
    wrong("reconstrct {}", &["reconstrct", "reconstruct"]);
    assert!(!dir.path().join("ws").exists());
}

#[test]
fn help_and_version_are_no_errors() {
    assert!(tiepoint(["--help"]).done().stdout().contains("reconstruct"));
    assert!(tiepoint(["match", "--help"]).done().stdout().contains("sequential:N"));
    assert!(tiepoint(["--version"]).done().stdout().starts_with("tiepoint "));
    let nothing = tiepoint([""; 0]);
    assert_eq!((nothing.code(), nothing.stderr().contains("Usage")), (2, true));
}

#[test]
fn stages_out_of_order() {
    let dir = tempfile::tempdir().unwrap();
    tiepoint_in(dir.path(), "match {}/ws")
        .failed(1, &["ws is not a workspace", "tiepoint features"]);
    photos::write(&dir.path().join("photos"), 2, 0);
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    tiepoint_in(dir.path(), "map {}/ws").failed(1, &["no matches yet", "tiepoint match"]);
}

#[test]
fn damaged_bal_problems() {
    let dir = tempfile::tempdir().unwrap();
    let numbers = "0 0 0 0 0 0 500 0 0\n".repeat(2) + "0 0 -5\n1 1 -6\n";
    let seen = "2 2 4\n0 0 1 2\n0 1 3 4\n1 0 5 6\n1 1 7 8\n";
    let good = seen.to_owned() + &numbers;
    for (text, says) in [
        ("", "line 1: the file ends"),
        (&good[..40], "the file ends where a camera's rotation should be"),
        (&good.replacen("500", "NaN", 1), "is NaN"),
        (&good.replacen("-6", "1e400", 1), "line 9: a point is inf"),
        (
            &good.replacen("1 1 7 8", "2 1 7 8", 1),
            "line 5: camera 2 sees point 1, but there are 2 cameras",
        ),
        (&good.replacen("1 1 7 8", "-1 1 7 8", 1), "line 5: a camera's index is `-1`"),
        ("4000000000 4000000000 1\n0 0 1 2\n0 0 0\n", "line 4: the file ends"),
        ("2 2 99999999999999\n0 0 1 2\n", "line 3: the file ends"),
        (
            "2 2 99999999999999999999999\n",
            "line 1: the number of observations is `99999999999999999999999`",
        ),
        (&(good.clone() + "7.5\n"), "line 10: `7.5` follows the last of 2 points"),
        (&good.replacen("-6", "-6 8", 1), "line 9: `8` follows the last of 2 points"),
        ("\0\u{1}\u{fffd}\n", "line 1: the number of cameras"),
    ] {
        fs::write(dir.path().join("bal.txt"), text).unwrap();
        tiepoint_in(dir.path(), "adjust {}/bal.txt").failed(1, &[says]);
    }
    for nothing in ["0 0 0\n", "1 1 0\n0 0 0 0 0 0 500 0 0\n0 0 -5\n"] {
        fs::write(dir.path().join("bal.txt"), nothing).unwrap();
        let report = tiepoint_in(dir.path(), "adjust {}/bal.txt --json").done().json();
        assert_eq!(
            (&report["final_cost"], &report["iterations"]),
            (&0.0.into(), &0.into()),
            "{report}"
        );
    }
}

#[test]
fn missing_and_damaged_models() {
    let dir = tempfile::tempdir().unwrap();
    tiepoint_in(dir.path(), "adjust {}").failed(1, &["holds no COLMAP model"]);
    tiepoint_in(dir.path(), "adjust {}/none.txt").failed(1, &["none.txt", "No such file"]);
    fs::write(dir.path().join("bal.txt"), "2 2\n").unwrap();
    tiepoint_in(dir.path(), "adjust {}/bal.txt").failed(1, &["bal.txt", "line 1"]);
    tiepoint_in(dir.path(), "evaluate poses {} --truth kitti:{}/p")
        .failed(1, &["holds no COLMAP model"]);
    tiepoint_in(dir.path(), "export {} --to ply -o {}/x.ply").failed(1, &["holds no COLMAP model"]);
}

#[test]
fn errors_are_json_with_json_output() {
    let dir = tempfile::tempdir().unwrap();
    for (line, code) in [("match {}/ws --json", 1), ("match {}/ws --json --no-such-flag", 2)] {
        let run = tiepoint_in(dir.path(), line);
        assert_eq!((run.code(), run.stdout()), (code, String::new()));
        let events = run.events();
        assert_eq!(events.last().unwrap()["event"], "error");
        assert!(events.last().unwrap()["message"].as_str().unwrap().len() > 10);
    }
}

#[test]
fn invalid_rolling_shutter() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 4, 0);
    let with = |readout: &str| {
        tiepoint_in(
            dir.path(),
            &format!("reconstruct {{}}/photos -o {{}}/ws --rolling-shutter {readout}"),
        )
    };
    for wrong in ["16", "fast", "3s", "nanms"] {
        with(wrong).failed(2, &["estimate", "16ms"]);
    }
    with("16ms").failed(1, &["ws", "--timestamps", "leave the option out"]);
}

#[test]
fn focal_lengths_that_are_constant_and_unknown() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 3, 0);
    let with = |options: &str| {
        tiepoint_in(dir.path(), &format!("reconstruct {{}}/photos -o {{}}/ws {options}"))
    };
    for refine in ["none", "distortion"] {
        with(&format!("--refine {refine}")).failed(1, &["focal length of", "--focal-prior"]);
    }
    with("--refine focal").done();
}

#[test]
fn calibrations_that_do_not_fit() {
    let dir = tempfile::tempdir().unwrap();
    for folder in ["left", "right"] {
        photos::write(&dir.path().join("photos").join(folder), 2, 0);
    }
    let wrong = |name: &str, text: &str, option: &str, parts: &[&str]| {
        fs::write(dir.path().join(name), text).unwrap();
        let line = format!("features {{}}/photos -o {{}}/ws --calibration {option}");
        let run = tiepoint_in(dir.path(), &line).failed(1, parts);
        assert!(run.stderr().lines().last().unwrap().len() < 600, "{}", run.stderr());
    };
    let colmap = "1 PINHOLE 320 240 330 330 160 120\n2 PINHOLE 320 240 330 330 160 120\n";
    let kitti = "P0: 330 0 160 0 0 330 120 0 0 0 1 0\nP1: 330 0 160 0 0 330 120 0 0 0 1 0\n\
                 P2: 330 0 160 0 0 330 120 0 0 0 1 0\n";
    let kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [330, 330, 160, 120]\n  \
                  resolution: [320, 240]\n";
    wrong("c.txt", colmap, "{}/c.txt#3", &["c.txt", "no camera \"3\"", "1, 2"]);
    wrong("c.txt", colmap, "left={}/c.txt", &["has the cameras 1, 2", "c.txt#1"]);
    wrong("c.txt", colmap, "middle={}/c.txt#1", &["\"middle\"", "no photo", "left, right"]);
    wrong("k.txt", kitti, "{}/k.txt", &["P0, P1, P2", "left, right", "left=", "#P0"]);
    wrong(
        "c.txt",
        &colmap.replace("320 240", "640 480"),
        "{}/c.txt",
        &["c.txt", "camera 1", "640 x 480", "left/0.png", "320 x 240", "calibrate at the size"],
    );
    wrong("k.txt", kitti, "{}/k.txt#P0", &["left, right", "k.txt#P0, or *=", "k.txt#P0 for all"]);
    let outside = kitti.replace("160 0", "500 0");
    wrong("k.txt", &outside, "*={}/k.txt#P0", &["principal point", "(500.5, 120.5)", "left/0.png"]);
    let half = kitti.replace("160 0", "80 0");
    wrong("k.txt", &half, "*={}/k.txt#P0", &["far from the centre", "FILE#P0@320x240"]);
    wrong("k.txt", kitti, "*={}/k.txt#P0@640x480", &["640 x 480", "left/0.png has 320 x 240"]);
    wrong("k.txt", &kitti.replace("P0: 330", "P0: 1e308"), "*={}/k.txt#P0", &["P0: no lens"]);
    wrong("c.txt", colmap, "*={}/c.txt#1@640x480", &["images of 320 x 240, and not 640 x 480"]);
    wrong("c.txt", colmap, "left={}/d#1", &["No such file", "pattern left", "camera 1"]);
    wrong("k.txt", &kitti.replace("P0: 330", "P0: NaN"), "{}/k.txt#P1", &["line 1", "NaN"]);
    wrong("k.txt", &kitti.replace("P0: 330", "P0: -330"), "{}/k.txt#P1", &["line 1", "fx"]);
    wrong("a.yaml", &kalibr[..60], "{}/a.yaml", &["a.yaml", "no YAML"]);
    wrong("a.yaml", &kalibr.replace("pinhole", "omni"), "{}/a.yaml", &["line 2", "omni"]);
    wrong("a.yaml", &"[".repeat(1 << 20), "{}/a.yaml", &["a.yaml", "recursion limit"]);
    wrong("a.yaml", &"a: 1\n".repeat(1 << 20), "{}/a.yaml", &["a.yaml", "more than 4 MB"]);
    wrong("a.txt", "words\n", "{}/a.txt", &["is no calibration", "camchain"]);
    wrong("a.txt", "", "{}/none.txt", &["none.txt", "No such file"]);
    wrong("a.txt", "", "{}", &["is a folder"]);
    assert!(!dir.path().join("ws/database.db").exists());
}

#[test]
fn one_calibration_for_photos_of_two_sizes() {
    let dir = tempfile::tempdir().unwrap();
    let write = |folder: &str| {
        let folder = dir.path().join(folder);
        photos::write(&folder, 2, 0);
        fs::remove_file(folder.join("1.png")).unwrap();
        folder
    };
    let turned = |name: &str, folder: std::path::PathBuf| {
        imageops::rotate90(&photos::photo(2, 0)).save(folder.join(name)).unwrap();
    };
    turned("2.png", write("photos"));
    // One size in a folder, and another one in the next.
    write("folders/a");
    let b = write("folders/b");
    turned("0.png", b);
    fs::write(dir.path().join("c.txt"), "1 PINHOLE 320 240 330 330 160 120\n").unwrap();
    let kitti = "P0: 330 0 140 0 0 330 140 0 0 0 1 0\n";
    fs::write(dir.path().join("k.txt"), kitti).unwrap();
    for (inputs, [one, other]) in
        [("photos", ["0.png", "2.png"]), ("folders", ["a/0.png", "b/0.png"])]
    {
        let wrong = |option: &str, parts: &[&str]| {
            let line = format!("features {{}}/{inputs} -o {{}}/ws {option}");
            tiepoint_in(dir.path(), &line).failed(1, parts);
        };
        let sizes = [format!("{one} is 320 x 240"), format!("{other} is 240 x 320")];
        let sizes = sizes.each_ref().map(String::as_str);
        wrong(
            "--intrinsics 330,330,140,140",
            &["--intrinsics", sizes[0], sizes[1], "--calibration"],
        );
        wrong("--calibration *={}/c.txt", &["c.txt", "320 x 240", other, "240 x 320", "PATTERN"]);
        let sizes = [format!("{one} is 320 x 240"), format!("{other} 240 x 320")];
        let sizes = sizes.each_ref().map(String::as_str);
        wrong("--calibration *={}/k.txt", &["no image size", sizes[0], sizes[1]]);
    }
}

#[test]
fn focal_lengths_that_no_lens_has() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    let wrong = |option: &str, parts: &[&str]| {
        let line = format!("features {{}}/photos -o {{}}/ws {option}");
        tiepoint_in(dir.path(), &line).failed(1, parts);
    };
    wrong("--focal-prior 1e306", &["--focal-prior", "0.png", "320 x 240"]);
    wrong("--intrinsics 500,500,5000,5000", &["--intrinsics", "(5000, 5000)", "outside of 0.png"]);
    wrong("--intrinsics 1e308,1e308,160,120", &["--intrinsics", "no lens", "0.png"]);
    wrong("--intrinsics 330,330,160,120,1e300,0,0,0", &["--intrinsics", "no lens", "0.png"]);
}

/// The user does not know the copy in the workspace.
#[test]
fn a_damaged_database_of_another_program_is_named() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    let theirs = dir.path().join("theirs.db");
    for damage in ["keypoints SET data = x'00'", "cameras SET params = x'00'"] {
        fs::copy(dir.path().join("ws/database.db"), &theirs).unwrap();
        let connection = rusqlite::Connection::open(&theirs).unwrap();
        connection.execute_batch(&format!("UPDATE {damage}")).unwrap();
        drop(connection);
        tiepoint_in(dir.path(), "reconstruct --database {}/theirs.db {}/photos -o {}/new")
            .failed(1, &["theirs.db"]);
    }
}

#[test]
fn what_one_camera_cannot_do_is_refused_before_features() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 3, 0);
    let rigid = "reconstruct {}/photos -o {}/ws --rig rigid";
    tiepoint_in(dir, rigid).failed(1, &["--rig needs two cameras", "of one", "--rig off"]);
    let shutter = "reconstruct {}/photos -o {}/ws --rolling-shutter estimate";
    tiepoint_in(dir, shutter).failed(1, &["capture times"]);
    assert!(!dir.join("ws/database.db").exists(), "no features yet");
}

#[test]
fn what_has_no_effect_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 3, 0);
    let said = tiepoint_in(dir, "features {}/photos -o {}/photos --every 5").done().stderr();
    for part in ["--every selects frames of videos", "has photos, and gets the results, too"] {
        assert!(said.contains(part), "{said}");
    }
    let report = tiepoint_in(dir, "match {}/photos --pairs sequential --json").done().json();
    assert_eq!(report["stages"]["match"]["selection"], "sequential:10");
}
