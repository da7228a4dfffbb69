//! `localize`.

use std::fmt::Write;

use tiepoint_pipeline::models::{LocalizeOptions, LocalizeReport, localize as localize_photos};

use crate::args::Localize;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::{Output, printable};
use crate::progress::Progress;

pub(crate) fn localize(args: &Localize, output: &Output) -> Result<(), Failure> {
    let options = LocalizeOptions {
        calibration: args.initial().map_err(Failure::Usage)?,
        calibration_files: args.calibration.clone(),
        masks: args.masks.clone(),
        max_size: args.max_size,
        seed: args.seed.seed,
        ..LocalizeOptions::default()
    };
    let model = open_model(&args.model, output)?;
    let mut progress = Progress::new(output);
    let report = localize_photos(&model, &args.inputs, &args.output, &options, &mut |event| {
        progress.watch(event)
    })?;
    drop(progress);
    output.result(&report, || describe(&report))?;
    if report.localized > 0 {
        return Ok(());
    }
    Err(Failure::CouldNot(format!(
        "none of the {} photos has a pose in {}: give photos of the same place, taken with similar \
        light, whose size and masks fit",
        report.photos.len(),
        args.model.display()
    )))
}

fn describe(report: &LocalizeReport) -> String {
    let mut text = String::new();
    for photo in &report.photos {
        let result = match (&photo.pose, &photo.reason) {
            (Some(pose), _) => {
                let numbers = pose.rotation_wxyz.iter().chain(&pose.translation);
                let numbers: Vec<String> = numbers.map(f64::to_string).collect();
                format!("{} {}", photo.inliers, numbers.join(" "))
            }
            (None, reason) => format!("no pose: {}", reason.as_deref().unwrap_or("")),
        };
        // File names may contain line breaks. Writing to a string does not fail.
        let _ = writeln!(text, "{}", printable(&format!("{} {result}", photo.image)));
    }
    let (count, total, seconds) = (report.localized, report.photos.len(), report.seconds);
    let _ = writeln!(
        text,
        "{count} of {total} photos have a pose in {}  ({seconds:.1} s)",
        report.path.display()
    );
    text
}
