//! `adjust`.

use std::fmt::Write;

use tiepoint_pipeline::models::adjust as adjust_model;

use crate::args::Adjust;
use crate::failure::Failure;
use crate::output::Output;
use crate::points;
use crate::progress::Progress;

pub(crate) fn adjust(args: &Adjust, output: &Output) -> Result<(), Failure> {
    let mut progress = Progress::new(output);
    let (to, overwrite) = (args.output.as_deref(), args.overwrite);
    let (fixed, points) = (args.fix_intrinsics, args.control_points.as_deref());
    let report = adjust_model(&args.model, to, overwrite, fixed, points, &mut |event| {
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
        if let Some(frame) = &report.frame {
            let _ = writeln!(text, "frame: {frame}");
        }
        if let Some(found) = &report.control_points {
            text += &points::table(found);
        }
        text
    })
}
