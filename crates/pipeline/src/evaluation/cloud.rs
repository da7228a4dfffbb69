//! Distances between a point cloud and a reference such as a laser scan, as in the tables of Huang,
//! Elhashash & Qin 2022.

use std::path::Path;

use serde::Serialize;
use tiepoint_eval::geometry::Sim3;
use tiepoint_eval::geometry::nalgebra::Vector3;
use tiepoint_eval::{Alignment, Cloud, IcpOptions, Statistics};
use tiepoint_io::ply;

use crate::Error;
use crate::evaluation::poses::ErrorStatistics;
use crate::workspace::located_model::LocatedModel;

/// Largest number of points that ICP uses, which bounds its run time.
const MAX_ICP_POINTS: usize = 50_000;

/// A cloud that is registered with a reference. Lengths are in units of the reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegisteredCloud {
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
    /// The alignment.
    #[serde(skip)]
    pub reference_from_cloud: Sim3,
    /// The points in the frame of the reference.
    #[serde(skip)]
    pub registered: Vec<Vector3<f64>>,
    /// The distance of each point.
    #[serde(skip)]
    pub distances: Vec<f64>,
}

/// Distances between the nearest points of a cloud and a reference, in units of the reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CloudEvaluation {
    /// The cloud beside the reference.
    #[serde(flatten)]
    pub cloud: RegisteredCloud,
    /// Completeness: distances of the reference points to their nearest neighbours in the cloud.
    pub reference_distance: ErrorStatistics,
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
    let reference = Cloud::new(finite(reference))?;
    let cloud = register_cloud(cloud, &reference, start, alignment)?;
    let back = Cloud::new(cloud.registered.clone())?.distances_of(reference.points());
    Some(CloudEvaluation { cloud, reference_distance: Statistics::of(&back)?.into() })
}

/// Registers a cloud with a reference by ICP from the initial `reference_from_cloud` in `start`.
/// Points with non-finite coordinates are left out. `None` if no points are left, or if they do not
/// determine the alignment.
pub fn register_cloud(
    cloud: &[Vector3<f64>],
    reference: &Cloud,
    start: &Sim3,
    alignment: Alignment,
) -> Option<RegisteredCloud> {
    let points = finite(cloud);
    let options = IcpOptions { alignment, ..IcpOptions::default() };
    let aligned = reference.align(&sample(&points), start, &options)?;
    let reference_from_cloud = aligned.reference_from_cloud;
    let registered: Vec<Vector3<f64>> =
        points.iter().map(|point| reference_from_cloud * *point).collect();
    let distances = reference.distances_of(&registered);
    Some(RegisteredCloud {
        points: points.len(),
        reference_points: reference.points().len(),
        scale: reference_from_cloud.scale,
        iterations: aligned.iterations,
        distance: Statistics::of(&distances)?.into(),
        reference_from_cloud,
        registered,
        distances,
    })
}

fn finite(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    points.iter().filter(|point| point.iter().all(|value| value.is_finite())).copied().collect()
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
        let model = LocatedModel::open(path)?.reconstruction;
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
