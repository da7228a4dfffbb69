//! Comparison of models and clouds with references.

pub(crate) mod cloud;
pub(crate) mod poses;
pub(crate) mod rig;
pub(crate) mod surface;
