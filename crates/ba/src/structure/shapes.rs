//! The distinct shapes of a task's factors.

use crate::error::Error;
use crate::factor_group::AnyFactorGroup;
use crate::problem::Problem;

use super::block::NONE;
use super::landmark_drafts::{FactorRef, GroupView};
use super::ordering::VariableClass;
use super::shape::{NO_LANDMARK, Segment, Shape};
use super::task::SINGLE_ROWS;

/// Largest number of variables of a factor.
const MAX_VARIABLES: usize = 8;

/// Collects the distinct shapes of a task's factors. Most factors have the shape of the one before,
/// which is recognised by the classes of their variables.
pub(super) struct Shapes<'a> {
    pub(super) shapes: Vec<Shape>,
    /// Derived data of each shape.
    pub(super) infos: Vec<ShapeInfo>,
    factor_groups: &'a [Box<dyn AnyFactorGroup>],
    views: &'a [GroupView<'a>],
    classes: &'a [VariableClass],
    /// The last result.
    last: (Key, u16),
}

/// Derived data of a shape.
pub(super) struct ShapeInfo {
    /// Length of the rows.
    pub(super) rows_len: usize,
    pub(super) landmark_position: u8,
    /// Whether a landmark block of such factors may be
    /// [`single`](super::task::LandmarkBlock::single).
    pub(super) single: bool,
    /// Position of the first variable of each segment.
    first_variables: Vec<u8>,
}

/// Determines a factor's shape.
#[derive(Clone, Copy, Default)]
struct Key {
    group: u16,
    /// Bit i: variable i is in the same block as variable i − 1.
    same_block: u8,
    classes: [u32; MAX_VARIABLES],
}

impl<'a> Shapes<'a> {
    pub(super) fn new(
        problem: &'a Problem,
        views: &'a [GroupView<'a>],
        classes: &'a [VariableClass],
    ) -> Self {
        Self {
            shapes: Vec::new(),
            infos: Vec::new(),
            factor_groups: &problem.factor_groups,
            views,
            classes,
            last: Default::default(),
        }
    }

    /// Returns the index of a factor's shape, and appends to `block_indices` the index in
    /// `pattern_blocks` of each of its segments.
    pub(super) fn add(
        &mut self,
        factor_ref: FactorRef,
        pattern_blocks: &[u32],
        block_indices: &mut Vec<u16>,
    ) -> Result<u16, Error> {
        let locations = || self.views[factor_ref.group as usize].locations(factor_ref.factor);
        let (mut blocks, mut last_block) = ([NONE; MAX_VARIABLES], NONE);
        let (mut same_block, mut classes_differ) = (0, 0);
        for (i, location) in locations().enumerate() {
            classes_differ |= location.class ^ self.last.0.classes[i];
            same_block |= u8::from(location.block == last_block) << i;
            (blocks[i], last_block) = (location.block, location.block);
        }
        // All factors of a group have equally many variables.
        let same = classes_differ == 0
            && (factor_ref.group, same_block) == (self.last.0.group, self.last.0.same_block)
            && !self.shapes.is_empty();
        if !same {
            let mut key = Key { group: factor_ref.group, same_block, classes: [0; MAX_VARIABLES] };
            key.classes
                .iter_mut()
                .zip(locations())
                .for_each(|(class, location)| *class = location.class);
            self.last = (key, self.number(&key)?);
        }
        let number = self.last.1;
        for &variable in &self.infos[number as usize].first_variables {
            let block = blocks[variable as usize];
            // Usually the next one.
            let next = block_indices.last().map_or(0, |&last| usize::from(last) + 1);
            let block_index = match pattern_blocks.len() {
                _ if pattern_blocks.get(next) == Some(&block) => Some(next),
                // Linear search is faster for few blocks.
                0..=8 => pattern_blocks.iter().position(|&other| other == block),
                _ => pattern_blocks.binary_search(&block).ok(),
            };
            block_indices
                .push(block_index.expect("the landmark lists all its factors' blocks") as u16);
        }
        Ok(number)
    }

    /// Index of the shape that `key` determines, existing or new.
    fn number(&mut self, key: &Key) -> Result<u16, Error> {
        let group = &self.factor_groups[key.group as usize];
        let mut shape = Shape {
            group: key.group,
            landmark_position: NO_LANDMARK,
            rows: group.rows(),
            stride: group.stride(),
            ..Shape::default()
        };
        let (mut column, mut last_has_block, mut first_variables) = (0, false, Vec::new());
        for ((position, &class), &dof) in (0u8..).zip(&key.classes).zip(group.dofs()) {
            let class = &self.classes[class as usize];
            if class.free != 0 {
                shape
                    .fixed_columns
                    .extend((0..dof).filter(|i| class.free >> i & 1 == 0).map(|i| column + i));
            }
            let (offset, block_dof) = (class.offset as usize, class.block_dof as usize);
            if block_dof > 0 {
                match shape.segments.last_mut() {
                    Some(last)
                        if last_has_block
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
                        first_variables.push(position);
                    }
                }
            } else if class.eliminated {
                (shape.landmark_position, shape.eliminated) = (position, column);
            }
            last_has_block = block_dof > 0;
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
        self.infos.push(ShapeInfo {
            rows_len: shape.rows * shape.stride,
            landmark_position: shape.landmark_position,
            single: shape.rows == SINGLE_ROWS
                && matches!(shape.segments[..], [Segment { whole: true, .. }]),
            first_variables,
        });
        self.shapes.push(shape);
        Ok((count - 1) as u16)
    }
}
