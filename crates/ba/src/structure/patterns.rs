//! The blocks that a chunk touches, the patterns that they form, and a tile for each two blocks
//! that meet in a pattern.

use super::block::{Block, NONE};
use super::cells::Draft;
use super::chunk::{Chunk, Local, Pattern};
use super::context::Context;
use super::elimination::Elimination;
use super::groups::Group;
use super::tile::{Tile, padded, tile_len};
use crate::error::Error;

/// Finds the chunk's blocks, patterns and tiles.
pub(super) fn find(
    context: &Context<'_>,
    drafts: &[Draft],
    groups: &[Group<'_>],
    chunk: &mut Chunk,
) -> Result<(), Error> {
    for group in groups {
        if group.blocks.len() >= u16::MAX as usize {
            let (count, limit) = (group.blocks.len(), u16::MAX as usize - 1);
            return Err(Error::TooLarge {
                what: "variables of one eliminated variable",
                count,
                limit,
            });
        }
    }
    let local_of = list_blocks(context.blocks, groups, chunk);
    list_patterns(context.blocks, groups, &local_of, chunk);
    let mut tiling = Tiling {
        blocks: context.blocks,
        groups,
        direct: direct_pairs(context, drafts),
        tile_at: vec![NONE; chunk.blocks.len()],
        met: Vec::new(),
        local_of: &local_of,
    };
    let (occurrences, ends) = occurrences(groups, &local_of, chunk);
    for (local, ends) in ends.windows(2).enumerate() {
        tiling.add_column(chunk.blocks[local].0, &occurrences[ends[0]..ends[1]], chunk);
    }
    Ok(())
}

/// Lists the blocks of all groups, in order. Gives which of these each block of the problem is.
fn list_blocks(blocks: &[Block], groups: &[Group<'_>], chunk: &mut Chunk) -> Vec<u32> {
    // First only whether it is one.
    let mut local_of = vec![NONE; blocks.len()];
    for group in groups {
        group.blocks.iter().for_each(|&block| local_of[block as usize] = 0);
    }
    for (block, local) in local_of.iter_mut().enumerate().filter(|(_, local)| **local != NONE) {
        *local = chunk.blocks.len() as u32;
        chunk.blocks.push((block as u32, chunk.vector_len));
        chunk.vector_len += padded(blocks[block].dof);
    }
    local_of
}

/// Lists the patterns, one for each group, with room for the tiles of their pairs.
fn list_patterns(blocks: &[Block], groups: &[Group<'_>], local_of: &[u32], chunk: &mut Chunk) {
    let mut pairs = 0;
    for group in groups {
        let begin = chunk.patterns.locals.len();
        let (mut width, mut dense) = (0, 0);
        let first = group.blocks.first().map_or(0, |&block| blocks[block as usize].dof);
        for &block in group.blocks {
            let dof = blocks[block as usize].dof;
            let at = chunk.blocks[local_of[block as usize] as usize].1;
            chunk.patterns.locals.push(Local {
                dof,
                padded: padded(dof),
                at,
                column: width,
                dense,
            });
            width += padded(dof);
            dense += dof;
        }
        let locals = begin..chunk.patterns.locals.len();
        let same = chunk.patterns.locals[locals.clone()].iter().all(|local| local.dof == first);
        let dof = if same { first } else { 0 };
        chunk.patterns.list.push(Pattern { locals, pairs, width, dense, dof });
        pairs += group.blocks.len() * (group.blocks.len() + 1) / 2;
    }
    chunk.patterns.pair_tiles = vec![0; pairs];
}

/// That a block is in a pattern: the pattern, and the block's number in it.
type Occurrence = (u32, u32);

/// The occurrences of each of the chunk's blocks, one after the other, and where those of each
/// begin, and the last ones end.
fn occurrences(
    groups: &[Group<'_>],
    local_of: &[u32],
    chunk: &Chunk,
) -> (Vec<Occurrence>, Vec<usize>) {
    let mut start = vec![0; chunk.blocks.len() + 1];
    for &block in groups.iter().flat_map(|group| group.blocks) {
        start[local_of[block as usize] as usize + 1] += 1;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut occurrences = vec![(0, 0); chunk.patterns.locals.len()];
    let mut next = start.clone();
    for (pattern, group) in (0u32..).zip(groups) {
        for (i, &block) in (0u32..).zip(group.blocks) {
            let next = &mut next[local_of[block as usize] as usize];
            occurrences[*next] = (pattern, i);
            *next += 1;
        }
    }
    (occurrences, start)
}

/// Gives tiles to pairs of blocks, block column by block column.
struct Tiling<'a> {
    blocks: &'a [Block],
    groups: &'a [Group<'a>],
    local_of: &'a [u32],
    /// Where only these get tiles, of different blocks.
    direct: Option<Vec<(u32, u32)>>,
    /// For each of the chunk's blocks, where its tile with the block at hand is.
    tile_at: Vec<u32>,
    /// Those of the chunk's blocks that have one.
    met: Vec<u32>,
}

impl Tiling<'_> {
    /// The tiles of block `a` with itself and with those behind it.
    fn add_column(&mut self, a: u32, occurrences: &[Occurrence], chunk: &mut Chunk) {
        self.meet(a, occurrences);
        self.met.sort_unstable();
        for &local in &self.met {
            let b = chunk.blocks[local as usize].0;
            self.tile_at[local as usize] = chunk.tiles_len as u32;
            chunk.tiles.push(Tile { a, b, at: chunk.tiles_len });
            chunk.tiles_len += tile_len(self.blocks[a as usize].dof, self.blocks[b as usize].dof);
        }
        for &(pattern, i) in occurrences {
            let (group, first) =
                (&self.groups[pattern as usize], chunk.patterns.list[pattern as usize].pairs);
            for j in i as usize..group.blocks.len() {
                let local = self.local_of[group.blocks[j] as usize];
                chunk.patterns.pair_tiles[first + j * (j + 1) / 2 + i as usize] =
                    self.tile_at[local as usize];
            }
        }
        for local in self.met.drain(..) {
            self.tile_at[local as usize] = NONE;
        }
    }

    /// Finds the blocks that are to have a tile with block `a`.
    fn meet(&mut self, a: u32, occurrences: &[Occurrence]) {
        for &(pattern, i) in occurrences {
            for &block in &self.groups[pattern as usize].blocks[i as usize..] {
                let tile_at = &mut self.tile_at[self.local_of[block as usize] as usize];
                let is_direct =
                    |direct: &Vec<_>| block == a || direct.binary_search(&(a, block)).is_ok();
                if self.direct.as_ref().is_none_or(is_direct) && *tile_at == NONE {
                    *tile_at = 0;
                    self.met.push(self.local_of[block as usize]);
                }
            }
        }
    }
}

/// Where only these get tiles: the pairs of different blocks that some factor joins, sorted.
fn direct_pairs(context: &Context<'_>, drafts: &[Draft]) -> Option<Vec<(u32, u32)>> {
    if context.elimination != Elimination::Implicit {
        return None;
    }
    let mut pairs = Vec::new();
    for entry in drafts.iter().flat_map(|draft| context.cells.entries_of(draft)) {
        let view = &context.cells.views[entry.run as usize];
        let blocks = || view.places(entry.factor).map(|place| place.block);
        for a in blocks().filter(|&a| a != NONE) {
            pairs.extend(blocks().filter(|&b| b != NONE && a < b).map(|b| (a, b)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    Some(pairs)
}
