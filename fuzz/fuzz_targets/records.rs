//! The files that a workspace keeps about itself: stages.json, report.json and the manifest.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{files, folder, write_model};
use tiepoint_pipeline::Workspace;
use tiepoint_pipeline::workspace::model_folder;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    let root = dir.join("ws");
    write_model(&root.join("sparse/0"));
    files(&root, &["stages.json", "report.json", "tiepoint-files.json"], data);
    let _ = model_folder(&root);
    if let Ok(workspace) = Workspace::open(&root) {
        let _ = workspace.report();
    }
});
