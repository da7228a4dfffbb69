//! Whether variables are eliminated, and whether the reduced system is formed.

/// Treatment of the variables that are declared eliminated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Elimination {
    /// Kept like the others, for solvers that need the whole Jacobian.
    Ignore,
    /// Eliminated.
    Do,
    /// Eliminated, and the reduced system is never formed: tiles hold C alone.
    Implicit,
}
