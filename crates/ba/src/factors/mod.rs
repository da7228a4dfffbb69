//! Standard factors. Only these know cameras; the solver does not.

mod between;
mod centre;
mod difference;
mod lens_field;
mod prior;
mod relative;
mod reprojection;

pub use between::Between;
pub use centre::{Centre, RigCentre};
pub use difference::Difference;
pub use lens_field::{FieldReprojection, LensField};
pub use prior::Prior;
pub use relative::Relative;
pub use reprojection::{Reprojection, RigReprojection, ShiftedReprojection};
