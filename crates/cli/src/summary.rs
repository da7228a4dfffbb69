//! Results as text for the terminal.

use std::ffi::OsStr;
use std::fmt::Write;
use std::path::Path;

use tiepoint_pipeline::Report;
use tiepoint_pipeline::evaluation::{
    CloudEvaluation, ErrorStatistics, PoseEvaluation, RegisteredCloud,
};
use tiepoint_pipeline::models::RigidReport;
use tiepoint_pipeline::sfm::geometry::CameraModelKind;
use tiepoint_pipeline::workspace::{
    ConstraintKind, DenseReport, ModelReport, PaperReport, RigCamera, RigClockState, ShardReport,
    SplitReport, verdict, why_unregistered,
};

use crate::output::printable;

/// More names are counted, not listed.
const MAX_NAMES: usize = 8;
/// Larger time differences between images of one rig frame are reported, in seconds: a millisecond
/// is a centimetre at 10 m/s.
const MIN_REPORTED_DIFFERENCE_S: f64 = 0.001;

/// Options of a command that those after it need as well, because no file has them.
#[derive(Clone, Copy, Default)]
pub(crate) struct PhotoOptions<'a> {
    pub(crate) masks: Option<&'a Path>,
    pub(crate) max_size: Option<u32>,
}

impl PhotoOptions<'_> {
    /// As words of a command line, with a space before each.
    fn words(self) -> String {
        let masks = self.masks.map(|masks| format!(" --masks {}", shell_word(masks)));
        let max_size = self.max_size.map(|size| format!(" --max-size {size}"));
        masks.into_iter().chain(max_size).collect()
    }
}

/// The stages and models of a workspace, what to be warned of, and what to do next with the photos.
pub(crate) fn report(workspace: &Path, report: &Report, photos: PhotoOptions) -> String {
    let mut text = stages(report);
    for (index, warning) in report.warnings.iter().enumerate() {
        let label = if index == 0 { "warnings" } else { "" };
        let _ = writeln!(text, "{label:<9} {}", printable(&warning.to_string()));
    }
    for (index, sentence) in verdict(report).iter().enumerate() {
        let label = if index == 0 { "result" } else { "" };
        let _ = writeln!(text, "{label:<9} {}", printable(sentence));
    }
    for (index, (command, why)) in next_commands(workspace, report, photos).iter().enumerate() {
        let label = if index == 0 { "next" } else { "" };
        let _ = writeln!(text, "{label:<9} {}  {why}", printable(command));
    }
    let _ = writeln!(text, "in {}", printable(&workspace.display().to_string()));
    text
}

/// What a shard did.
pub(crate) fn shard(report: &ShardReport) -> String {
    let ShardReport { stage, shard, tile, is_kept } = report;
    match tile {
        None => format!("the stage {stage} is complete: nothing is left for shard {shard}\n"),
        Some(tile) => {
            let was = if *is_kept { " was there" } else { "" };
            format!("shard {shard} of {stage} in {}{was}\n", printable(tile))
        }
    }
}

/// What may be done next with a workspace: commands, and what each is for.
fn next_commands(
    root: &Path,
    report: &Report,
    photos: PhotoOptions,
) -> Vec<(String, &'static str)> {
    let (workspace, photos) = (shell_word(root), photos.words());
    let stages = &report.stages;
    let Some(model) = report.models.first() else {
        let next = if stages.matches.is_some() { "map" } else { "match" };
        return vec![(format!("tiepoint {next} {workspace}"), "the next stage")];
    };
    // Each workspace has a folder of its own: a second one would replace the first.
    let of_root = |name: &OsStr| format!("splats_{}", name.to_string_lossy());
    let splats = root.file_name().map_or_else(|| "splats".to_owned(), of_root);
    let splats = shell_word(Path::new(&splats));
    let to_look = match has_older_page(root) {
        false => "writes report.html, to look at it in a browser",
        true => "writes report.html again, which is older than the result",
    };
    let mut commands = vec![
        (format!("tiepoint view {workspace}"), to_look),
        (
            format!("tiepoint undistort {workspace} -o {splats}{photos}"),
            "images and model as trainers of Gaussian splats read them",
        ),
    ];
    if stages.dense.is_none() {
        let what = "depth maps and a dense cloud";
        commands.push((format!("tiepoint dense {workspace}{photos}"), what));
    }
    let is_unknown = model.rig.as_ref().is_some_and(|rig| rig.mode != "known");
    if is_unknown && model.scale.is_none() && model.positions.is_none() {
        let what =
            "in metres, if X is the distance of the first two cameras; the scale is arbitrary";
        commands.push((format!("tiepoint map {workspace} --redo map --baseline Xm"), what));
    }
    commands
}

/// Whether the page of a workspace is older than what it shows.
fn has_older_page(root: &Path) -> bool {
    let written = |path: &str| root.join(path).metadata().and_then(|found| found.modified()).ok();
    let is_newer = |page| {
        let results = ["sparse/0/points3D.bin", "dense/fused.ply"];
        results.into_iter().filter_map(written).any(|result| result > page)
    };
    written("report.html").is_some_and(is_newer)
}

/// A path as a word of a shell's command line.
fn shell_word(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+:@%\\".contains(c);
    match text.chars().all(is_plain) {
        true => text,
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

/// The paper's constraint in units of the model.
fn paper_constraint(paper: &PaperReport, unit: &str) -> String {
    let [first, second] = &paper.unit_images;
    let relative = paper
        .relative_sigma_translation
        .map(|relative| format!(" ({:.1} % of the baseline)", 100.0 * relative))
        .unwrap_or_default();
    format!(
        "one unit of \u{3bb} is the distance of {first} and {second} (now {:.3} {unit}); \u{3bb} = \
        {} means a sigma of p_i of {:.3} {unit}{relative} and {:.2}°; {} pairs weighted as \
        incorrect",
        paper.unit_distance,
        paper.lambda,
        paper.sigma_translation,
        paper.sigma_rotation_deg,
        paper.bad_pairs.len(),
    )
}

/// The stages and models.
fn stages(report: &Report) -> String {
    let mut text = String::new();
    let mut line = |arguments: std::fmt::Arguments| {
        // File names may contain line breaks. Writing to a string does not fail.
        let _ = writeln!(text, "{}", printable(&arguments.to_string()));
    };
    if let Some(features) = &report.stages.features {
        let skipped = match features.num_skipped() {
            0 => String::new(),
            count => format!(", {count} skipped"),
        };
        let cameras = match features.cameras.len() {
            0 | 1 => String::new(),
            count => format!(" of {count} cameras"),
        };
        let (images, keypoints, seconds) = (features.images, features.keypoints, features.seconds);
        line(format_args!(
            "features  {images} images{cameras}, {keypoints} keypoints{skipped}  ({seconds:.1} s)"
        ));
        for note in &features.notes {
            line(format_args!("          {note}"));
        }
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
                "{label:<9} {}: {} of {} images, {} points, {} observations ({:.2} per point), \
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
                    "          closed loops: {pairs} image pairs were separated by drift before"
                ));
            }
            if !model.other_place.is_empty() {
                let images = model.other_place.len();
                line(format_args!(
                    "          {images} images that match it are of another place that looks alike"
                ));
            }
            for failure in &model.failed {
                line(format_args!("          {failure}"));
            }
        }
        for note in &map.notes {
            line(format_args!("          {note}"));
        }
        for text in cameras(report) {
            line(format_args!("{text}"));
        }
        for scale in report.models.first().iter().filter_map(|model| model.scale.as_ref()) {
            line(format_args!("scale     {}", scale.reason));
        }
        let is_scaled = |model: &ModelReport| {
            model.positions.is_some()
                || model.scale.as_ref().is_some_and(|scale| scale.factor.is_some())
        };
        let unit = if report.models.first().is_some_and(is_scaled) { "m" } else { "units" };
        for rig in report.models.first().iter().filter_map(|model| model.rig.as_ref()) {
            for camera in &rig.cameras {
                let [left, right] = &camera.names;
                line(format_args!(
                    "rig       {}: {left} and {right}: {} of {} frames, baseline {:.4} {unit}, \
                    translation RMS {:.2} % of it, rotation RMS {:.3}°, baseline of second half / \
                    first half {:.4}",
                    rig.mode,
                    camera.reconstructed_pairs,
                    camera.pairs,
                    camera.median_baseline,
                    100.0 * camera.relative_translation_rms,
                    camera.rotation_rms_deg,
                    camera.second_over_first_half,
                ));
            }
            if let Some(extrinsics) = &rig.extrinsics {
                let chosen = match extrinsics.chosen {
                    None => "off",
                    Some(ConstraintKind::Soft) => "soft",
                    Some(ConstraintKind::Rigid) => "rigid",
                };
                line(format_args!("          {chosen}: {}", extrinsics.reason));
                for camera in extrinsics.rig.iter().flat_map(|rig| &rig.cameras) {
                    line(format_args!("          {}", camera_extrinsics(camera)));
                }
                if let Some(split) = &extrinsics.split {
                    line(format_args!("          {}", repaired_split(split)));
                }
                for [left, right] in extrinsics.bad_pairs.iter().take(MAX_NAMES) {
                    line(format_args!(
                        "          not constrained: {left} and {right} contradict the extrinsics"
                    ));
                }
            }
            if let Some(paper) = &rig.paper {
                line(format_args!("          {}", paper_constraint(paper, unit)));
            }
        }
        let model = report.models.first().filter(|_| !map.unregistered.is_empty());
        if let Some(ModelReport { path, images, .. }) = model {
            let count = map.unregistered.len();
            let have = if count == 1 { "has" } else { "have" };
            line(format_args!("missing   {count} of {images} images {have} no pose in {path}:"));
            for reason in why_unregistered(&map.unregistered) {
                line(format_args!("          {reason}"));
            }
        }
    }
    if let Some(dense) = &report.stages.dense {
        let DenseReport { seconds, depth_maps, megapixels, points, without_depth_map, .. } = dense;
        let rows = match dense.depth_maps_with_row_poses {
            0 => String::new(),
            count => format!(", {count} with the poses of their rows"),
        };
        let without = match without_depth_map.is_empty() {
            true => String::new(),
            false => format!(", none for {}", names(without_depth_map)),
        };
        line(format_args!(
            "dense     dense/fused.ply: {points} points from {depth_maps} depth maps of together \
            {megapixels:.1} megapixels{rows}{without}  ({seconds:.1} s)"
        ));
    }
    text
}

/// What mapping found out about the cameras of the first model, a line each.
fn cameras(report: &Report) -> Vec<String> {
    let lenses = other_camera_models(report).into_iter().chain(calibrations(report));
    let mut lines: Vec<String> = lenses.map(|lens| format!("lens      {lens}")).collect();
    let cameras = report.models.first().into_iter().flat_map(|model| &model.cameras);
    for (id, readout_s) in cameras.filter_map(|camera| Some((camera.id, camera.readout_s?))) {
        lines.push(format!("shutter   camera {id}: readout time {:.2} ms", 1e3 * readout_s));
    }
    lines
}

/// Smaller numbers are 0.0 with one decimal.
const LEAST_SHOWN: f64 = 0.05;

/// The cameras of the first model that have another camera model than photos begin with, a line
/// each: the images asked for it, or an input model has it.
fn other_camera_models(report: &Report) -> Vec<String> {
    let initial = report.stages.features.as_ref().map_or(&[][..], |features| &features.cameras);
    let cameras = report.models.first().into_iter().flat_map(|model| &model.cameras);
    let other = cameras.filter_map(|camera| {
        let before = initial.iter().find(|other| other.id == camera.id)?;
        let (id, now, before) = (camera.id, &camera.model, &before.model);
        (now != before).then(|| format!("camera {id}: {now} in place of {before}"))
    });
    other.take(MAX_NAMES).collect()
}

/// How far the calibrations of the first model's cameras were refined, a line each.
fn calibrations(report: &Report) -> Vec<String> {
    let cameras = report.models.first().into_iter().flat_map(|model| &model.cameras);
    let calibrated = cameras.filter_map(|camera| Some((camera, camera.calibration.as_ref()?)));
    let lines = calibrated.filter_map(|(camera, calibration)| {
        let id = camera.id;
        if calibration.is_exact {
            return Some(format!(
                "camera {id}: {} its calibration, kept",
                match calibration.log_bayes_factor {
                    Some(_) => "the images do not contradict",
                    None => "the images are too few to test",
                }
            ));
        }
        let names = CameraModelKind::from_name(&camera.model).ok()?.param_names();
        let moved: Vec<String> = names
            .iter()
            .zip(&calibration.deviations)
            .filter(|(_, deviation)| deviation.abs() >= LEAST_SHOWN)
            .map(|(name, deviation)| format!("{name} {deviation:+.1}"))
            .collect();
        let moved = match moved.is_empty() {
            true => "0".to_owned(),
            false => moved.join(", "),
        };
        Some(format!("camera {id}: {moved} standard deviations from its calibration"))
    });
    lines.take(MAX_NAMES).collect()
}

/// A repaired split of the model, as a line.
fn repaired_split(split: &SplitReport) -> String {
    let SplitReport { images, pairs_matched_again } = split;
    let support = match pairs_matched_again {
        0 => "only the extrinsics determine their poses".to_owned(),
        pairs => format!("{pairs} pairs with them match now"),
    };
    format!(
        "split: {images} images without matches to the other cameras had wrong poses, and were \
        moved to where the extrinsics place them; {support}"
    )
}

/// Extrinsics and time offset of a camera, as a line.
fn camera_extrinsics(camera: &RigCamera) -> String {
    let RigCamera { name, centre_in_rig: [x, y, z], rotation_wxyz, clock, .. } = camera;
    let angle_deg = 2.0 * rotation_wxyz[0].abs().min(1.0).acos().to_degrees();
    let uncertainty = match (camera.translation_sd, camera.rotation_sd_deg) {
        (Some(t), Some(r)) => {
            format!("\u{b1} {t:.4}, rotated by {angle_deg:.3}\u{b0} \u{b1} {r:.4}\u{b0}")
        }
        _ => format!("rotated by {angle_deg:.3}\u{b0}, undetermined by the images"),
    };
    let (offset, its) = (clock.offset_text(), clock.added_to());
    let time = match (clock.state, clock.offset_sd_s) {
        (RigClockState::Estimated, Some(_)) => format!(
            "time offset {offset} (to add to its {its}), skew {:+.0} \u{b1} {:.0} ppm",
            clock.drift_ppm,
            clock.drift_sd_ppm.unwrap_or(f64::INFINITY),
        ),
        (RigClockState::Estimated, None) => format!("time offset {offset} (to add to its {its})"),
        (RigClockState::Unobservable, _) => {
            format!("time offset unobservable, fixed at {offset} (added to its {its})")
        }
        (RigClockState::Synchronised, _) if clock.offset_s == 0.0 => {
            "images of one frame count as simultaneous".to_owned()
        }
        (RigClockState::Synchronised, _) => {
            format!("synchronised after a time offset of {offset} (added to its {its})")
        }
    };
    let unobservable = camera.unobservable.map_or(String::new(), |[x, y, z]| {
        format!(
            "; without common points with the first camera, its position along ({x:.2}, {y:.2}, \
            {z:.2}) is unobservable from the motion"
        )
    });
    format!("{name} at ({x:.4}, {y:.4}, {z:.4}) {uncertainty}; {time}{unobservable}")
}

/// The first [`MAX_NAMES`] names, and the number of the others.
fn names(all: &[String]) -> String {
    let shown = all[..all.len().min(MAX_NAMES)].join(", ");
    match all.len() - all.len().min(MAX_NAMES) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// Pose errors of a model.
pub(crate) fn poses(evaluation: &PoseEvaluation) -> String {
    let PoseEvaluation { images, registered, scale, centre_error, rotation_error_deg, .. } =
        evaluation;
    let mut text = format!(
        "{registered} of {images} images, scale {scale:.6}, lengths in units of the truth\n\
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
    if registered < images {
        text += "  (pairs without both poses count as wrong)";
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

/// Distances between a cloud and a reference.
pub(crate) fn cloud(evaluation: &CloudEvaluation) -> String {
    let RegisteredCloud { points, reference_points, scale, iterations, .. } = &evaluation.cloud;
    let line = |distance: &ErrorStatistics| {
        let ErrorStatistics { mean, std, median, max, .. } = distance;
        format!("mean {mean:.6}  std {std:.6}  median {median:.6}  max {max:.6}")
    };
    format!(
        "{points} points, {reference_points} reference points, scale {scale:.6}, {iterations} ICP \
        iterations\n\
         cloud to reference  {}\n\
         reference to cloud  {}\n",
        line(&evaluation.cloud.distance),
        line(&evaluation.reference_distance),
    )
}

/// The effect of exact rig extrinsics on a model.
pub(crate) fn rigid(report: &RigidReport) -> String {
    let RigidReport { cameras, frames, images, free_images, .. } = report;
    let mut text = format!(
        "rigid     {} in {frames} frames of {images} images, {free_images} images outside frames; \
        mean reprojection error {:.3} px, before {:.3} px; {} of {} observations are inliers\n",
        printable(&cameras.join(" and ")),
        report.error_after_px,
        report.error_before_px,
        report.observations_after,
        report.observations_before,
    );
    let difference_s =
        report.max_time_difference_s.filter(|seconds| *seconds > MIN_REPORTED_DIFFERENCE_S);
    if let Some(difference_s) = difference_s {
        let _ = writeln!(
            text,
            "          images of one frame are up to {:.1} ms apart, and the rig moves in that \
            time: a rigid model cannot be exact",
            1e3 * difference_s
        );
    }
    text
}
