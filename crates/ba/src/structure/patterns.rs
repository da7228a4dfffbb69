//! The column blocks of a task, its patterns, and a tile for each pair of blocks that share a
//! pattern.

use super::block::{ColumnBlock, NONE};
use super::clusters::Cluster;
use super::context::Context;
use super::elimination::Elimination;
use super::landmark_drafts::Draft;
use super::task::{Pattern, PatternBlock, Task, pair};
use super::tile::{Tile, padded, tile_len};
use crate::error::Error;

/// Finds the task's column blocks, patterns and tiles.
pub(super) fn find(
    context: &Context<'_>,
    drafts: &[Draft],
    clusters: &[Cluster<'_>],
    task: &mut Task,
) -> Result<(), Error> {
    for cluster in clusters {
        if cluster.blocks.len() >= u16::MAX as usize {
            let (count, limit) = (cluster.blocks.len(), u16::MAX as usize - 1);
            return Err(Error::TooLarge {
                what: "variables of one eliminated variable",
                count,
                limit,
            });
        }
    }
    let task_index_of = list_blocks(context.blocks, clusters, task);
    list_patterns(context.blocks, clusters, &task_index_of, task);
    let mut tiling = Tiling {
        blocks: context.blocks,
        clusters,
        allowed: pairs_in_factors(context, drafts),
        tile_at: vec![NONE; task.blocks.len()],
        with_tile: Vec::new(),
        task_index_of: &task_index_of,
    };
    let (occurrences, ends) = occurrences(clusters, &task_index_of, task);
    for (index, ends) in ends.windows(2).enumerate() {
        tiling.add_column(task.blocks[index].0, &occurrences[ends[0]..ends[1]], task);
    }
    Ok(())
}

/// Lists the column blocks of all clusters, in order. Returns the index in this list of each block
/// of the problem.
fn list_blocks(blocks: &[ColumnBlock], clusters: &[Cluster<'_>], task: &mut Task) -> Vec<u32> {
    // Marks the blocks first.
    let mut task_index_of = vec![NONE; blocks.len()];
    for cluster in clusters {
        cluster.blocks.iter().for_each(|&block| task_index_of[block as usize] = 0);
    }
    for (block, index) in task_index_of.iter_mut().enumerate().filter(|(_, index)| **index != NONE)
    {
        *index = task.blocks.len() as u32;
        task.blocks.push((block as u32, task.vector_len));
        task.vector_len += padded(blocks[block].dof);
    }
    task_index_of
}

/// Lists the patterns, one for each cluster, and allocates the tile offsets of their pairs.
fn list_patterns(
    blocks: &[ColumnBlock],
    clusters: &[Cluster<'_>],
    task_index_of: &[u32],
    task: &mut Task,
) {
    let mut pairs = 0;
    for cluster in clusters {
        let begin = task.patterns.blocks.len();
        let (mut padded_width, mut packed_width) = (0, 0);
        let first = cluster.blocks.first().map_or(0, |&block| blocks[block as usize].dof);
        for &block in cluster.blocks {
            let dof = blocks[block as usize].dof;
            let vector_offset = task.blocks[task_index_of[block as usize] as usize].1;
            task.patterns.blocks.push(PatternBlock {
                dof,
                padded: padded(dof),
                vector_offset,
                padded_offset: padded_width,
                packed_offset: packed_width,
            });
            padded_width += padded(dof);
            packed_width += dof;
        }
        let range = begin..task.patterns.blocks.len();
        let same = task.patterns.blocks[range.clone()].iter().all(|block| block.dof == first);
        let dof = if same { first } else { 0 };
        task.patterns.list.push(Pattern { blocks: range, pairs, padded_width, packed_width, dof });
        pairs += cluster.blocks.len() * (cluster.blocks.len() + 1) / 2;
    }
    task.patterns.pair_tiles = vec![0; pairs];
}

/// A pattern that contains a block, and the index of the block in it.
type Occurrence = (u32, u32);

/// The occurrences of each of the task's blocks, block by block, and the first occurrence of each
/// block (compressed rows).
fn occurrences(
    clusters: &[Cluster<'_>],
    task_index_of: &[u32],
    task: &Task,
) -> (Vec<Occurrence>, Vec<usize>) {
    let mut start = vec![0; task.blocks.len() + 1];
    for &block in clusters.iter().flat_map(|cluster| cluster.blocks) {
        start[task_index_of[block as usize] as usize + 1] += 1;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut occurrences = vec![(0, 0); task.patterns.blocks.len()];
    let mut next = start.clone();
    for (pattern, cluster) in (0u32..).zip(clusters) {
        for (i, &block) in (0u32..).zip(cluster.blocks) {
            let next = &mut next[task_index_of[block as usize] as usize];
            occurrences[*next] = (pattern, i);
            *next += 1;
        }
    }
    (occurrences, start)
}

/// Assigns tiles to pairs of blocks, block column by block column.
struct Tiling<'a> {
    blocks: &'a [ColumnBlock],
    clusters: &'a [Cluster<'a>],
    task_index_of: &'a [u32],
    /// Pairs of different blocks that may have a tile; `None` for all.
    allowed: Option<Vec<(u32, u32)>>,
    /// For each of the task's blocks: offset of its tile with the current block.
    tile_at: Vec<u32>,
    /// The task's blocks that have a tile with the current block.
    with_tile: Vec<u32>,
}

impl Tiling<'_> {
    /// Adds the tiles of block `a` with itself and with later blocks.
    fn add_column(&mut self, a: u32, occurrences: &[Occurrence], task: &mut Task) {
        self.find_partners(a, occurrences);
        self.with_tile.sort_unstable();
        for &index in &self.with_tile {
            let b = task.blocks[index as usize].0;
            self.tile_at[index as usize] = task.tiles_len as u32;
            task.tiles.push(Tile { a, b, at: task.tiles_len });
            task.tiles_len += tile_len(self.blocks[a as usize].dof, self.blocks[b as usize].dof);
        }
        for &(pattern, i) in occurrences {
            let (cluster, first) =
                (&self.clusters[pattern as usize], task.patterns.list[pattern as usize].pairs);
            for j in i as usize..cluster.blocks.len() {
                let index = self.task_index_of[cluster.blocks[j] as usize];
                task.patterns.pair_tiles[first + pair(cluster.blocks.len(), i as usize, j)] =
                    self.tile_at[index as usize];
            }
        }
        for index in self.with_tile.drain(..) {
            self.tile_at[index as usize] = NONE;
        }
    }

    /// Finds the blocks that share a tile with block `a`.
    fn find_partners(&mut self, a: u32, occurrences: &[Occurrence]) {
        for &(pattern, i) in occurrences {
            for &block in &self.clusters[pattern as usize].blocks[i as usize..] {
                let tile_at = &mut self.tile_at[self.task_index_of[block as usize] as usize];
                let is_allowed =
                    |allowed: &Vec<_>| block == a || allowed.binary_search(&(a, block)).is_ok();
                if self.allowed.as_ref().is_none_or(is_allowed) && *tile_at == NONE {
                    *tile_at = 0;
                    self.with_tile.push(self.task_index_of[block as usize]);
                }
            }
        }
    }
}

/// For the implicit solver: the sorted pairs of different blocks that share a factor. `None` for
/// the others, where all pairs of a pattern have tiles.
fn pairs_in_factors(context: &Context<'_>, drafts: &[Draft]) -> Option<Vec<(u32, u32)>> {
    if context.elimination != Elimination::Implicit {
        return None;
    }
    let mut pairs = Vec::new();
    for factor_ref in drafts.iter().flat_map(|draft| context.drafts.factors_of(draft)) {
        let view = &context.drafts.views[factor_ref.group as usize];
        let blocks = || view.locations(factor_ref.factor).map(|location| location.block);
        for a in blocks().filter(|&a| a != NONE) {
            pairs.extend(blocks().filter(|&b| b != NONE && a < b).map(|b| (a, b)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    Some(pairs)
}
