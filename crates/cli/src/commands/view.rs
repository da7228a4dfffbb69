//! `view`.

use serde::Serialize;
use tiepoint_report::view as write_report;

use crate::args::View;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;

pub(crate) fn view(args: &View, output: &Output) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Written {
        report: std::path::PathBuf,
    }
    let model = open_model(&args.workspace, output)?;
    let shown = |text: &str| output.for_reader(text).into_owned();
    // A browser has another working folder.
    let here = std::env::current_dir()?;
    let written = Written { report: write_report(&model, &here, &shown)? };
    output.result(&written, || format!("open in a browser: {}\n", written.report.display()))
}
