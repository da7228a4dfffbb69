//! Results for people.

use std::fmt::Write;
use std::path::Path;

use tiepoint_pipeline::{
    CloudEvaluation, ErrorStatistics, ModelReport, PoseEvaluation, Report, RigCamera, RigidReport,
    SplitReport,
};

use crate::output::printable;

/// Names listed before the rest is only counted.
const MAX_NAMES: usize = 8;
/// Images that are farther apart in time are of different instants, in seconds: a millisecond is a
/// centimetre at 10 m/s.
const WORTH_SAYING_S: f64 = 0.001;

/// What a workspace holds now.
pub(crate) fn report(workspace: &Path, report: &Report) -> String {
    let mut text = String::new();
    let mut line = |arguments: std::fmt::Arguments| {
        // One line, whatever the names in it. Writing to a string does not fail.
        let _ = writeln!(text, "{}", printable(&arguments.to_string()));
    };
    if let Some(features) = &report.stages.features {
        let skipped = match features.skipped.len() {
            0 => String::new(),
            count => format!(", {count} skipped"),
        };
        let (images, keypoints, seconds) = (features.images, features.keypoints, features.seconds);
        line(format_args!(
            "features  {images} images, {keypoints} keypoints{skipped}  ({seconds:.1} s)"
        ));
    }
    if let Some(matches) = &report.stages.matches {
        let (pairs, verified, inliers) =
            (matches.pairs, matches.verified_pairs, matches.inlier_matches);
        let seconds = matches.seconds;
        line(format_args!(
            "match     {verified} of {pairs} pairs, {inliers} matches  ({seconds:.1} s)"
        ));
    }
    if let Some(map) = &report.stages.map {
        for (index, model) in report.models.iter().enumerate() {
            let label = if index == 0 { "map" } else { "" };
            let time = if index == 0 { format!("  ({:.1} s)", map.seconds) } else { String::new() };
            line(format_args!(
                "{label:<9} {}: {} of {} images, {} points, {} observations ({:.2} a point), \
                error {:.3} px{time}",
                model.path,
                model.registered,
                model.images,
                model.points,
                model.observations,
                model.mean_track_length,
                model.mean_reprojection_error_px,
            ));
            if model.loop_pairs > 0 {
                let pairs = model.loop_pairs;
                line(format_args!(
                    "          closed a loop: {pairs} pairs of images had been torn apart by drift"
                ));
            }
            for what in &model.failed {
                line(format_args!("          {what}"));
            }
        }
        let shutters = report.models.first().into_iter().flat_map(|model| &model.cameras);
        for (camera, readout_s) in
            shutters.filter_map(|camera| Some((camera.id, camera.readout_s?)))
        {
            line(format_args!(
                "shutter   camera {camera} reads a photo in {:.2} ms",
                1e3 * readout_s
            ));
        }
        for scale in report.models.first().iter().filter_map(|model| model.scale.as_ref()) {
            line(format_args!("scale     {}", scale.why));
        }
        let is_scaled =
            |model: &ModelReport| model.scale.as_ref().is_some_and(|scale| scale.factor.is_some());
        let unit = if report.models.first().is_some_and(is_scaled) { "m" } else { "units" };
        for rig in report.models.first().iter().filter_map(|model| model.rig.as_ref()) {
            for camera in &rig.cameras {
                let [left, right] = &camera.names;
                line(format_args!(
                    "rig       {}: {left} and {right} in {} of {} moments, distance {:.4} {unit}, \
                    its spread {:.2} %, rotation's {:.3}°, \
                     second half / first {:.4}",
                    rig.mode,
                    camera.reconstructed_pairs,
                    camera.pairs,
                    camera.median_baseline,
                    100.0 * camera.relative_translation_rms,
                    camera.rotation_rms_deg,
                    camera.second_over_first_half,
                ));
            }
            if let Some(mounting) = &rig.mounting {
                line(format_args!("          {}: {}", mounting.chosen, mounting.why));
                for camera in mounting.rig.iter().flat_map(|rig| &rig.cameras) {
                    line(format_args!("          {}", mounted(camera)));
                }
                if let Some(split) = &mounting.split {
                    line(format_args!("          {}", closed(split)));
                }
                for [left, right] in mounting.bad_pairs.iter().take(MAX_NAMES) {
                    line(format_args!(
                        "          not held: {left} and {right} do not agree with the mounting"
                    ));
                }
            }
            if let Some(paper) = &rig.paper {
                let [first, second] = &paper.unit_images;
                line(format_args!(
                    "          the unit of \u{3bb} is the distance of {first} and {second} (now \
                    {:.3} {unit}); \u{3bb} = {} holds p_i to {:.3} {unit} ({:.1} % of \
                     the distance) and {:.2}°; {} pairs weighed as bad",
                    paper.unit_distance,
                    paper.lambda,
                    paper.sigma_translation,
                    100.0 * paper.relative_sigma_translation,
                    paper.sigma_rotation_deg,
                    paper.bad_pairs.len(),
                ));
            }
        }
        if let Some(model) = report.models.first().filter(|model| !model.unregistered.is_empty()) {
            line(format_args!(
                "          without a pose in {}: {}",
                model.path,
                names(&model.unregistered)
            ));
        }
    }
    line(format_args!("in {}", workspace.display()));
    text
}

/// What became of a split, in a line.
fn closed(split: &SplitReport) -> String {
    let SplitReport { images, pairs_matched_again } = split;
    let held = match pairs_matched_again {
        0 => "nothing but the mounting holds them there".to_owned(),
        pairs => format!("{pairs} pairs with them match now"),
    };
    format!(
        "split: {images} images stood elsewhere, without matches with their partners, and were \
        brought back; {held}"
    )
}

/// The calibration of a camera and its clock, in a line.
fn mounted(camera: &RigCamera) -> String {
    let RigCamera { name, centre_in_rig: [x, y, z], rotation_wxyz, clock, .. } = camera;
    let angle_deg = 2.0 * rotation_wxyz[0].abs().min(1.0).acos().to_degrees();
    let spread = match (camera.translation_sd, camera.rotation_sd_deg) {
        (Some(t), Some(r)) => {
            format!("\u{b1} {t:.4}, turned by {angle_deg:.3}\u{b0} \u{b1} {r:.4}\u{b0}")
        }
        _ => format!("turned by {angle_deg:.3}\u{b0}, not determined by the images"),
    };
    let offset_ms = 1e3 * clock.offset_s;
    let time = match (clock.timing.as_str(), clock.offset_sd_s) {
        ("free", Some(sd_s)) => format!(
            "clock {offset_ms:+.2} \u{b1} {:.2} ms, {:+.0} \u{b1} {:.0} ppm",
            1e3 * sd_s,
            clock.drift_ppm,
            clock.drift_sd_ppm.unwrap_or(f64::INFINITY),
        ),
        ("free", None) => format!("clock {offset_ms:+.2} ms"),
        ("not observable", _) => format!("clock not observable, held at {offset_ms:+.2} ms"),
        _ => format!("images at the same instants, clock {offset_ms:+.2} ms"),
    };
    let frames = if camera.hold == "hard" { "" } else { ", not rigid frames" };
    let guessed = camera.unobservable.map_or(String::new(), |[x, y, z]| {
        format!(
            "; it sees nothing that the first camera sees, and the motion does not tell its \
        place along ({x:.2}, {y:.2}, {z:.2})"
        )
    });
    format!("{name} at ({x:.4}, {y:.4}, {z:.4}) {spread}; {time}{frames}{guessed}")
}

fn names(all: &[String]) -> String {
    let shown = all[..all.len().min(MAX_NAMES)].join(", ");
    match all.len() - all.len().min(MAX_NAMES) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// A model against the truth.
pub(crate) fn poses(evaluation: &PoseEvaluation) -> String {
    let PoseEvaluation { images, registered, scale, centre_error, rotation_error_deg, .. } =
        evaluation;
    let mut text = format!(
        "{registered} of {images} images, scale {scale:.6}\n\
         centre error    mean {:.6}  median {:.6}  rmse (ATE) {:.6}  max {:.6}\n\
         rotation error  mean {:.4}°  median {:.4}°  max {:.4}°\n\
         relative poses ",
        centre_error.mean,
        centre_error.median,
        centre_error.rmse,
        centre_error.max,
        rotation_error_deg.mean,
        rotation_error_deg.median,
        rotation_error_deg.max,
    );
    for auc in &evaluation.relative_pose_auc {
        let _ = write!(text, " AUC@{}° {:.2} %", auc.threshold_deg, 100.0 * auc.auc);
    }
    text.push('\n');
    for focal in &evaluation.focal_lengths {
        let _ = write!(text, "camera {}  focal length {:.2} px", focal.camera, focal.model_px);
        if let Some(truth_px) = focal.truth_px {
            let percent = 100.0 * (focal.model_px / truth_px - 1.0);
            let _ = write!(text, ", true {truth_px:.2} px ({percent:+.3} %)");
        }
        text.push('\n');
    }
    text
}

/// A cloud against a reference.
pub(crate) fn cloud(evaluation: &CloudEvaluation) -> String {
    let CloudEvaluation { points, reference_points, scale, iterations, .. } = evaluation;
    let line = |distance: &ErrorStatistics| {
        let ErrorStatistics { mean, std, median, max, .. } = distance;
        format!("mean {mean:.6}  std {std:.6}  median {median:.6}  max {max:.6}")
    };
    format!(
        "{points} points against {reference_points}, scale {scale:.6}, aligned in {iterations} \
        rounds\n\
         distance to the reference  {}\n\
         distance of the reference  {}\n",
        line(&evaluation.distance),
        line(&evaluation.reference_distance),
    )
}

/// What it took to make a model rigid.
pub(crate) fn rigid(report: &RigidReport) -> String {
    let RigidReport { cameras, frames, images, free_images, .. } = report;
    let mut text = format!(
        "rigid     {} in {frames} frames of {images} images, {free_images} images free; mean \
        reprojection error {:.3} px, before {:.3} px; \
         {} of {} observations fit\n",
        printable(&cameras.join(" and ")),
        report.error_after_px,
        report.error_before_px,
        report.observations_after,
        report.observations_before,
    );
    if let Some(apart_s) = report.max_time_difference_s.filter(|apart_s| *apart_s > WORTH_SAYING_S)
    {
        let _ = writeln!(
            text,
            "          images of one frame are up to {:.1} ms apart, in which the rig moves: no \
            rigid model can be right",
            1e3 * apart_s
        );
    }
    text
}
