//! The paper's experiments, on a few small frames.

use std::fs;
use std::time::SystemTime;

use crate::tiepoint_in;

/// Small enough for seconds, and all of it.
const SMALL: &str = "--frames 6 --size 160x120 --effects clocks --rig off,soft";
/// Seven metres of way: anything that is no failure.
const MAX_ATE_M: f64 = 2.0;
/// Of 12 images. With two left over, a second model begins and falls apart, which must not be the end of the first.
const MIN_REGISTERED: f64 = 10.0;

#[test]
fn two_cameras_with_and_without_a_constraint() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let line = format!("experiment baseline -o {{}}/e {SMALL}");
    let outcome = tiepoint_in(dir, &format!("{line} --json")).done().json();
    let cells = outcome["cells"].as_array().unwrap();
    assert_eq!(cells.len(), 2);
    for (cell, rig) in cells.iter().zip(["off", "soft"]) {
        assert_eq!((&cell["rig"], &cell["images"]), (&rig.into(), &12.into()), "{cell}");
        let result = &cell["result"];
        let number = |what: &str| result[what].as_f64().unwrap_or_else(|| panic!("no {what} in {cell}"));
        assert!(number("registered") >= MIN_REGISTERED, "{cell}");
        assert!(number("ate_m") < MAX_ATE_M, "{cell}");
        // The parts make the whole.
        let whole = number("horizontal_m").hypot(number("vertical_m"));
        assert!((whole - number("ate_m")).abs() < 1e-6 * whole, "{cell}");
        assert!(result["cloud"]["mean_m"].as_f64().unwrap() > 0.0, "{cell}");
        assert!(number("baseline_m") <= number("largest_baseline_m"), "{cell}");
    }
    let page = fs::read_to_string(outcome["page"].as_str().unwrap()).unwrap();
    for part in ["Table 4", "Constrained (soft)", "truth_above"] {
        assert!(page.contains(part), "no {part}");
    }
    let written = |file: &str| -> SystemTime { fs::metadata(dir.join(file)).unwrap().modified().unwrap() };
    let files = ["e/baseline/drive/right/000000.png", "e/baseline/soft/sparse/0/images.bin"];
    let before = files.map(written);

    // Again nothing is rendered or reconstructed, and the text has the same numbers in the paper's layout.
    let text = tiepoint_in(dir, &line).done().stdout();
    assert_eq!(files.map(written), before);
    let mean = format!("{:.3}", cells[0]["result"]["cloud"]["mean_m"].as_f64().unwrap());
    for part in ["Mean absolute distance [m]", "Std deviation [m]", "Traditional (off)", &mean] {
        assert!(text.contains(part), "no {part} in {text}");
    }
    assert!(fs::read_to_string(dir.join("e/baseline/tables.md")).unwrap().contains("|---|"));
    // A further method uses what is there; what contradicts it is refused.
    fs::remove_file(dir.join("e/baseline/soft/judged.json")).unwrap();
    let events = tiepoint_in(dir, &format!("{line} --json")).done().events();
    assert!(events.iter().all(|event| event["event"] == "stage_kept"), "{events:?}");
    tiepoint_in(dir, &line.replace("--frames 6", "--frames 7")).failed(1, &["other options", "-o"]);
}

#[test]
fn experiments_that_cannot_be() {
    let dir = tempfile::tempdir().unwrap();
    for (which, options, parts) in [
        ("mounting", "--frames 0", ["--frames", "0"]),
        ("mounting", "--frames 2", ["--frames 2", "from 3 frames on"]),
        ("mounting", "--rig off", ["--rig", "unexpected"]),
        ("baseline", "--rig off,none", ["none", "paper"]),
        ("baseline", "--length 1e12", ["--length", "at most"]),
        ("baseline", "--length nan", ["length_m = NaN", "160"]),
        ("baseline", "--rate 0", ["rate_hz = 0", "0.01"]),
        ("drift", "", ["drift", "subcommand"]),
    ] {
        tiepoint_in(dir.path(), &format!("experiment {which} -o {{}}/e {options}")).failed(2, &parts);
    }
    assert!(!dir.path().join("e").exists(), "nothing was begun");
    fs::create_dir(dir.path().join("e")).unwrap();
    fs::write(dir.path().join("e/mounting"), "a file").unwrap();
    tiepoint_in(dir.path(), "experiment mounting -o {}/e").failed(1, &["e/mounting"]);
    fs::create_dir(dir.path().join("e/baseline")).unwrap();
    fs::write(dir.path().join("e/baseline/mine.txt"), "mine").unwrap();
    tiepoint_in(dir.path(), "experiment baseline -o {}/e").failed(1, &["baseline is not empty", "-o"]);
}
