//! `export`.

use tiepoint_pipeline::export as export_model;

use super::Failure;
use crate::args::Export;
use crate::output::Output;

pub(crate) fn export(args: &Export, output: &Output) -> Result<(), Failure> {
    let exported = export_model(&args.workspace, args.to, &args.output)?;
    output.result(&exported, || format!("{}\n", exported.path.display()));
    Ok(())
}
