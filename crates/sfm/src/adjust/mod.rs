//! Bundle adjustment of a reconstruction.

mod gauge;
mod intrinsics;
mod options;
mod portrait_landscape;
mod problem;
mod rigid_frames;
mod solve;
mod term;
mod variables;

pub use gauge::fix_gauge;
pub use options::{AdjustOptions, RefineIntrinsics, Scope};
pub(crate) use problem::build;
pub use solve::adjust;
pub(crate) use solve::keep_going;
pub use term::{Shifted, Term, TermContext};
pub use variables::Variables;
