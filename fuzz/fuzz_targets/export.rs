//! `export` of a model of strangers into every format that needs no photos.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{files, folder};
use tiepoint_pipeline::models::{ExportFormat, ExportSource, export, export_rigid};
use tiepoint_pipeline::workspace::LocatedModel;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    let model = dir.join("ws/sparse/0");
    let names = [
        "cameras.txt",
        "images.txt",
        "points3D.txt",
        "rigs.txt",
        "frames.txt",
        "../../timestamps.csv",
    ];
    std::fs::create_dir_all(&model).expect("memory is writable");
    files(&model, &names, data);
    let workspace = dir.join("ws");
    let Ok(located) = LocatedModel::open(&workspace) else { return };
    let source = ExportSource { model: &located, images: None, overwrite: false };
    for (format, to) in [
        (ExportFormat::Colmap, "binary"),
        (ExportFormat::ColmapText, "text"),
        (ExportFormat::Ply, "a.ply"),
        (ExportFormat::Gltf, "a.glb"),
        (ExportFormat::Tum, "a.tum"),
        (ExportFormat::Kitti, "a.kitti"),
        (ExportFormat::Bal, "bal.txt"),
        (ExportFormat::Kalibr, "camchain.yaml"),
    ] {
        let _ = export(&source, format, &dir.join(to));
    }
    let _ = export_rigid(&source, ExportFormat::Colmap, &dir.join("rigid"));
});
