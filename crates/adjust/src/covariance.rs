//! Covariance of a fit whose residuals are correlated.
//!
//! Residuals of keypoints are correlated along tracks, because detectors slip on their surface, and
//! within a part of the camera's image, because lens models leave a smooth field of displacements.
//! Such errors do not average out over many keypoints: with a field of 0.1 to 0.2 px, the
//! covariance for independent residuals states a third to an eighth of the true deviations.
//! Cluster-robust covariances need no model of the correlation.

use tiepoint_ba::nalgebra::{DMatrix, Vector2};
use tiepoint_ba::{AnyKey, ClusteredCovariance, FactorKey, Problem};
use tiepoint_scene::{CameraId, Reconstruction};

use crate::Error;
use crate::image_grid::grid_cell;
use crate::noise::FitNoise;
use crate::variables::Variables;

/// Rows and columns of the cells of an image. Errors are correlated in a cell and independent
/// between cells. Smaller cells miss a part of the correlation of a smooth field; larger ones are
/// too few: two cameras should have 20 to 50 clusters together (Cameron and Miller 2015, section
/// VI.A). It was chosen among 3 to 16 on the seeds of docs/benchmarks/rig.md, which has half and
/// double.
const CELLS: usize = 4;

/// Joint covariance of some variables in the problem of a finished model, in tangent coordinates
/// and in the order of `keys`.
///
/// The residuals of keypoints may have any correlations within a track. They may also have any
/// within a cell, a sixteenth of the images of a camera. Each variance is the larger one of the
/// covariance clustered by track and of that clustered by track and by cell (Cameron, Gelbach and
/// Miller 2011). Factors of terms and priors are independent, with the standard deviations that
/// they state. `variables` were built for the noise `noise.sigma`
/// ([`crate::AdjustOptions::noise`]).
///
/// # Errors
///
/// If a variable is undetermined, or no variable of the problem.
pub fn covariance_of_fit(
    model: &Reconstruction,
    variables: &Variables,
    noise: &FitNoise,
    keys: &[AnyKey],
) -> Result<DMatrix<f64>, Error> {
    let mut cells: Vec<(FactorKey, u32)> = variables
        .observations
        .iter()
        .map(|observation| {
            let image = model.image(observation.image);
            let pixel = &image.keypoints[observation.keypoint as usize].pixel;
            (observation.factor, cluster_cell(model, image.camera, pixel))
        })
        .collect();
    cells.sort_unstable();
    clustered_by_track_and_cell(variables.problem(), &cells, noise, keys)
}

/// The cluster of a keypoint: a part of the camera's image.
pub(crate) fn cluster_cell(model: &Reconstruction, camera: CameraId, pixel: &Vector2<f64>) -> u32 {
    let cell = grid_cell(model.camera(camera), pixel, CELLS);
    (camera.index() * CELLS * CELLS + cell) as u32
}

/// [`covariance_of_fit`] of a problem with the clusters of its reprojection errors, in order.
pub(crate) fn clustered_by_track_and_cell(
    problem: &Problem,
    cells: &[(FactorKey, u32)],
    noise: &FitNoise,
    keys: &[AnyKey],
) -> Result<DMatrix<f64>, Error> {
    let cell_of = |factor| {
        let index = cells.binary_search_by_key(&factor, |(key, _)| *key).ok()?;
        Some(cells[index].1)
    };
    let found = problem.clustered_covariance(keys, cell_of)?;
    let ClusteredCovariance { by_landmark, by_cluster, by_both, independent } = &found;
    let (by_track, by_cell) = (by_landmark.matrix(), by_cluster.matrix());
    let clustered =
        with_larger_variances(by_track, &(by_cell - by_both.matrix()), &(by_track + by_cell));
    // H counts the weights of the loss, and the scores its slopes.
    Ok(clustered * noise.curvature_excess.powi(2) + independent.matrix() * noise.sigma.powi(2))
}

/// The covariance with the variances of `base`, plus those of `addition` that are positive. The
/// difference of two covariances may have any signs, so the correlations are those of `correlated`,
/// which is positive semidefinite.
fn with_larger_variances(
    base: &DMatrix<f64>,
    addition: &DMatrix<f64>,
    correlated: &DMatrix<f64>,
) -> DMatrix<f64> {
    let larger = base.diagonal().zip_map(&addition.diagonal(), |a, b| a + b.max(0.0));
    let scales = larger.zip_map(&correlated.diagonal(), |larger, of_sum| {
        if of_sum > 0.0 { (larger / of_sum).sqrt() } else { 0.0 }
    });
    let scales = DMatrix::from_diagonal(&scales);
    &scales * correlated * &scales
}
