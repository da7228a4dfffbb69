//! Control points and check points, as text.

use std::fmt::Write;

use tiepoint_pipeline::workspace::{ControlPointReport, ControlReport, PointStatistics};

use crate::output::printable;

/// A point.
pub(crate) fn line(point: &ControlPointReport) -> String {
    let kind = if point.is_check { "check" } else { "control" };
    let ControlPointReport { marks, inlier_marks, .. } = point;
    let name = printable(&point.name);
    let (Some([x, y, z]), Some(rms_px)) = (point.error_m, point.rms_px) else {
        return format!("{kind} point {name}: its {marks} marks do not determine it");
    };
    let wrong = match point.wrong_marks.as_slice() {
        [] => String::new(),
        images => format!("; wrong marks in {}", printable(&images.join(", "))),
    };
    let tested = match point.detectable_m.map(in_metres) {
        _ if point.detectable_m == [None; 3] => String::new(),
        [x, y, z] => format!("; errors from {x} {y} {z} m on are detected"),
    };
    let end = match point.alternatives.as_slice() {
        [] if point.is_wrong => "; the others contradict it, and it is not used".to_owned(),
        [] => String::new(),
        others => format!(
            "; the others contradict it or {}, and it is not used",
            printable(&others.join(", "))
        ),
    };
    format!(
        "{kind} point {name}: {inlier_marks} of {marks} marks agree to {rms_px:.2} px, errors \
         {x:.3} {y:.3} {z:.3} m{wrong}{tested}{end}"
    )
}

fn in_metres(size_m: Option<f64>) -> String {
    size_m.map_or("∞".to_owned(), |size_m| format!("{size_m:.2}"))
}

/// All points of a model, and the root mean squares of their errors.
pub(crate) fn table(report: &ControlReport) -> String {
    let mut text = String::new();
    for point in &report.points {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{}", line(point));
    }
    for (kind, statistics) in [("control", &report.control), ("check", &report.check)] {
        let Some(PointStatistics { points, rms_m: [x, y, z] }) = statistics else { continue };
        let norm = x.hypot(*y).hypot(*z);
        let _ = writeln!(
            text,
            "{points} {kind} points: root mean square errors {x:.4} {y:.4} {z:.4} m, together \
             {norm:.4} m"
        );
    }
    text
}
