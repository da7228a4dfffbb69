//! Experiments I and II of Huang, Elhashash & Qin 2022 on rendered images with ground
//! truth.
//!
//! The vehicle drives a loop whose end overlaps its beginning, or an open route. Experiment I
//! (`mounting`): one camera that looks to the front, right, rear and left in turn. Experiment II
//! (`baseline`): two cameras that look to the right, reconstructed with and without a rig
//! constraint. As in the paper, the error is the distance of the dense cloud to a laser scan after
//! registration; a camera that looks to one side is compared with the scan of that side. The tables
//! also have the distances of the sparse cloud, those with the true cameras, and trajectory errors.
//!
//! Each drive and each reconstruction has a folder of its own. Complete ones are not computed
//! again.

mod dense_cloud;
mod distance;
mod drive;
mod run;
mod scenery;
mod side;
mod tables;

use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_pipeline::sfm::RigMode;
use tiepoint_pipeline::{Report, Workspace};
use tiepoint_report::{ReportModel, ReportSection, Table, Thumbnails, report_html};
use tiepoint_synth::{Drive, DriveOptions, Mount, ViewDirection};

use crate::drive_evaluation::{camera_errors, read_drive_model};
use crate::drive_folder::{BASELINE_M, Plan, claim};
use crate::{Error, Progress};
use dense_cloud::DenseCloud;
use drive::write;
use run::{Run, Scan, Task};
pub use scenery::Scenery;
use side::Side;

/// File with the options of the experiment in a folder.
const RECORD: &str = "experiment.json";
/// Workspace with the true poses and intrinsics.
const EXACT: &str = "true";
/// Camera configurations of Table 3 of the paper, in its order.
const VIEW_DIRECTIONS: [(&str, ViewDirection); 4] = [
    ("Front", ViewDirection::Front),
    ("Right", ViewDirection::Right),
    ("Rear", ViewDirection::Rear),
    ("Left", ViewDirection::Left),
];

/// The runs of an experiment with their errors.
#[derive(Serialize)]
pub struct ExperimentOutcome {
    experiment: &'static str,
    folder: PathBuf,
    /// HTML page with tables, clouds and trajectories.
    page: PathBuf,
    runs: Vec<Run>,
    #[serde(skip)]
    tables: Vec<Table>,
}

impl ExperimentOutcome {
    /// The tables, and where the page is.
    pub fn describe(&self) -> String {
        let tables: String = self.tables.iter().map(|table| table.to_text() + "\n").collect();
        format!("{tables}open in a browser: {}\n", self.page.display())
    }
}

/// Experiment I: one camera that looks to the front, right, rear and left in turn.
///
/// # Errors
///
/// The folder holds something else or cannot be written, a stage fails, or `progress` stops it.
pub fn view_directions(
    scenery: &Scenery,
    progress: &mut dyn Progress,
) -> Result<ExperimentOutcome, Error> {
    let plan = |folder: PathBuf, direction| plan(scenery, folder, vec![Mount::facing(direction)]);
    let folder = scenery.folder.join("mounting");
    begin(scenery, &folder, &plan(PathBuf::new(), ViewDirection::Front)?)?;
    // Street and trajectory are the same for all runs, so they share the scan.
    let scan = Scan::new();
    let (mut runs, mut drives) = (Vec::new(), Vec::new());
    for (name, direction) in VIEW_DIRECTIONS {
        let own = folder.join(direction.name());
        let plan = plan(own.join("drive"), direction)?;
        let drive = plan.drive()?;
        let task = Task {
            name,
            rig: RigMode::Off,
            workspace: own.join("off"),
            exact: own.join(EXACT),
            scenery,
            plan: &plan,
            drive: &drive,
        };
        // A camera that looks to one side is compared on that side only.
        let side = match direction {
            ViewDirection::Right => Side::right(&drive),
            ViewDirection::Left => Side::left(&drive),
            ViewDirection::Front | ViewDirection::FrontRight | ViewDirection::Rear => Side::both(),
        };
        runs.push(task.run(&side, &scan, progress)?);
        drives.push(drive);
    }
    let tables = tables::view_directions(&runs);
    write_results("mounting", folder, runs, &drives.iter().collect::<Vec<_>>(), tables)
}

/// Experiment II: two cameras that look to the right, a run for each rig constraint.
///
/// # Errors
///
/// The folder holds something else or cannot be written, a stage fails, or `progress` stops it.
pub fn constraints(
    scenery: &Scenery,
    rigs: &[RigMode],
    progress: &mut dyn Progress,
) -> Result<ExperimentOutcome, Error> {
    let folder = scenery.folder.join("baseline");
    let plan = plan(
        scenery,
        folder.join("drive"),
        Mount::stereo(ViewDirection::Right, BASELINE_M).to_vec(),
    )?;
    let drive = plan.drive()?;
    begin(scenery, &folder, &plan)?;
    let (mut runs, scan) = (Vec::new(), Scan::new());
    for (index, rig) in rigs.iter().enumerate().filter(|(index, rig)| !rigs[..*index].contains(rig))
    {
        let workspace = folder.join(rig.name());
        let first = folder.join(rigs[0].name());
        if index > 0
            && first.join("stages.json").is_file()
            && !workspace.join("stages.json").is_file()
        {
            // Reuses features and matches of the first run.
            Workspace::open(&first)?.fork(&workspace)?;
        }
        let name = tables::row_of(*rig);
        let exact = folder.join(EXACT);
        let (rig, plan, drive) = (*rig, &plan, &drive);
        let task = Task { name: &name, rig, workspace, exact, scenery, plan, drive };
        runs.push(task.run(&Side::right(drive), &scan, progress)?);
    }
    let tables = tables::of_constraints(&runs);
    let drives = vec![&drive; runs.len()];
    write_results("baseline", folder, runs, &drives, tables)
}

fn plan(scenery: &Scenery, folder: PathBuf, mounts: Vec<Mount>) -> Result<Plan, Error> {
    let Scenery { frames, size, seed, rate_hz, route, length_m, effects, .. } = scenery;
    let options = DriveOptions {
        seed: *seed,
        route: *route,
        length_m: *length_m,
        mounts,
        width: size[0],
        height: size[1],
        rate_hz: *rate_hz,
        effects: *effects,
        ..DriveOptions::default()
    };
    Ok(Plan { folder, frames: *frames, options })
}

/// Checks the options and claims the folder for an experiment with them.
fn begin(scenery: &Scenery, folder: &Path, plan: &Plan) -> Result<(), Error> {
    if let Some(frames) = scenery.frames.map(usize::from).filter(|frames| *frames < run::MIN_FRAMES)
    {
        let least = run::MIN_FRAMES;
        return Err(Error::Usage(format!(
            "--frames {frames} is too few: the alignment of a trajectory needs {least} frames"
        )));
    }
    // Rejects impossible options before anything is written.
    plan.drive()?;
    // A row without dense clouds is not completed later.
    let clouds = if scenery.has_dense_clouds { "" } else { "sparse clouds only\n" };
    let record = format!("{}pairs {}\n{clouds}", plan.record(), scenery.pairs);
    claim(folder, RECORD, &record, "an experiment")
}

/// Writes tables.md and report.html.
fn write_results(
    experiment: &'static str,
    folder: PathBuf,
    runs: Vec<Run>,
    drives: &[&Drive],
    tables: Vec<Table>,
) -> Result<ExperimentOutcome, Error> {
    let mut distinct: Vec<&Drive> = drives.to_vec();
    distinct.dedup_by(|one, other| std::ptr::eq(*one, *other));
    let max_bytes = Thumbnails::MAX_BYTES / distinct.len().max(1);
    // Runs on the images of one drive, which follow each other, share the photos.
    let mut photos: Vec<(&Drive, Thumbnails)> = Vec::new();
    let mut models = Vec::new();
    for (run, drive) in runs.iter().zip(drives) {
        let Some(world_from_model) = run.world_from_model() else { continue };
        let (model, rig) = read_drive_model(&run.workspace, drive)?;
        let errors = camera_errors(&model, drive, &world_from_model);
        let report: Report = Workspace::open(&run.workspace)?.report()?;
        if !photos.last().is_some_and(|(last, _)| std::ptr::eq(*last, *drive)) {
            photos.push((drive, Thumbnails::of_workspace(&run.workspace, &model, max_bytes)));
        }
        let of_cloud = run.result.as_ref().and_then(|result| result.dense.as_ref());
        let of_cloud = of_cloud.map_or_else(Vec::new, DenseCloud::errors);
        let set = photos.len() - 1;
        models.push((run, world_from_model, (model, rig), (errors, of_cloud), report, set));
    }
    let report_models: Vec<ReportModel> = models
        .iter()
        .map(|(run, world_from_model, (model, rig), (camera_errors, of_cloud), report, set)| {
            ReportModel {
                name: &run.name,
                model,
                rig: rig.as_ref(),
                world_from_model: Some(*world_from_model),
                report: Some(report),
                camera_errors,
                cloud_errors: of_cloud,
                dense: None,
                photos: Some(&photos[*set].1),
            }
        })
        .collect();
    let page = folder.join("report.html");
    let title = format!("tiepoint experiment {experiment}");
    let section =
        ReportSection { tables: &tables, models: &report_models, ..ReportSection::default() };
    write(&page, &report_html(&title, &[section], Vec::new()))?;
    write(
        &folder.join("tables.md"),
        &tables.iter().map(|table| table.to_markdown() + "\n").collect::<String>(),
    )?;
    Ok(ExperimentOutcome { experiment, folder, page, runs, tables })
}
