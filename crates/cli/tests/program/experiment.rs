//! The experiments of the paper on a few small images.

use std::fs;
use std::ops::RangeInclusive;
use std::time::SystemTime;

use crate::tiepoint_in;

/// Six frames less than a metre apart, so that neighbours overlap well; the run takes seconds.
const SMALL: &str = "--frames 6 --rate 10 --size 160x120 --effects clocks --rig off,soft";
/// Thirty runs (seeds 2 to 16, with and without the constraint) end at 0.003 to 0.076 m, half of
/// them below 0.01 m. A wrong pose costs decimetres.
const MAX_ATE_M: f64 = 0.1;
/// Dense matching of 160 x 120 pixels with the true poses.
const MAX_EXACT_DISTANCE_M: f64 = 0.1;
/// Frames four times as far apart: one or two of the 12 images overlap too little to be registered.
const SPARSE: &str = "--frames 6 --size 160x120 --effects clocks --rig off";
const REGISTERED_OF_SPARSE: RangeInclusive<u64> = 10..=11;

#[test]
fn two_cameras_with_and_without_a_constraint() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let line = format!("experiment baseline -o {{}}/e {SMALL}");
    let outcome = tiepoint_in(dir, &format!("{line} --json")).done().json();
    let runs = outcome["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 2);
    for (run, rig) in runs.iter().zip(["off", "soft"]) {
        assert_eq!((&run["rig"], &run["images"]), (&rig.into(), &12.into()), "{run}");
        let result = &run["result"];
        let number =
            |what: &str| result[what].as_f64().unwrap_or_else(|| panic!("no {what} in {run}"));
        assert_eq!(run["result"]["registered"], 12, "{run}");
        assert!(number("ate_m") < MAX_ATE_M, "{run}");
        // The parts make the whole.
        let whole = number("horizontal_m").hypot(number("vertical_m"));
        assert!((whole - number("ate_m")).abs() < 1e-6 * whole, "{run}");
        for cloud in [&result["cloud"], &result["dense"]["distance"]] {
            assert!(cloud["mean_m"].as_f64().unwrap() > 0.0, "{run}");
        }
        let along = result["dense"]["along"].as_array().unwrap();
        assert!((2..=6).contains(&along.len()), "{run}");
        let exact = result["exact_dense"]["distance"]["mean_m"].as_f64().unwrap();
        assert!(exact < MAX_EXACT_DISTANCE_M, "{run}");
        assert!(number("baseline_m") <= number("largest_baseline_m"), "{run}");
    }
    let page = fs::read_to_string(outcome["page"].as_str().unwrap()).unwrap();
    for part in ["Table 4", "Constrained (soft)", "truth_above"] {
        assert!(page.contains(part), "no {part}");
    }
    let written =
        |file: &str| -> SystemTime { fs::metadata(dir.join(file)).unwrap().modified().unwrap() };
    let files = ["e/baseline/drive/right/000000.png", "e/baseline/soft/sparse/0/images.bin"];
    let before = files.map(written);

    // A second run renders and reconstructs nothing, and prints the same numbers in the paper's
    // layout.
    let text = tiepoint_in(dir, &line).done().stdout();
    assert_eq!(files.map(written), before);
    let mean = format!("{:.3}", runs[0]["result"]["dense"]["distance"]["mean_m"].as_f64().unwrap());
    for part in ["Mean absolute distance [m]", "Std deviation [m]", "Traditional (off)", &mean] {
        assert!(text.contains(part), "no {part} in {text}");
    }
    assert!(fs::read_to_string(dir.join("e/baseline/tables.md")).unwrap().contains("|---|"));
    // A missing evaluation uses the existing models; other options are rejected.
    fs::remove_file(dir.join("e/baseline/soft/evaluation.json")).unwrap();
    let events = tiepoint_in(dir, &format!("{line} --json")).done().events();
    assert!(events.iter().all(|event| event["event"] == "stage_kept"), "{events:?}");
    tiepoint_in(dir, &line.replace("--frames 6", "--frames 7")).failed(1, &["other options", "-o"]);
}

/// The unregistered images start a second model that fails; the first one stays valid.
#[test]
fn unregistered_images_do_not_abort_an_experiment() {
    let dir = tempfile::tempdir().unwrap();
    let outcome =
        tiepoint_in(dir.path(), &format!("experiment baseline -o {{}}/e {SPARSE} --json"))
            .done()
            .json();
    let run = &outcome["runs"][0];
    assert_eq!(run["images"], 12, "{run}");
    assert!(REGISTERED_OF_SPARSE.contains(&run["result"]["registered"].as_u64().unwrap()), "{run}");
}

#[test]
fn invalid_experiment_options() {
    let dir = tempfile::tempdir().unwrap();
    for (which, options, parts) in [
        ("mounting", "--frames 0", ["--frames", "0"]),
        ("mounting", "--frames 2", ["--frames 2", "needs 3 frames"]),
        ("mounting", "--rig off", ["--rig", "unexpected"]),
        ("baseline", "--rig off,none", ["none", "paper"]),
        ("baseline", "--length 1e12", ["--length", "at most"]),
        ("baseline", "--length nan", ["length_m = NaN", "160"]),
        ("baseline", "--rate 0", ["rate_hz = 0", "0.01"]),
        ("drift", "", ["drift", "subcommand"]),
    ] {
        tiepoint_in(dir.path(), &format!("experiment {which} -o {{}}/e {options}"))
            .failed(2, &parts);
    }
    assert!(!dir.path().join("e").exists(), "nothing was begun");
    fs::create_dir(dir.path().join("e")).unwrap();
    fs::write(dir.path().join("e/mounting"), "a file").unwrap();
    tiepoint_in(dir.path(), "experiment mounting -o {}/e").failed(1, &["e/mounting"]);
    fs::create_dir(dir.path().join("e/baseline")).unwrap();
    fs::write(dir.path().join("e/baseline/mine.txt"), "mine").unwrap();
    tiepoint_in(dir.path(), "experiment baseline -o {}/e")
        .failed(1, &["baseline is not empty", "-o"]);
}
