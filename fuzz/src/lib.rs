//! What the fuzz targets share: bytes become files in a folder in memory, and several files are one
//! input.

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tiepoint_input::fingerprint::hash_files;

/// Linux keeps this folder in memory; elsewhere the usual one will do.
const IN_MEMORY: &str = "/dev/shm";
/// Divides the files of an input; no reader takes it for anything.
pub const DIVIDER: &[u8] = b"\n%%%%\n";

thread_local! {
    static FOLDER: RefCell<Option<TempDir>> = const { RefCell::new(None) };
}

/// An empty folder.
pub fn folder() -> PathBuf {
    FOLDER.with_borrow_mut(|folder| {
        *folder = None;
        let made = tempfile::tempdir_in(IN_MEMORY).or_else(|_| tempfile::tempdir());
        let made = made.expect("a temporary folder can be made");
        let path = made.path().to_owned();
        *folder = Some(made);
        path
    })
}

/// Writes a file and the folders above it.
pub fn write(path: &Path, bytes: &[u8]) {
    fs::create_dir_all(path.parent().expect("a file lies in a folder"))
        .expect("memory is writable");
    fs::write(path, bytes).expect("memory is writable");
}

/// A file of these bytes in an empty folder.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    write(&path, bytes);
    path
}

/// The parts of an input, for files of these names.
pub fn files(dir: &Path, names: &[&str], data: &[u8]) {
    let mut rest = data;
    for name in names {
        let end = rest.windows(DIVIDER.len()).position(|window| window == DIVIDER);
        let (part, after) = match end {
            Some(end) => (&rest[..end], &rest[end + DIVIDER.len()..]),
            None => (rest, &[][..]),
        };
        write(&dir.join(name), part);
        rest = after;
    }
}

/// A COLMAP model of two cameras on a rig, as text. No two images have the same number.
pub const MODEL: [(&str, &str); 5] = [
    (
        "cameras.txt",
        "1 PINHOLE 640 480 500 500 320 240\n2 SIMPLE_RADIAL 640 480 500 320 240 \
    0.01\n",
    ),
    ("rigs.txt", "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.5 0 0\n"),
    (
        "frames.txt",
        "1 1 1 0 0 0 0 0 0 2 CAMERA 1 1 CAMERA 2 2\n2 1 1 0 0 0 0 0 -1 2 CAMERA 1 3 \
    CAMERA 2 4\n",
    ),
    (
        "images.txt",
        "1 1 0 0 0 0 0 0 1 left/000000.png\n320 240 1 330 250 2 300 220 3 10 10 -1\n\
         2 1 0 0 0 -0.5 0 0 2 right/000002.png\n270 240 1 280 250 2 250 220 3\n\
         3 1 0 0 0 0 0 -1 1 left/000001.png\n320 240 1 332 252 2 295 215 3\n\
         4 1 0 0 0 -0.5 0 -1 2 right/000003.png\n260 240 1 270 250 2 240 220 3\n",
    ),
    (
        "points3D.txt",
        "1 0 0 5 255 0 0 1 1 0 2 0 3 0 4 0\n2 0.1 0.1 5 0 255 0 1 1 1 2 1 3 1 4 1\n3 -0.2 -0.2 5 \
        0 0 255 1 1 2 2 2 3 2 4 2\n",
    ),
];

/// Writes that model into a folder.
pub fn write_model(dir: &Path) {
    MODEL.iter().for_each(|(name, text)| write(&dir.join(name), text.as_bytes()));
}

/// The `tiepoint.json` of that model, behind the hashes of the files.
pub const SIDECAR: &str = r#""cameras": [
  {"id": 1, "is_calibrated": true, "has_focal_prior": true, "readout_s": 0.02},
  {"id": 2, "is_calibrated": false, "has_focal_prior": false, "readout_s": 0.03,
   "readout_sd_s": 0.001, "expected_params": [500.0, 320.0, 240.0, 0.0]}],
  "portrait_landscape_pairs": [[1, 2]], "images": [
  {"id": 1, "stream": "left", "time_s": 0.0}, {"id": 2, "stream": "right", "time_s": 0.0},
  {"id": 3, "stream": "left", "time_s": 1.0}, {"id": 4, "stream": "right", "time_s": null}],
  "held_out_points": [2], "rig": {"reference": "left", "cameras": [
  {"name": "right", "rotation_wxyz": [1.0, 0.0, 0.0, 0.0],
  "translation": [-0.5, 0.0, 0.0], "centre_in_rig": [0.5, 0.0, 0.0], "constraint": "rigid",
  "clock": {"state": "synchronised", "offset_s": 0.0, "offset_sd_s": null, "drift_ppm": 0.0,
   "drift_sd_ppm": null, "pivot_s": 0.5},
  "covariance": null, "rotation_sd_deg": null, "translation_sd": null}]}}"#;

/// Writes these bytes as the `tiepoint.json` of that model in a folder, behind the right hashes.
pub fn sidecar(dir: &Path, data: &[u8]) {
    let hash = |name: &str| hash_files(&[dir.join(name)]).expect("the file was written");
    let files = MODEL.map(|(name, _)| format!("\"{name}\": \"{}\"", hash(name)));
    let mut text = format!("{{\"format\": 1, \"files\": {{{}}}, ", files.join(", ")).into_bytes();
    text.extend(data);
    write(&dir.join("tiepoint.json"), &text);
}

/// Times of the images of that model.
pub const TIMES: &str =
    "image,seconds\nleft/000000.png,0\nright/000002.png,0\nleft/000001.png,1\nright/000003.png,1\n";

/// Scripts of the page that `view` writes.
pub const SCRIPTS: usize = 2;
