//! Clusters of landmark blocks that share one pattern of column blocks.
//!
//! The product YᵀY of several landmark blocks keeps its sums in registers, while one product for
//! each would read and write every tile. A landmark block whose column blocks are a subset of those
//! of a larger one therefore uses the larger one's pattern, with zeros for the column blocks that
//! it does not observe. This adds no tile, because the larger one needs them all.

use super::elimination::Elimination;
use super::landmark_drafts::{Draft, LandmarkDrafts};

/// A landmark block joins a larger one if it has at least this fraction of the larger one's pairs
/// of column blocks. Below it, the products with zeros cost more than a separate product.
const MIN_PART: f64 = 0.4;
/// Number of clusters that are tried for each landmark block.
const LOOK_BACK: usize = 32;

/// A task's drafts, ordered by cluster.
pub(super) struct Clusters<'a> {
    pub(super) drafts: Vec<Draft>,
    pub(super) clusters: Vec<Cluster<'a>>,
}

/// Landmark blocks with one pattern.
pub(super) struct Cluster<'a> {
    /// Column blocks of its largest landmark block.
    pub(super) blocks: &'a [u32],
    /// End of its drafts in [`Clusters::drafts`].
    pub(super) end: usize,
}

impl<'a> Clusters<'a> {
    /// Clusters drafts that are sorted by their first column blocks.
    pub(super) fn new(
        landmarks: &'a LandmarkDrafts<'a>,
        drafts: &[Draft],
        elimination: Elimination,
    ) -> Self {
        // The implicit solver makes no products, so zeros would only cost memory.
        let is_mergeable = |draft: &Draft| elimination == Elimination::Do && is_mergeable(draft);
        let mut this = Self { drafts: Vec::with_capacity(drafts.len()), clusters: Vec::new() };
        let first = |draft: &Draft| (draft.dof, landmarks.blocks_of(draft).first());
        // Drafts with the index of their cluster.
        let mut candidates: Vec<(u32, Draft)> = Vec::new();
        for drafts in drafts.chunk_by(|a, b| first(a) == first(b)) {
            candidates.clear();
            candidates.extend(drafts.iter().map(|draft| (0, *draft)));
            // The largest first. Drafts that cannot join a larger one keep their order.
            candidates.sort_by_key(|(_, draft)| {
                if is_mergeable(draft) { u32::MAX - draft.num_blocks } else { 0 }
            });
            this.add(landmarks, &mut candidates, is_mergeable);
        }
        this
    }

    /// Adds drafts with the same first column block, the largest first.
    fn add(
        &mut self,
        landmarks: &'a LandmarkDrafts<'a>,
        candidates: &mut [(u32, Draft)],
        is_mergeable: impl Fn(&Draft) -> bool,
    ) {
        let begin = self.clusters.len();
        for (number, draft) in &mut *candidates {
            let blocks = landmarks.blocks_of(draft);
            let open = &self.clusters[begin..];
            // Drafts with equal blocks are neighbours unless they are sorted by size.
            let look_back =
                open.len().saturating_sub(if is_mergeable(draft) { LOOK_BACK } else { 1 });
            let fits = |cluster: &Cluster<'_>| {
                let Cluster { blocks: of, .. } = *cluster;
                of == blocks
                    || is_mergeable(draft) && is_worth_padding(blocks, of) && is_subset(blocks, of)
            };
            let found = open[look_back..].iter().rposition(fits).map(|found| look_back + found);
            *number = found.unwrap_or(open.len()) as u32;
            if found.is_none() {
                self.clusters.push(Cluster { blocks, end: 0 });
            }
        }
        candidates.sort_by_key(|(number, _)| *number);
        for (number, draft) in candidates {
            self.drafts.push(*draft);
            self.clusters[begin + *number as usize].end = self.drafts.len();
        }
    }
}

/// Whether a landmark block may join a larger one. Those whose factors each have a column block of
/// their own are eliminated faster by `eliminate::single`.
fn is_mergeable(draft: &Draft) -> bool {
    draft.dof > 0 && draft.num_blocks != draft.num_factors
}

fn is_worth_padding(blocks: &[u32], of: &[u32]) -> bool {
    let pairs = |blocks: &[u32]| (blocks.len() * (blocks.len() + 1)) as f64;
    pairs(blocks) >= MIN_PART * pairs(of)
}

/// Whether the sorted list `many` contains all of the sorted list `few`.
fn is_subset(few: &[u32], many: &[u32]) -> bool {
    let mut many = many.iter();
    few.iter().all(|block| many.by_ref().find(|&other| other >= block) == Some(block))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers
mod tests {
    use std::collections::BTreeSet;

    use nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::cameras::SimplePinhole;
    use tiepoint_geometry::{Loss, Rigid3};

    use super::{is_subset, is_worth_padding};
    use crate::factors::Reprojection;
    use crate::structure::{Elimination, Structure};
    use crate::{EliminationOrder, Problem};

    #[test]
    fn a_list_is_within_another_one() {
        assert!(
            is_subset(&[], &[])
                && is_subset(&[3], &[1, 3])
                && is_subset(&[1, 4, 9], &[1, 2, 4, 8, 9])
        );
        assert!(
            !is_subset(&[1, 5], &[1, 2, 4, 8])
                && !is_subset(&[9], &[1, 2])
                && !is_subset(&[0], &[1])
        );
    }

    #[test]
    fn much_smaller_ones_stay_apart() {
        assert!(is_worth_padding(&[0; 8], &[0; 12]) && !is_worth_padding(&[0; 7], &[0; 12]));
    }

    /// Images with shared intrinsics. `points` are the images that see each point.
    fn seen_by(points: &[&[usize]], elimination: Elimination) -> (Structure, Vec<BTreeSet<u32>>) {
        let mut problem = Problem::new();
        let intrinsics =
            problem.add_parameter(Vector3::new(600.0, 320.0, 240.0), EliminationOrder::Last);
        let poses: Vec<_> = (0..6)
            .map(|i| problem.add_parameter(Rigid3::identity(), EliminationOrder::At(i)))
            .collect();
        for images in points {
            let point = problem.add_landmark(Vector3::new(0.0, 0.0, 5.0));
            for &image in *images {
                let factor = Reprojection::<SimplePinhole>::new(Vector2::new(320.0, 240.0), 1.0);
                problem.add((intrinsics, poses[image], point), factor, Loss::Trivial).unwrap();
            }
        }
        let structure = Structure::new(&problem, elimination).unwrap();
        // The intrinsics come last.
        let blocks = points
            .iter()
            .map(|images| images.iter().map(|&i| i as u32).chain([6]).collect())
            .collect();
        (structure, blocks)
    }

    #[test]
    fn cells_join_larger_ones_and_no_tile_comes_of_it() {
        let points: &[&[usize]] = &[
            &[0, 2, 3],
            &[0, 1, 2, 3],
            &[1, 4],
            &[0, 1, 3],
            &[0, 5],
            &[1, 3, 4],
            &[0, 2, 3],
            &[0, 1, 2],
        ];
        let (structure, blocks) = seen_by(points, Elimination::Do);
        let [task] = &structure.tasks[..] else { panic!("one task") };
        // All but {0, 5} join {0, 1, 2, 3}, and {1, 4} joins {1, 3, 4}.
        let mut sizes: Vec<usize> =
            task.landmarks.chunk_by(|a, b| a.pattern == b.pattern).map(<[_]>::len).collect();
        sizes.sort_unstable();
        assert_eq!((sizes, task.patterns.list.len()), (vec![1, 2, 5], 3));
        let mut pairs: BTreeSet<(u32, u32)> = (0..7).map(|block| (block, block)).collect();
        for blocks in &blocks {
            pairs.extend(blocks.iter().flat_map(|&a| blocks.range(a..).map(move |&b| (a, b))));
        }
        assert_eq!(structure.tile_pairs(), Vec::from_iter(pairs));
        assert_eq!(task.rank_updates.list.len(), 6, "one rank-k update for each image");
        assert_eq!(task.rank_updates.rows.len(), 2 * task.factors.indices.len());
        // Without products, only equal ones are clustered, of which there are two.
        let (structure, _) = seen_by(points, Elimination::Implicit);
        assert_eq!(structure.tasks[0].patterns.list.len(), 7);
    }
}
