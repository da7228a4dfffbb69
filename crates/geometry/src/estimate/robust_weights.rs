//! Robust losses of a block of eight residuals.

use crate::Loss;
use crate::simd::{LANES, Lanes};

/// Computes ρ and the weight ρ′ of eight squared residuals. Residuals from index `num_valid` on are
/// padding: their ρ is set to zero.
#[inline(always)]
pub(super) fn robust_weights(
    loss: Loss,
    squared: &Lanes,
    num_valid: usize,
    rho: &mut Lanes,
    weight: &mut Lanes,
) {
    match loss {
        Loss::Trivial => {
            *rho = *squared;
            *weight = [1.0; LANES];
        }
        Loss::Truncated(a) => {
            for l in 0..LANES {
                let is_near = squared[l] < a * a;
                rho[l] = if is_near { squared[l] } else { a * a };
                weight[l] = if is_near { 1.0 } else { 0.0 };
            }
        }
        _ => {
            for l in 0..LANES {
                [rho[l], weight[l], _] = loss.evaluate(squared[l]);
            }
        }
    }
    rho[num_valid..].fill(0.0);
}
