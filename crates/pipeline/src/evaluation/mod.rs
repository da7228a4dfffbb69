//! Comparison of models and clouds with references.

pub(crate) mod cloud;
pub(crate) mod points;
pub(crate) mod poses;
pub(crate) mod rig;
pub(crate) mod surface;

pub use cloud::{CloudEvaluation, RegisteredCloud, evaluate_cloud, read_cloud, register_cloud};
pub use points::evaluate_points;
pub use poses::{
    Auc, ErrorStatistics, FocalLength, PoseEvaluation, Truth, TruthFormat, evaluate_poses,
};
pub use rig::{RigEvaluation, evaluate_rig};
pub use surface::{SurfaceEvaluation, evaluate_surface};
