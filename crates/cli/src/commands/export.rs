//! `export`.

use std::path::Path;

use tiepoint_pipeline::models::{
    ExportSource, Exported, export as export_model, export_detected, export_rigid,
};
use tiepoint_pipeline::store::disk::FileId;

use crate::args::Export;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::summary;

pub(crate) fn export(args: &Export, output: &Output) -> Result<(), Failure> {
    let write = match (args.rigid, args.detected_keypoints) {
        (true, _) => export_rigid,
        (false, true) => export_detected,
        (false, false) => export_model,
    };
    let model = open_model(&args.workspace, output)?;
    let source = ExportSource {
        model: &model,
        images: args.images.as_deref(),
        crs: args.crs,
        overwrite: args.overwrite,
    };
    let exported = write(&source, args.to, &args.output)?;
    output.result(&exported, || describe(&exported))
}

fn describe(exported: &Exported) -> String {
    let stdout = FileId::of(Path::new("/dev/stdout"));
    if stdout.is_some() && FileId::of(&exported.path) == stdout {
        // Its reader wants the file alone.
        return String::new();
    }
    let rigid = exported.rigid.as_ref().map_or_else(String::new, summary::rigid);
    let in_place = match exported.photos_in_place {
        0 => String::new(),
        count => format!("{count} photos are in their places already and were not copied\n"),
    };
    let crs = exported.crs.as_ref().map_or_else(String::new, |crs| format!(": {crs}"));
    format!("{rigid}{in_place}{}{crs}\n", exported.path.display())
}
