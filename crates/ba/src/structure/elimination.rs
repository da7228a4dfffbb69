//! Whether variables are eliminated, and whether the reduced system is put together.

/// What becomes of the variables that are declared eliminated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Elimination {
    /// Kept like the others, for solvers that see the whole Jacobian.
    Ignore,
    /// Eliminated.
    Do,
    /// The same, and the reduced system is never put together: tiles are of C alone.
    Implicit,
}
