//! Errors of surveyed points in a model.

use std::path::Path;

use crate::Error;
use crate::stages::control_points::ControlPoints;
use crate::workspace::control_report::ControlReport;
use crate::workspace::located_model::LocatedModel;

/// The errors of the points of a file ([`tiepoint_io::control_points`]) in a model that is in their
/// frame. The model is not changed.
///
/// # Errors
///
/// The file cannot be read, the model is in no frame or in another one, or it has no image of a
/// mark.
pub fn evaluate_points(model: &LocatedModel, file: &Path) -> Result<ControlReport, Error> {
    let points = ControlPoints::read(file)?;
    points.evaluate(&model.reconstruction, &model.shutters).map_err(|reason| Error::NoComparison {
        model: model.folder().to_owned(),
        reference: file.to_owned(),
        reason,
    })
}
