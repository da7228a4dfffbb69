//! Minimal solvers: as many data as unknowns in, every solution out, nothing allocated. An empty
//! list, or `None`, is a degenerate sample. [`TABLE`] lists them; tests, benches and the README
//! follow it.

mod essential_5pt;
mod fundamental_7pt;
mod homography_4pt;
mod null_space;
mod p3p;
mod polynomial;
mod sturm;
mod umeyama;

pub use essential_5pt::essential_5pt;
pub(crate) use fundamental_7pt::normalisation;
pub use fundamental_7pt::{fundamental_7pt, fundamental_8pt};
pub use homography_4pt::{homography_4pt, homography_dlt};
pub use p3p::p3p;
pub use umeyama::umeyama;

/// One line about a solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SolverInfo {
    /// Name of the function.
    pub name: &'static str,
    /// What it finds.
    pub finds: &'static str,
    /// Fewest data.
    pub sample_size: usize,
    /// Most solutions.
    pub max_solutions: usize,
    /// Where it is from.
    pub paper: &'static str,
}

/// Every solver.
#[rustfmt::skip]
pub const TABLE: &[SolverInfo] = &[
    SolverInfo {
        name: "p3p",
        finds: "camera pose from rays and points",
        sample_size: 3,
        max_solutions: 4,
        paper: "Ding et al. 2023",
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
