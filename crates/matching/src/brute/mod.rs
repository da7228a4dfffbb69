//! Exact nearest and second nearest neighbours by brute force, in both directions at once.
//!
//! The squared distance is `|a|² + |b|² − 2 a·b`, so the work is a matrix product of 8-bit numbers.
//! It is cut into tiles whose products stay in registers; while they are there, each updates the
//! two largest values of its row and the two largest of its column, so that one product serves both
//! directions and no N × N matrix is ever stored.
//!
//! - `kernel` is the loop over tiles, written once over the trait [`Lanes`];
//! - `lanes` is that trait with its portable implementation, `x86` the ones in AVX-512 VNNI,
//!   AVX-VNNI and AVX2;
//! - `isa` picks one at run time. All give the same bits: the arithmetic is exact in integers.

mod isa;
mod kernel;
mod lanes;
#[cfg(target_arch = "x86_64")]
mod x86;

use crate::matches::Nearest;
use crate::packed::{Packed, Vectors};
use crate::prepared::Prepared;

pub use isa::Isa;
pub(crate) use isa::Kind;
pub(crate) use kernel::RowLanes;
use kernel::nearest_of_columns;

/// The nearest neighbours of two images' descriptors in each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NearestBothWays {
    /// For every descriptor of the first image, its partners in the second.
    pub of_a: Vec<Nearest>,
    /// For every descriptor of the second image, its partners in the first.
    pub of_b: Vec<Nearest>,
}

/// The two nearest neighbours of every descriptor, in both directions, exact: by comparing all with
/// all, on the fastest instruction set of this machine.
pub fn nearest(a: &Prepared, b: &Prepared) -> NearestBothWays {
    nearest_on(Isa::best(), a, b)
}

/// As [`nearest`], on a given instruction set: for tests and measurements.
pub fn nearest_on(isa: Isa, a: &Prepared, b: &Prepared) -> NearestBothWays {
    let b = b.pack_all();
    let mut of_a = Vec::with_capacity(a.len());
    let of_b = compare(isa, a, &b, |_, row| of_a.push(row.whole()));
    NearestBothWays { of_a, of_b }
}

/// Compares all with all: what each row has found goes to `finish_row`, in order; the nearest
/// neighbours of the columns come back.
pub(crate) fn compare<const G: usize>(
    isa: Isa,
    a: &impl Vectors<G>,
    b: &Packed<G>,
    finish_row: impl FnMut(usize, RowLanes<'_>),
) -> Vec<Nearest> {
    nearest_of_columns(b, &isa.sweep(a, b, finish_row))
}

#[cfg(test)]
mod tests {
    use tiepoint_features::Descriptor;

    use super::{Isa, nearest_on};
    use crate::distance::squared_distance;
    use crate::prepared::Prepared;
    use crate::random::SplitMix64;

    /// Small enough for Miri and a sanitizer: two tiles, both with padding, and rows that fill no
    /// block.
    #[test]
    fn a_few_descriptors_find_their_nearest() {
        let mut random = SplitMix64::new(3, 0);
        let mut some = |count: usize| -> Vec<Descriptor> {
            (0..count).map(|_| std::array::from_fn(|_| random.below(256) as u8)).collect()
        };
        let (a, b) = (some(13), some(67));
        for isa in Isa::supported() {
            let found = nearest_on(isa, &Prepared::new(&a), &Prepared::new(&b));
            for (from, to, found) in [(&a, &b, &found.of_a), (&b, &a, &found.of_b)] {
                for (descriptor, nearest) in from.iter().zip(found) {
                    let mut distances: Vec<u32> =
                        to.iter().map(|other| squared_distance(descriptor, other)).collect();
                    assert_eq!(distances[nearest.index as usize], nearest.distance, "{isa}");
                    distances.sort_unstable();
                    assert_eq!(distances[..2], [nearest.distance, nearest.second], "{isa}");
                }
            }
        }
    }
}
