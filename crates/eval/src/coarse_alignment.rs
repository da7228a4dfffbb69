//! Coarse alignment of two point clouds by their principal axes, as a start for ICP.
//!
//! Centre, principal axes and extent of both clouds determine a similarity up to the signs of the
//! axes; four choices of signs are rotations. Each of the four, and the identity, is refined by ICP
//! on a few thousand points. The one with the smallest sum of distances in both directions wins.
//! Distances from the cloud to the reference alone would favour a cloud shrunk to a point.

use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tiepoint_geometry::numeric::median;

use crate::{Alignment, Cloud, IcpOptions};

/// Maximum number of points of each cloud that are used.
const MAX_POINTS: usize = 4_000;
/// Fraction of the points, those nearest to the median, that determine the axes: reconstructions
/// have outliers.
const INNER: f64 = 0.9;

/// Coarse `reference_from_cloud` without an initial guess, as a start for [`Cloud::align`]. Both
/// clouds must cover about the same surfaces. `None` if a cloud has fewer than three points, or
/// collinear ones.
pub fn find_alignment(cloud: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Option<Sim3> {
    let (cloud, reference) = (subsample(cloud), subsample(reference));
    let (from, to) = (PrincipalAxes::of(&cloud)?, PrincipalAxes::of(&reference)?);
    let indexed = Cloud::new(reference)?;
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let starts = signs.map(|(x, y)| from.onto(&to, Vector3::new(x, y, x * y)));
    let options = IcpOptions { alignment: Alignment::Similarity, ..IcpOptions::default() };
    let refine = |start: &Sim3| {
        let refined = indexed.align(&cloud, start, &options)?.reference_from_cloud;
        let moved: Vec<_> = cloud.iter().map(|point| refined * *point).collect();
        let forward = trimmed_mean(indexed.distances_of(&moved), options.overlap);
        let backward =
            trimmed_mean(Cloud::new(moved)?.distances_of(indexed.points()), options.overlap);
        Some((refined, forward + backward))
    };
    let candidates =
        std::iter::once(Sim3::identity()).chain(starts).filter_map(|start| refine(&start));
    candidates.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(refined, _)| refined)
}

/// At most [`MAX_POINTS`] finite points.
fn subsample(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let finite = points.iter().filter(|point| point.iter().all(|value| value.is_finite()));
    finite.step_by(points.len().div_ceil(MAX_POINTS).max(1)).copied().collect()
}

/// Mean of the smallest distances, a fraction `part` of all.
fn trimmed_mean(mut distances: Vec<f64>, part: f64) -> f64 {
    distances.sort_by(f64::total_cmp);
    let kept = &distances[..((distances.len() as f64 * part) as usize).max(1)];
    kept.iter().sum::<f64>() / kept.len() as f64
}

/// Centre, principal axes and extent of a cloud.
struct PrincipalAxes {
    centre: Vector3<f64>,
    /// A rotation matrix; its columns are the axes by decreasing variance.
    axes: Matrix3<f64>,
    /// Root mean square distance from the centre.
    extent: f64,
}

impl PrincipalAxes {
    fn of(points: &[Vector3<f64>]) -> Option<Self> {
        let median_of =
            |axis: usize| median(&mut points.iter().map(|point| point[axis]).collect::<Vec<f64>>());
        let medians = Vector3::new(median_of(0)?, median_of(1)?, median_of(2)?);
        let mut inner: Vec<Vector3<f64>> = points.iter().map(|point| point - medians).collect();
        inner.sort_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
        inner.truncate(((inner.len() as f64 * INNER) as usize).max(1));
        let mean = inner.iter().sum::<Vector3<f64>>() / inner.len() as f64;
        let covariance: Matrix3<f64> =
            inner.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
        let eigen = covariance.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [x, y] = [order[0], order[1]].map(|k| eigen.eigenvectors.column(k).into_owned());
        let extent = (eigen.eigenvalues.sum() / inner.len() as f64).sqrt();
        let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
        (extent > 0.0).then_some(Self { centre: medians + mean, axes, extent })
    }

    /// The similarity that maps these axes onto others with these signs.
    fn onto(&self, to: &Self, signs: Vector3<f64>) -> Sim3 {
        let rotation = to.axes * Matrix3::from_diagonal(&signs) * self.axes.transpose();
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let scale = to.extent / self.extent;
        Sim3 { scale, rotation, translation: to.centre - (rotation * self.centre) * scale }
    }
}
