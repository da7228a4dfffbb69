//! Writes the first inputs of every target into `corpus/`: small files that are right, from which
//! the fuzzer goes on.

use std::io::Read;
use std::path::Path;

use tiepoint_fuzz::{DIVIDER, SIDECAR, TIMES, folder, write, write_model};
use tiepoint_input::Rgb;
use tiepoint_io::bal::Bal;
use tiepoint_io::colmap::{self, Format};
use tiepoint_io::database::{Database, StageRow, TileWriter};
use tiepoint_io::features::{Features, Keypoint};
use tiepoint_io::scene::geometry::Rigid3;
use tiepoint_io::scene::{ImageId, ImagePair, Match, TwoView, TwoViewKind};
use tiepoint_io::store::disk::Folder;
use tiepoint_io::store::open_hashed;
use tiepoint_io::trajectory::{self, TimedPose};
use tiepoint_io::{las, ply};

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// An image of a few pixels: noise, which leaves nothing to guess.
fn picture(width: u32, height: u32) -> Rgb {
    let value = |k: u32| (k.wrapping_mul(2_654_435_761) >> 24) as u8;
    Rgb { width, height, data: (0..3 * width * height).map(value).collect() }
}

/// Files of a folder as one input.
fn joined(dir: &Path, names: &[&str]) -> Vec<u8> {
    let parts: Vec<Vec<u8>> =
        names.iter().map(|name| std::fs::read(dir.join(name)).unwrap_or_default()).collect();
    parts.join(DIVIDER)
}

fn put(target: &str, name: &str, bytes: &[u8]) {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    write(&corpus.join(target).join(name), bytes);
}

/// Images of every format: names, widths and heights.
const IMAGES: [(&str, u32, u32); 7] = [
    ("a.jpg", 24, 16),
    ("b.png", 9, 7),
    ("c.tif", 8, 8),
    ("d.jpg", 65, 3),
    ("e.webp", 9, 7),
    ("f.bmp", 9, 7),
    ("g.ppm", 9, 7),
];

fn main() -> Outcome {
    let dir = folder();
    let read = |name: &str| std::fs::read(dir.join(name));
    for (name, width, height) in IMAGES {
        picture(width, height).write(&dir.join(name))?;
        put("images", name, &read(name)?);
    }
    put(
        "images",
        "progressive.jpg",
        include_bytes!("../../crates/input/tests/data/gradient_progressive.jpg"),
    );
    put("images", "cmyk.jpg", include_bytes!("../../crates/input/tests/data/red_cmyk.jpg"));
    let exif = [
        b"II*\0\x08\0\0\0".as_slice(),
        &[
            2, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 38, 0, 0, 0,
            0, 0, 0, 0,
        ],
        &[
            2, 0, 5, 0xA4, 3, 0, 1, 0, 0, 0, 26, 0, 0, 0, 3, 0x90, 2, 0, 20, 0, 0, 0, 68, 0, 0, 0,
            0, 0, 0, 0,
        ],
        b"2024:02:29 12:34:56\0",
    ]
    .concat();
    put("exif", "tiff", &exif);

    // moov/udta/GPMF with the key EISE in a container of keys.
    let mp4 = |name: &[u8; 4], content: &[u8]| {
        [&(8 + content.len() as u32).to_be_bytes(), &name[..], content].concat()
    };
    let keys = b"DEVC\0\x01\0\x0CEISEc\x01\0\x01Y\0\0\0";
    put(
        "gopro",
        "video",
        &[mp4(b"ftyp", b"mp41"), mp4(b"moov", &mp4(b"udta", &mp4(b"GPMF", keys)))].concat(),
    );

    let model_dir = dir.join("ws/sparse/0");
    write_model(&model_dir);
    let text = joined(
        &model_dir,
        &["cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"],
    );
    put("colmap_text", "model", &text);
    let model = colmap::read_model(&model_dir)?;
    colmap::write_model(&dir.join("binary"), &model, Format::Binary)?;
    let names = ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"];
    put("colmap_binary", "model", &joined(&dir.join("binary"), &names));
    write(&dir.join("ws/timestamps.csv"), TIMES.as_bytes());
    put("sidecar", "sidecar", SIDECAR.as_bytes());
    put("times", "times", TIMES.as_bytes());
    let with = |more: &[&str]| {
        let mut all = text.clone();
        for part in more {
            all.extend(DIVIDER);
            all.extend(part.as_bytes());
        }
        all
    };
    put("export", "workspace", &with(&[TIMES]));
    put("view", "workspace", &with(&[TIMES, "{}", "{}"]));
    put("adjust", "model", &[&[1], &text[..]].concat());

    let poses: Vec<_> = model.registered().map(|(.., pose)| *pose).collect();
    trajectory::write_kitti(&dir.join("a.kitti"), &poses)?;
    let timed = |(time_s, cam_from_world)| TimedPose { time_s, cam_from_world };
    let poses: Vec<_> = [0.0, 0.5, 1.0, 1.5].into_iter().zip(poses).map(timed).collect();
    trajectory::write_tum(&dir.join("a.tum"), &poses)?;
    ply::write(&dir.join("a.ply"), &ply::points(&model))?;
    Bal::from_reconstruction(&model)?.write(&dir.join("bal.txt"))?;
    put("trajectories", "tum", &read("a.tum")?);
    put("trajectories", "kitti", &read("a.kitti")?);
    trajectory::write_euroc(&dir.join("a.csv"), &poses)?;
    put("trajectories", "euroc", &read("a.csv")?);
    put("bal", "problem", &read("bal.txt")?);
    put("adjust", "problem", &[&[0], &read("bal.txt")?[..]].concat());
    put("ply", "binary", &read("a.ply")?);
    let map = [&b"3&1&1&"[..], &[0; 12]].concat();
    put("dense_map", "depths", &map);
    let ascii = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty float \
    y\nproperty short z\n\
                  property uchar red\nelement face 1\nproperty list uchar int i\nend_header\n1 2 \
                  3 4\n5 6 7 8\n1 0\n";
    put("ply", "ascii", ascii);
    let vertices = ply::read(&dir.join("a.ply"))?;
    for name in ["a.las", "a.laz"] {
        las::write(&dir.join(name), &vertices)?;
        put("las", name, &read(name)?);
    }
    put("evaluate", "kitti", &[&[0], &read("a.kitti")?[..]].concat());
    put("evaluate", "tum", &[&[1], &read("a.tum")?[..]].concat());
    let camera = "500 0 320\n0 500 240\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n640 480\n";
    put("evaluate", "strecha", &[&[2], [camera; 3].join("\n%%%%\n").as_bytes()].concat());
    put("evaluate", "colmap", &[&[3], &text[..]].concat());
    put("evaluate", "cloud", &[&[4], &read("a.ply")?[..]].concat());
    put("calibrations", "strecha", camera.as_bytes());
    put(
        "calibrations",
        "kitti",
        b"P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -378 0 700 \
    180 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    );
    put(
        "listing",
        "manifest",
        br#"{"program": "tiepoint", "files": {"1.jpg": {}, "a/2.png": "x", "../b/1.jpg": null}}"#,
    );
    let stages = br#"{"format": 1, "inputs": ["/photos"], "stages": {"features":
        {"is_complete": true, "input": "f", "options": {"seed": "0"}}}}"#;
    let mut records = stages.to_vec();
    records.extend(DIVIDER);
    records.extend(b"{}");
    records.extend(DIVIDER);
    records.extend(br#"{"program": "tiepoint", "files": {"stages.json": "x"}}"#);
    put("records", "records", &records);

    let path = dir.join("database.db");
    let mut database = Database::create(&path)?;
    let cameras: Vec<_> = model.cameras().map(|(_, camera)| camera.clone()).collect();
    let images: Vec<_> = model.images().map(|(_, image)| image.clone()).collect();
    database.write_cameras(&cameras)?;
    database.write_images(&images)?;
    database.write_rigs(&[], &[])?;
    let keypoint = Keypoint { x: 1.0, y: 2.0, scale: 3.0, orientation: 0.5 };
    let features = Features { keypoints: vec![keypoint; 2], descriptors: vec![[7; 128]; 2].into() };
    database.write_features([(ImageId(0), &features), (ImageId(1), &features)])?;
    let pair = ImagePair::new(ImageId(0), ImageId(1)).ok_or("a pair")?;
    let matches = vec![Match { a: 0, b: 1 }, Match { a: 1, b: 0 }];
    let view =
        TwoView { kind: TwoViewKind::Calibrated, matches: matches.clone(), ..TwoView::default() };
    database.write_pairs([(pair, matches.as_slice(), &view)])?;
    let row = StageRow { stage: "features".to_owned(), is_complete: true, recipe: "{}".to_owned() };
    database.write_stage_rows(&[row])?;
    database.close()?;
    // Small pages leave fewer zeros to change.
    rusqlite::Connection::open(&path)?.execute_batch("PRAGMA page_size = 512; VACUUM;")?;
    put("database", "database", &read("database.db")?);
    tiles(&features, pair, &matches, view)
}

/// Tiles, without the hash behind them, which the target writes.
fn tiles(features: &Features, pair: ImagePair, matches: &[Match], view: TwoView) -> Outcome {
    let folder = Folder::open(&folder())?;
    let tile = |name: &str, fill: &dyn Fn(&mut TileWriter) -> tiepoint_io::Result<()>| -> Outcome {
        let mut tile = TileWriter::create(&folder, name, b"{}")?;
        fill(&mut tile)?;
        tile.finish()?;
        let (file, length) = open_hashed(&folder, name)?.ok_or("a tile")?;
        let mut content = Vec::new();
        file.take(length).read_to_end(&mut content)?;
        put("tile", name, &content);
        Ok(())
    };
    tile("features", &|tile| tile.write_features(ImageId(1), features))?;
    let view = TwoView { cam2_from_cam1: Some(Rigid3::identity()), ..view };
    tile("pairs", &|tile| tile.write_pair(pair, matches, &view))
}
