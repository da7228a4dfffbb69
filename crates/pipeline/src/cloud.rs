//! A cloud against a reference, a laser scan say: what the paper's tables have.

use std::path::Path;

use serde::Serialize;
use tiepoint_eval::geometry::Sim3;
use tiepoint_eval::geometry::nalgebra::Vector3;
use tiepoint_eval::{Alignment, Cloud, IcpOptions, Statistics};
use tiepoint_io::colmap::read_model;
use tiepoint_io::ply;

use crate::evaluate::model_folder;
use crate::{Error, ErrorStatistics};

/// Points that take part in the search for the alignment, at most: evenly chosen. A rigid motion
/// needs no more, and it is repeated for each.
const MAX_ALIGNED: usize = 50_000;

/// How far a cloud is from a reference, point by point to the nearest one. In units of the
/// reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CloudEvaluation {
    /// Points of the cloud.
    pub points: usize,
    /// Points of the reference.
    pub reference_points: usize,
    /// Length in the reference of one unit of the cloud.
    pub scale: f64,
    /// Rounds of the alignment.
    pub iterations: usize,
    /// Distance of each point to the nearest one of the reference: `mean` and `std` are the paper's
    /// numbers.
    pub distance: ErrorStatistics,
    /// Distance of each point of the reference to the nearest one of the cloud: what was
    /// reconstructed of it.
    pub reference_distance: ErrorStatistics,
    /// Where the cloud came to lie.
    #[serde(skip)]
    pub reference_from_cloud: Sim3,
}

/// Compares a cloud with a reference after aligning it by closest points, beginning where `start`
/// puts it. Points that are not finite are left out; `None` where nothing is left, or nothing to
/// align by.
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

/// Evenly chosen points, so that there are at most [`MAX_ALIGNED`].
fn sample(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    points.iter().step_by(points.len().div_ceil(MAX_ALIGNED).max(1)).copied().collect()
}

/// The points of a PLY file, of a LAS or LAZ one (with the feature `las`), or of a model (a folder,
/// or a workspace).
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
