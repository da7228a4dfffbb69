//! What all chunks are built from.

use super::block::Block;
use super::cells::Cells;
use super::elimination::Elimination;
use super::place::Look;
use crate::problem::Problem;

/// What is known of the whole problem before it is cut into chunks.
pub(super) struct Context<'a> {
    pub(super) problem: &'a Problem,
    pub(super) blocks: &'a [Block],
    pub(super) looks: &'a [Look],
    pub(super) cells: &'a Cells<'a>,
    pub(super) elimination: Elimination,
}
