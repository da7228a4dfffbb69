//! How the rows of a factor fall into blocks.

use crate::error::Error;
use crate::problem::Problem;

use super::cells::{Draft, Entry};
use super::{Block, NO_OWN, NONE, Place, Segment, Shape};

/// The few shapes that serve all factors of a chunk. Most factors are shaped as the one before, which a look at what matters of
/// their variables tells.
pub(super) struct Shapes<'a> {
    pub(super) problem: &'a Problem,
    pub(super) blocks: &'a [Block],
    pub(super) places: &'a [Vec<Place>],
    pub(super) shapes: Vec<Shape>,
    looks: Vec<Look>,
    last_looks: Vec<Look>,
    last_run: Option<u16>,
    last: u16,
}

/// What matters of one of a factor's variables.
#[derive(Clone, Copy, PartialEq)]
struct Look {
    free: u64,
    offset: u32,
    block_dof: u32,
    own: bool,
    /// It is in the block of the variable before.
    same_block: bool,
}

impl<'a> Shapes<'a> {
    pub(super) fn new(problem: &'a Problem, blocks: &'a [Block], places: &'a [Vec<Place>]) -> Self {
        let (shapes, looks, last_looks) = (Vec::new(), Vec::new(), Vec::new());
        Self { problem, blocks, places, shapes, looks, last_looks, last_run: None, last: 0 }
    }

    /// The number of a factor's shape; and, for each of its segments, which of the cell's blocks it is, appended to `locals`.
    pub(super) fn add(
        &mut self,
        entry: Entry,
        draft: &Draft,
        cell_blocks: &[u32],
        locals: &mut Vec<u16>,
    ) -> Result<u16, Error> {
        let run = &self.problem.runs[entry.run as usize];
        let slots = run.slots(entry.factor as usize);
        self.looks.clear();
        let mut last_block = NONE;
        for (&store, &slot) in run.stores().iter().zip(slots) {
            let place = self.places[store as usize][slot as usize];
            let own = draft.dof > 0 && (u32::from(store), slot) == (draft.store, draft.slot);
            self.looks.push(Look {
                free: self.problem.metas[store as usize][slot as usize].free,
                offset: place.offset,
                block_dof: self.blocks.get(place.block as usize).map_or(0, |block| block.dof as u32),
                own,
                same_block: place.block == last_block,
            });
            last_block = place.block;
        }
        if self.last_run != Some(entry.run) || self.looks != self.last_looks {
            self.last = self.number(entry.run)?;
            self.last_run = Some(entry.run);
            std::mem::swap(&mut self.looks, &mut self.last_looks);
        }
        // Segments begin where their columns do.
        let (mut segments, mut column) = (self.shapes[self.last as usize].segments.iter().peekable(), 0);
        for ((&store, &slot), &dof) in run.stores().iter().zip(slots).zip(run.dofs()) {
            if segments.next_if(|segment| segment.column == column).is_some() {
                let block = self.places[store as usize][slot as usize].block;
                let local = match cell_blocks.len() {
                    // Few are found sooner one by one.
                    0..=8 => cell_blocks.iter().position(|&other| other == block),
                    _ => cell_blocks.binary_search(&block).ok(),
                };
                locals.push(local.expect("the cell lists all its factors' blocks") as u16);
            }
            column += dof;
        }
        Ok(self.last)
    }

    /// The shape of a factor that looks like `looks`, found or new.
    fn number(&mut self, run_index: u16) -> Result<u16, Error> {
        let run = &self.problem.runs[run_index as usize];
        let mut shape =
            Shape { run: run_index, own: NO_OWN, rows: run.rows(), stride: run.stride(), ..Shape::default() };
        let (mut column, mut last_placed) = (0, false);
        for ((position, look), &dof) in (0u8..).zip(&self.looks).zip(run.dofs()) {
            if look.free != 0 {
                shape.held.extend((0..dof).filter(|i| look.free >> i & 1 == 0).map(|i| column + i));
            }
            let (offset, block_dof) = (look.offset as usize, look.block_dof as usize);
            if block_dof > 0 {
                match shape.segments.last_mut() {
                    Some(last)
                        if last_placed
                            && look.same_block
                            && last.column + last.dof == column
                            && last.offset + last.dof == offset =>
                    {
                        last.dof += dof;
                        last.whole = last.dof == block_dof;
                    }
                    _ => shape.segments.push(Segment { column, dof, offset, whole: dof == block_dof }),
                }
            } else if look.own {
                (shape.own, shape.eliminated) = (position, column);
            }
            last_placed = block_dof > 0;
            column += dof;
        }
        shape.residual = column;
        if let Some(found) = self.shapes.iter().rposition(|other| *other == shape) {
            return Ok(found as u16);
        }
        let (count, limit) = (self.shapes.len() + 1, u16::MAX as usize);
        if count > limit {
            return Err(Error::TooLarge { what: "shapes of factors", count, limit });
        }
        self.shapes.push(shape);
        Ok((count - 1) as u16)
    }
}
