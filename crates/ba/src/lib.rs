#![doc = include_str!("../README.md")]

mod autodiff;
mod covariance;
mod damping;
mod eliminate;
mod error;
mod factor;
pub mod factors;
mod memory;
mod options;
mod problem;
mod qr;
mod reduced;
mod refine;
mod retraction;
mod run;
mod schur;
mod solver;
mod spanning_tree;
mod structure;
mod summary;
mod system;
pub mod testing;
mod variable;

pub use autodiff::{AutoDiff, DIRECTIONS, Dual, Lift, LiftVars, Residual, RigidOf, Scalar};
pub use covariance::Covariance;
pub use error::Error;
pub use factor::{Factor, IntoKeys, Linear, Refs, Vars};
pub use nalgebra;
pub use options::{LinearSolver, Options};
pub use problem::{Cost, Problem};
pub use retraction::{Moved, Retraction, Step, StepOf};
pub use solver::Solver;
pub use spanning_tree::SpanningTree;
pub use summary::{IterationRecord, Summary, Termination, Times};
pub use tiepoint_geometry::{Block, Loss, Manifold};
pub use variable::{AnyKey, Key, Order};
