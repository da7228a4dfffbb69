//! The tables of the page on rigs.

use tiepoint_pipeline::evaluation::RigEvaluation;
use tiepoint_pipeline::workspace::{
    ConstraintKind, RigCamera, RigClock, RigClockState, RigFile, RigReport,
};

use crate::{Table, TableRow};

/// The constraint that was chosen, and extrinsics and clock of each camera, as in `rig.json`.
pub(super) fn rig_table(
    report: Option<&RigReport>,
    rig: Option<&RigFile>,
    unit: &str,
) -> Option<Table> {
    let mut rows: Vec<TableRow> = Vec::new();
    let mut row = |name: &str, value: String| rows.push((name.to_owned(), vec![value]));
    if let Some(RigReport { mode, extrinsics, cameras, .. }) = report {
        row("asked for", mode.clone());
        if let Some(extrinsics) = extrinsics {
            let chosen = extrinsics.chosen.map_or("off", name_of);
            row("chosen", format!("{chosen}: {}", extrinsics.reason));
            if let Some(change) = extrinsics.held_out_change() {
                row("error of held-out tracks", change);
            }
            for camera in cameras {
                let sigmas = camera.sigma_translation.zip(camera.sigma_rotation_deg);
                let Some((translation, rotation_deg)) = sigmas else { continue };
                let percent = 100.0 * translation;
                row(
                    &format!("sigmas of {}", camera.names[1]),
                    format!("{percent:.3} % of the baseline, {rotation_deg:.4}°"),
                );
            }
            for camera in &extrinsics.unconstrained {
                row(&format!("constraint of {camera}"), "none, others permit one".to_owned());
            }
        }
    }
    for camera in rig.iter().flat_map(|rig| &rig.cameras) {
        let RigCamera { name, centre_in_rig: [x, y, z], rotation_wxyz: [w, ..], clock, .. } =
            camera;
        let length = (x * x + y * y + z * z).sqrt();
        let sd = |sd: Option<f64>, unit: &str| match sd {
            Some(sd) => format!(" ± {sd:.4} {unit}"),
            None => format!(" {unit}, undetermined by the images"),
        };
        let reference = rig.map_or("", |rig| &rig.reference);
        row(
            &format!("baseline {reference} – {name}"),
            format!("{length:.4}{}", sd(camera.translation_sd, unit)),
        );
        row(
            &format!("centre of {name} in {reference}"),
            format!("({x:.4}, {y:.4}, {z:.4}) {unit}"),
        );
        let angle_deg = 2.0 * w.abs().min(1.0).acos().to_degrees();
        row(
            &format!("rotation of {name}"),
            format!("{angle_deg:.3}{}", sd(camera.rotation_sd_deg, "°")),
        );
        row(&format!("clock of {name}"), of_clock(clock));
    }
    let caption = "Rig".to_owned();
    (!rows.is_empty()).then_some(Table { caption, head: Vec::new(), rows })
}

fn name_of(kind: ConstraintKind) -> &'static str {
    match kind {
        ConstraintKind::Soft => "soft",
        ConstraintKind::Rigid => "rigid",
    }
}

fn of_clock(clock: &RigClock) -> String {
    let (offset, its) = (clock.offset_text(), clock.added_to());
    match clock.state {
        RigClockState::Synchronised if clock.offset_s == 0.0 => {
            "images of one frame count as simultaneous".to_owned()
        }
        RigClockState::Synchronised => {
            format!("synchronised after an offset of {offset} (added to its {its})")
        }
        RigClockState::Estimated => format!(
            "offset {offset} (to add to its {its}), skew {:+.0}{} ppm",
            clock.drift_ppm,
            clock.drift_sd_ppm.map_or(String::new(), |sd| format!(" ± {sd:.0}")),
        ),
        RigClockState::Unobservable => {
            format!("offset {offset} (added to its {its}), undetermined by the motion")
        }
    }
}

/// How the relative poses of each pair of cameras scatter.
pub(super) fn relative_poses(pairs: &[RigEvaluation], unit: &str) -> Option<Table> {
    let mut rows: Vec<TableRow> = Vec::new();
    for pair in pairs {
        let between = pair.cameras.join(" – ");
        let mut row = |name: &str, value: String| {
            rows.push((format!("{name} {between}"), vec![value]));
        };
        let how = match (pair.has_clock, pair.has_times) {
            (true, _) => "at the times of the clock",
            (false, true) => "images nearest in time, clocks not compared",
            (false, false) => "images of the same or the nearest number",
        };
        row("frames", format!("{} ({how})", pair.frames));
        row("distance", format!("{:.4} ± {:.4} {unit}", pair.baseline.mean, pair.baseline.std));
        row("translation, RMS", format!("{:.4} {unit}", pair.translation_rms));
        row("rotation, RMS", format!("{:.4}°", pair.rotation_rms_deg));
    }
    let caption = "Relative poses over time, deviation from the mean".to_owned();
    (!rows.is_empty()).then_some(Table { caption, head: Vec::new(), rows })
}

#[cfg(test)]
mod tests {
    use tiepoint_pipeline::workspace::{ExtrinsicsReport, RigCameraReport};

    use super::*;

    #[test]
    fn the_table_has_what_rig_json_has() {
        assert_eq!(rig_table(None, None, "m"), None);
        let camera = RigCamera {
            name: "right".to_owned(),
            rotation_wxyz: [0.5_f64.sqrt(), 0.0, 0.5_f64.sqrt(), 0.0],
            centre_in_rig: [0.3, 0.0, 0.4],
            translation_sd: Some(0.0123),
            clock: RigClock {
                state: RigClockState::Estimated,
                offset_s: 0.18235,
                offset_sd_s: Some(0.0005),
                drift_ppm: -12.0,
                ..RigClock::default()
            },
            ..RigCamera::default()
        };
        let rig =
            RigFile { reference: "left".to_owned(), cameras: vec![camera], bad_pairs: Vec::new() };
        let extrinsics = ExtrinsicsReport {
            chosen: Some(ConstraintKind::Soft),
            reason: "why".to_owned(),
            held_out_error_off_px: 0.5,
            held_out_error_px: 0.49,
            held_out_change_sd: Some(0.004),
            unconstrained: vec!["rear".to_owned()],
            ..ExtrinsicsReport::default()
        };
        let of_right = RigCameraReport {
            names: ["left".to_owned(), "right".to_owned()],
            sigma_translation: Some(0.0001),
            sigma_rotation_deg: Some(0.0006),
            ..RigCameraReport::default()
        };
        let report = RigReport {
            mode: "auto".to_owned(),
            extrinsics: Some(extrinsics),
            cameras: vec![of_right],
            ..RigReport::default()
        };
        let table = rig_table(Some(&report), Some(&rig), "m").unwrap();
        let text: Vec<String> =
            table.rows.iter().map(|(name, values)| format!("{name}: {}", values[0])).collect();
        assert_eq!(
            text,
            [
                "asked for: auto",
                "chosen: soft: why",
                "error of held-out tracks: -2.0 ± 0.4 %",
                "sigmas of right: 0.010 % of the baseline, 0.0006°",
                "constraint of rear: none, others permit one",
                "baseline left – right: 0.5000 ± 0.0123 m",
                "centre of right in left: (0.3000, 0.0000, 0.4000) m",
                "rotation of right: 90.000 °, undetermined by the images",
                "clock of right: offset +182.35 ± 0.50 ms (to add to its times), skew -12 ppm",
            ]
        );
        let numbered = RigClock { assumed_frame_s: Some(0.1), ..rig.cameras[0].clock.clone() };
        assert_eq!(
            of_clock(&numbered),
            "offset +1.82 ± 0.01 frames (to add to its numbers), skew -12 ppm"
        );
    }
}
