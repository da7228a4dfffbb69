//! Focal lengths from fundamental matrices, before any pose is known.
//!
//! For the right calibration K₂ᵀ F K₁ is an essential matrix: its two singular values are equal. The cost of a pair is
//! (σ₁ − σ₂)/(σ₁ + σ₂) (Mendonça & Cipolla 1999; Sweeney et al. 2015, "Optimizing the viewing graph"), summed robustly over the
//! verified pairs, and searched over a grid of focal lengths camera by camera, since it has several minima.

use tiepoint_geometry::nalgebra::Matrix3;
use tiepoint_geometry::{Intrinsics, Loss};
use tiepoint_scene::{CameraId, CorrespondenceGraph, Reconstruction, TwoViewKind};

/// Range of focal lengths considered, relative to the larger side of the image: 130° to 10° of view.
const RANGE: (f64, f64) = (0.25, 6.0);
/// Steps of the grid: 3.2 % each over that range.
const NUM_STEPS: usize = 100;
/// Imbalance of the singular values at which a pair is thought an outlier.
const LOSS_SCALE: f64 = 0.05;
/// A minimum counts when it lies below this share of the median over the grid; in degenerate motions the cost is flat.
const MAX_RELATIVE_MINIMUM: f64 = 0.6;
/// Pairs with fewer matches say little.
const MIN_MATCHES: usize = 30;
/// Rounds over the cameras; each depends on the others' focal lengths.
const NUM_ROUNDS: usize = 3;

/// Estimates the focal length of each camera that has none from elsewhere; returns those that were found.
pub fn estimate_focal_lengths(graph: &CorrespondenceGraph, model: &mut Reconstruction) -> Vec<CameraId> {
    let unknown: Vec<CameraId> =
        model.cameras().filter(|(_, c)| !c.has_focal_prior).map(|(id, _)| id).collect();
    let mut found = vec![false; unknown.len()];
    let rounds = if unknown.len() > 1 { NUM_ROUNDS } else { 1 };
    for _ in 0..rounds {
        for (index, &camera) in unknown.iter().enumerate() {
            if let Some(focal_px) = best_focal_px(graph, model, camera) {
                found[index] = true;
                let intrinsics = &mut model.camera_mut(camera).intrinsics;
                for &param in intrinsics.kind().focal_indices() {
                    intrinsics.params_mut()[param] = focal_px;
                }
            }
        }
    }
    unknown.into_iter().zip(found).filter_map(|(camera, found)| found.then_some(camera)).collect()
}

fn best_focal_px(graph: &CorrespondenceGraph, model: &Reconstruction, camera: CameraId) -> Option<f64> {
    let pairs: Vec<(&Matrix3<f64>, CameraId, CameraId, f64)> = graph
        .pairs()
        .iter()
        .filter(|(_, two_view)| {
            two_view.kind == TwoViewKind::Uncalibrated && two_view.matches.len() >= MIN_MATCHES
        })
        .filter_map(|(pair, two_view)| {
            let (a, b) = (model.image(pair.a).camera, model.image(pair.b).camera);
            let concerns = a == camera || b == camera;
            let weight = (two_view.matches.len() as f64).sqrt();
            two_view.fundamental.as_ref().filter(|_| concerns).map(|f| (f, a, b, weight))
        })
        .collect();
    if pairs.is_empty() {
        return None;
    }
    let side_px = f64::from(model.camera(camera).width.max(model.camera(camera).height));
    let cost = |focal_px: f64| -> f64 {
        let calibration = |id: CameraId| {
            let intrinsics = &model.camera(id).intrinsics;
            if id == camera { with_focal(intrinsics, focal_px) } else { intrinsics.calibration_matrix() }
        };
        let sum: f64 = pairs
            .iter()
            .map(|(f, a, b, weight)| {
                weight * imbalance(&(calibration(*b).transpose() * *f * calibration(*a)))
            })
            .sum();
        sum
    };
    let ratio = (RANGE.1 / RANGE.0).powf(1.0 / (NUM_STEPS - 1) as f64);
    let grid: Vec<(f64, f64)> = (0..NUM_STEPS)
        .map(|step| RANGE.0 * side_px * ratio.powi(step as i32))
        .map(|focal_px| (cost(focal_px), focal_px))
        .collect();
    let (least, focal_px) = grid.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut costs: Vec<f64> = grid.iter().map(|g| g.0).collect();
    costs.sort_by(f64::total_cmp);
    (least < MAX_RELATIVE_MINIMUM * costs[NUM_STEPS / 2])
        .then(|| golden_section(cost, focal_px / ratio, focal_px * ratio))
}

fn with_focal(intrinsics: &Intrinsics, focal_px: f64) -> Matrix3<f64> {
    let mut matrix = intrinsics.calibration_matrix();
    (matrix[(0, 0)], matrix[(1, 1)]) = (focal_px, focal_px);
    matrix
}

/// ρ of (σ₁ − σ₂)/(σ₁ + σ₂).
fn imbalance(essential: &Matrix3<f64>) -> f64 {
    let singular = essential.singular_values();
    let (first, second) = (singular[0], singular[1]);
    let relative = (first - second) / (first + second).max(f64::MIN_POSITIVE);
    Loss::GemanMcClure(LOSS_SCALE).evaluate(relative * relative)[0]
}

/// The minimum of a function with one minimum in [low, high], to 1e-4 of the interval's start.
fn golden_section(function: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let tolerance = 1e-4 * low;
    while high - low > tolerance {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if function(a) < function(b) { high = b } else { low = a }
    }
    0.5 * (low + high)
}
