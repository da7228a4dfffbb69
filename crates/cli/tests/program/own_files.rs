//! Files of the user are never changed, wherever the program writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{photos, tiepoint_in};

const COUNT: usize = 4;

/// All regular files below a folder with their content.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(files(&path));
        } else if path.is_file() {
            all.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    all
}

/// A workspace of photos that lie in `photos` of the folder.
fn reconstructed(dir: &Path, photos: &str) {
    photos::write(&dir.join(photos), COUNT, 0);
    tiepoint_in(dir, &format!("reconstruct {{}}/{photos} -o {{}}/ws")).done();
}

#[test]
fn photos_stay_where_an_export_would_put_its_images() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "proj/images");
    let before = files(&dir.join("proj"));
    let run = tiepoint_in(dir, "export {}/ws --to nerfstudio -o {}/proj").done();
    assert!(run.stdout().contains("4 photos are in their places already"), "{}", run.stdout());
    let photos = |all: BTreeMap<PathBuf, Vec<u8>>| -> BTreeMap<PathBuf, Vec<u8>> {
        all.into_iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "png")).collect()
    };
    assert!(photos(files(&dir.join("proj"))) == before);
    assert!(dir.join("proj/transforms.json").is_file());
    // The same command again replaces its own results, and does not use them as photos.
    tiepoint_in(dir, "export {}/ws --to nerfstudio -o {}/proj").done();
    tiepoint_in(dir, "export {}/ws --to openmvs -o {}/proj")
        .failed(1, &["images/0.png", "another place"]);
    assert!(photos(files(&dir.join("proj"))) == before);
    assert!(!dir.join("proj/scene.mvs").exists());

    // Hard and symbolic links to the photos are recognised.
    fs::create_dir_all(dir.join("linked/images")).unwrap();
    fs::hard_link(dir.join("proj/images/0.png"), dir.join("linked/images/0.png")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(dir.join("proj/images/1.png"), dir.join("linked/images/1.png"))
        .unwrap();
    tiepoint_in(dir, "export {}/ws --to openmvs -o {}/linked")
        .failed(1, &["images/", "another place"]);
    tiepoint_in(dir, "export {}/ws --to nerfstudio -o {}/linked").done();
    assert!(photos(files(&dir.join("proj"))) == before);
    #[cfg(unix)]
    assert!(fs::symlink_metadata(dir.join("linked/images/1.png")).unwrap().is_symlink());

    // Other people's images of the same names.
    photos::write(&dir.join("theirs/images"), 1, 9);
    let theirs = files(&dir.join("theirs"));
    for format in ["nerfstudio", "openmvs"] {
        tiepoint_in(dir, &format!("export {{}}/ws --to {format} -o {{}}/theirs"))
            .failed(1, &["theirs/images/0.png", "did not make it", "move it away"]);
    }
    let now = files(&dir.join("theirs"));
    assert!(theirs.iter().all(|(path, bytes)| now.get(path) == Some(bytes)));
}

#[test]
fn files_of_others_keep_a_folder_from_becoming_a_workspace() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 2, 0);
    for name in [
        "timestamps.csv",
        "points.ply",
        "rig.json",
        "report.json",
        "report.html",
        "frames/mine.jpg",
    ] {
        let path = dir.join("proj").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "image,seconds\nother.png,3\n").unwrap();
        let before = files(&dir.join("proj"));
        let top = name.split('/').next().unwrap();
        tiepoint_in(dir, "reconstruct {}/photos -o {}/proj")
            .failed(1, &["proj holds", top, "did not make it"]);
        assert!(files(&dir.join("proj")) == before, "{name}");
        fs::remove_dir_all(dir.join("proj")).unwrap();
    }
}

#[test]
fn files_of_others_in_a_workspace_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    let put = |name: &str| fs::write(dir.join("ws").join(name), "mine").unwrap();
    let refused = |line: &str, name: &str| {
        tiepoint_in(dir, line).failed(1, &[name]);
        assert_eq!(fs::read(dir.join("ws").join(name)).unwrap(), b"mine", "{line}");
    };
    for name in ["points.ply", "rig.json", "sparse/0/images.bin", "sparse/0/images.txt"] {
        let before = fs::read(dir.join("ws").join(name)).ok();
        put(name);
        refused("map {}/ws --redo map", name);
        match before {
            Some(bytes) => fs::write(dir.join("ws").join(name), bytes).unwrap(),
            None => fs::remove_file(dir.join("ws").join(name)).unwrap(),
        }
    }
    put("report.html");
    refused("view {}/ws", "report.html");
    fs::remove_file(dir.join("ws/report.html")).unwrap();
    tiepoint_in(dir, "view {}/ws").done();
    tiepoint_in(dir, "view {}/ws").done();
    let times = fs::read(dir.join("ws/timestamps.csv")).unwrap();
    put("timestamps.csv");
    refused("features {}/photos -o {}/ws --redo features", "timestamps.csv");
    refused("map {}/ws --redo map", "timestamps.csv");
    fs::write(dir.join("ws/timestamps.csv"), times).unwrap();
    // Files with other names stay.
    put("sparse/0/notes.txt");
    fs::create_dir(dir.join("ws/sparse/aligned")).unwrap();
    put("sparse/aligned/images.bin");
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws --redo features").done();
    for name in ["sparse/0/notes.txt", "sparse/aligned/images.bin"] {
        assert_eq!(fs::read(dir.join("ws").join(name)).unwrap(), b"mine");
    }
}

#[test]
fn the_workspace_may_lie_anywhere_beside_the_photos() {
    for (photos, workspace) in
        [("proj", "proj"), ("proj", "proj/ws"), ("ws/photos", "ws"), ("link", "proj")]
    {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path();
        photos::write(&dir.join(if photos == "link" { "proj" } else { photos }), COUNT, 0);
        #[cfg(unix)]
        if photos == "link" {
            std::os::unix::fs::symlink("proj", dir.join("link")).unwrap();
        }
        if !dir.join(photos).exists() {
            continue;
        }
        let before = files(dir);
        for line in [
            format!("reconstruct {{}}/{photos} -o {{}}/{workspace}"),
            format!("reconstruct {{}}/{photos} -o {{}}/{workspace} --redo features"),
            format!("match {{}}/{workspace} --redo match"),
            format!("map {{}}/{workspace} --redo map"),
            format!("adjust {{}}/{workspace} -o {{}}/{workspace}/adjusted"),
            format!("export {{}}/{workspace} --to nerfstudio -o {{}}/{workspace}/nerf"),
            format!("export {{}}/{workspace} --to openmvs -o {{}}/{workspace}/mvs"),
            format!("export {{}}/{workspace} --to colmap -o {{}}/{workspace}"),
            format!("export {{}}/{workspace} --to ply -o {{}}/{workspace}/cloud.ply"),
            format!("view {{}}/{workspace}"),
            format!("evaluate poses {{}}/{workspace} --truth colmap:{{}}/{workspace}/sparse/0"),
        ] {
            tiepoint_in(dir, &line).done();
            let now = files(dir);
            assert!(before.iter().all(|(path, bytes)| now.get(path) == Some(bytes)), "{line}");
        }
        // The next run does not use exported images as photos.
        tiepoint_in(dir, &format!("reconstruct {{}}/{photos} -o {{}}/{workspace}")).done();
    }
}

#[test]
fn an_input_is_never_an_output() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    let before = files(dir);
    for line in [
        "adjust {}/ws -o {}/ws/sparse/0",
        "adjust {}/ws/sparse/0 -o {}/ws/sparse/0",
        "export {}/ws --to colmap -o {}/ws/sparse/0",
        "export {}/ws --to ply -o {}/ws/sparse/0/images.bin",
    ] {
        tiepoint_in(dir, line)
            .failed(1, &["sparse/0/", "is read by this command", "another place"]);
    }
    tiepoint_in(dir, "export {}/ws --to colmap-text -o {}/text").done();
    tiepoint_in(dir, "export {}/ws --to bal -o {}/bal.txt").done();
    tiepoint_in(dir, "adjust {}/bal.txt -o {}/bal.txt")
        .failed(1, &["bal.txt", "is read by this command"]);
    let now = files(dir);
    // Hidden files are the program's own.
    let changed = before.iter().find(|(path, bytes)| now.get(*path) != Some(bytes));
    assert!(changed.is_none(), "{changed:?}");
}

#[test]
fn foreign_results_are_kept_and_own_ones_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    for (format, name) in [("ply", "a.ply"), ("bal", "b.txt"), ("kitti", "c.txt")] {
        let line = format!("export {{}}/ws --to {format} -o {{}}/{name}");
        fs::write(dir.join(name), "mine").unwrap();
        tiepoint_in(dir, &line).failed(1, &[name, "did not make it"]);
        assert_eq!(fs::read(dir.join(name)).unwrap(), b"mine");
        fs::write(dir.join(name), "").unwrap();
        tiepoint_in(dir, &line).done();
        tiepoint_in(dir, &line).done();
        assert!(fs::metadata(dir.join(name)).unwrap().len() > 0);
    }
    fs::create_dir(dir.join("model")).unwrap();
    fs::write(dir.join("model/cameras.txt"), "mine").unwrap();
    for line in ["export {}/ws --to colmap -o {}/model", "adjust {}/ws -o {}/model"] {
        tiepoint_in(dir, line).failed(1, &["model/cameras.txt", "did not make it"]);
    }
    assert_eq!(fs::read(dir.join("model/cameras.txt")).unwrap(), b"mine");
    fs::write(dir.join("report.html"), "mine").unwrap();
    tiepoint_in(dir, "demo -o {} --frames 2 --size 64x48")
        .failed(1, &["report.html", "did not make it"]);
    assert_eq!(fs::read(dir.join("report.html")).unwrap(), b"mine");
    assert!(!dir.join("drive").exists(), "nothing was begun");
}

#[cfg(unix)]
#[test]
fn devices_links_and_modes_stay_what_they_are() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    let null = || fs::metadata("/dev/null").map(|m| (m.ino(), m.mode(), m.rdev())).unwrap();
    let before = null();
    tiepoint_in(dir, "export {}/ws --to ply -o /dev/null").done();
    assert_eq!(null(), before);
    tiepoint_in(dir, "export {}/ws --to ply -o /dev/full").failed(1, &["/dev/full", "No space"]);
    fs::create_dir(dir.join("deep")).unwrap();
    symlink("deep/real.ply", dir.join("link.ply")).unwrap();
    for _ in 0..2 {
        tiepoint_in(dir, "export {}/ws --to ply -o {}/link.ply").done();
        assert!(fs::symlink_metadata(dir.join("link.ply")).unwrap().is_symlink());
        fs::set_permissions(dir.join("deep/real.ply"), fs::Permissions::from_mode(0o600)).unwrap();
    }
    let mode = fs::metadata(dir.join("deep/real.ply")).unwrap().mode();
    assert_eq!(mode & 0o777, 0o600);
}

#[test]
fn folder_name_like_a_url_is_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_tiepoint"))
        .current_dir(dir.path())
        .args(["features", "photos", "-o", "file:w"])
        .output();
    assert!(run.unwrap().status.success());
    assert!(dir.path().join("file:w/database.db").is_file());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
}
