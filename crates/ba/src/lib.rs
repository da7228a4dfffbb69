#![doc = include_str!("../README.md")]

pub mod autodiff;
mod covariance;
mod damping;
mod eliminate;
mod error;
pub mod factor;
mod factor_group;
pub mod factors;
mod landmark_refinement;
mod levenberg_marquardt;
mod linear_system;
mod memory;
mod options;
mod problem;
mod qr;
mod reduced;
pub mod retraction;
mod schur;
mod solver;
mod spanning_tree;
mod structure;
mod summary;
pub mod testing;
mod variable;

pub use covariance::Covariance;
pub use error::Error;
pub use factor::Factor;
pub use nalgebra;
pub use options::{LinearSolver, Options};
pub use problem::{Cost, Problem};
pub use solver::Solver;
pub use spanning_tree::SpanningTree;
pub use summary::{IterationRecord, Summary, Termination, Times};
pub use tiepoint_geometry::{Block, Loss, Manifold};
pub use variable::{AnyKey, EliminationOrder, Key};
