//! A robust loss, eight residuals at a time.

use crate::Loss;
use crate::simd::{LANES, Lanes};

/// ρ and ρ′ of some squared residuals; ρ is zero beyond the first `counted`, which are padding.
#[inline(always)]
pub(super) fn weigh(
    loss: Loss,
    squared: &Lanes,
    counted: usize,
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
    rho[counted..].fill(0.0);
}
