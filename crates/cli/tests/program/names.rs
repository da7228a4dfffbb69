//! Special files, and file names that a COLMAP model cannot have.

#![cfg(unix)]

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;

use crate::{Run, photos, tiepoint_in};

fn named_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

#[test]
fn special_files_and_invalid_names_are_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 4, 0);
    let photo = fs::read(folder.join("0.png")).unwrap();
    named_pipe(&folder.join("pipe.jpg"));
    let _socket = UnixListener::bind(folder.join("socket.jpg")).unwrap();
    symlink("/dev/null", folder.join("device.jpg")).unwrap();
    symlink("nowhere.jpg", folder.join("link.jpg")).unwrap();
    for name in
        ["line\nbreak.png", "colour\u{1b}[31m.png", " before.png", "behind.png ", "in between.png"]
    {
        fs::write(folder.join(name), &photo).unwrap();
    }
    // A sub-folder of images beside images.
    fs::create_dir(folder.join("tab\there")).unwrap();
    fs::write(folder.join("tab\there/1.png"), &photo).unwrap();
    fs::write(folder.join("tab\there/2.png"), &photo).unwrap();
    fs::create_dir(folder.join("no images\n")).unwrap();
    let mut expected = vec![
        ("pipe.jpg", "is a named pipe and no regular file"),
        ("socket.jpg", "is a socket and no regular file"),
        ("device.jpg", "is a device and no regular file"),
        ("link.jpg", "No such file"),
        (r"line\nbreak.png", "control characters: rename it"),
        (r"colour\u{1b}[31m.png", "control characters: rename it"),
        (" before.png", "begins with white space: rename it"),
        ("behind.png ", "ends with white space: rename it"),
        (r"tab\there", "with 2 images below it: rename the folder"),
    ];
    if cfg!(target_os = "linux") {
        fs::write(folder.join(OsStr::from_bytes(b"caf\xe9.png")), &photo).unwrap();
        expected.push((r"caf\xe9.png", "not UTF-8: rename it"));
    }

    let run = tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    let said = run.stderr();
    let (copies, said): (Vec<&str>, Vec<&str>) =
        said.lines().partition(|line| line.contains("there twice"));
    assert!(copies.len() == 1 && copies[0].contains("0.png and in between.png"), "{copies:?}");
    let said = said.join("\n");
    assert_eq!(said.lines().count(), expected.len(), "{said}");
    assert!(said.chars().all(|c| c == '\n' || !c.is_control()), "{said:?}");
    for (name, reason) in &expected {
        let line = said.lines().find(|line| line.contains(&format!("photos/{name}:")));
        let line = line.unwrap_or_else(|| panic!("no {name}: {said}"));
        assert!(line.starts_with("skipped ") && line.contains(reason), "{line}");
    }
    let report = fs::read(dir.path().join("ws/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let features = &report["stages"]["features"];
    assert_eq!(features["images"], 5, "`in between.png` is as good as any other");
    let mut names: Vec<&str> = features["skipped"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["image"].as_str().unwrap())
        .collect();
    names.sort_unstable();
    expected.sort_unstable();
    assert_eq!(names, expected.iter().map(|(name, _)| *name).collect::<Vec<_>>());
}

/// File systems allow 255 bytes, and a depth map adds 14.
#[test]
fn names_too_long_for_depth_maps_are_refused_before_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 4, 0);
    for length in [242, 241] {
        let name = "n".repeat(length - 5) + "0.png";
        let from = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).max();
        fs::rename(from.unwrap(), folder.join(name)).unwrap();
        let line = "reconstruct {}/photos -o {}/ws --redo features --dense";
        let run = tiepoint_in(dir.path(), line);
        match length {
            242 => _ = run.failed(1, &["its name is too long", "to at most 241 bytes"]),
            _ => _ = run.done(),
        }
    }
}

#[test]
fn only_special_files() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("photos")).unwrap();
    named_pipe(&dir.path().join("photos/a\n.jpg"));
    named_pipe(&dir.path().join("photos/b.jpg"));
    let reconstruct = || tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws");
    let parts = ["photos: holds no images", "2 skipped", r"a\n.jpg: is a named pipe"];
    assert_eq!(reconstruct().failed(1, &parts).stderr().lines().count(), 1);
    photos::photo(0, 0).save(dir.path().join("photos/0.png")).unwrap();
    reconstruct().failed(1, &["1 usable photo of 3", "2 skipped", r"a\n.jpg: is a named pipe"]);
    assert!(!dir.path().join("ws").exists(), "nothing was begun");
}

#[test]
fn named_pipes_are_not_waited_for() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    fs::create_dir(dir.path().join("masks")).unwrap();
    fs::copy(dir.path().join("photos/0.png"), dir.path().join("masks/0.png")).unwrap();
    for name in ["times.csv", "a.mp4", "masks/1.png.png"] {
        named_pipe(&dir.path().join(name));
    }
    let features = |rest: &str| tiepoint_in(dir.path(), &format!("features {rest} -o {{}}/ws"));
    let says = "is a named pipe and no regular file";
    features("{}/photos --timestamps {}/times.csv").failed(1, &["times.csv", says]);
    features("{}/a.mp4").failed(1, &["a.mp4", says]);
    features("{}/times.csv").failed(1, &["times.csv", says]);
    for (name, what) in [
        ("sound.m4a", "is a file and no video that is read (mp4, mov"),
        ("photos/0.png", "is a photo: give the folder that it is in"),
    ] {
        let path = dir.path().join(name);
        if !path.exists() {
            fs::write(path, "x").unwrap();
        }
        features(&format!("{{}}/{name}")).failed(1, &[name, what]);
    }
    let run = features("{}/photos --masks {}/masks").done();
    assert!(run.stderr().contains("masks/1.png.png: is a named pipe"), "{}", run.stderr());
}

#[test]
fn names_with_commas_and_spaces_have_times() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos/left side");
    photos::write(&folder, 2, 0);
    fs::rename(folder.join("0.png"), folder.join("a, b  c.png")).unwrap();
    let times = "image,seconds\nleft side/1.png,2\nleft side/a, b  c.png, 1.5\n";
    fs::write(dir.path().join("times.csv"), times).unwrap();
    tiepoint_in(dir.path(), "features {}/photos -o {}/ws --timestamps {}/times.csv").done();
    let kept = fs::read_to_string(dir.path().join("ws/timestamps.csv")).unwrap();
    assert_eq!(kept, "image,seconds\nleft side/1.png,2\nleft side/a, b  c.png,1.5\n");
}

#[test]
fn input_folder_with_an_invalid_name() {
    let dir = tempfile::tempdir().unwrap();
    for folder in ["left", "ri\nght"] {
        photos::write(&dir.path().join(folder), 2, 0);
    }
    let features = |inputs: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
        command.arg("features").args(inputs).args(["-o", "ws"]).current_dir(dir.path());
        Run(command.output().unwrap())
    };
    features(&["left", "ri\nght"])
        .failed(1, &[r"ri\nght: its name has control characters", "rename the folder"]);
    // The name of a single input folder is not part of image names.
    features(&["ri\nght"]).done();
}
