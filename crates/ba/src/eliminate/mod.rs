//! The Schur complement, point by point.
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
//! One pass over a chunk's cells linearises a batch of factors into rows, sums C of factors with
//! the same blocks and V, W, g of a cell while they are in the nearest cache, and subtracts YᵀY of
//! cells with the same blocks from the tiles of the chunk. L, y and Y stay in the chunk's stash for
//! δ_p. λD_c is added when the chunks' tiles are put together.

mod cell;
mod cursor;
mod kernel;
mod multiply;
mod normal;
mod product;
mod simd;
mod single;
mod stash;
mod sums;
mod workspace;

pub(crate) use stash::CellStash;
pub(crate) use sums::Sums;
