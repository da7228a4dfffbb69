//! Nearest-point distances between a point cloud and a reference such as a laser scan, and their
//! alignment by ICP (Besl and McKay 1992). ICP is trimmed (Chetverikov et al. 2002), because cloud
//! and scan overlap only partially.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::Vector3;

use crate::Alignment;

/// A point cloud with a k-d tree for nearest-neighbour queries.
pub struct Cloud {
    points: Vec<Vector3<f64>>,
    tree: ImmutableKdTree<f64, 3>,
}

/// Options of ICP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IcpOptions {
    /// Type of the transform. ICP with a free scale tends to shrink a noisy or badly initialised
    /// cloud; prefer a rigid alignment that starts from a similarity of the camera poses.
    pub alignment: Alignment,
    /// Fraction of the points that is used, those nearest to the reference: 0 to 1.
    pub overlap: f64,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// ICP stops when an iteration reduces the mean distance of the used points by less than this
    /// fraction.
    pub min_relative_change: f64,
}

impl Default for IcpOptions {
    fn default() -> Self {
        Self {
            alignment: Alignment::Rigid,
            overlap: 0.8,
            max_iterations: 100,
            min_relative_change: 1e-5,
        }
    }
}

/// Result of ICP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudAlignment {
    /// The alignment.
    pub reference_from_cloud: Sim3,
    /// Number of iterations.
    pub iterations: usize,
    /// Mean distance of the used points, in units of the reference.
    pub mean_distance: f64,
}

impl std::fmt::Debug for Cloud {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Cloud of {} points", self.points.len())
    }
}

impl Cloud {
    /// Builds the tree; `None` if there are no points or a coordinate is not finite.
    pub fn new(points: Vec<Vector3<f64>>) -> Option<Self> {
        if points.is_empty() || !points.iter().all(is_finite) {
            return None;
        }
        let entries: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
        let tree = ImmutableKdTree::new_from_slice(&entries).ok()?;
        Some(Self { points, tree })
    }

    /// The points, in the order given.
    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// Distance of each point of `cloud` to its nearest neighbour in this cloud; infinite for
    /// points that are not finite.
    pub fn distances_of(&self, cloud: &[Vector3<f64>]) -> Vec<f64> {
        self.nearest(cloud).into_iter().map(|(_, distance)| distance).collect()
    }

    /// Aligns `cloud` to this one by ICP, starting from `initial` (reference_from_cloud). `None` if
    /// the used points are fewer than three or collinear.
    pub fn align(
        &self,
        cloud: &[Vector3<f64>],
        initial: &Sim3,
        options: &IcpOptions,
    ) -> Option<CloudAlignment> {
        let kept = ((cloud.len() as f64 * options.overlap.clamp(0.0, 1.0)).ceil() as usize).max(3);
        let mut transform = *initial;
        let mut last_mean = f64::INFINITY;
        for iteration in 0.. {
            let moved: Vec<_> = cloud.iter().map(|point| transform * *point).collect();
            let mut pairs: Vec<(usize, (usize, f64))> =
                self.nearest(&moved).into_iter().enumerate().collect();
            // Ties are broken by the index, so that the choice does not depend on the sort.
            pairs.sort_by(|(i, (_, a)), (j, (_, b))| a.total_cmp(b).then(i.cmp(j)));
            pairs.truncate(kept);
            pairs.retain(|(_, (_, distance))| distance.is_finite());
            let mean = pairs.iter().map(|(_, (_, distance))| distance).sum::<f64>()
                / pairs.len().max(1) as f64;
            let has_converged = last_mean - mean <= options.min_relative_change * last_mean;
            if iteration == options.max_iterations || (iteration > 0 && has_converged) {
                return Some(CloudAlignment {
                    reference_from_cloud: transform,
                    iterations: iteration,
                    mean_distance: mean,
                });
            }
            last_mean = mean;
            // Fitted to the original cloud, so that rounding errors do not accumulate.
            let from: Vec<_> = pairs.iter().map(|(index, _)| cloud[*index]).collect();
            let to: Vec<_> = pairs.iter().map(|(_, (nearest, _))| self.points[*nearest]).collect();
            transform = match options.alignment {
                Alignment::Rigid => {
                    // The scale stays that of `initial`.
                    let scaled: Vec<_> = from.iter().map(|point| point * initial.scale).collect();
                    Sim3 { scale: initial.scale, ..Alignment::Rigid.fit(&scaled, &to)? }
                }
                Alignment::Similarity => Alignment::Similarity.fit(&from, &to)?,
                Alignment::None => *initial,
            };
        }
        None
    }

    /// Index and distance of each point's nearest neighbour in this cloud.
    fn nearest(&self, cloud: &[Vector3<f64>]) -> Vec<(usize, f64)> {
        let origin = [0.0; 3];
        let queries: Vec<[f64; 3]> = cloud
            .iter()
            .map(|point| if is_finite(point) { (*point).into() } else { origin })
            .collect();
        let found =
            self.tree.query_batch(&queries).nearest_one::<SquaredEuclidean<f64>>().execute();
        let nearest = found.into_iter().zip(cloud).map(|(nearest, query)| {
            let index = nearest.item as usize;
            // Computed here, because the tree may add up squares in another order.
            (
                index,
                if is_finite(query) { (self.points[index] - query).norm() } else { f64::INFINITY },
            )
        });
        nearest.collect()
    }
}

fn is_finite(point: &Vector3<f64>) -> bool {
    point.iter().all(|value| value.is_finite())
}
