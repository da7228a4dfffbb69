//! Folders that somebody else made: their links, names and manifests never make a command change,
//! remove or move a file outside of them.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::{photos, tiepoint_in};

const COUNT: usize = 4;
/// Folders that are drawn in each run of the tests; `TIEPOINT_HOSTILE_FOLDERS=500` draws more.
const DRAWN: u64 = 12;
const SEED: u64 = 20_261_125;
/// Commands that each drawn folder meets.
const COMMANDS_PER_FOLDER: usize = 3;

/// Commands that read the folder `{}/hostile`.
const READING: [&str; 21] = [
    "model info {}/hostile",
    "export {}/hostile --to ply -o {}/out/x.ply",
    "export {}/hostile --to colmap-text -o {}/out/text",
    "export {}/hostile --to nerfstudio -o {}/out/nerfstudio",
    "view {}/hostile",
    "adjust {}/hostile -o {}/out/adjusted",
    "evaluate poses {}/hostile --truth colmap:{}/model",
    "evaluate poses {}/model --truth colmap:{}/hostile",
    "undistort {}/hostile -o {}/out/undistorted",
    "map {}/ws --input-model {}/hostile --redo map",
    "model merge {}/model {}/hostile -o {}/out/merged",
    "model align {}/hostile --to {}/model -o {}/out/aligned",
    "model align {}/model --to {}/hostile -o {}/out/aligned2",
    "localize {}/hostile {}/photos -o {}/out/poses.txt",
    "colmap model_analyzer --path {}/hostile",
    "model crop {}/hostile --quantiles 0,1 -o {}/out/cropped",
    "evaluate cloud {}/hostile/points.ply {}/ws/points.ply",
    "colmap model_converter --input_path {}/hostile --output_type PLY --output_path {}/out/c.ply",
    "colmap model_aligner --input_path {}/hostile --output_path {}/out/plane \
     --alignment_type plane",
    "colmap image_undistorter --image_path {}/photos \
     --input_path {}/hostile --output_path {}/out/u",
    "colmap bundle_adjuster --input_path {}/hostile --output_path {}/out/adjusted2",
];

/// Commands that write into it.
const WRITING: [&str; 22] = [
    "export {}/model --to colmap -o {}/hostile",
    "export {}/ws --to nerfstudio -o {}/hostile",
    "export {}/ws --to openmvs -o {}/hostile",
    "adjust {}/model -o {}/hostile",
    "undistort {}/ws -o {}/hostile",
    "model align {}/model --to {}/ws -o {}/hostile",
    "features {}/photos -o {}/hostile",
    "match {}/hostile --redo match",
    "map {}/hostile --redo map",
    "dense {}/hostile",
    "reconstruct {}/photos -o {}/hostile --redo features",
    "reconstruct {}/photos -o {}/hostile",
    "colmap bundle_adjuster --input_path {}/model --output_path {}/hostile",
    "colmap mapper --database_path {}/hostile/database.db --image_path {}/photos \
     --output_path {}/hostile/made",
    "synth -o {}/hostile --frames 1 --size 32x24",
    "model crop {}/model --quantiles 0,1 -o {}/hostile",
    "model merge {}/model {}/ws -o {}/hostile",
    "localize {}/ws {}/photos -o {}/hostile",
    "export {}/ws --to ply -o {}/hostile/points.ply --overwrite",
    "colmap image_undistorter --image_path {}/photos --input_path {}/model \
     --output_path {}/hostile",
    "colmap model_converter --input_path {}/model --output_type TXT --output_path {}/hostile",
    "colmap feature_extractor --image_path {}/photos --database_path {}/hostile/database.db",
];

/// Names in a workspace at which a link may stand.
const NAMES: [&str; 22] = [
    "sub",
    "deep/sub",
    ".tiepoint-commit",
    ".tiepoint-new",
    ".tiepoint-old",
    "tiepoint-files.json",
    ".lock",
    "report.html",
    "report.json",
    "rig.json",
    "stages.json",
    "points.ply",
    "timestamps.csv",
    "database.db",
    "database.db-wal",
    "database.db-journal",
    "sparse",
    "sparse/0",
    "sparse/0/images.bin",
    "images",
    "dense",
    "cameras.bin",
];

/// All entries below a folder but for those that commands may change: files with their content,
/// links with their targets.
fn entries(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let found = fs::symlink_metadata(&path).unwrap();
        let content = if found.is_symlink() {
            fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes()
        } else if found.is_dir() {
            all.extend(entries(&path));
            Vec::new()
        } else {
            fs::read(&path).unwrap()
        };
        all.insert(path, content);
    }
    all
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

/// A home folder, photos, a workspace and a plain model, in which hostile folders are made.
struct Scene(tempfile::TempDir);

impl Scene {
    fn new() -> Self {
        let this = Self(tempfile::tempdir().unwrap());
        let dir = this.dir();
        fs::create_dir_all(dir.join("home/sub")).unwrap();
        for (name, text) in [("bashrc", "default"), ("id_rsa", "secret"), ("sub/x", "mine")] {
            fs::write(dir.join("home").join(name), text).unwrap();
        }
        photos::write(&dir.join("photos"), COUNT, 0);
        tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
        copy(&dir.join("ws/sparse/0"), &dir.join("model"));
        this
    }

    fn dir(&self) -> &Path {
        self.0.path()
    }

    fn hostile(&self, name: &str) -> PathBuf {
        self.dir().join("hostile").join(name)
    }

    /// A fresh copy of the workspace or of the model as `hostile`.
    fn reset(&self, is_workspace: bool) {
        let dir = self.dir();
        for name in ["hostile", "out"] {
            let _ = fs::remove_dir_all(dir.join(name));
        }
        fs::create_dir(dir.join("out")).unwrap();
        copy(&dir.join(if is_workspace { "ws" } else { "model" }), &dir.join("hostile"));
    }

    /// Puts a link at a name; nothing where a part of the name is a link already.
    fn link(&self, to: &str, name: &str) {
        let name = self.hostile(name);
        let parent = name.parent().unwrap();
        let is_inside = |path: &Path| !path.is_symlink();
        let parents = parent.ancestors().take_while(|path| *path != self.dir());
        if !parents.into_iter().all(is_inside) || fs::create_dir_all(parent).is_err() {
            return;
        }
        if is_inside(&name) && name.is_dir() {
            fs::remove_dir_all(&name).unwrap();
        } else {
            let _ = fs::remove_file(&name);
        }
        symlink(self.dir().join(to), name).unwrap();
    }

    fn manifest(&self, files: &[(&str, &str)], order: &[&str], removed: &[&str]) {
        let hash = |text: &str| [blake3::hash(text.as_bytes()).to_hex().to_string()];
        let files: BTreeMap<&str, [String; 1]> =
            files.iter().map(|(name, text)| (*name, hash(text))).collect();
        let text = json!({"program": "tiepoint", "files": files, "order": order,
            "removed": removed});
        // A link may stand there.
        let path = self.hostile("tiepoint-files.json");
        let _ = fs::remove_file(&path);
        fs::write(path, text.to_string()).unwrap();
    }

    fn stage(&self, name: &str) {
        let path = self.hostile(".tiepoint-commit").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "planted").unwrap();
    }

    /// Runs a command and checks that nothing outside of the folder, the results and the own
    /// workspace changed.
    fn check(&self, line: &str, case: &str) {
        let outside = || ["home", "photos", "model"].map(|name| entries(&self.dir().join(name)));
        let before = outside();
        let run = tiepoint_in(self.dir(), line);
        assert!(before == outside(), "{case}: {line}\n{}", run.stderr());
        assert!(!run.stderr().contains("panicked"), "{case}: {line}\n{}", run.stderr());
        assert!([0, 1].contains(&run.code()), "{case}: {line}\n{}", run.stderr());
    }
}

#[test]
fn manifest_of_others_moves_nothing_outside_of_its_folder() {
    let scene = Scene::new();
    let attacks: [(&str, &dyn Fn()); 5] = [
        ("a new file is planted", &|| {
            scene.link("home", "sub");
            scene.stage("sub/planted");
            scene.manifest(&[], &["sub/planted"], &[]);
        }),
        ("a known file is replaced", &|| {
            scene.link("home", "sub");
            scene.stage("sub/bashrc");
            scene.manifest(&[("sub/bashrc", "default")], &["sub/bashrc"], &[]);
        }),
        ("a known file is removed", &|| {
            scene.link("home", "deep/sub");
            fs::create_dir(scene.hostile(".tiepoint-commit")).unwrap();
            let name = "deep/sub/bashrc";
            scene.manifest(&[(name, "default")], &[], &[name]);
        }),
        ("a private file is moved into the folder", &|| {
            scene.link("home", ".tiepoint-commit");
            scene.manifest(&[], &["id_rsa"], &[]);
        }),
        ("a replaced file is moved into a linked folder", &|| {
            scene.link("home", ".tiepoint-old");
            scene.stage("cameras.bin");
            let cameras = fs::read(scene.dir().join("model/cameras.bin")).unwrap();
            let hash = blake3::hash(&cameras).to_hex().to_string();
            let text = json!({"program": "tiepoint", "files": {"cameras.bin": [hash]},
                "order": ["cameras.bin"]});
            fs::write(scene.hostile("tiepoint-files.json"), text.to_string()).unwrap();
        }),
    ];
    for (case, attack) in attacks {
        for line in [READING[0], READING[4], READING[9], READING[14], WRITING[0]] {
            scene.reset(false);
            attack();
            scene.check(line, case);
        }
        // What reads refuses and says what is wrong; what writes names the link.
        scene.reset(false);
        attack();
        tiepoint_in(scene.dir(), READING[0]).failed(1, &["hostile", "interrupted"]);
        if case != "a replaced file is moved into a linked folder" {
            tiepoint_in(scene.dir(), WRITING[0]).failed(1, &["hostile", "is a symbolic link"]);
        }
    }
}

#[test]
fn page_shows_and_follows_no_links() {
    let scene = Scene::new();
    scene.reset(true);
    scene.link("home/id_rsa", "rig.json");
    tiepoint_in(scene.dir(), "view {}/hostile").done();
    let page = fs::read_to_string(scene.hostile("report.html")).unwrap();
    assert!(!page.contains("secret") && page.contains("/9j/"), "a JPEG file in base 64");
    // Who sends a workspace knows where photos may lie, and not what they show.
    let database = rusqlite::Connection::open(scene.hostile("database.db")).unwrap();
    database.execute("DELETE FROM tiepoint_photos", ()).unwrap();
    database.close().unwrap();
    tiepoint_in(scene.dir(), "view {}/hostile").done();
    assert!(!fs::read_to_string(scene.hostile("report.html")).unwrap().contains("/9j/"));
    scene.link("home/page.html", "report.html");
    tiepoint_in(scene.dir(), "view {}/hostile").failed(1, &["report.html", "is a symbolic link"]);
    assert!(!scene.dir().join("home/page.html").exists());
}

/// SplitMix64 (Steele et al. 2014).
struct Draw(u64);

impl Draw {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as usize % count
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }
}

/// Links at drawn names, and a manifest with drawn names, which may lead over the links.
fn draw_attack(scene: &Scene, draw: &mut Draw) {
    const TARGETS: [&str; 6] =
        ["home", "home/sub", "home/bashrc", "home/id_rsa", "home/none", "photos/0.png"];
    const INNER: [&str; 6] = ["bashrc", "id_rsa", "sub/x", "new", "cameras.bin", "0.png"];
    let mut names: Vec<String> = INNER.iter().map(|name| (*name).to_owned()).collect();
    for _ in 0..1 + draw.below(3) {
        let (to, name) = (draw.one(&TARGETS), draw.one(&NAMES));
        scene.link(to, name);
        names.extend(INNER.iter().map(|inner| format!("{name}/{inner}")));
        names.push(name.to_owned());
    }
    if draw.below(4) == 0 {
        return;
    }
    let mut some = |most: usize| -> Vec<String> {
        (0..draw.below(most + 1)).map(|_| names[draw.below(names.len())].clone()).collect()
    };
    let (order, removed, known) = (some(3), some(2), some(4));
    fn texts(names: &[String]) -> Vec<&str> {
        names.iter().map(String::as_str).collect()
    }
    let known: Vec<(&str, &str)> = known
        .iter()
        .chain(&removed)
        .map(|name| match name.rsplit('/').next().unwrap() {
            "bashrc" => (name.as_str(), "default"),
            "id_rsa" => (name.as_str(), "secret"),
            _ => (name.as_str(), "mine"),
        })
        .collect();
    let commit = scene.hostile(".tiepoint-commit");
    if !commit.is_symlink() {
        let _ = fs::create_dir(&commit);
        for name in &order {
            // A part of the name may be a file by now.
            let path = commit.join(name);
            if fs::create_dir_all(path.parent().unwrap()).is_ok() {
                let _ = fs::write(path, "planted");
            }
        }
    }
    scene.manifest(&known, &texts(&order), &texts(&removed));
}

#[test]
fn drawn_folders_change_nothing_outside_of_them() {
    let wanted = std::env::var("TIEPOINT_HOSTILE_FOLDERS").ok().and_then(|n| n.parse().ok());
    let scene = Scene::new();
    for folder in 0..wanted.unwrap_or(DRAWN) {
        let mut draw = Draw(SEED + folder);
        for _ in 0..COMMANDS_PER_FOLDER {
            scene.reset(draw.below(2) == 0);
            draw_attack(&scene, &mut draw);
            let all = [&READING[..], &WRITING[..]].concat();
            scene.check(draw.one(&all), &format!("folder {folder}"));
        }
    }
}
