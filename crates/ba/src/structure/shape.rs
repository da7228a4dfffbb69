//! Column layout of a factor's Jacobian rows.

/// Position of the landmark in a factor that has none.
pub(crate) const NO_LANDMARK: u8 = u8::MAX;

/// Adjacent columns of a factor's rows that belong to one column block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    /// First column in the rows.
    pub(crate) column: usize,
    pub(crate) dof: usize,
    /// First column in the block.
    pub(crate) offset: usize,
    /// Columns of the block.
    pub(crate) block_dof: usize,
    /// Whether the segment is the whole block.
    pub(crate) whole: bool,
}

/// Column layout of a factor's Jacobian rows. All factors of a task share a few shapes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Shape {
    pub(crate) group: u16,
    /// Position of the eliminated variable among the factor's variables, or [`NO_LANDMARK`].
    pub(crate) landmark_position: u8,
    pub(crate) rows: usize,
    pub(crate) stride: usize,
    /// Column of the residual.
    pub(crate) residual: usize,
    pub(crate) segments: Vec<Segment>,
    /// First column of the eliminated variable.
    pub(crate) eliminated: usize,
    /// Columns of fixed directions in partly fixed variables.
    pub(crate) fixed_columns: Vec<usize>,
}
