//! Point clouds against a reference, a laser scan say: distances to the nearest points, and
//! alignment by iterated closest points (Besl and McKay 1992), trimmed (Chetverikov et al. 2002)
//! because a reconstruction shows what the scan does not, and the other way round.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::Vector3;

use crate::Alignment;

/// A reference cloud, indexed.
pub struct Cloud {
    points: Vec<Vector3<f64>>,
    tree: ImmutableKdTree<f64, 3>,
}

/// How to align a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IcpOptions {
    /// Which freedom there is. With a scale, closest points tend to shrink a cloud that is noisy or
    /// badly placed: start from a similarity of the camera poses, and go on with a rigid alignment.
    pub alignment: Alignment,
    /// The part of the points, those nearest to the reference, that take part: 0 to 1.
    pub overlap: f64,
    /// At most so many rounds.
    pub max_iterations: usize,
    /// Ends when a round makes the mean distance of the points that take part shorter by less than
    /// this part of it.
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

/// Where a cloud came to lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudAlignment {
    /// The transform found.
    pub reference_from_cloud: Sim3,
    /// Rounds that it took.
    pub iterations: usize,
    /// Mean distance of the points that took part, in units of the reference.
    pub mean_distance: f64,
}

impl std::fmt::Debug for Cloud {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Cloud of {} points", self.points.len())
    }
}

impl Cloud {
    /// Indexes a cloud; `None` where it is empty or a coordinate is not finite.
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

    /// The distance of each point of `cloud` to the nearest one of this cloud. A point that is not
    /// finite is infinitely far.
    pub fn distances_of(&self, cloud: &[Vector3<f64>]) -> Vec<f64> {
        self.nearest(cloud).into_iter().map(|(_, distance)| distance).collect()
    }

    /// Moves `cloud` from where `initial` puts it to where it lies closest to this one. `None`
    /// where fewer than three points, or points on a line, are left to align by.
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
            // From the cloud itself rather than from where it lay last: roundings do not add up.
            let from: Vec<_> = pairs.iter().map(|(index, _)| cloud[*index]).collect();
            let to: Vec<_> = pairs.iter().map(|(_, (nearest, _))| self.points[*nearest]).collect();
            transform = match options.alignment {
                Alignment::Rigid => {
                    // The scale is the one that the cloud came with.
                    let scaled: Vec<_> = from.iter().map(|point| point * initial.scale).collect();
                    Sim3 { scale: initial.scale, ..Alignment::Rigid.fit(&scaled, &to)? }
                }
                Alignment::Similarity => Alignment::Similarity.fit(&from, &to)?,
                Alignment::None => *initial,
            };
        }
        None
    }

    /// Index and distance of the nearest point of this cloud.
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
            // Worked out here, so that it is the same number in whatever order the tree adds up.
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
