//! Which few shapes serve all factors of a chunk.

use crate::error::Error;
use crate::problem::Problem;
use crate::run::AnyRun;

use super::block::NONE;
use super::cells::{Entry, View};
use super::chunk::SINGLE_ROWS;
use super::place::Look;
use super::shape::{NO_OWN, Segment, Shape};

/// Most variables of a factor.
const MAX_VARIABLES: usize = 8;

/// The few shapes that serve all factors of a chunk. Most factors are shaped as the one before,
/// which a look at what matters of their variables tells.
pub(super) struct Shapes<'a> {
    pub(super) shapes: Vec<Shape>,
    /// What is often asked of each shape.
    pub(super) facts: Vec<Facts>,
    runs: &'a [Box<dyn AnyRun>],
    views: &'a [View<'a>],
    looks: &'a [Look],
    /// The shape that was last asked for.
    last: (Key, u16),
}

/// What is often asked of a shape.
pub(super) struct Facts {
    /// Numbers in the rows.
    pub(super) rows_len: usize,
    pub(super) own: u8,
    /// Whether a cell may be [`single`](super::chunk::Cell::single) with it.
    pub(super) single: bool,
    /// Which of the factor's variables the segments begin with.
    begins: Vec<u8>,
}

/// What a factor's shape follows from.
#[derive(Clone, Copy, Default)]
struct Key {
    run: u16,
    /// Bit i: variable i is in the block of the one before.
    same_block: u8,
    classes: [u32; MAX_VARIABLES],
}

impl<'a> Shapes<'a> {
    pub(super) fn new(problem: &'a Problem, views: &'a [View<'a>], looks: &'a [Look]) -> Self {
        Self {
            shapes: Vec::new(),
            facts: Vec::new(),
            runs: &problem.runs,
            views,
            looks,
            last: Default::default(),
        }
    }

    /// The number of a factor's shape; and, for each of its segments, which of the cell's blocks it
    /// is, appended to `locals`.
    pub(super) fn add(
        &mut self,
        entry: Entry,
        cell_blocks: &[u32],
        locals: &mut Vec<u16>,
    ) -> Result<u16, Error> {
        let places = || self.views[entry.run as usize].places(entry.factor);
        let (mut blocks, mut last_block) = ([NONE; MAX_VARIABLES], NONE);
        let (mut same_block, mut classes_differ) = (0, 0);
        for (i, place) in places().enumerate() {
            classes_differ |= place.class ^ self.last.0.classes[i];
            same_block |= u8::from(place.block == last_block) << i;
            (blocks[i], last_block) = (place.block, place.block);
        }
        // Those of one run have equally many classes.
        let same = classes_differ == 0
            && (entry.run, same_block) == (self.last.0.run, self.last.0.same_block)
            && !self.shapes.is_empty();
        if !same {
            let mut key = Key { run: entry.run, same_block, classes: [0; MAX_VARIABLES] };
            key.classes.iter_mut().zip(places()).for_each(|(class, place)| *class = place.class);
            self.last = (key, self.number(&key)?);
        }
        let number = self.last.1;
        for &variable in &self.facts[number as usize].begins {
            let block = blocks[variable as usize];
            // Often the one after the one before.
            let next = locals.last().map_or(0, |&last| usize::from(last) + 1);
            let local = match cell_blocks.len() {
                _ if cell_blocks.get(next) == Some(&block) => Some(next),
                // Few are found sooner one by one.
                0..=8 => cell_blocks.iter().position(|&other| other == block),
                _ => cell_blocks.binary_search(&block).ok(),
            };
            locals.push(local.expect("the cell lists all its factors' blocks") as u16);
        }
        Ok(number)
    }

    /// The shape that follows from `key`, found or new.
    fn number(&mut self, key: &Key) -> Result<u16, Error> {
        let run = &self.runs[key.run as usize];
        let mut shape = Shape {
            run: key.run,
            own: NO_OWN,
            rows: run.rows(),
            stride: run.stride(),
            ..Shape::default()
        };
        let (mut column, mut last_placed, mut begins) = (0, false, Vec::new());
        for ((position, &class), &dof) in (0u8..).zip(&key.classes).zip(run.dofs()) {
            let look = &self.looks[class as usize];
            if look.free != 0 {
                shape.held.extend((0..dof).filter(|i| look.free >> i & 1 == 0).map(|i| column + i));
            }
            let (offset, block_dof) = (look.offset as usize, look.block_dof as usize);
            if block_dof > 0 {
                match shape.segments.last_mut() {
                    Some(last)
                        if last_placed
                            && key.same_block >> position & 1 == 1
                            && last.column + last.dof == column
                            && last.offset + last.dof == offset =>
                    {
                        last.dof += dof;
                        last.whole = last.dof == block_dof;
                    }
                    _ => {
                        let whole = dof == block_dof;
                        shape.segments.push(Segment { column, dof, offset, block_dof, whole });
                        begins.push(position);
                    }
                }
            } else if look.eliminated {
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
        self.facts.push(Facts {
            rows_len: shape.rows * shape.stride,
            own: shape.own,
            single: shape.rows == SINGLE_ROWS
                && matches!(shape.segments[..], [Segment { whole: true, .. }]),
            begins,
        });
        self.shapes.push(shape);
        Ok((count - 1) as u16)
    }
}
