//! `demo`: the drive of `synth`, through `reconstruct` and `evaluate poses`.

use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tiepoint_pipeline::sfm::MapperOptions;
use tiepoint_pipeline::{
    FeatureOptions, MatchOptions, Options, PoseEvaluation, Report, Truth, TruthFormat, evaluate_poses,
    reconstruct,
};
use tiepoint_synth::{Effects, Mounting};

use super::Failure;
use super::synth::{Rendered, render};
use crate::args::{Demo, Synth};
use crate::output::Output;
use crate::progress::Progress;
use crate::summary;

/// Images a second: the vehicle moves by about 0.75 m from one to the next.
const RATE_HZ: f64 = 10.0;

#[derive(Serialize)]
struct Outcome {
    drive: Rendered,
    workspace: PathBuf,
    /// Of this run; stages that were kept took none of it.
    seconds: f64,
    report: Report,
    evaluation: PoseEvaluation,
}

pub(crate) fn demo(args: &Demo, output: &Output) -> Result<(), Failure> {
    let start = Instant::now();
    let synth = Synth {
        output: args.output.join("drive"),
        frames: Some(args.frames),
        size: args.size,
        seed: args.seed,
        rate: RATE_HZ,
        mounting: Mounting::Front,
        effects: Effects::default(),
    };
    let mut progress = Progress::new(output);
    let drive = render(&synth, &mut progress)?;
    let workspace = args.output.join("workspace");
    let options = Options {
        features: FeatureOptions {
            timestamps: Some(synth.output.join("timestamps.csv")),
            ..FeatureOptions::default()
        },
        matching: MatchOptions { seed: args.seed, ..MatchOptions::default() },
        mapper: MapperOptions { seed: args.seed, ..MapperOptions::default() },
        ..Options::default()
    };
    let report = reconstruct(std::slice::from_ref(&synth.output), &workspace, &options, &mut |event| {
        progress.watch(event)
    })?;
    drop(progress);
    let truth = Truth { format: TruthFormat::Colmap, path: drive.truth.clone() };
    let evaluation = evaluate_poses(&workspace, &truth, None)?;
    let outcome = Outcome { drive, workspace, seconds: start.elapsed().as_secs_f64(), report, evaluation };
    output.result(&outcome, || outcome.describe(&synth));
    Ok(())
}

impl Outcome {
    fn describe(&self, synth: &Synth) -> String {
        let Self { drive, workspace, seconds, report, evaluation } = self;
        let mut text = summary::report(workspace, report);
        text.push_str("\nagainst the truth:\n");
        // Writing to a string does not fail.
        let mut row = |what: &str, value: std::fmt::Arguments| {
            let _ = writeln!(text, "{what:<29} {value}");
        };
        row("metres driven", format_args!("{:.1} m", drive.driven_m));
        row("images with a pose", format_args!("{} of {}", evaluation.registered, evaluation.images));
        let error = &evaluation.centre_error;
        row("camera centres, rms (ATE)", format_args!("{:.4} m", error.rmse));
        row("camera centres, median, max", format_args!("{:.4} m, {:.4} m", error.median, error.max));
        row("rotation, median", format_args!("{:.4}°", evaluation.rotation_error_deg.median));
        for auc in &evaluation.relative_pose_auc {
            let what = format!("relative poses, AUC@{}°", auc.threshold_deg);
            row(&what, format_args!("{:.2} %", 100.0 * auc.auc));
        }
        for focal in &evaluation.focal_lengths {
            if let Some(truth_px) = focal.truth_px {
                let percent = 100.0 * (focal.model_px / truth_px - 1.0);
                let what = format!("focal length, camera {}", focal.camera);
                row(&what, format_args!("{:.2} px, true {truth_px:.2} px ({percent:+.3} %)", focal.model_px));
            }
        }
        row("time of this run", format_args!("{seconds:.1} s"));
        let (folder, truth, workspace) = (synth.output.display(), drive.truth.display(), workspace.display());
        let frames = drive.cameras.iter().map(|camera| camera.images).max().unwrap_or(0);
        let _ = write!(
            text,
            "\nThis did what these do:\n  \
             tiepoint synth -o {folder} --frames {frames} --size {} --seed {}\n  \
             tiepoint reconstruct {folder} -o {workspace} --timestamps {folder}/timestamps.csv --seed {}\n  \
             tiepoint evaluate poses {workspace} --truth colmap:{truth}\n",
            synth.size, synth.seed, synth.seed,
        );
        text
    }
}
