//! Renders an open street and a loop, reconstructs each with `--rig off` and `auto`, the street
//! also with `paper`, and compares the models with the ground truth.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tiepoint_pipeline::eval::Cloud;
use tiepoint_pipeline::evaluation::{PoseEvaluation, RegisteredCloud, SurfaceEvaluation};
use tiepoint_pipeline::sfm::scene::Reconstruction;
use tiepoint_pipeline::sfm::{MapperOptions, RigMode};
use tiepoint_pipeline::stages::{FeatureOptions, MapOptions, MatchOptions};
use tiepoint_pipeline::workspace::{RigCamera, RigFile};
use tiepoint_pipeline::{Options, Report, Workspace, reconstruct};
use tiepoint_report::{
    CameraError, ReportModel, ReportSection, Table, TableRow, Thumbnails, refuse_foreign_page,
    report_html, write_page,
};
use tiepoint_synth::{Drive, DriveOptions, Mount, RouteKind, ViewDirection};

use crate::drive_evaluation::{DriveEvaluation, evaluate_drive};
use crate::drive_folder::{BASELINE_M, Plan, Rendered, render, scan};
use crate::{Error, Progress};

/// Simulated imperfections: unsynchronised clocks.
const EFFECTS: &str = "clocks";
/// The error without the rig over that with it from which on the demo calls it a gain.
const MIN_GAIN: f64 = 1.2;
/// The scale of a drive is compared between its first and its last fifth.
const SCALE_PARTS: usize = 5;

/// A drive of the demo.
struct Setting {
    /// Name of its folder.
    name: &'static str,
    heading: &'static str,
    route: RouteKind,
    /// Length of the street, in metres.
    length_m: f64,
    /// Images per second of each camera.
    rate_hz: f64,
    /// Largest number of images of a camera.
    frames: Option<NonZeroUsize>,
    pairs: &'static str,
    /// The constraints that are compared.
    modes: &'static [RigMode],
}

/// The drives. Lengths, rates and pairs were chosen on the seeds 101 to 106, so that the demo is
/// short. The loop leaves out `paper` for the same reason. With them the ATE of `auto` over that of
/// `off` is 0.17 to 0.33 on the street; with images of 400 × 300 it was 0.14 to 0.69.
const SETTINGS: [Setting; 2] = [
    Setting {
        name: "street",
        heading: "An open street: the scale of the model may drift",
        route: RouteKind::Open,
        length_m: 240.0,
        // 2 to 3 m between images. At 2.5 Hz the windows of the facades, 2.9 m apart, are mistaken
        // for each other.
        rate_hz: 5.0,
        // The street ends in a meadow, where little is near enough to be triangulated.
        frames: NonZeroUsize::new(140),
        pairs: "sequential:5",
        modes: &[RigMode::Off, RigMode::Paper, RigMode::Auto],
    },
    Setting {
        name: "loop",
        heading: "A loop around a block: its two ends determine the scale",
        route: RouteKind::Loop,
        length_m: 160.0,
        rate_hz: 2.5,
        frames: None,
        pairs: "sequential:6+ends",
        modes: &[RigMode::Off, RigMode::Auto],
    },
];

impl Setting {
    /// A drive is rendered, and then reconstructed with each constraint.
    fn num_steps(&self) -> usize {
        1 + self.modes.len()
    }
}

/// What the demo renders.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// Output folder. A later call resumes an interrupted one.
    pub folder: PathBuf,
    /// Largest number of images of each camera of each drive.
    pub frames: Option<NonZeroUsize>,
    /// Width and height of the images, in pixels.
    pub size: [u32; 2],
    /// Seed of the streets and all random numbers.
    pub seed: u64,
}

/// The drives of the demo with their reconstructions.
#[derive(Serialize)]
pub struct DemoOutcome {
    drives: Vec<DriveOutcome>,
    /// Wall time of this command; stages kept from earlier ones take none.
    seconds: f64,
    /// The HTML page that shows the models side by side.
    page: PathBuf,
}

/// A drive with its reconstructions.
#[derive(Serialize)]
struct DriveOutcome {
    name: &'static str,
    #[serde(skip)]
    plan: Plan,
    #[serde(skip)]
    setting: &'static Setting,
    drive: Rendered,
    /// True time offset of the right camera to the left one in the middle of the drive.
    true_offset_s: f64,
    runs: Vec<Run>,
}

/// One reconstruction with its errors.
#[derive(Serialize)]
struct Run {
    rig: &'static str,
    /// Heading of its column.
    #[serde(skip)]
    heading: String,
    workspace: PathBuf,
    report: Report,
    poses: PoseEvaluation,
    #[serde(skip)]
    model: Reconstruction,
    /// Extrinsics and clocks of its rig.
    #[serde(skip)]
    extrinsics: Option<RigFile>,
    #[serde(skip)]
    camera_errors: Vec<CameraError>,
    surface: Option<SurfaceEvaluation>,
    cloud: Option<RegisteredCloud>,
    /// Scale of the last fifth of the first camera's path over that of its first fifth; 1 without
    /// scale drift.
    scale_drift: Option<f64>,
}

/// Renders the drives, reconstructs each with its constraints, and writes a page that shows the
/// models side by side.
///
/// # Errors
///
/// The folder holds something else or cannot be written, a stage fails, or `progress` stops it.
pub fn demo(options: &DemoOptions, progress: &mut dyn Progress) -> Result<DemoOutcome, Error> {
    let start = Instant::now();
    let page = options.folder.join("report.html");
    refuse_foreign_page(&page)?;
    let mut drives: Vec<DriveOutcome> = Vec::new();
    for setting in &SETTINGS {
        let steps_before = drives.iter().map(|drive| drive.setting.num_steps()).sum();
        drives.push(reconstruct_drive(options, setting, steps_before, progress)?);
    }
    let seconds = start.elapsed().as_secs_f64();
    let outcome = DemoOutcome { drives, seconds, page };
    outcome.write_page()?;
    Ok(outcome)
}

/// Renders a drive and reconstructs it with each constraint.
fn reconstruct_drive(
    demo: &DemoOptions,
    setting: &'static Setting,
    steps_before: usize,
    progress: &mut dyn Progress,
) -> Result<DriveOutcome, Error> {
    let folder = demo.folder.join(setting.name);
    let plan = plan(demo, setting, folder.join("drive"))?;
    let drive = plan.drive()?;
    let num_steps = SETTINGS.iter().map(Setting::num_steps).sum();
    let begin = |step: usize, what: &str, progress: &mut dyn Progress| {
        let what = format!("{}: {what}", setting.name);
        progress.step(steps_before + step, num_steps, &what);
    };
    begin(1, "render the images", progress);
    let rendered = render(&plan, &drive, progress)?;
    let scan = Cloud::new(scan(&drive)?);
    let options = |rig| Options {
        features: FeatureOptions {
            timestamps: Some(plan.folder.join("timestamps.csv")),
            ..FeatureOptions::default()
        },
        matching: MatchOptions {
            pairs: setting.pairs.parse().expect("it is a selection of pairs"),
            seed: demo.seed,
            ..MatchOptions::default()
        },
        mapping: MapOptions {
            mapper: MapperOptions { rig, seed: demo.seed, ..MapperOptions::default() },
            ..MapOptions::default()
        },
        ..Options::default()
    };
    let mut runs = Vec::new();
    for (step, &mode) in (2..).zip(setting.modes) {
        begin(step, &format!("reconstruct with --rig {}", mode.name()), progress);
        let workspace = folder.join(mode.name());
        if let Some(first) = runs.first().map(|run: &Run| &run.workspace) {
            // Reuses features and matches of the first run.
            Workspace::open(first)?.fork(&workspace)?;
        }
        let inputs = std::slice::from_ref(&plan.folder);
        let report =
            reconstruct(inputs, &workspace, &options(mode), &mut |event| progress.watch(event))?;
        runs.push(evaluate(mode.name(), workspace, report, &drive, &rendered, scan.as_ref())?);
    }
    let true_offset_s = true_offset_s(&drive);
    Ok(DriveOutcome { name: setting.name, plan, setting, drive: rendered, true_offset_s, runs })
}

/// The drive to render.
fn plan(demo: &DemoOptions, setting: &Setting, folder: PathBuf) -> Result<Plan, Error> {
    let effects =
        EFFECTS.parse().map_err(|error: tiepoint_synth::Error| Error::Usage(error.to_string()))?;
    let options = DriveOptions {
        seed: demo.seed,
        route: setting.route,
        length_m: setting.length_m,
        mounts: Mount::stereo(ViewDirection::Front, BASELINE_M).to_vec(),
        width: demo.size[0],
        height: demo.size[1],
        rate_hz: setting.rate_hz,
        effects,
        ..DriveOptions::default()
    };
    let frames = [demo.frames, setting.frames].into_iter().flatten().min();
    Ok(Plan { folder, frames, options })
}

fn evaluate(
    rig: &'static str,
    workspace: PathBuf,
    report: Report,
    drive: &Drive,
    rendered: &Rendered,
    scan: Option<&Cloud>,
) -> Result<Run, Error> {
    let DriveEvaluation { poses, model, rig: extrinsics, camera_errors, surface, cloud, .. } =
        evaluate_drive(&workspace, drive, &rendered.truth, scan, |_| true)?;
    let scale_drift = scale_drift(&camera_errors);
    Ok(Run {
        rig,
        heading: format!("--rig {rig}"),
        workspace,
        report,
        poses,
        model,
        extrinsics,
        camera_errors,
        surface,
        cloud,
        scale_drift,
    })
}

/// Scale of the last part of the first camera's path over that of its first part. The scale of a
/// part is the estimated distance of its ends over their true distance.
fn scale_drift(camera_errors: &[CameraError]) -> Option<f64> {
    let first = camera_errors.iter().map(|error| error.camera).min()?;
    let path: Vec<&CameraError> =
        camera_errors.iter().filter(|error| error.camera == first).collect();
    let length = path.len() / SCALE_PARTS;
    let scale_of = |from: usize| {
        let (begin, end) = (path[from], path[from + length]);
        let estimated = (end.estimated_centre - begin.estimated_centre).norm();
        let truth = (end.true_centre - begin.true_centre).norm();
        (truth > 0.0).then(|| estimated / truth)
    };
    (length > 0).then_some(())?;
    Some(scale_of(path.len() - 1 - length)? / scale_of(0)?)
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

impl DemoOutcome {
    fn write_page(&self) -> Result<(), Error> {
        let max_bytes = Thumbnails::MAX_BYTES / self.drives.len();
        let photos: Vec<_> = self.drives.iter().map(|drive| drive.photos(max_bytes)).collect();
        let parts: Vec<_> = self
            .drives
            .iter()
            .zip(&photos)
            .map(|(drive, photos)| (drive.report_models(photos), [drive.table()], drive.note()))
            .collect();
        let sections: Vec<ReportSection> = self
            .drives
            .iter()
            .zip(&parts)
            .map(|(drive, (models, tables, note))| ReportSection {
                heading: drive.setting.heading,
                note,
                tables,
                models,
                ..ReportSection::default()
            })
            .collect();
        let page = report_html("tiepoint demo", &sections, Vec::new());
        Ok(write_page(&self.page, &page)?)
    }

    /// Tables of the errors, and the commands that give the same.
    pub fn describe(&self) -> String {
        let mut text = String::new();
        for drive in &self.drives {
            text += &format!("{}\n{}\n\n", drive.setting.heading, drive.note());
            text += &format!("{}\n", drive.table().to_text());
        }
        text += &format!(
            "wall time {:.1} s\nopen in a browser: {}\n\nThe same as these commands:\n",
            self.seconds,
            self.page.display()
        );
        text + &self.drives.iter().map(DriveOutcome::commands).collect::<String>()
    }
}

impl DriveOutcome {
    fn report_models<'a>(&'a self, photos: &'a Thumbnails) -> Vec<ReportModel<'a>> {
        let model = |run: &'a Run| ReportModel {
            name: &run.heading,
            model: &run.model,
            rig: run.extrinsics.as_ref(),
            world_from_model: Some(run.poses.truth_from_model),
            report: Some(&run.report),
            camera_errors: &run.camera_errors,
            cloud_errors: &[],
            dense: None,
            photos: Some(photos),
        };
        self.runs.iter().map(model).collect()
    }

    /// Small copies of the rendered images, which all runs share.
    fn photos(&self, max_bytes: usize) -> Thumbnails {
        let run = self.runs.last().expect("all modes are run");
        Thumbnails::of_workspace(&run.workspace, &run.model, max_bytes)
    }

    /// What the drive is, and how the errors of `off` and `auto` compare.
    fn note(&self) -> String {
        let ate = |rig: &str| {
            let run = self.runs.iter().find(|run| run.rig == rig).expect("all modes are run");
            run.poses.centre_error.rmse
        };
        let (off, auto) = (ate("off"), ate("auto"));
        let images: usize = self.drive.cameras.iter().map(|camera| camera.images).sum();
        let (off_cm, auto_cm) = (100.0 * off, 100.0 * auto);
        let verdict = if off > MIN_GAIN * auto {
            format!(
                "With the rig (--rig auto) the position error is {auto_cm:.1} cm, {:.1} times \
                smaller than without it ({off_cm:.1} cm).",
                off / auto
            )
        } else {
            let why = match self.setting.route {
                RouteKind::Loop => ": a closed loop determines its scale by itself",
                _ => "",
            };
            format!(
                "The rig gains nothing here{why}. The position error is {auto_cm:.1} cm with it \
                (--rig auto) and {off_cm:.1} cm without."
            )
        };
        format!(
            "{:.0} m, {images} images of two cameras whose clocks differ. {verdict}",
            self.drive.driven_m
        )
    }

    /// Results of all runs, a column each.
    fn table(&self) -> Table {
        let mut rows: Vec<TableRow> = Vec::new();
        let mut row = |name: &str, value: &dyn Fn(&Run) -> Option<String>| {
            let values = self.runs.iter().map(|run| value(run).unwrap_or_else(|| "-".to_owned()));
            rows.push((name.to_owned(), values.collect()));
        };
        row("images with a pose", &|run| {
            Some(format!("{} of {}", run.poses.registered, run.poses.images))
        });
        row("position error (ATE), RMS", &|run| {
            Some(format!("{:.4} m", run.poses.centre_error.rmse))
        });
        row("position error, median", &|run| {
            Some(format!("{:.4} m", run.poses.centre_error.median))
        });
        row("rotation error, median", &|run| {
            Some(format!("{:.4}°", run.poses.rotation_error_deg.median))
        });
        row("change of scale, first to last fifth", &|run| {
            Some(format!("{:+.2} %", 100.0 * (run.scale_drift? - 1.0)))
        });
        row("focal length (error)", &|run| {
            let focal = run.poses.focal_lengths.first()?;
            let percent = 100.0 * (focal.model_px / focal.truth_px? - 1.0);
            Some(format!("{:.2} px ({percent:+.2} %)", focal.model_px))
        });
        row(&format!("baseline of the rig (true {BASELINE_M} m)"), &|run| {
            let [x, y, z] = run.right_camera()?.centre_in_rig;
            Some(format!("{:.4} m", run.poses.scale * (x * x + y * y + z * z).sqrt()))
        });
        let true_ms = 1e3 * self.true_offset_s;
        row(&format!("time offset (true {true_ms:.2} ms)"), &|run| {
            let clock = &run.right_camera()?.clock;
            Some(format!("{:.2} ± {:.2} ms", 1e3 * clock.offset_s, 1e3 * clock.offset_sd_s?))
        });
        row("surface distance to 30 m, median", &|run| {
            Some(format!("{:.4} m", run.surface.as_ref()?.near.as_ref()?.median))
        });
        row("  of the same points, true cameras", &|run| {
            Some(format!("{:.4} m", run.surface.as_ref()?.near_floor.as_ref()?.median))
        });
        row("cloud to laser scan, mean ± sd", &|run| {
            let distance = &run.cloud.as_ref()?.distance;
            Some(format!("{:.3} ± {:.3} m", distance.mean, distance.std))
        });
        row("points", &|run| Some(run.report.models.first()?.points.to_string()));
        row("mapping time", &|run| {
            Some(format!("{:.1} s", run.report.stages.map.as_ref()?.seconds))
        });
        let headings: Vec<String> = self.runs.iter().map(|run| run.heading.clone()).collect();
        Table::of_columns(&headings, rows)
    }

    /// The commands that give the same results.
    fn commands(&self) -> String {
        let Self { plan, setting, .. } = self;
        let DriveOptions { width, height, seed, length_m, rate_hz, .. } = plan.options;
        let (folder, truth) = (plan.folder.display(), self.drive.truth.display());
        let route = setting.route.name();
        let frames = plan.frames.map(|frames| format!(" --frames {frames}")).unwrap_or_default();
        let mut text = format!(
            "  tiepoint synth -o {folder} --route {route} --length {length_m} --rate {rate_hz} \
            --effects {EFFECTS} --size {width}x{height} --seed {seed}{frames}\n"
        );
        for Run { rig, workspace, .. } in &self.runs {
            let workspace = workspace.display();
            text += &format!(
                "  tiepoint reconstruct {folder} -o {workspace} --rig {rig} --pairs {} \
                --timestamps {folder}/timestamps.csv --seed {seed}\n  tiepoint evaluate poses \
                {workspace} --truth colmap:{truth}\n",
                setting.pairs
            );
        }
        text
    }
}
