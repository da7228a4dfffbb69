//! Input from which all tasks are built.

use super::block::ColumnBlock;
use super::elimination::Elimination;
use super::landmark_drafts::LandmarkDrafts;
use super::ordering::VariableClass;
use crate::problem::Problem;

/// Analysis of the whole problem before it is cut into tasks.
pub(super) struct Context<'a> {
    pub(super) problem: &'a Problem,
    pub(super) blocks: &'a [ColumnBlock],
    pub(super) classes: &'a [VariableClass],
    pub(super) drafts: &'a LandmarkDrafts<'a>,
    pub(super) elimination: Elimination,
}
