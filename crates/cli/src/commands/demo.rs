//! `demo`: renders a drive as `synth` does, reconstructs it with `--rig off`, `paper` and `auto`,
//! and compares the models with the ground truth.

use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tiepoint_pipeline::eval::geometry::nalgebra::Vector3;
use tiepoint_pipeline::sfm::scene::Reconstruction;
use tiepoint_pipeline::sfm::{MapperOptions, RigTerm};
use tiepoint_pipeline::{
    CameraError, CloudEvaluation, FeatureOptions, MapOptions, MatchOptions, Options,
    PoseEvaluation, Report, ReportModel, RigCamera, RigEvaluation, SurfaceEvaluation, Table,
    TableRow, Workspace, reconstruct, refuse_foreign_page, report_html, write_page,
};
use tiepoint_synth::{Drive, DriveOptions, Mount, Mounting, RouteKind};

use super::drive_evaluation::{DriveEvaluation, evaluate_drive};
use super::synth::{BASELINE_M, Plan, Rendered, render, scan};
use crate::args::Demo;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

/// Frame rate: the vehicle moves by 2 to 3 m between images.
const RATE_HZ: f64 = 2.5;
/// Length of the shortest loop, in metres.
const LENGTH_M: f64 = 160.0;
/// Neighbours, and the end of the loop with its beginning.
const PAIRS: &str = "sequential:6+ends";
/// Simulated imperfections: unsynchronised clocks.
const EFFECTS: &str = "clocks";

#[derive(Serialize)]
struct Outcome {
    drive: Rendered,
    /// Wall time of this command; stages kept from earlier ones take none.
    seconds: f64,
    /// True time offset of the right camera to the left one in the middle of the drive.
    true_offset_s: f64,
    runs: Vec<Run>,
    /// The HTML page that shows the models side by side.
    page: PathBuf,
}

/// One reconstruction with its errors.
#[derive(Serialize)]
struct Run {
    rig: &'static str,
    workspace: PathBuf,
    report: Report,
    poses: PoseEvaluation,
    #[serde(skip)]
    model: Reconstruction,
    #[serde(skip)]
    camera_errors: Vec<CameraError>,
    /// Lengths in metres.
    baseline: Option<RigEvaluation>,
    surface: Option<SurfaceEvaluation>,
    cloud: Option<CloudEvaluation>,
    /// With `--rig paper`: local scale at the initial pair over the scale of the whole model; 1
    /// without scale drift.
    model_size_over_true_size: Option<f64>,
}

pub(crate) fn demo(args: &Demo, output: &Output) -> Result<(), Failure> {
    let start = Instant::now();
    let plan = plan(args)?;
    let page = args.output.join("report.html");
    refuse_foreign_page(&page)?;
    let drive = plan.drive()?;
    let mut progress = Progress::new(output);
    let rendered = render(&plan, &drive, &mut progress)?;
    let scan = scan(&drive)?;
    let options = |rig| -> Result<Options, Failure> {
        Ok(Options {
            features: FeatureOptions {
                timestamps: Some(plan.folder.join("timestamps.csv")),
                ..FeatureOptions::default()
            },
            matching: MatchOptions {
                pairs: PAIRS.parse().expect("it is a selection of pairs"),
                seed: args.seed,
                ..MatchOptions::default()
            },
            mapping: MapOptions {
                mapper: MapperOptions { rig, seed: args.seed, ..MapperOptions::default() },
                baseline_m: None,
            },
            ..Options::default()
        })
    };
    let mut runs = Vec::new();
    for (rig, term) in [("off", RigTerm::Off), ("paper", RigTerm::Paper), ("auto", RigTerm::Auto)] {
        let workspace = args.output.join(rig);
        if let Some(first) = runs.first().map(|run: &Run| &run.workspace) {
            // Reuses features and matches of the first run.
            Workspace::open(first)?.fork(&workspace)?;
        }
        let report = reconstruct(
            std::slice::from_ref(&plan.folder),
            &workspace,
            &options(term)?,
            &mut |event| progress.watch(event),
        )?;
        runs.push(evaluate(rig, workspace, report, &drive, &rendered, &scan)?);
    }
    drop(progress);
    let seconds = start.elapsed().as_secs_f64();
    let true_offset_s = true_offset_s(&drive);
    let outcome = Outcome { drive: rendered, seconds, true_offset_s, runs, page };
    outcome.write_page()?;
    output.result(&outcome, || outcome.describe(&plan))
}

/// The drive to render.
fn plan(args: &Demo) -> Result<Plan, Failure> {
    let effects = EFFECTS
        .parse()
        .map_err(|error: tiepoint_synth::Error| Failure::Usage(error.to_string()))?;
    let options = DriveOptions {
        seed: args.seed,
        route: RouteKind::Loop,
        length_m: LENGTH_M,
        mounts: Mount::stereo(Mounting::Front, BASELINE_M).to_vec(),
        width: args.size.width,
        height: args.size.height,
        rate_hz: RATE_HZ,
        effects,
        ..DriveOptions::default()
    };
    Ok(Plan { folder: args.output.join("drive"), frames: args.frames, options })
}

fn evaluate(
    rig: &'static str,
    workspace: PathBuf,
    report: Report,
    drive: &Drive,
    rendered: &Rendered,
    scan: &[Vector3<f64>],
) -> Result<Run, Failure> {
    let DriveEvaluation { poses, model, camera_errors, baseline, surface, cloud, .. } =
        evaluate_drive(&workspace, drive, &rendered.truth, scan, |_| true)?;
    let model_size_over_true_size = size_ratio(&report, &model, drive, poses.scale);
    Ok(Run {
        rig,
        workspace,
        report,
        poses,
        model,
        camera_errors,
        baseline,
        surface,
        cloud,
        model_size_over_true_size,
    })
}

/// True distance of the initial pair over its distance in the aligned model, in a model that was
/// mapped with `--rig paper`: there this distance is the unit of length.
fn size_ratio(
    report: &Report,
    model: &Reconstruction,
    drive: &Drive,
    metres_per_unit: f64,
) -> Option<f64> {
    let names = &report.models.first()?.rig.as_ref()?.paper.as_ref()?.unit_images;
    let centres = |name: &String| {
        let (camera, exposure) = drive.find(name)?;
        let image = model.images().find(|(_, image)| image.name == *name)?.1;
        let true_centre = drive.cam_from_world(camera, exposure.time_s).origin_in_a();
        Some((true_centre, image.cam_from_world()?.origin_in_a()))
    };
    let (first, second) = (centres(&names[0])?, centres(&names[1])?);
    Some((first.0 - second.0).norm() / ((first.1 - second.1).norm() * metres_per_unit))
}

/// True time minus time stamp of the last camera, in seconds, in the middle of its images.
fn true_offset_s(drive: &Drive) -> f64 {
    let Some(camera) = drive.cameras().last() else { return 0.0 };
    let (first, last) = (camera.exposures.first(), camera.exposures.last());
    let middle = first.zip(last).map_or(0.0, |(first, last)| 0.5 * (first.stamp_s + last.stamp_s));
    camera.clock.time_s(middle) - middle
}

impl Run {
    /// Estimated extrinsics and clock of the right camera.
    fn right_camera(&self) -> Option<&RigCamera> {
        let rig = self.report.models.first()?.rig.as_ref()?;
        rig.extrinsics.as_ref()?.rig.as_ref()?.cameras.first()
    }
}

impl Outcome {
    fn write_page(&self) -> Result<(), Failure> {
        let names: Vec<String> = self.runs.iter().map(|run| format!("--rig {}", run.rig)).collect();
        let report_models: Vec<ReportModel> = self
            .runs
            .iter()
            .zip(&names)
            .map(|(run, name)| ReportModel {
                name,
                model: &run.model,
                world_from_model: Some(run.poses.truth_from_model),
                report: Some(&run.report),
                camera_errors: &run.camera_errors,
            })
            .collect();
        let table = Table::of_columns(&names, self.table());
        let page = report_html("tiepoint demo", &report_models, &[table], Vec::new());
        Ok(write_page(&self.page, &page)?)
    }

    /// Results of all runs, a column each.
    fn table(&self) -> Vec<TableRow> {
        let mut rows: Vec<TableRow> = Vec::new();
        let mut row = |name: &str, value: &dyn Fn(&Run) -> Option<String>| {
            let values = self.runs.iter().map(|run| value(run).unwrap_or_else(|| "-".to_owned()));
            rows.push((name.to_owned(), values.collect()));
        };
        row("images with a pose", &|run| {
            Some(format!("{} of {}", run.poses.registered, run.poses.images))
        });
        row("trajectory error (ATE)", &|run| Some(format!("{:.4} m", run.poses.centre_error.rmse)));
        row("camera position error, median", &|run| {
            Some(format!("{:.4} m", run.poses.centre_error.median))
        });
        row("rotation error, median", &|run| {
            Some(format!("{:.4}°", run.poses.rotation_error_deg.median))
        });
        row("focal length (error)", &|run| {
            let focal = run.poses.focal_lengths.first()?;
            let percent = 100.0 * (focal.model_px / focal.truth_px? - 1.0);
            Some(format!("{:.2} px ({percent:+.2} %)", focal.model_px))
        });
        row("stereo baseline (0.5 m), mean", &|run| {
            Some(format!("{:.4} m", run.baseline.as_ref()?.baseline.mean))
        });
        row("right camera in left, RMS dev.", &|run| {
            Some(format!("{:.4} m", run.baseline.as_ref()?.translation_rms))
        });
        row("stereo baseline, drift", &|run| {
            Some(format!("{:+.2} %", 100.0 * run.baseline.as_ref()?.baseline_drift))
        });
        row("relative rotation, RMS dev.", &|run| {
            Some(format!("{:.4}°", run.baseline.as_ref()?.rotation_rms_deg))
        });
        row("baseline of the extrinsics", &|run| {
            let [x, y, z] = run.right_camera()?.centre_in_rig;
            Some(format!("{:.4} m", run.poses.scale * (x * x + y * y + z * z).sqrt()))
        });
        row("time offset of right camera", &|run| {
            let clock = &run.right_camera()?.clock;
            Some(format!("{:.2} ± {:.2} ms", 1e3 * clock.offset_s, 1e3 * clock.offset_sd_s?))
        });
        let true_ms = 1e3 * self.true_offset_s;
        row("  true", &|run| run.right_camera().map(|_| format!("{true_ms:.2} ms")));
        row("surface distance to 30 m, median", &|run| {
            Some(format!("{:.4} m", run.surface.as_ref()?.near.as_ref()?.median))
        });
        row("  with the true cameras", &|run| {
            Some(format!("{:.4} m", run.surface.as_ref()?.near_floor.as_ref()?.median))
        });
        row("cloud to laser scan, mean ± sd", &|run| {
            let distance = &run.cloud.as_ref()?.distance;
            Some(format!("{:.3} ± {:.3} m", distance.mean, distance.std))
        });
        row("scale at start / mean scale", &|run| {
            Some(format!("{:.4}", run.model_size_over_true_size?))
        });
        row("points", &|run| Some(run.report.models.first()?.points.to_string()));
        row("mapping time", &|run| {
            Some(format!("{:.1} s", run.report.stages.map.as_ref()?.seconds))
        });
        rows
    }

    fn describe(&self, plan: &Plan) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let mut line = |arguments: std::fmt::Arguments| {
            let _ = writeln!(text, "{arguments}");
        };
        let images: usize = self.drive.cameras.iter().map(|camera| camera.images).sum();
        line(format_args!(
            "loop of {:.1} m, {images} images of two cameras, compared with ground truth:\n",
            self.drive.driven_m
        ));
        let heads: Vec<String> = self.runs.iter().map(|run| format!("--rig {}", run.rig)).collect();
        for (name, values) in std::iter::once((String::new(), heads)).chain(self.table()) {
            let columns: String = values.iter().map(|value| format!("{value:>22}")).collect();
            line(format_args!("{name:<33}{columns}"));
        }
        line(format_args!(
            "\nwall time {:.1} s\nopen in a browser: {}\n\nThe same as these commands:",
            self.seconds,
            self.page.display()
        ));
        let (folder, truth) = (plan.folder.display(), self.drive.truth.display());
        let frames = plan.frames.map(|frames| format!(" --frames {frames}")).unwrap_or_default();
        line(format_args!(
            "  tiepoint synth -o {folder} --length {LENGTH_M} --rate {RATE_HZ} --effects \
            {EFFECTS} --size {}x{} --seed {}{frames}",
            plan.options.width, plan.options.height, plan.options.seed
        ));
        for Run { rig, workspace, .. } in &self.runs {
            let workspace = workspace.display();
            line(format_args!(
                "  tiepoint reconstruct {folder} -o {workspace} --rig {rig} --pairs {PAIRS} \
                --timestamps {folder}/timestamps.csv --seed {}",
                plan.options.seed
            ));
            line(format_args!("  tiepoint evaluate poses {workspace} --truth colmap:{truth}"));
        }
        text
    }
}
