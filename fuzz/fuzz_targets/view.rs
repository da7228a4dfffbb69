//! `view`: the page of a workspace whose model and files are a stranger's.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{files, folder};
use tiepoint_pipeline::workspace::LocatedModel;
use tiepoint_report::view;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    let model = dir.join("ws/sparse/0");
    std::fs::create_dir_all(&model).expect("memory is writable");
    let names = [
        "cameras.txt",
        "images.txt",
        "points3D.txt",
        "rigs.txt",
        "frames.txt",
        "../../timestamps.csv",
        "../../rig.json",
        "../../report.json",
    ];
    files(&model, &names, data);
    let ws = dir.join("ws");
    let Ok(model) = LocatedModel::open(&ws) else { return };
    if let Ok(page) = view(&model, &ws, &str::to_owned) {
        let text = std::fs::read_to_string(page).expect("it was written");
        // The data stand in a script: a name must not end it.
        assert_eq!(text.matches("</script").count(), tiepoint_fuzz::SCRIPTS);
    }
});
