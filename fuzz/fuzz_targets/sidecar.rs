//! `tiepoint.json` beside a model, through the exports that use it: no number of Kalibr's file is
//! NaN or infinite.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{TIMES, folder, sidecar, write, write_model};
use tiepoint_pipeline::models::{ExportFormat, ExportSource, export, export_rigid};
use tiepoint_pipeline::workspace::LocatedModel;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    let model = dir.join("ws/sparse/0");
    write_model(&model);
    sidecar(&model, data);
    write(&dir.join("ws/timestamps.csv"), TIMES.as_bytes());
    let chain = dir.join("camchain.yaml");
    let located = LocatedModel::open(&dir.join("ws")).expect("the model is right");
    let source = ExportSource { model: &located, images: None, overwrite: false };
    if export(&source, ExportFormat::Kalibr, &chain).is_ok() {
        let text = std::fs::read_to_string(&chain).expect("it was written");
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
    let _ = export(&source, ExportFormat::Tum, &dir.join("a.tum"));
    let _ = export_rigid(&source, ExportFormat::Colmap, &dir.join("rigid"));
});
