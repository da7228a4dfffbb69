//! Shows events as a progress bar on a terminal or as JSON lines.

use std::ops::ControlFlow;

use indicatif::{ProgressBar, ProgressStyle};
use tiepoint_pipeline::{DenseStep, Event};

use crate::output::{Output, line_to_stderr, printable};

/// Progress of a run, shown on stderr.
pub(crate) struct Progress {
    output: Output,
    /// Hidden unless stderr is a terminal.
    bar: ProgressBar,
}

impl Progress {
    pub(crate) fn new(output: &Output) -> Self {
        Self { output: output.clone(), bar: ProgressBar::hidden() }
    }

    /// Shows an event. `Break` asks the run to stop.
    pub(crate) fn watch(&mut self, event: &Event) -> ControlFlow<()> {
        if !self.output.progress(event) {
            self.draw(event);
        }
        self.output.interrupt.watch(event)
    }

    fn start_bar(&mut self, stage: &'static str, total: usize, done: usize) {
        let style =
            ProgressStyle::with_template("{prefix:>8} {bar:30} {pos}/{len} {elapsed} {wide_msg}");
        self.bar.finish_and_clear();
        self.set_bar(ProgressBar::new(total as u64).with_prefix(stage).with_position(done as u64));
        self.bar.set_style(style.expect("the template is valid"));
    }

    fn set_bar(&mut self, bar: ProgressBar) {
        self.output.interrupt.set_bar(&bar);
        self.bar = bar;
    }

    fn draw(&mut self, event: &Event) {
        match *event {
            Event::StageBegan { stage, total, done } => self.start_bar(stage.name(), total, done),
            Event::StageKept { .. } => {}
            Event::AudioOffset { reference, recording, after_s } => self.print_line(&format!(
                "audio synchronisation: {recording} started {:.3} s {} {reference}",
                after_s.abs(),
                if after_s < 0.0 { "before" } else { "after" }
            )),
            Event::LoopClosed { pairs } => self.print_line(&format!(
                "closed a loop: merged the points of {pairs} image pairs that drift had separated"
            )),
            Event::Stabilised { recording } => self.print_line(&format!(
                "{recording} was recorded with electronic stabilisation, which changes intrinsics \
                and rig extrinsics from frame to frame: switch it off when recording"
            )),
            Event::FrameSelected { image, read } => {
                if self.bar.is_hidden() || self.bar.length().is_some() {
                    self.set_bar(ProgressBar::new_spinner());
                }
                self.show(&format!("{image}: {read} frames read"));
                self.bar.tick();
            }
            Event::Noted { what } => self.print_line(what),
            Event::ImageSkipped { reason, .. } => {
                self.print_line(&format!("skipped {reason}"));
                self.bar.inc(1);
            }
            Event::CameraCalibrated { image, calibration } => {
                self.print_line(&format!("the camera of {image} is calibrated by {calibration}"));
            }
            Event::FocalIgnored { image, focal_px } => self.print_line(&format!(
                "{image}: its EXIF focal length of {focal_px:.3e} pixels is impossible and is \
                ignored: give --focal-prior PX if you know it"
            )),
            Event::ColorsMissing { reason } => {
                self.print_line(&format!("the points have no colours: {reason}"))
            }
            Event::ImageDone { image, keypoints } => {
                self.show(&format!("{image}: {keypoints} keypoints"));
                self.bar.inc(1);
            }
            Event::PairsChosen { selection, pairs, expected_s } => self.print_line(&format!(
                "matching {pairs} pairs ({selection}), about {}",
                duration(expected_s)
            )),
            Event::PairDone { image1, image2, inliers, .. } => {
                self.show(&format!("{image1}, {image2}: {inliers} matches"));
                self.bar.inc(1);
            }
            Event::ModelInitialised { image1, image2, points } => {
                self.show(&format!("initial pair {image1}, {image2}: {points} points"));
                self.bar.set_position(2);
            }
            Event::ModelExtended { images, absent, other_keypoints, points } => {
                let absent = match absent {
                    0 => String::new(),
                    count => format!(", {count} of them not in the workspace"),
                };
                let other = match other_keypoints {
                    0 => String::new(),
                    count => format!("; {count} images have other keypoints there"),
                };
                self.print_line(&format!(
                    "going on from a model of {images} images{absent}, {points} points{other}"
                ));
            }
            Event::ImageLocalized { image, inliers } => {
                self.show(&format!("{image}: {inliers} inliers"));
            }
            Event::ImageUndistorted { image, done, total } => {
                if done == 1 {
                    self.start_bar("undistort", total, 0);
                }
                self.show(image);
                self.bar.set_position(done as u64);
            }
            Event::ImageRegistered { image, registered, points } => {
                self.show(&format!("{image}: {points} points"));
                self.bar.set_position(registered as u64);
            }
            Event::ModelAdjusted { images, observations, .. } => {
                self.show(&format!("adjusted {images} images, {observations} observations"));
            }
            Event::DenseDone { step, image } => {
                let step = match step {
                    DenseStep::Undistort => "undistorted",
                    DenseStep::Planes => "planes at half resolution",
                    DenseStep::Depths => "depth map",
                };
                self.show(&format!("{image}: {step}"));
                self.bar.inc(1);
            }
            Event::AdjustmentStep { step, cost } => {
                if self.bar.is_hidden() {
                    self.set_bar(ProgressBar::new_spinner());
                }
                self.show(&format!("step {step}: cost {cost:.6e}"));
                self.bar.tick();
            }
            Event::StageDone { .. } => self.bar.finish_and_clear(),
        }
    }

    /// Sets the text behind the bar.
    fn show(&self, text: &str) {
        self.bar.set_message(printable(text).into_owned());
    }

    /// Prints a line above the bar, where it stays.
    fn print_line(&self, line: &str) {
        self.bar.suspend(|| line_to_stderr(&printable(&self.output.for_reader(line))));
    }
}

impl tiepoint_experiments::Progress for Progress {
    fn watch(&mut self, event: &Event) -> ControlFlow<()> {
        Self::watch(self, event)
    }

    fn step(&mut self, number: usize, total: usize, what: &str) {
        let event = serde_json::json!({
            "event": "step", "number": number, "total": total, "what": what
        });
        if !self.output.progress(&event) {
            self.print_line(&format!("step {number} of {total}: {what}"));
        }
    }

    fn rendering(&mut self, image: &str, done: usize, total: usize) -> ControlFlow<()> {
        let event = serde_json::json!({
            "event": "rendering", "image": image, "done": done, "total": total
        });
        if self.output.progress(&event) {
            return self.output.interrupt.flow();
        }
        if done == 0 {
            self.start_bar("render", total, 0);
        }
        self.show(image);
        self.bar.set_position(done as u64);
        self.output.interrupt.flow()
    }
}

/// A duration in its largest unit, with two digits.
fn duration(seconds: f64) -> String {
    let units = [(86_400.0, "d"), (3600.0, "h"), (60.0, "min")];
    let (unit_s, unit) =
        units.into_iter().find(|(unit_s, _)| seconds >= *unit_s).unwrap_or((1.0, "s"));
    match seconds / unit_s {
        value if value < 10.0 => format!("{value:.1} {unit}"),
        value => format!("{value:.0} {unit}"),
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
