//! Draws events: a bar on a terminal, JSON lines for programs.

use std::ops::ControlFlow;
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};
use tiepoint_pipeline::Event;

use crate::interrupt::Interrupt;
use crate::output::{Output, json_line, line_to_stderr, printable};

/// Watches a run.
pub(crate) struct Progress {
    json: bool,
    /// Hidden where stderr is no terminal.
    bar: ProgressBar,
    interrupt: Arc<Interrupt>,
}

impl Progress {
    pub(crate) fn new(output: &Output) -> Self {
        let interrupt = Arc::clone(&output.interrupt);
        Self { json: output.json, bar: ProgressBar::hidden(), interrupt }
    }

    /// Tells an event. The run is to stop where this breaks.
    pub(crate) fn watch(&mut self, event: &Event) -> ControlFlow<()> {
        if self.json {
            line_to_stderr(&json_line(event));
        } else {
            self.draw(event);
        }
        self.interrupt.watch(event)
    }

    /// An image of a drive is about to be rendered, `done` of `total` being there. The run is to
    /// stop where this breaks.
    pub(crate) fn rendering(&mut self, image: &str, done: usize, total: usize) -> ControlFlow<()> {
        if self.json {
            let event = serde_json::json!({
                "event": "rendering", "image": image, "done": done, "total": total
            });
            line_to_stderr(&json_line(&event));
            return self.interrupt.flow();
        }
        if done == 0 {
            self.begin("render", total, 0);
        }
        self.show(image);
        self.bar.set_position(done as u64);
        self.interrupt.flow()
    }

    /// A new bar.
    fn begin(&mut self, what: &'static str, total: usize, done: usize) {
        let style =
            ProgressStyle::with_template("{prefix:>8} {bar:30} {pos}/{len} {elapsed} {wide_msg}");
        self.bar.finish_and_clear();
        self.set_bar(ProgressBar::new(total as u64).with_prefix(what).with_position(done as u64));
        self.bar.set_style(style.expect("the template is sound"));
    }

    fn set_bar(&mut self, bar: ProgressBar) {
        self.interrupt.set_bar(&bar);
        self.bar = bar;
    }

    fn draw(&mut self, event: &Event) {
        match *event {
            Event::StageBegan { stage, total, done } => self.begin(stage.name(), total, done),
            Event::StageKept { .. } => {}
            Event::SoundHeard { reference, recording, after_s } => self.say(&format!(
                "by its sound, {recording} began {:.3} s {} {reference}",
                after_s.abs(),
                if after_s < 0.0 { "before" } else { "after" }
            )),
            Event::LoopClosed { pairs } => self.say(&format!(
                "closed a loop: {pairs} pairs of images had been torn apart by \
                drift"
            )),
            Event::Stabilised { recording } => self.say(&format!(
                "{recording}: the camera stabilised its pictures electronically, which changes \
                lens and mounting from frame to frame: switch that \
                 off when recording"
            )),
            Event::FrameKept { image, read } => {
                if self.bar.is_hidden() || self.bar.length().is_some() {
                    self.set_bar(ProgressBar::new_spinner());
                }
                self.show(&format!("{image}: {read} frames read"));
                self.bar.tick();
            }
            Event::ImageSkipped { why, .. } => {
                self.say(&format!("skipped {why}"));
                self.bar.inc(1);
            }
            Event::FocalIgnored { image, focal_px } => self.say(&format!(
                "{image}: its EXIF data tell a focal length of {focal_px:.3e} pixels, which no \
                camera has, so it counts as unknown: give \
                 --focal-prior PX if you know it"
            )),
            Event::PointsGrey { why } => self.say(&format!("the points have no colours: {why}")),
            Event::ImageDone { image, keypoints } => {
                self.show(&format!("{image}: {keypoints} keypoints"));
                self.bar.inc(1);
            }
            Event::PairDone { image1, image2, inliers, .. } => {
                self.show(&format!("{image1}, {image2}: {inliers} matches"));
                self.bar.inc(1);
            }
            Event::ModelBegan { image1, image2, points } => {
                self.show(&format!("began with {image1}, {image2}: {points} points"));
                self.bar.set_position(2);
            }
            Event::ImageRegistered { image, registered, points } => {
                self.show(&format!("{image}: {points} points"));
                self.bar.set_position(registered as u64);
            }
            Event::ModelAdjusted { images, observations, .. } => {
                self.show(&format!("adjusted {images} images, {observations} observations"));
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

    /// What stands behind the bar.
    fn show(&self, text: &str) {
        self.bar.set_message(printable(text).into_owned());
    }

    /// A line that stays, above the bar.
    fn say(&self, line: &str) {
        self.bar.suspend(|| line_to_stderr(&printable(line)));
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
