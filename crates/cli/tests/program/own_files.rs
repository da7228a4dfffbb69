//! Files of the user are never changed, wherever the program writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{photos, tiepoint_in};

const COUNT: usize = 4;
/// The cameras of the photos as COLMAP writes them.
const CAMERAS: &str = "1 PINHOLE 320 240 330 330 160 120\n";

/// All regular files below a folder with their content.
pub(crate) fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
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

    fs::rename(dir.join("proj"), dir.join("moved")).unwrap();
    tiepoint_in(dir, "undistort {}/ws -o {}/u")
        .failed(1, &["proj/images is no longer there", "--images", "`tiepoint features`"]);
    tiepoint_in(dir, "features {}/moved/images -o {}/ws").done();
    tiepoint_in(dir, "undistort {}/ws -o {}/u").done();
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
    tiepoint_in(dir, "view {}/ws/sparse/0").done();
    assert!(dir.join("ws/report.html").is_file() && !dir.join("ws/sparse/0/report.html").exists());
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
            format!("export {{}}/{workspace} --to colmap -o {{}}/{workspace}/colmap"),
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
    // A model of another program gets no page among its files.
    fs::create_dir(dir.join("colmap")).unwrap();
    tiepoint_in(dir, "export {}/ws --to colmap -o {}/colmap/sparse/0").done();
    let before = files(&dir.join("colmap"));
    let line = "view {}/colmap/sparse/0 --json";
    let page = tiepoint_in(dir, line).done().json()["report"].as_str().unwrap().to_owned();
    assert_eq!(fs::canonicalize(page).unwrap(), dir.join("colmap.html").canonicalize().unwrap());
    tiepoint_in(dir, line).done();
    fs::write(dir.join("colmap.html"), "mine").unwrap();
    tiepoint_in(dir, "view {}/colmap").failed(1, &["colmap.html", "did not make it"]);
    tiepoint_in(&dir.join("colmap/sparse/0"), "view .").failed(1, &["run this in another folder"]);
    assert!(files(&dir.join("colmap")) == before);
    fs::write(dir.join("report.html"), "mine").unwrap();
    tiepoint_in(dir, "demo -o {} --frames 2 --size 64x48")
        .failed(1, &["report.html", "did not make it"]);
    assert_eq!(fs::read(dir.join("report.html")).unwrap(), b"mine");
    assert!(!dir.join("drive").exists(), "nothing was begun");
}

/// The options that name a file or folder to write; all other paths are read. A new option belongs
/// to one of the two lists, and one that names a file needs a line in [`FILES`].
const WRITTEN: [&str; 2] = ["output", "save-transform"];
const READ: [&str; 19] = [
    "baseline",
    "by",
    "calibration",
    "cloud",
    "control-points",
    "database",
    "images",
    "input-model",
    "inputs",
    "masks",
    "model",
    "models",
    "points",
    "positions",
    "reference",
    "rig-calibration",
    "timestamps",
    "to",
    "workspace",
];
/// The same for COLMAP's options.
const COLMAP_WRITTEN: [&str; 4] =
    ["database_path", "output_path", "transform_path", "workspace_path"];
const COLMAP_READ: [&str; 22] = [
    "bbox_path",
    "config_path",
    "mask_path",
    "vocab_tree_path",
    "ImageReader.camera_mask_path",
    "ImageReader.mask_path",
    "Mapper.constant_camera_list_path",
    "Mapper.constant_rig_list_path",
    "Mapper.snapshot_path",
    "SequentialMatching.vocab_tree_path",
    "StereoFusion.mask_path",
    "VocabTreeMatching.match_list_path",
    "VocabTreeMatching.vocab_tree_path",
    "image_list_path",
    "image_path",
    "ref_images_path",
    "ref_model_path",
    "rig_config_path",
    "input_path",
    "input_path1",
    "input_path2",
    "path",
];
/// Command lines that write the file `<>`.
const FILES: [&str; 15] = [
    "export {}/ws --to bal -o <>",
    "export {}/ws --to ply -o <>",
    "export {}/ws --to gltf -o <>",
    "export {}/ws --to kitti -o <>",
    "export {}/ws --to tum -o <>",
    "export {}/ws --to kalibr -o <>",
    "adjust {}/bal.txt -o <>",
    "model align {}/ws --to {}/ws -o {}/aligned --save-transform <>",
    "colmap model_converter --input_path {}/model --output_type PLY --output_path <>",
    "colmap model_aligner --input_path {}/model --output_path {}/al --ref_is_gps 0 \
     --ref_images_path {}/positions.txt --robust_alignment 0 --transform_path <>",
    "colmap model_aligner --input_path {}/model --output_path {}/al --alignment_type plane \
     --transform_path <>",
    "colmap feature_extractor --image_path {}/photos --database_path <>",
    "colmap exhaustive_matcher --database_path <>",
    "colmap mapper --image_path {}/photos --database_path <> --output_path {}/mapped",
    "colmap stereo_fusion --workspace_path {}/dense --output_path <>",
];

#[test]
fn every_path_of_the_command_line_is_known_as_read_or_written() {
    for command in tiepoint_cli::commands() {
        for argument in command.arguments.iter().filter(|argument| argument.is_path) {
            let name = argument.name.as_str();
            let lists = [WRITTEN.contains(&name), READ.contains(&name)];
            assert_eq!(lists.iter().filter(|found| **found).count(), 1, "{name}: {command:?}");
        }
    }
    let verbs = crate::tiepoint(["colmap", "help"]).done().stdout();
    let verbs = verbs.lines().skip_while(|line| !line.starts_with("Available commands"));
    let verbs = verbs.filter_map(|line| line.strip_prefix("  "));
    for verb in verbs.filter(|verb| !["help", "version"].contains(verb)) {
        let help = crate::tiepoint(["colmap", verb, "-h"]).done().stdout();
        for line in help.lines().filter_map(|line| line.strip_prefix("  --")) {
            let name = line.split_whitespace().next().unwrap();
            // Options of all verbs.
            if !name.contains("path") || name == "project_path" {
                continue;
            }
            let lists = [COLMAP_WRITTEN.contains(&name), COLMAP_READ.contains(&name)];
            assert_eq!(lists.iter().filter(|found| **found).count(), 1, "{verb}: {name}");
        }
    }
}

#[test]
fn no_command_replaces_a_file_that_it_reads_or_did_not_make() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    tiepoint_in(dir, "export {}/ws --to colmap -o {}/model").done();
    tiepoint_in(dir, "export {}/ws --to bal -o {}/bal.txt").done();
    let undistorter = "colmap image_undistorter --image_path {}/photos --input_path {}/model \
                       --output_path {}/dense";
    tiepoint_in(dir, undistorter).done();
    let stereo = "colmap patch_match_stereo --workspace_path {}/dense \
                  --PatchMatchStereo.max_image_size 64";
    tiepoint_in(dir, stereo).done();
    let positions: String = (0..COUNT).map(|i| format!("{i}.png {i} {} 0\n", i * i)).collect();
    fs::write(dir.join("positions.txt"), positions).unwrap();
    fs::write(dir.join("mine"), "mine").unwrap();
    let before = files(dir);
    for line in FILES {
        let targets = [
            "mine",
            "photos/0.png",
            "model/points3D.bin",
            "model/cameras.bin",
            "positions.txt",
            "bal.txt",
            "ws/sparse/0/images.bin",
            "dense/sparse/images.bin",
            "dense/stereo/depth_maps/0.png.geometric.bin",
        ];
        for target in targets {
            let run = tiepoint_in(dir, &line.replace("<>", &format!("{{}}/{target}")));
            assert!(!run.stderr().contains("panicked"), "{line}: {}", run.stderr());
            let now = files(dir);
            let changed = before.iter().find(|(path, bytes)| now.get(*path) != Some(bytes));
            assert!(changed.is_none(), "{line}: {:?}", changed.map(|(path, _)| path));
        }
    }
    // These photos have neither times nor a rig.
    let is_possible =
        |line: &&&str| !["database_path", "tum", "kalibr"].iter().any(|word| line.contains(word));
    for line in FILES.iter().filter(is_possible) {
        let new = line.replace("<>", "{}/new");
        tiepoint_in(dir, &new).done();
        let first = fs::read(dir.join("new")).unwrap();
        tiepoint_in(dir, &new).done();
        assert!(fs::read(dir.join("new")).unwrap() == first, "{line}");
        fs::write(dir.join("new"), "mine").unwrap();
        tiepoint_in(dir, &new).failed(1, &["did not make it", "replace it with --overwrite"]);
        assert_eq!(fs::read(dir.join("new")).unwrap(), b"mine");
        let value = if line.starts_with("colmap") { " 1" } else { "" };
        let overwrite = format!("--overwrite{value}");
        tiepoint_in(dir, &format!("{new} {overwrite}")).done();
        assert!(fs::read(dir.join("new")).unwrap() == first, "{line}");
        fs::remove_file(dir.join("new")).unwrap();
        let input = match line.split_once("/bal.txt") {
            Some(_) => "bal.txt",
            None if line.contains("/model ") => "model/points3D.bin",
            None if line.contains("/dense ") => "dense/stereo/depth_maps/0.png.geometric.bin",
            None => "ws/sparse/0/images.bin",
        };
        let onto_input = line.replace("<>", &format!("{{}}/{input}"));
        tiepoint_in(dir, &format!("{onto_input} {overwrite}"))
            .failed(1, &["is read by this command"]);
        assert!(files(dir)[&dir.join(input)] == before[&dir.join(input)], "{line}");
    }
}

#[test]
fn an_export_with_overwrite_keeps_what_the_model_was_made_of() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    let names = (0..COUNT).map(|k| format!("{k}.png,{k}\n")).collect::<String>();
    fs::write(dir.join("times.csv"), format!("image,seconds\n{names}")).unwrap();
    fs::write(dir.join("cameras.txt"), CAMERAS).unwrap();
    let read = "--timestamps {}/times.csv --calibration {}/cameras.txt";
    tiepoint_in(dir, &format!("reconstruct {{}}/photos -o {{}}/ws {read}")).done();
    for target in ["photos/0.png", "ws/database.db", "times.csv", "cameras.txt"] {
        let before = fs::read(dir.join(target)).unwrap();
        for format in ["ply", "csv", "gltf"] {
            let line = format!("export {{}}/ws --to {format} -o {{}}/{target} --overwrite");
            tiepoint_in(dir, &line).failed(1, &["is read by this command"]);
            assert!(fs::read(dir.join(target)).unwrap() == before, "{line}");
        }
    }
}

#[test]
fn workspace_copied_without_hidden_files_knows_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    reconstructed(dir, "photos");
    tiepoint_in(dir, "dense {}/ws").done();
    let copy = || {
        let _ = fs::remove_dir_all(dir.join("copy"));
        for (path, bytes) in files(&dir.join("ws")) {
            let name = path.strip_prefix(dir.join("ws")).unwrap();
            // As `cp -r ws/* copy` does it.
            if !name.to_str().unwrap().starts_with('.') {
                let to = dir.join("copy").join(name);
                fs::create_dir_all(to.parent().unwrap()).unwrap();
                fs::write(to, bytes).unwrap();
            }
        }
    };
    copy();
    for line in ["map {}/copy --redo map", "dense {}/copy --redo dense"] {
        tiepoint_in(dir, line).done();
    }
    for name in ["points.ply", "sparse/0/images.bin"] {
        copy();
        fs::write(dir.join("copy").join(name), "MY OWN").unwrap();
        tiepoint_in(dir, "map {}/copy --redo map").failed(1, &[name, "did not make it"]);
        assert_eq!(fs::read(dir.join("copy").join(name)).unwrap(), b"MY OWN");
    }
}

#[test]
fn drive_that_was_killed_at_its_first_file_continues() {
    let dir = tempfile::tempdir().unwrap();
    let drive = dir.path().join("drive");
    fs::create_dir(&drive).unwrap();
    fs::write(drive.join(".synth.json.tiepoint-part"), "{").unwrap();
    let line = "synth -o {}/drive --frames 1 --size 32x24";
    tiepoint_in(dir.path(), line).done();
    assert!(!drive.join(".synth.json.tiepoint-part").exists());
    fs::write(drive.join(".hidden"), "mine").unwrap();
    fs::remove_file(drive.join("synth.json")).unwrap();
    tiepoint_in(dir.path(), line).failed(1, &["drive is not empty"]);
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
    tiepoint_in(dir, "export {}/ws --to ply -o {}/link.ply")
        .failed(1, &["link.ply", "symbolic link to nothing"]);
    fs::write(dir.join("deep/real.ply"), "").unwrap();
    for _ in 0..2 {
        tiepoint_in(dir, "export {}/ws --to ply -o {}/link.ply").done();
        assert!(fs::symlink_metadata(dir.join("link.ply")).unwrap().is_symlink());
        fs::set_permissions(dir.join("deep/real.ply"), fs::Permissions::from_mode(0o600)).unwrap();
    }
    let mode = fs::metadata(dir.join("deep/real.ply")).unwrap().mode();
    assert_eq!(mode & 0o777, 0o600);
    // What reads the pipe gets the file alone.
    let piped = tiepoint_in(dir, "export {}/ws --to kitti -o /dev/stdout").done();
    fs::write(dir.join("piped.txt"), piped.stdout()).unwrap();
    tiepoint_in(dir, "export {}/ws --to kitti -o {}/file.txt").done();
    let read = |name: &str| fs::read(dir.join(name)).unwrap();
    assert!(read("piped.txt") == read("file.txt"), "{}", piped.stdout());
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
