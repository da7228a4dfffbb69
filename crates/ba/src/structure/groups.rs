//! Which cells are worked on at once, as if all of them saw the same blocks.
//!
//! The product YᵀY of many cells together has its sums in registers where each cell's own would
//! read and write every tile. So a cell whose blocks are among those of a larger one joins it, and
//! has zeros for the blocks that it does not see. No tile comes of it that there would not be, for
//! the larger one needs it anyway.

use super::cells::{Cells, Draft};
use super::elimination::Elimination;

/// A cell joins a larger one where it has at least this part of the pairs of blocks: so much dearer
/// is a product of its own.
const MIN_PART: f64 = 0.4;
/// Among so many groups a cell looks for one.
const LOOK_BACK: usize = 32;

/// A chunk's cells, those of a group side by side.
pub(super) struct Groups<'a> {
    pub(super) drafts: Vec<Draft>,
    pub(super) groups: Vec<Group<'a>>,
}

/// Cells that are worked on at once.
pub(super) struct Group<'a> {
    /// Of its largest cell.
    pub(super) blocks: &'a [u32],
    /// Where its cells end.
    pub(super) end: usize,
}

impl<'a> Groups<'a> {
    /// Sorts cells that come in the order of their first blocks.
    pub(super) fn new(cells: &'a Cells<'a>, drafts: &[Draft], elimination: Elimination) -> Self {
        // Where no products are made, zeros would only cost memory.
        let joins = |draft: &Draft| elimination == Elimination::Do && joins(draft);
        let mut this = Self { drafts: Vec::with_capacity(drafts.len()), groups: Vec::new() };
        let first = |draft: &Draft| (draft.dof, cells.blocks_of(draft).first());
        // Cells with the group that each joins.
        let mut stretch: Vec<(u32, Draft)> = Vec::new();
        for drafts in drafts.chunk_by(|a, b| first(a) == first(b)) {
            stretch.clear();
            stretch.extend(drafts.iter().map(|draft| (0, *draft)));
            // The largest first; what joins no larger one stays in its order.
            stretch.sort_by_key(
                |(_, draft)| if joins(draft) { u32::MAX - draft.num_blocks } else { 0 },
            );
            this.add(cells, &mut stretch, joins);
        }
        this
    }

    /// Adds cells with the same first block, the largest first.
    fn add(
        &mut self,
        cells: &'a Cells<'a>,
        stretch: &mut [(u32, Draft)],
        joins: impl Fn(&Draft) -> bool,
    ) {
        let begin = self.groups.len();
        for (number, draft) in &mut *stretch {
            let blocks = cells.blocks_of(draft);
            let open = &self.groups[begin..];
            // Cells with equal blocks come one after the other, unless they come by size.
            let look_back = open.len().saturating_sub(if joins(draft) { LOOK_BACK } else { 1 });
            let fits = |group: &Group<'_>| {
                let Group { blocks: of, .. } = *group;
                of == blocks || joins(draft) && worth(blocks, of) && within(blocks, of)
            };
            let found = open[look_back..].iter().rposition(fits).map(|found| look_back + found);
            *number = found.unwrap_or(open.len()) as u32;
            if found.is_none() {
                self.groups.push(Group { blocks, end: 0 });
            }
        }
        stretch.sort_by_key(|(number, _)| *number);
        for (number, draft) in stretch {
            self.drafts.push(*draft);
            self.groups[begin + *number as usize].end = self.drafts.len();
        }
    }
}

/// Whether a cell may join a larger one. Cells of which each factor has a block of its own have
/// quicker ways.
fn joins(draft: &Draft) -> bool {
    draft.dof > 0 && draft.num_blocks != draft.num_entries
}

fn worth(blocks: &[u32], of: &[u32]) -> bool {
    let pairs = |blocks: &[u32]| (blocks.len() * (blocks.len() + 1)) as f64;
    pairs(blocks) >= MIN_PART * pairs(of)
}

/// Whether one sorted list has all that another one has.
fn within(few: &[u32], many: &[u32]) -> bool {
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

    use super::{within, worth};
    use crate::factors::Reprojection;
    use crate::structure::{Elimination, Structure};
    use crate::{Order, Problem};

    #[test]
    fn a_list_is_within_another_one() {
        assert!(within(&[], &[]) && within(&[3], &[1, 3]) && within(&[1, 4, 9], &[1, 2, 4, 8, 9]));
        assert!(!within(&[1, 5], &[1, 2, 4, 8]) && !within(&[9], &[1, 2]) && !within(&[0], &[1]));
    }

    #[test]
    fn much_smaller_ones_stay_apart() {
        assert!(worth(&[0; 8], &[0; 12]) && !worth(&[0; 7], &[0; 12]));
    }

    /// Images with one lens, and which of them see each point.
    fn seen_by(points: &[&[usize]], elimination: Elimination) -> (Structure, Vec<BTreeSet<u32>>) {
        let mut problem = Problem::new();
        let lens = problem.add_parameter(Vector3::new(600.0, 320.0, 240.0), Order::Shared);
        let poses: Vec<_> =
            (0..6).map(|i| problem.add_parameter(Rigid3::identity(), Order::At(i))).collect();
        for images in points {
            let point = problem.add_landmark(Vector3::new(0.0, 0.0, 5.0));
            for &image in *images {
                let factor = Reprojection::<SimplePinhole>::new(Vector2::new(320.0, 240.0), 1.0);
                problem.add((lens, poses[image], point), factor, Loss::Trivial).unwrap();
            }
        }
        let structure = Structure::new(&problem, elimination).unwrap();
        // The lens comes last.
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
        let [chunk] = &structure.chunks[..] else { panic!("one chunk") };
        // All but {0, 5} join {0, 1, 2, 3}, and {1, 4} joins {1, 3, 4}.
        let mut sizes: Vec<usize> =
            chunk.cells.chunk_by(|a, b| a.pattern == b.pattern).map(<[_]>::len).collect();
        sizes.sort_unstable();
        assert_eq!((sizes, chunk.patterns.list.len()), (vec![1, 2, 5], 3));
        let mut pairs: BTreeSet<(u32, u32)> = (0..7).map(|block| (block, block)).collect();
        for blocks in &blocks {
            pairs.extend(blocks.iter().flat_map(|&a| blocks.range(a..).map(move |&b| (a, b))));
        }
        assert_eq!(structure.tile_pairs(), Vec::from_iter(pairs));
        assert_eq!(chunk.bundles.list.len(), 6, "a bundle for each image");
        assert_eq!(chunk.bundles.rows.len(), 2 * chunk.factors.numbers.len());
        // Only equal ones, of which there are two, where no products are made.
        let (structure, _) = seen_by(points, Elimination::Implicit);
        assert_eq!(structure.chunks[0].patterns.list.len(), 7);
    }
}
