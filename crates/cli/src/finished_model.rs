//! Finished models, which most commands begin with.

use std::path::Path;

use tiepoint_pipeline::workspace::LocatedModel;

use crate::failure::Failure;
use crate::output::Output;

/// Opens a finished model. Warns if another program has changed it since.
pub(crate) fn open_model(path: &Path, output: &Output) -> Result<LocatedModel, Failure> {
    let model = LocatedModel::open(path)?;
    if let Some(note) = model.note() {
        output.warning(note);
    }
    Ok(model)
}
