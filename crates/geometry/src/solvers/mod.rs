//! Minimal solvers, and least-squares solvers for more data. They return all solutions and do not
//! allocate. An empty list, or `None`, means that the sample is degenerate. [`TABLE`] lists the
//! solvers; tests, benchmarks and the README use it.

mod essential_5pt;
mod fundamental_7pt;
mod gp3p;
mod homography_4pt;
mod null_space;
mod p3p;
mod polynomial;
mod sturm;
mod umeyama;

pub use essential_5pt::essential_5pt;
pub(crate) use fundamental_7pt::normalisation;
pub use fundamental_7pt::{fundamental_7pt, fundamental_8pt};
pub use gp3p::gp3p;
pub use homography_4pt::{homography_4pt, homography_dlt};
pub use p3p::p3p;
pub use umeyama::umeyama;

/// Description of a solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SolverInfo {
    /// Name of the function.
    pub name: &'static str,
    /// The estimated quantity.
    pub finds: &'static str,
    /// Minimum number of data.
    pub sample_size: usize,
    /// Maximum number of solutions.
    pub max_solutions: usize,
    /// Author and year of the source.
    pub paper: &'static str,
}

/// All solvers.
#[rustfmt::skip]
pub const TABLE: &[SolverInfo] = &[
    SolverInfo {
        name: "p3p",
        finds: "camera pose from unit rays and points",
        sample_size: 3,
        max_solutions: 4,
        paper: "Ding et al. 2023",
    },
    SolverInfo {
        name: "gp3p",
        finds: "pose of a generalised camera from rays and points",
        sample_size: 3,
        max_solutions: 8,
        paper: "Nistér & Stewénius 2007",
    },
    SolverInfo {
        name: "essential_5pt",
        finds: "essential matrix",
        sample_size: 5,
        max_solutions: 10,
        paper: "Nistér 2004",
    },
    SolverInfo {
        name: "fundamental_7pt",
        finds: "fundamental matrix",
        sample_size: 7,
        max_solutions: 3,
        paper: "Hartley & Zisserman 2004",
    },
    SolverInfo {
        name: "fundamental_8pt",
        finds: "fundamental matrix, least squares",
        sample_size: 8,
        max_solutions: 1,
        paper: "Hartley 1997",
    },
    SolverInfo {
        name: "homography_4pt",
        finds: "homography",
        sample_size: 4,
        max_solutions: 1,
        paper: "Heckbert 1989",
    },
    SolverInfo {
        name: "homography_dlt",
        finds: "homography, least squares",
        sample_size: 4,
        max_solutions: 1,
        paper: "Hartley & Zisserman 2004",
    },
    SolverInfo {
        name: "umeyama",
        finds: "similarity or rigid transform",
        sample_size: 3,
        max_solutions: 1,
        paper: "Umeyama 1991",
    },
];
