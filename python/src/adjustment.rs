//! Bundle adjustment of a model.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use numpy::ndarray::{Axis, Ix2, IxDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tiepoint_geometry::Loss;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CameraId, ImageId};
use tiepoint_sfm::adjust::ba::factors::{Centre, RigCentre};
use tiepoint_sfm::adjust::{
    AdjustOptions, Error, FocalPrior, Gauge, RefineIntrinsics, Scope, Term, TermContext, Variables,
    adjust,
};

use crate::arrays::{invalid_array, numbers, selection};
use crate::errors::{failed, invalid};
use crate::fork::refuse_after_fork;
use crate::model::Reconstruction;

/// Names of losses, and of what they are.
type NewLoss = fn(f64) -> Loss;
const LOSSES: [(&str, NewLoss); 5] = [
    ("trivial", |_| Loss::Trivial),
    ("huber", Loss::Huber),
    ("soft_l1", Loss::SoftL1),
    ("cauchy", Loss::Cauchy),
    ("tukey", Loss::Tukey),
];

/// Measured centres of images, with the standard deviation of each axis.
struct Centers(Vec<(ImageId, Vector3<f64>, [f64; 3])>);

impl Centers {
    /// The factor of an image. Residuals are in standard deviations of the keypoints, of which
    /// `noise` is the scale.
    fn factor(&self, image: ImageId, noise: f64) -> Result<Option<Centre>, Error> {
        let Ok(at) = self.0.binary_search_by_key(&image, |(id, ..)| *id) else { return Ok(None) };
        let (_, center, sigmas) = &self.0[at];
        Ok(Some(Centre::new(*center, &sigmas.map(|sigma| sigma / noise))?))
    }
}

impl Term for Centers {
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        for (image, pose) in variables.poses().to_vec() {
            if let Some(factor) = self.factor(image, context.noise)? {
                variables.problem_mut().add((pose,), factor, Loss::Trivial)?;
            }
        }
        for (image, pose) in variables.composed_poses().to_vec() {
            if let Some(factor) = self.factor(image, context.noise)? {
                let keys = (pose.cam_from_rig, pose.rig_from_world);
                variables.problem_mut().add(keys, RigCentre(factor), Loss::Trivial)?;
            }
        }
        Ok(())
    }
}

/// Intrinsics to refine, from a list of words, or a text with commas between them.
fn refined(refine: &Bound<'_, PyAny>) -> PyResult<RefineIntrinsics> {
    let words: Vec<String> = match refine.extract::<String>() {
        Ok(text) => text.split(',').map(|word| word.trim().to_owned()).collect(),
        Err(_) => {
            refine.extract().map_err(|_| invalid("refine must be a text or a list of texts"))?
        }
    };
    let mut refined = RefineIntrinsics::NONE;
    for word in words.iter().filter(|word| !word.is_empty()) {
        match word.as_str() {
            "none" if words.len() == 1 => {}
            "focal" => refined.focal = true,
            "aspect" => refined.aspect = true,
            "principal-point" => refined.principal_point = true,
            "distortion" => refined.distortion = true,
            "prism" => refined.prism = true,
            _ => {
                return Err(invalid(format!(
                    "refine has '{word}': it is none, or a list of focal, aspect, \
                    principal-point, distortion and prism"
                )));
            }
        }
    }
    Ok(refined)
}

fn loss_of(name: &str, scale: f64) -> PyResult<Loss> {
    let Some((_, new)) = LOSSES.iter().find(|(other, _)| *other == name) else {
        let names: Vec<&str> = LOSSES.iter().map(|(name, _)| *name).collect();
        return Err(invalid(format!("loss is '{name}': it is one of {}", names.join(", "))));
    };
    let loss = new(scale);
    loss.validate().map_err(invalid)?;
    Ok(loss)
}

/// The measured centres of images. A row of `centers` with NaN is an image without one; `sigmas`
/// are a number, or an array of shape (N,) or (N, 3).
fn centers_of(
    images: &[ImageId],
    centers: &Bound<'_, PyAny>,
    sigmas: Option<&Bound<'_, PyAny>>,
) -> PyResult<Centers> {
    let count = images.len();
    let shape = format!("({count}, 3)");
    let positions = numbers::<Ix2>(centers, "centers", &shape)?;
    let positions = positions.as_array();
    if positions.dim() != (count, 3) {
        return Err(invalid_array(centers, "centers", "numbers", &shape));
    }
    let Some(sigmas) = sigmas else {
        return Err(invalid("centers need center_sigmas, their standard deviations"));
    };
    let shape = format!("(), ({count},) or {shape}");
    let deviations = numbers::<IxDyn>(sigmas, "center_sigmas", &shape)?;
    let deviations = deviations.as_array();
    let deviations = match deviations.shape() {
        [rows] if *rows == count => deviations.insert_axis(Axis(1)),
        [] => deviations,
        [rows, 3] if *rows == count => deviations,
        _ => return Err(invalid_array(sigmas, "center_sigmas", "numbers", &shape)),
    };
    let deviations = deviations.broadcast((count, 3)).expect("the shape was checked");
    let mut all = Vec::new();
    for ((image, center), sigmas) in
        images.iter().zip(positions.outer_iter()).zip(deviations.outer_iter())
    {
        let center = Vector3::from_fn(|axis, _| center[axis]);
        if center.iter().any(|value| value.is_nan()) {
            continue;
        }
        if !(center.iter().all(|value| value.is_finite()) && sigmas.iter().all(|s| *s > 0.0)) {
            return Err(invalid(
                "centers must be finite, or NaN for images without one, and center_sigmas greater \
                than 0",
            ));
        }
        all.push((*image, center, [0, 1, 2].map(|axis| sigmas[axis])));
    }
    Ok(Centers(all))
}

/// Bundle adjustment of a model, in place. Images of a frame stay rigidly connected. Returns a
/// dictionary with `initial_cost`, `final_cost`, `iterations` and `converged`. Ctrl-C stops it at
/// the next step and keeps what was reached.
///
/// - `refine`: the intrinsics that are refined: none, or a list of focal, aspect, principal-point,
///   distortion, prism.
/// - `fixed_poses`: images whose poses stay, as a mask or indices; of a frame of a rig all images
///   stay, and need `fixed_rigs`: whether the poses of cameras on their rigs stay.
/// - `loss`: trivial, huber, soft_l1, cauchy or tukey, of residuals in standard deviations of the
///   keypoints, with `loss_scale` in the same unit.
/// - `focal_priors`: rows of the index of a camera, a focal length and its standard deviation, in
///   pixels. Cameras that a calibration gave exactly are not refined.
/// - `centers`: measured centres of the images in the world, of shape (N, 3), NaN for images
///   without one; `center_sigmas`: their standard deviations, a number or an array of shape (N,) or
///   (N, 3). The model must be near them (`transform`); then they determine its frame.
#[pyfunction]
#[pyo3(signature = (
    reconstruction, *, refine=None, fixed_poses=None, fixed_rigs=false, loss="soft_l1",
    loss_scale=4.0, focal_priors=Vec::new(), centers=None, center_sigmas=None, max_iterations=100
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn bundle_adjust<'py>(
    python: Python<'py>,
    reconstruction: &Bound<'py, Reconstruction>,
    refine: Option<&Bound<'py, PyAny>>,
    fixed_poses: Option<&Bound<'py, PyAny>>,
    fixed_rigs: bool,
    loss: &str,
    loss_scale: f64,
    focal_priors: Vec<[f64; 3]>,
    centers: Option<&Bound<'py, PyAny>>,
    center_sigmas: Option<&Bound<'py, PyAny>>,
    max_iterations: usize,
) -> PyResult<Bound<'py, PyDict>> {
    refuse_after_fork()?;
    let mut reconstruction = reconstruction.try_borrow_mut()?;
    let Reconstruction { model, images, .. } = &mut *reconstruction;
    let fixed =
        fixed_poses.map(|value| selection(value, "fixed_poses", images.len())).transpose()?;
    let mut fixed: BTreeSet<ImageId> =
        fixed.unwrap_or_default().into_iter().map(|index| images[index]).collect();
    for frame in model.frames.iter().filter(|frame| frame.images.len() > 1) {
        if !frame.images.iter().any(|image| fixed.contains(image)) {
            continue;
        }
        if !fixed_rigs {
            return Err(invalid(
                "fixed_poses has images of a rig, which move with it: give fixed_rigs=True",
            ));
        }
        fixed.extend(frame.images.iter().copied());
    }
    let mut priors = Vec::new();
    for [index, mean_px, sigma_px] in focal_priors {
        let count = model.num_cameras();
        let Some(camera) = (0..count).find(|camera| *camera as f64 == index) else {
            return Err(invalid(format!("focal_priors has camera {index} of {count}")));
        };
        priors.push(FocalPrior { camera: CameraId::from_index(camera), mean_px, sigma_px });
    }
    let mut measured =
        centers.map(|centers| centers_of(images, centers, center_sigmas)).transpose()?;
    let defaults = AdjustOptions::default();
    let options = AdjustOptions {
        refine: refine.map_or(Ok(defaults.refine), refined)?,
        loss: loss_of(loss, loss_scale)?,
        focal_priors: &priors,
        gauge: if measured.is_some() { Gauge::FixedByTerms } else { defaults.gauge },
        constant_poses: Some(&fixed),
        constant_rigs: fixed_rigs,
        max_iterations,
        ..defaults
    };
    options.validate().map_err(invalid)?;
    let mut interrupted = None;
    let mut watch = |_: &_| match Python::attach(|python| python.check_signals()) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            interrupted = Some(error);
            ControlFlow::Break(())
        }
    };
    let summary = python.detach(|| {
        let terms = measured.iter_mut().map(|term| term as &mut dyn Term);
        adjust(model, &Scope::Global, &options, &mut terms.collect::<Vec<_>>(), &mut watch)
    });
    if let Some(error) = interrupted {
        return Err(error);
    }
    let summary = summary.map_err(failed)?;
    let all = PyDict::new(python);
    all.set_item("initial_cost", summary.initial_cost)?;
    all.set_item("final_cost", summary.final_cost)?;
    all.set_item("iterations", summary.iterations.len())?;
    all.set_item("converged", summary.termination.converged())?;
    Ok(all)
}
