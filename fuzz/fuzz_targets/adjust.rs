//! `adjust` of BAL problems and of models: no cost that is told is NaN.
#![no_main]

use libfuzzer_sys::fuzz_target;

use std::ops::ControlFlow;

use tiepoint_fuzz::{file, files, folder};
use tiepoint_pipeline::models::adjust;

fuzz_target!(|data: &[u8]| {
    let Some((&which, data)) = data.split_first() else { return };
    let path = if which % 2 == 0 {
        file("bal.txt", data)
    } else {
        let dir = folder();
        files(&dir, &["cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"], data);
        dir
    };
    let mut steps = 0;
    let done = adjust(&path, None, false, which & 2 != 0, &mut |_| {
        steps += 1;
        if steps < 20 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    // It may grow: an observation behind its camera costs nothing until a step makes it valid.
    if let Ok(report) = done {
        assert!(report.initial_cost.is_finite() && report.final_cost.is_finite());
    }
});
