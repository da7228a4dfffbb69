//! Distances between a point cloud and a reference such as a laser scan, as in the tables of Huang,
//! Elhashash & Qin 2022.

use std::path::Path;

use serde::Serialize;
use tiepoint_eval::geometry::Sim3;
use tiepoint_eval::geometry::nalgebra::Vector3;
use tiepoint_eval::{Alignment, Cloud, IcpOptions, Statistics};
use tiepoint_io::colmap::read_model;
use tiepoint_io::ply;

use crate::evaluate::model_folder;
use crate::{Error, ErrorStatistics};

/// Largest number of points that ICP uses, which bounds its run time.
const MAX_ICP_POINTS: usize = 50_000;

/// Distances between the nearest points of a cloud and a reference, in units of the reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CloudEvaluation {
    /// Number of points of the cloud.
    pub points: usize,
    /// Number of points of the reference.
    pub reference_points: usize,
    /// Scale of `reference_from_cloud`.
    pub scale: f64,
    /// Number of ICP iterations.
    pub iterations: usize,
    /// Accuracy: distances of the points to their nearest neighbours in the reference. The paper
    /// has `mean` and `std`.
    pub distance: ErrorStatistics,
    /// Completeness: distances of the reference points to their nearest neighbours in the cloud.
    pub reference_distance: ErrorStatistics,
    /// The alignment.
    #[serde(skip)]
    pub reference_from_cloud: Sim3,
}

/// Compares a cloud with a reference after ICP from the initial `reference_from_cloud` in `start`.
/// Points with non-finite coordinates are left out. `None` if no points are left, or if they do not
/// determine the alignment.
pub fn evaluate_cloud(
    cloud: &[Vector3<f64>],
    reference: &[Vector3<f64>],
    start: &Sim3,
    alignment: Alignment,
) -> Option<CloudEvaluation> {
    let finite = |points: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
        points.iter().filter(|point| point.iter().all(|value| value.is_finite())).copied().collect()
    };
    let (points, indexed) = (finite(cloud), Cloud::new(finite(reference))?);
    let aligned = indexed.align(
        &sample(&points),
        start,
        &IcpOptions { alignment, ..IcpOptions::default() },
    )?;
    let reference_from_cloud = aligned.reference_from_cloud;
    let moved: Vec<Vector3<f64>> =
        points.iter().map(|point| reference_from_cloud * *point).collect();
    let distance = Statistics::of(&indexed.distances_of(&moved))?;
    let back = Cloud::new(moved)?.distances_of(indexed.points());
    Some(CloudEvaluation {
        points: points.len(),
        reference_points: indexed.points().len(),
        scale: reference_from_cloud.scale,
        iterations: aligned.iterations,
        distance: distance.into(),
        reference_distance: Statistics::of(&back)?.into(),
        reference_from_cloud,
    })
}

/// Every n-th point, at most [`MAX_ICP_POINTS`].
fn sample(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    points.iter().step_by(points.len().div_ceil(MAX_ICP_POINTS).max(1)).copied().collect()
}

/// Reads the points of a PLY file, of a LAS or LAZ file (with the feature `las`), or of a model (a
/// folder or a workspace).
///
/// # Errors
///
/// The file or model cannot be read, or the build lacks the feature `las`.
pub fn read_cloud(path: &Path) -> Result<Vec<Vector3<f64>>, Error> {
    if path.is_dir() {
        let model = read_model(&model_folder(path)?)?;
        return Ok(model.tracks().map(|(_, track)| track.xyz).collect());
    }
    let is_las = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("las") || e.eq_ignore_ascii_case("laz"));
    let vertices = if is_las { read_las(path)? } else { ply::read(path)? };
    Ok(vertices.into_iter().map(|vertex| vertex.xyz).collect())
}

#[cfg(feature = "las")]
fn read_las(path: &Path) -> Result<Vec<ply::Vertex>, Error> {
    Ok(tiepoint_io::las::read(path)?)
}

#[cfg(not(feature = "las"))]
fn read_las(path: &Path) -> Result<Vec<ply::Vertex>, Error> {
    Err(Error::NoLas { path: path.to_owned() })
}
