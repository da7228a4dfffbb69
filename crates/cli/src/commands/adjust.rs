//! `adjust`.

use std::fmt::Write;

use tiepoint_pipeline::models::adjust as adjust_model;

use crate::args::Adjust;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(crate) fn adjust(args: &Adjust, output: &Output) -> Result<(), Failure> {
    let mut progress = Progress::new(output);
    let (to, overwrite) = (args.output.as_deref(), args.overwrite);
    let report = adjust_model(&args.model, to, overwrite, args.fix_intrinsics, &mut |event| {
        progress.watch(event)
    })?;
    drop(progress);
    output.result(&report, || {
        let end = if report.converged { "converged" } else { "iteration limit reached" };
        let mut text = "   seconds           cost\n".to_owned();
        for step in &report.steps {
            let rejected = if step.accepted { "" } else { "  rejected" };
            // Writing to a string does not fail.
            let _ = writeln!(text, "{:10.4} {:14.8e}{rejected}", step.seconds, step.cost);
        }
        let _ = writeln!(
            text,
            "{} images, {} points, {} residuals\ncost {:.6e} -> {:.6e} in {} iterations, \
            {:.2} s, {end}",
            report.images,
            report.points,
            report.residuals,
            report.initial_cost,
            report.final_cost,
            report.iterations,
            report.seconds,
        );
        text
    })
}
