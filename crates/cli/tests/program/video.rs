//! Videos as input. What needs the program ffmpeg says so where it is not there.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::{Run, photos, tiepoint_in};

/// `date -u -d '2024-02-29 12:34:56' +%s`
const CREATED_S: f64 = 1_709_210_096.0;
const RATE_HZ: usize = 10;
/// A time base of milliseconds is the coarsest in use.
const TIME_TOLERANCE_S: f64 = 1e-3;

#[expect(clippy::print_stderr, reason = "a test that is left out says so")]
fn is_there() -> bool {
    let there = Command::new("ffmpeg").arg("-version").output().is_ok();
    if !there {
        eprintln!("SKIPPED: the program ffmpeg is not installed; videos were not tested");
    }
    there
}

/// The corner of a room as a video, the camera standing still on the last photo for as long as it moved before.
fn film(dir: &Path, name: &str, photos: usize) {
    let frames = dir.join("frames-of-film");
    fs::create_dir(&frames).unwrap();
    for index in 0..2 * photos {
        photos::photo(index.min(photos - 1), 3).save(frames.join(format!("{index:03}.png"))).unwrap();
    }
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", &RATE_HZ.to_string(), "-i"])
        .arg(frames.join("%03d.png"))
        .args(["-metadata", "creation_time=2024-02-29T12:34:56Z", "-c:v", "mjpeg", "-q:v", "2"])
        .arg(dir.join(name))
        .status();
    assert!(made.unwrap().success());
    fs::remove_dir_all(frames).unwrap();
}

fn times(workspace: &Path) -> Vec<(String, f64)> {
    let text = fs::read_to_string(workspace.join("timestamps.csv")).unwrap();
    let row = |line: &str| {
        let (name, seconds) = line.rsplit_once(',').unwrap();
        (name.to_owned(), seconds.parse().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn a_video_is_a_camera_whose_frames_have_times() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "front.mov", 5);
    let run = || -> Run { tiepoint_in(dir.path(), "reconstruct {}/front.mov -o {}/ws --every 1 --json") };
    let report = run().done().json();
    assert_eq!(report["stages"]["features"]["images"], 5, "the stop gave no frames: {report}");
    assert_eq!(report["models"][0]["registered"], 5, "{report}");
    let times = times(&dir.path().join("ws"));
    for (index, (name, seconds)) in times.iter().enumerate() {
        assert_eq!(*name, format!("front/{index:06}.jpg"));
        let expected = CREATED_S + index as f64 / RATE_HZ as f64;
        assert!((seconds - expected).abs() < TIME_TOLERANCE_S, "{seconds} {expected}");
    }
    // Nothing is read again, and nothing of another choice taken for this one.
    let events = run().done().events();
    assert!(events.iter().all(|event| event["event"] == "stage_kept"), "{events:?}");
    tiepoint_in(dir.path(), "reconstruct {}/front.mov -o {}/ws --every 2")
        .failed(1, &["frames", "--redo features"]);
    let again =
        tiepoint_in(dir.path(), "features {}/front.mov -o {}/ws --every 2 --redo features --json").done();
    assert_eq!(again.json()["stages"]["features"]["images"], 3);
}

#[test]
fn chapters_follow_each_other() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "GX010042.mov", 4);
    fs::copy(dir.path().join("GX010042.mov"), dir.path().join("GX020042.mov")).unwrap();
    let report = tiepoint_in(dir.path(), "features {} -o {}/ws --every 1 --json").done().json();
    // The second chapter begins with a jump back to the first photo: all of its four are new.
    assert_eq!(report["stages"]["features"]["images"], 8, "{report}");
    let times = times(&dir.path().join("ws"));
    assert_eq!(times[4].0, "GX010042/000008.jpg");
    assert!((times[4].1 - CREATED_S - 0.8).abs() < TIME_TOLERANCE_S, "{times:?}");
}

#[test]
fn what_is_no_video_is_told() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("words.mp4"), "these are words").unwrap();
    let reason = if is_there() { "no video could be read" } else { "needs the program ffmpeg" };
    tiepoint_in(dir.path(), "features {}/words.mp4 -o {}/ws").failed(1, &["words.mp4", reason]);
    tiepoint_in(dir.path(), "features {}/none.mp4 -o {}/ws").failed(1, &["none.mp4", "No such file"]);
}

#[test]
fn photos_beside_a_video_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    fs::write(dir.path().join("a.mp4"), "").unwrap();
    tiepoint_in(dir.path(), "features {}/photos {}/a.mp4 -o {}/ws")
        .failed(1, &["photos", "a.mp4", "not both"]);
    assert!(!dir.path().join("ws").exists(), "nothing was begun");
}

#[test]
fn without_ffmpeg_it_is_named() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("a.mp4"), "x").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args(["features", "a.mp4", "-o", "ws"]).current_dir(dir.path()).env("PATH", dir.path());
    Run(command.output().unwrap()).failed(1, &["a.mp4", "needs the program ffmpeg", "install it"]);
}
