//! `rig.json`, through the exports that read it: no number of Kalibr's file is NaN or infinite.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{TIMES, folder, write, write_model};
use tiepoint_pipeline::models::{ExportFormat, ExportSource, export, export_rigid};

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    write_model(&dir.join("ws/sparse/0"));
    write(&dir.join("ws/rig.json"), data);
    write(&dir.join("ws/timestamps.csv"), TIMES.as_bytes());
    let chain = dir.join("camchain.yaml");
    let workspace = dir.join("ws");
    let source = ExportSource { model: &workspace, images: None };
    if export(&source, ExportFormat::Kalibr, &chain).is_ok() {
        let text = std::fs::read_to_string(&chain).expect("it was written");
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
    let _ = export_rigid(&source, ExportFormat::Colmap, &dir.join("rigid"));
});
