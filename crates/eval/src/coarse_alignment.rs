//! Where to begin an alignment of closest points when nothing is known: the clouds' own axes.
//!
//! Middle, extent and principal axes of a cloud give a similarity but for the signs of the axes;
//! four choices are rotations. Each, and where the cloud lies as it is, is improved on a few
//! thousand points, and judged by the distances both ways: a cloud that shrank to a point on the
//! reference would be near to it, but not the reference to the cloud.

use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tiepoint_geometry::numeric::median;

use crate::{Alignment, Cloud, IcpOptions};

/// Points of each cloud that take part.
const MAX_POINTS: usize = 4_000;
/// The part of the points, those nearest to the middle, that give the axes: reconstructions have
/// points far out.
const INNER: f64 = 0.9;

/// Finds roughly where a cloud belongs on a reference, whatever its scale and orientation, as a
/// start for [`Cloud::align`]; `None` where fewer than three points, or points on a line, are all
/// there is. Both clouds must show about the same things.
pub fn find_alignment(cloud: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Option<Sim3> {
    let (cloud, reference) = (thin(cloud), thin(reference));
    let (from, to) = (Shape::of(&cloud)?, Shape::of(&reference)?);
    let indexed = Cloud::new(reference)?;
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let turned = signs.map(|(x, y)| from.onto(&to, Vector3::new(x, y, x * y)));
    let options = IcpOptions { alignment: Alignment::Similarity, ..IcpOptions::default() };
    let judge = |start: &Sim3| {
        let found = indexed.align(&cloud, start, &options)?.reference_from_cloud;
        let moved: Vec<_> = cloud.iter().map(|point| found * *point).collect();
        let there = trimmed_mean(indexed.distances_of(&moved), options.overlap);
        let back = trimmed_mean(Cloud::new(moved)?.distances_of(indexed.points()), options.overlap);
        Some((found, there + back))
    };
    let judged = std::iter::once(Sim3::identity()).chain(turned).filter_map(|start| judge(&start));
    judged.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(found, _)| found)
}

fn thin(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let finite = points.iter().filter(|point| point.iter().all(|value| value.is_finite()));
    finite.step_by(points.len().div_ceil(MAX_POINTS).max(1)).copied().collect()
}

fn trimmed_mean(mut distances: Vec<f64>, part: f64) -> f64 {
    distances.sort_by(f64::total_cmp);
    let kept = &distances[..((distances.len() as f64 * part) as usize).max(1)];
    kept.iter().sum::<f64>() / kept.len() as f64
}

/// Middle, principal axes and extent of a cloud.
struct Shape {
    middle: Vector3<f64>,
    /// Columns, the longest first; a rotation.
    axes: Matrix3<f64>,
    extent: f64,
}

impl Shape {
    fn of(points: &[Vector3<f64>]) -> Option<Self> {
        let middle =
            |axis: usize| median(&mut points.iter().map(|point| point[axis]).collect::<Vec<f64>>());
        let middle = Vector3::new(middle(0)?, middle(1)?, middle(2)?);
        let mut inner: Vec<Vector3<f64>> = points.iter().map(|point| point - middle).collect();
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
        (extent > 0.0).then_some(Self { middle: middle + mean, axes, extent })
    }

    /// Puts this shape onto another, its axes along the other's with these signs.
    fn onto(&self, to: &Self, signs: Vector3<f64>) -> Sim3 {
        let rotation = to.axes * Matrix3::from_diagonal(&signs) * self.axes.transpose();
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let scale = to.extent / self.extent;
        Sim3 { scale, rotation, translation: to.middle - (rotation * self.middle) * scale }
    }
}
