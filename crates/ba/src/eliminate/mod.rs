//! Schur complement, landmark by landmark.
//!
//! With the residuals linearised as r + J_c δ_c + J_p δ_p (c kept, p eliminated) and damping λD,
//! the normal equations are
//!
//! ```text
//! | C   W | |δ_c|     |g_c|      C = J_cᵀJ_c + λD_c,  W = J_cᵀJ_p,  g = Jᵀr
//! | Wᵀ  V | |δ_p| = − |g_p|      V = J_pᵀJ_p + λD_p  (block diagonal: one block per p)
//! ```
//!
//! and, with V = LLᵀ, Y = L⁻¹Wᵀ and y = L⁻¹g_p,
//!
//! ```text
//! (C − YᵀY) δ_c = −(g_c − Yᵀy),      δ_p = −L⁻ᵀ (y + Y δ_c).
//! ```
//!
//! One pass over a task's landmark blocks linearises a batch of factors into rows, sums C over
//! factors with the same column blocks, sums V, W and g of each landmark while the rows are in the
//! first-level cache, and subtracts YᵀY of landmarks with the same pattern from the task's tiles.
//! L, y and Y stay in the task's stash for back-substitution. λD_c is added when the tiles of all
//! tasks are summed.

mod batch;
mod cursor;
mod general;
mod multiply;
mod normal;
mod product;
mod simd;
mod single;
mod stash;
mod sums;
mod workspace;

pub(crate) use stash::LandmarkStash;
pub(crate) use sums::Sums;
