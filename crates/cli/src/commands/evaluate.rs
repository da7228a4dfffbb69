//! `evaluate poses`.

use tiepoint_pipeline::evaluate_poses;

use super::Failure;
use crate::args::EvaluatePoses;
use crate::output::Output;
use crate::summary;

pub(crate) fn poses(args: &EvaluatePoses, output: &Output) -> Result<(), Failure> {
    let evaluation = evaluate_poses(&args.model, &args.truth, args.images.as_deref())?;
    output.result(&evaluation, || summary::poses(&evaluation));
    Ok(())
}
