//! `experiment`: Experiments I and II of Huang, Elhashash & Qin 2022 in the rendered world, where
//! the truth is known.
//!
//! Both drive along one street on a loop whose end overlaps with its beginning. I (`mounting`): one
//! camera, looking to the front, right, rear and left in turn. II (`baseline`): two cameras that
//! look right, reconstructed with and without a constraint between them. What is measured is what
//! the paper measures, the distance of the cloud to a laser scan after registration, scans of one
//! side where a camera sees one side; beside it stand the distances that exactly known cameras
//! would have, and the error of the trajectory. A sparse cloud takes the place of the dense one.
//!
//! Each drive and each reconstruction has a folder of its own that is kept: what is complete is not
//! made again.

mod cell;
mod drive;
mod side;
mod tables;

use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_pipeline::sfm::RigTerm;
use tiepoint_pipeline::{Exhibit, Report, Table, Workspace, report_html};
use tiepoint_synth::{Drive, DriveOptions, Mount, Mounting, RouteKind};

use super::judge::{read_drive_model, whereabouts};
use super::synth::{BASELINE_M, Plan, claim};
use crate::args::{Experiment, Scenery, rig_name};
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;
use cell::{Cell, Scan, Task};
use drive::write;
use side::Side;

/// What the files in the folder were made from.
const RECORD: &str = "experiment.json";
/// Mountings of the paper's Table 3, in its order.
const MOUNTINGS: [(&str, Mounting); 4] = [
    ("Front", Mounting::Front),
    ("Right", Mounting::Right),
    ("Rear", Mounting::Rear),
    ("Left", Mounting::Left),
];

#[derive(Serialize)]
struct Outcome {
    experiment: &'static str,
    folder: PathBuf,
    /// Where to look at tables, clouds and trajectories.
    page: PathBuf,
    cells: Vec<Cell>,
    #[serde(skip)]
    tables: Vec<Table>,
}

pub(crate) fn experiment(experiment: &Experiment, output: &Output) -> Result<(), Failure> {
    let outcome = match experiment {
        Experiment::Mounting(scenery) => mounting(scenery, output)?,
        Experiment::Baseline { scenery, rig } => baseline(scenery, rig, output)?,
    };
    let text = || outcome.tables.iter().map(|table| table.to_text() + "\n").collect::<String>();
    output.result(&outcome, || format!("{}to look at: {}\n", text(), outcome.page.display()))
}

fn mounting(scenery: &Scenery, output: &Output) -> Result<Outcome, Failure> {
    let plan = |folder: PathBuf, mounting| plan(scenery, folder, vec![Mount::of(mounting)]);
    let folder = scenery.output.join("mounting");
    begin(scenery, &folder, &plan(PathBuf::new(), Mounting::Front)?)?;
    let mut progress = Progress::new(output);
    // The street and the way are the same for all, so the scan is.
    let whole = Scan::new();
    let (mut cells, mut drives) = (Vec::new(), Vec::new());
    for (name, mounting) in MOUNTINGS {
        let own = folder.join(mounting.name());
        let plan = plan(own.join("drive"), mounting)?;
        let drive = plan.drive()?;
        let task = Task {
            name,
            rig: RigTerm::Off,
            workspace: own.join("off"),
            scenery,
            plan: &plan,
            drive: &drive,
        };
        // Where a camera sees one side of the street, that side is what is compared.
        let side = match mounting {
            Mounting::Right => Side::right(&drive),
            Mounting::Left => Side::left(&drive),
            Mounting::Front | Mounting::FrontRight | Mounting::Rear => Side::both(),
        };
        cells.push(task.run(&side, &whole, &mut progress)?);
        drives.push(drive);
    }
    drop(progress);
    let tables = tables::of_mountings(&cells);
    finish("mounting", folder, cells, &drives.iter().collect::<Vec<_>>(), tables)
}

fn baseline(scenery: &Scenery, rigs: &[RigTerm], output: &Output) -> Result<Outcome, Failure> {
    let folder = scenery.output.join("baseline");
    let plan =
        plan(scenery, folder.join("drive"), Mount::stereo(Mounting::Right, BASELINE_M).to_vec())?;
    let drive = plan.drive()?;
    begin(scenery, &folder, &plan)?;
    let mut progress = Progress::new(output);
    let (mut cells, whole) = (Vec::new(), Scan::new());
    for (index, rig) in rigs.iter().enumerate().filter(|(index, rig)| !rigs[..*index].contains(rig))
    {
        let workspace = folder.join(rig_name(*rig));
        let first = folder.join(rig_name(rigs[0]));
        if index > 0
            && first.join("stages.json").is_file()
            && !workspace.join("stages.json").is_file()
        {
            // Features and matches are the same.
            Workspace::open(&first)?.fork(&workspace)?;
        }
        let name = tables::row_of(*rig);
        let task = Task { name: &name, rig: *rig, workspace, scenery, plan: &plan, drive: &drive };
        cells.push(task.run(&Side::right(&drive), &whole, &mut progress)?);
    }
    drop(progress);
    let tables = tables::of_constraints(&cells);
    let drives = vec![&drive; cells.len()];
    finish("baseline", folder, cells, &drives, tables)
}

fn plan(scenery: &Scenery, folder: PathBuf, mounts: Vec<Mount>) -> Result<Plan, Failure> {
    let Scenery { frames, size, seed, rate, length, effects, .. } = scenery;
    let options = DriveOptions {
        seed: *seed,
        route: RouteKind::Loop,
        length_m: *length,
        mounts,
        width: size.width,
        height: size.height,
        rate_hz: *rate,
        effects: *effects,
        ..DriveOptions::default()
    };
    Ok(Plan { folder, frames: *frames, options })
}

/// Takes the folder for an experiment with these options.
fn begin(scenery: &Scenery, folder: &Path, plan: &Plan) -> Result<(), Failure> {
    if let Some(frames) =
        scenery.frames.map(usize::from).filter(|frames| *frames < cell::MIN_FRAMES)
    {
        let least = cell::MIN_FRAMES;
        return Err(Failure::Usage(format!(
            "--frames {frames} is too few: a trajectory can be compared from {least} frames on"
        )));
    }
    // Says what cannot be driven before anything is written.
    plan.drive()?;
    claim(folder, RECORD, &format!("{}pairs {}\n", plan.record(), scenery.pairs), "an experiment")
}

/// Writes the tables and the page.
fn finish(
    experiment: &'static str,
    folder: PathBuf,
    cells: Vec<Cell>,
    drives: &[&Drive],
    tables: Vec<Table>,
) -> Result<Outcome, Failure> {
    let mut shown = Vec::new();
    for (cell, drive) in cells.iter().zip(drives) {
        let Some(world_from_model) = cell.world_from_model() else { continue };
        let model = read_drive_model(&cell.workspace, drive)?;
        let places = whereabouts(&model, drive, &world_from_model);
        let report: Report = Workspace::open(&cell.workspace)?.report()?;
        shown.push((cell, world_from_model, model, places, report));
    }
    let exhibits: Vec<Exhibit> = shown
        .iter()
        .map(|(cell, world_from_model, model, whereabouts, report)| Exhibit {
            name: &cell.name,
            model,
            world_from_model: Some(*world_from_model),
            report: Some(report),
            whereabouts,
        })
        .collect();
    let page = folder.join("report.html");
    let title = format!("tiepoint experiment {experiment}");
    write(&page, &report_html(&title, &exhibits, &tables, Vec::new()))?;
    write(
        &folder.join("tables.md"),
        &tables.iter().map(|table| table.to_markdown() + "\n").collect::<String>(),
    )?;
    Ok(Outcome { experiment, folder, page, cells, tables })
}
