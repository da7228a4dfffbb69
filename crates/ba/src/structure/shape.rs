//! How the rows of a factor fall into blocks.

/// In place of a variable's position in a factor: none of them is eliminated.
pub(crate) const NO_OWN: u8 = u8::MAX;

/// Columns of one block in a factor's rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    /// First column in the rows.
    pub(crate) column: usize,
    pub(crate) dof: usize,
    /// First column in the block.
    pub(crate) offset: usize,
    /// Columns of the block.
    pub(crate) block_dof: usize,
    /// Whether it is the whole block.
    pub(crate) whole: bool,
}

/// How the rows of a factor fall into blocks: few of these serve all factors.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Shape {
    pub(crate) run: u16,
    /// Which of the factor's variables is the eliminated one, or [`NO_OWN`].
    pub(crate) own: u8,
    pub(crate) rows: usize,
    pub(crate) stride: usize,
    /// Column of the residual.
    pub(crate) residual: usize,
    pub(crate) segments: Vec<Segment>,
    /// First column of the eliminated variable.
    pub(crate) eliminated: usize,
    /// Columns of directions that are held fixed in variables that move otherwise.
    pub(crate) held: Vec<usize>,
}
