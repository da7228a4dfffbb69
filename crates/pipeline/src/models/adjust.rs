//! Bundle adjustment of a COLMAP model or a BAL problem.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use tiepoint_io::bal::{Bal, BalCamera, BalObservation};
use tiepoint_sfm as sfm;
use tiepoint_sfm::adjust::{AdjustOptions, RefineIntrinsics, Scope};
use tiepoint_sfm::ba::factors::Reprojection;
use tiepoint_sfm::ba::{
    EliminationOrder, IterationRecord, Key, Problem, Solver, Summary, Termination,
};
use tiepoint_sfm::geometry::cameras::Radial;
use tiepoint_sfm::geometry::nalgebra::{Quaternion, SVector, UnitQuaternion, Vector2, Vector3};
use tiepoint_sfm::geometry::{Loss, Rigid3, so3};
use tiepoint_store::{Replace, write_file};

use crate::models::model_tools::frame_in_words;
use crate::stages::control_points::ControlPoints;
use crate::workspace::control_report::ControlReport;
use crate::workspace::located_model::LocatedModel;
use crate::{Error, Event, Watch, emit};

/// Summary of a bundle adjustment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AdjustReport {
    /// ½ Σ ρ(|r|²) before the first step. Residuals are in pixels, divided by the scale of the
    /// keypoint where it is known.
    pub initial_cost: f64,
    /// ½ Σ ρ(|r|²) after the last step.
    pub final_cost: f64,
    /// Number of attempted steps.
    pub iterations: usize,
    /// Wall time without reading and writing files.
    pub seconds: f64,
    /// Whether a convergence criterion was met.
    pub converged: bool,
    /// Number of scalar residuals.
    pub residuals: usize,
    /// Number of images; of a BAL problem, of cameras.
    pub images: usize,
    /// Number of points.
    pub points: usize,
    /// Cost over time.
    pub steps: Vec<AdjustStep>,
    /// The frame of the control points, as a sentence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// The control points that took part, and the check points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_points: Option<ControlReport>,
}

/// An attempted step of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AdjustStep {
    /// Wall time since the start of the optimiser.
    pub seconds: f64,
    /// ½ Σ ρ(|r|²) after the step.
    pub cost: f64,
    /// Whether the step was accepted.
    pub accepted: bool,
}

const MAX_ITERATIONS: usize = 100;

/// Adjusts a model (a folder with a COLMAP model, a workspace, or a BAL file) and writes the result
/// to `output` in the format of the input. Calibrated intrinsics have a prior at the calibration,
/// or are constant where mapping kept them. With `fix_intrinsics` all are constant. Images of a rig
/// frame keep their sensor_from_rig in common. `overwrite` permits to replace a file at `output`.
/// With `control_points`, a file of them, the model is brought into their frame, and adjusted
/// together with them; the report is that of the last adjustment.
///
/// # Errors
///
/// Where the model cannot be read or adjusted, or the result cannot be written.
pub fn adjust(
    path: &Path,
    output: Option<&Path>,
    overwrite: bool,
    fix_intrinsics: bool,
    control_points: Option<&Path>,
    watch: Watch,
) -> Result<AdjustReport, Error> {
    if path.is_dir() {
        let points = control_points.map(ControlPoints::read).transpose()?;
        adjust_colmap(&LocatedModel::open(path)?, output, fix_intrinsics, points.as_ref(), watch)
    } else if let Some(file) = control_points {
        Err(Error::NoAlignment {
            model: path.to_owned(),
            reference: file.to_owned(),
            reason: "images of a BAL problem have no names".to_owned(),
        })
    } else {
        let output = output.map(|output| (output, Replace::new(None, overwrite)));
        adjust_bal(path, output, fix_intrinsics, watch)
    }
}

fn adjust_colmap(
    located: &LocatedModel,
    output: Option<&Path>,
    fix_intrinsics: bool,
    control_points: Option<&ControlPoints>,
    watch: Watch,
) -> Result<AdjustReport, Error> {
    if let Some(what) = located.note() {
        emit(watch, &Event::Noted { what })?;
    }
    let mut model = located.reconstruction.clone();
    let defaults = AdjustOptions::default();
    let refine = if fix_intrinsics { RefineIntrinsics::NONE } else { defaults.refine };
    let options = AdjustOptions { refine, max_iterations: MAX_ITERATIONS, ..defaults };
    let start = Instant::now();
    let mut watch = |step: &IterationRecord| {
        watch(&Event::AdjustmentStep { step: step.number, cost: step.cost })
    };
    let (summary, points) = match control_points {
        Some(points) => {
            let placed = (located.folder(), &mut model);
            let found = points.adjust_finished(placed, &located.shutters, &options, &mut watch)?;
            (found.summary, Some(ControlReport::from(found.points)))
        }
        None => {
            let scope = &Scope::Global;
            let adjusted = sfm::adjust::adjust(&mut model, scope, &options, &mut [], &mut watch);
            (adjusted.map_err(Error::adjusting(located.folder()))?, None)
        }
    };
    let (images, num_points) = (model.num_registered(), model.num_tracks());
    let report = AdjustReport {
        frame: control_points.map(|points| frame_in_words(&points.georeference())),
        control_points: points,
        ..AdjustReport::new(&summary, start, images, num_points)?
    };
    if let Some(output) = output {
        let mut inputs = located.files();
        inputs.extend(control_points.map(|points| points.file().to_owned()));
        located.changed(model).write(output, &inputs)?;
    }
    Ok(report)
}

/// The cost function is that of the BAL paper: no robust loss, no priors, residuals in pixels. A
/// BAL camera looks along −z; a rotation by π about x converts it.
fn adjust_bal(
    path: &Path,
    output: Option<(&Path, Replace)>,
    fix_intrinsics: bool,
    watch: Watch,
) -> Result<AdjustReport, Error> {
    let mut bal = Bal::read(path)?;
    let start = Instant::now();
    let mut problem = Problem::new();
    let half_turn = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
    let mut cameras: Vec<(Key<SVector<f64, 5>>, Key<Rigid3>)> =
        Vec::with_capacity(bal.cameras.len());
    for (index, camera) in bal.cameras.iter().enumerate() {
        let order = EliminationOrder::At(index as u32);
        let params = SVector::<f64, 5>::new(camera.focal_px, 0.0, 0.0, camera.k1, camera.k2);
        let rotation = half_turn * so3::exp(&camera.axis_angle_rad);
        let params = problem.add_parameter(params, order);
        // BAL has the principal point at the origin.
        problem.fix_dofs(params, &[1, 2]).map_err(sfm::Error::from)?;
        if fix_intrinsics {
            problem.fix(params);
        }
        cameras.push((
            params,
            problem.add_parameter(Rigid3::new(rotation, half_turn * camera.translation), order),
        ));
    }
    let poses: Vec<Key<Rigid3>> = cameras.iter().map(|(_, pose)| *pose).collect();
    sfm::adjust::fix_gauge(&mut problem, &poses, &vec![false; poses.len()], None)
        .map_err(sfm::Error::from)?;
    let points: Vec<Key<Vector3<f64>>> =
        bal.points.iter().map(|xyz| problem.add_landmark(*xyz)).collect();
    for BalObservation { camera, point, pixel } in &bal.observations {
        let (params, pose) = cameras[*camera as usize];
        let factor = Reprojection::<Radial>::new(Vector2::new(pixel.x, -pixel.y), 1.0);
        let keys = (params, pose, points[*point as usize]);
        problem.add(keys, factor, Loss::Trivial).map_err(sfm::Error::from)?;
    }
    let options = sfm::ba::Options { max_iterations: MAX_ITERATIONS, ..Default::default() };
    let mut watch = |step: &IterationRecord| {
        watch(&Event::AdjustmentStep { step: step.number, cost: step.cost })
    };
    let summary = Solver::new(&problem, &options)
        .and_then(|mut solver| solver.solve_with(&mut problem, &mut watch))
        .map_err(Error::adjusting(path))?;
    let report = AdjustReport::new(&summary, start, cameras.len(), points.len())?;
    if let Some((output, replace)) = output {
        for (camera, (params, pose)) in bal.cameras.iter_mut().zip(&cameras) {
            let (params, pose) = (problem.get(*params), problem.get(*pose));
            *camera = BalCamera {
                axis_angle_rad: so3::log(&(half_turn * pose.rotation)),
                translation: half_turn * pose.translation,
                focal_px: params[0],
                k1: params[3],
                k2: params[4],
            };
        }
        bal.points = points.iter().map(|point| problem.get(*point)).collect();
        write_file(output, [path], replace, |output| Ok::<_, Error>(bal.write(output)?))?;
    }
    Ok(report)
}

impl AdjustReport {
    /// The report of an adjustment that began at `start`.
    ///
    /// # Errors
    ///
    /// [`Error::Cancelled`] if the adjustment was stopped.
    pub fn new(
        summary: &Summary,
        start: Instant,
        images: usize,
        points: usize,
    ) -> Result<Self, Error> {
        if summary.termination == Termination::Cancelled {
            return Err(Error::Cancelled);
        }
        Ok(Self {
            initial_cost: summary.initial_cost,
            final_cost: summary.final_cost,
            iterations: summary.iterations.len(),
            seconds: start.elapsed().as_secs_f64(),
            converged: summary.termination.converged(),
            residuals: summary.num_residuals,
            images,
            points,
            steps: summary
                .iterations
                .iter()
                .map(|step| AdjustStep {
                    seconds: step.elapsed.as_secs_f64(),
                    cost: step.cost,
                    accepted: step.accepted,
                })
                .collect(),
            frame: None,
            control_points: None,
        })
    }
}
