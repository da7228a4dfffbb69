//! What a report says, in a few sentences.

use crate::workspace::report::{FeaturesReport, ModelReport, Report};
use crate::workspace::rig_file::ConstraintKind;
use crate::workspace::rig_report::RigReport;

/// How good the largest model of a report is, a sentence each: how many images have a pose and with
/// which error, what the rig contributes, and what speaks against the model. Empty without a model.
pub fn verdict(report: &Report) -> Vec<String> {
    let Some(model) = report.models.first() else { return Vec::new() };
    let ModelReport { registered, images, path, mean_reprojection_error_px, .. } = model;
    let poses = match registered == images {
        true => format!("complete: all {images} images have a pose"),
        false => format!("incomplete: {registered} of {images} images have a pose in {path}"),
    };
    let mut sentences =
        vec![format!("{poses}, mean reprojection error {mean_reprojection_error_px:.2} px")];
    let features = report.stages.features.as_ref();
    sentences.extend(features.and_then(of_skipped));
    let drifts = report.warnings.iter().any(|warning| warning.is_of_rig(path));
    sentences.extend(model.rig.as_ref().map(|rig| of_rig(rig, drifts)));
    sentences.push(match report.warnings.len() {
        0 => "no warnings".to_owned(),
        1 => "1 warning: look at it before you use the result".to_owned(),
        count => format!("{count} warnings: look at them before you use the result"),
    });
    sentences
}

/// How many files of the input no image was made of.
fn of_skipped(features: &FeaturesReport) -> Option<String> {
    let first = &features.skipped.first()?.image;
    Some(match features.num_skipped() {
        1 => format!("1 file of the input was left out: {first}"),
        count => format!("{count} files of the input were left out, first {first}"),
    })
}

/// Whether the rig constrains the model, and what that contributes. `drifts`: whether its baseline
/// is not constant for all that.
fn of_rig(rig: &RigReport, drifts: bool) -> String {
    let Some(extrinsics) = &rig.extrinsics else {
        return match rig.mode.as_str() {
            "paper" => {
                "the relative poses of consecutive frames are constrained (paper)".to_owned()
            }
            "known" => "the rig is known".to_owned(),
            _ => "the cameras are not constrained to each other".to_owned(),
        };
    };
    let Some(chosen) = extrinsics.chosen else {
        return format!("no rig constraint: {}", extrinsics.reason);
    };
    let frames: usize = rig.cameras.iter().map(|camera| camera.reconstructed_pairs).sum();
    let all: usize = rig.cameras.iter().map(|camera| camera.pairs).sum();
    let kind = match chosen {
        ConstraintKind::Soft => "soft",
        ConstraintKind::Rigid => "rigid",
    };
    let (off_px, px) = (extrinsics.held_out_error_off_px, extrinsics.held_out_error_px);
    let change = extrinsics.held_out_change();
    let change = change.map_or(String::new(), |change| format!(" ({change})"));
    let free = match &extrinsics.unconstrained[..] {
        [] => String::new(),
        free => format!("; {} permits no constraint", free.join(", ")),
    };
    let scale = match drifts {
        true => "but their relative poses are not constant",
        false => "so that the scale cannot drift between them",
    };
    format!(
        "the rig ({kind}) ties {frames} of {all} pairs of images, {scale}; held-out tracks \
        {px:.3} px, without it {off_px:.3} px{change}{free}"
    )
}

#[cfg(test)]
mod tests {
    use tiepoint_input::SkippedImage;

    use super::*;
    use crate::workspace::report::StageReports;
    use crate::workspace::rig_report::{ExtrinsicsReport, RigCameraReport};
    use crate::workspace::warning::Warning;

    #[test]
    fn sentences_have_the_numbers_of_the_report() {
        assert_eq!(verdict(&Report::default()), [""; 0]);
        let model = ModelReport {
            path: "sparse/0".to_owned(),
            registered: 7,
            images: 9,
            mean_reprojection_error_px: 0.516,
            ..ModelReport::default()
        };
        let camera =
            RigCameraReport { pairs: 5, reconstructed_pairs: 4, ..RigCameraReport::default() };
        let extrinsics = ExtrinsicsReport {
            chosen: Some(ConstraintKind::Rigid),
            held_out_error_off_px: 0.6,
            held_out_error_px: 0.5,
            reason: "why".to_owned(),
            ..ExtrinsicsReport::default()
        };
        let rig = RigReport { cameras: vec![camera], ..RigReport::default() };
        let of = |mode: &str, extrinsics: Option<ExtrinsicsReport>| {
            let rig = RigReport { mode: mode.to_owned(), extrinsics, ..rig.clone() };
            let models = vec![ModelReport { rig: Some(rig), ..model.clone() }];
            verdict(&Report { models, ..Report::default() })[1].clone()
        };
        let used = of("auto", Some(extrinsics.clone()));
        assert!(used.starts_with("the rig (rigid) ties 4 of 5 pairs"), "{used}");
        assert!(used.ends_with("held-out tracks 0.500 px, without it 0.600 px"), "{used}");
        let with_sd = ExtrinsicsReport {
            held_out_change_sd: Some(0.02),
            unconstrained: vec!["rear".to_owned()],
            ..extrinsics.clone()
        };
        let used = of("auto", Some(with_sd));
        let end = "0.600 px (-16.7 ± 2.0 %); rear permits no constraint";
        assert!(used.ends_with(end), "{used}");
        let same = ExtrinsicsReport {
            held_out_error_px: 0.5999,
            held_out_change_sd: Some(0.0001),
            ..extrinsics.clone()
        };
        let used = of("auto", Some(same));
        assert!(used.ends_with("(+0.0 ± 0.0 %)"), "{used}");
        let rigged = |warned: &str| {
            let rig = RigReport { extrinsics: Some(extrinsics.clone()), ..rig.clone() };
            let models = vec![ModelReport { rig: Some(rig), ..model.clone() }];
            let cameras = ["left", "right"].map(str::to_owned);
            let warning = Warning::RigDrift { model: warned.to_owned(), cameras, change: 0.9 };
            verdict(&Report { models, warnings: vec![warning], ..Report::default() })[1].clone()
        };
        assert!(rigged("sparse/1").contains("cannot drift"), "{}", rigged("sparse/1"));
        assert!(rigged("sparse/0").contains("are not constant"), "{}", rigged("sparse/0"));
        let unused = of("auto", Some(ExtrinsicsReport { chosen: None, ..extrinsics }));
        assert_eq!(unused, "no rig constraint: why");
        assert!(
            of("paper", None).contains("(paper)") && of("off", None).contains("not constrained")
        );
        assert!(of("known", None).contains("is known"));

        let mut report = Report { models: vec![model.clone()], ..Report::default() };
        let expected =
            "incomplete: 7 of 9 images have a pose in sparse/0, mean reprojection error 0.52 px";
        assert_eq!(verdict(&report), [expected, "no warnings"]);
        // One entry may stand for several files.
        let skipped = |others: usize| {
            let skipped =
                SkippedImage { image: "b.heic".to_owned(), reason: String::new(), others };
            let features = FeaturesReport { skipped: vec![skipped], ..FeaturesReport::default() };
            let stages = StageReports { features: Some(features), ..StageReports::default() };
            verdict(&Report { stages, ..report.clone() })[1].clone()
        };
        assert_eq!(skipped(0), "1 file of the input was left out: b.heic");
        assert_eq!(skipped(2), "3 files of the input were left out, first b.heic");
        report.models[0].registered = 9;
        report.warnings = vec![Warning::Jumps { model: String::new(), images: Vec::new() }; 2];
        let [poses, warnings] = verdict(&report).try_into().unwrap();
        assert!(poses.starts_with("complete: all 9 images have a pose, mean"), "{poses}");
        assert!(warnings.starts_with("2 warnings"), "{warnings}");
    }
}
