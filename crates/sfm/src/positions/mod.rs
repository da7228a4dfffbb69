//! Measured positions of cameras: the similarity of a model to their frame, their term in bundle
//! adjustments, and whether a model that was built with them is better.
//!
//! Positions may be wrong: a receiver between walls, a fix that stands still, a file whose columns
//! are swapped. The similarity is that of least median of squares (Rousseeuw 1984), the term has a
//! robust loss, and a model with the term counts only if positions that took no part say so
//! ([`compare`]). Positions with a clock of their own become positions of images by
//! [`align_track`].

mod alignment;
mod control_adjustment;
mod control_alignment;
mod control_points;
mod control_term;
mod evidence;
mod measured;
mod redundancy;
mod term;
mod track;

pub use alignment::{Misfit, PositionAlignment, align, may_be_mirrored};
pub use control_adjustment::{ControlAdjustment, adjust_to_points};
pub use control_alignment::{
    ControlAlignment, ControlMisfit, align_to_points, first_similarity_to_points,
};
pub use control_points::{MarkedPoint, PointError, point_errors, with_global_shutter};
pub use evidence::{Comparison, compare, held_out};
pub use measured::MeasuredPosition;
pub use term::PositionTerm;
pub use track::{TimedPosition, TrackAlignment, TrackMisfit, align_track};
