//! `evaluate poses`, `evaluate cloud` and `evaluate points`.

use tiepoint_pipeline::Error;
use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::{Alignment, find_alignment};
use tiepoint_pipeline::evaluation::{evaluate_cloud, evaluate_points, evaluate_poses, read_cloud};

use crate::args::{EvaluateCloud, EvaluatePoints, EvaluatePoses};
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::{points, summary};

pub(crate) fn poses(args: &EvaluatePoses, output: &Output) -> Result<(), Failure> {
    let model = open_model(&args.model, output)?;
    let evaluation = evaluate_poses(&model, &args.truth, args.images.as_deref())?;
    output.result(&evaluation, || summary::poses(&evaluation))
}

pub(crate) fn points(args: &EvaluatePoints, output: &Output) -> Result<(), Failure> {
    let model = open_model(&args.model, output)?;
    let found = evaluate_points(&model, &args.points)?;
    output.result(&found, || points::table(&found))
}

pub(crate) fn cloud(args: &EvaluateCloud, output: &Output) -> Result<(), Failure> {
    let (cloud, reference) = (read_cloud(&args.cloud)?, read_cloud(&args.reference)?);
    let (start, alignment) = match (&args.truth, args.align) {
        (Some(truth), _) => {
            let model = open_model(&args.cloud, output)?;
            (Some(evaluate_poses(&model, truth, None)?.truth_from_model), Alignment::Rigid)
        }
        (None, Alignment::Similarity) => {
            (find_alignment(&cloud, &reference), Alignment::Similarity)
        }
        (None, alignment) => (Some(Sim3::identity()), alignment),
    };
    let evaluation = start.and_then(|start| evaluate_cloud(&cloud, &reference, &start, alignment));
    let evaluation = evaluation.ok_or_else(|| Error::DegenerateClouds {
        cloud: args.cloud.clone(),
        reference: args.reference.clone(),
    })?;
    output.result(&evaluation, || summary::cloud(&evaluation))
}
