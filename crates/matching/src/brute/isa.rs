//! Selection of the instruction set at run time.

use std::fmt;

use tiepoint_features::SiftDescriptor;

use super::kernel::compare_all;
use super::lanes::Portable;
use super::screen::for_each_candidate;
#[cfg(target_arch = "x86_64")]
use super::x86;
use crate::distance::squared_distance;
use crate::matches::Nearest;
use crate::packed::{Packed, Vectors};

/// An instruction set that the CPU supports. Values of other sets cannot be constructed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(pub(crate) Kind);

/// The implemented instruction sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    #[cfg(target_arch = "x86_64")]
    Avx512Vnni,
    #[cfg(target_arch = "x86_64")]
    AvxVnni,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

/// All instruction sets, the fastest first.
const KINDS: &[Kind] = &[
    #[cfg(target_arch = "x86_64")]
    Kind::Avx512Vnni,
    #[cfg(target_arch = "x86_64")]
    Kind::AvxVnni,
    #[cfg(target_arch = "x86_64")]
    Kind::Avx2,
    Kind::Portable,
];

impl Kind {
    fn is_supported(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512vnni")
            }
            #[cfg(target_arch = "x86_64")]
            Kind::AvxVnni => {
                is_x86_feature_detected!("avx2") && is_x86_feature_detected!("avxvnni")
            }
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => is_x86_feature_detected!("avx2"),
            Kind::Portable => true,
        }
    }
}

impl Isa {
    /// The fastest instruction set of the CPU.
    pub fn best() -> Self {
        Isa(KINDS.iter().copied().find(|kind| kind.is_supported()).unwrap_or(Kind::Portable))
    }

    /// The instruction sets that the CPU supports, the fastest first. The last one is portable
    /// Rust.
    pub fn supported() -> impl Iterator<Item = Self> {
        KINDS.iter().copied().filter(|kind| kind.is_supported()).map(Isa)
    }

    /// Time of brute force per pair of descriptors, both directions, in nanoseconds, measured on
    /// one core of Zen 5.
    pub(crate) fn pair_ns(self) -> f64 {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => 0.27,
            #[cfg(target_arch = "x86_64")]
            Kind::AvxVnni => 0.53,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => 1.16,
            Kind::Portable => 13.0,
        }
    }

    /// Squared Euclidean distance, exact.
    pub(crate) fn squared_distance(self, a: &SiftDescriptor, b: &SiftDescriptor) -> u32 {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is only constructed if the CPU supports it, and these include AVX2.
            Kind::Avx512Vnni | Kind::AvxVnni | Kind::Avx2 => unsafe { x86::squared_distance(a, b) },
            Kind::Portable => squared_distance(a, b),
        }
    }

    /// The nearest neighbours of all rows `a` and of all columns `b`.
    pub(super) fn compare_all<const G: usize>(
        self,
        a: &impl Vectors<G>,
        b: &Packed<G>,
    ) -> [Vec<Nearest>; 2] {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is only constructed if the CPU supports it.
            Kind::Avx512Vnni => unsafe { x86::compare_all_avx512_vnni(a, b) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is only constructed if the CPU supports it.
            Kind::AvxVnni => unsafe { x86::compare_all_avx_vnni(a, b) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is only constructed if the CPU supports it.
            Kind::Avx2 => unsafe { x86::compare_all_avx2(a, b) },
            // SAFETY: the portable implementation runs on every CPU.
            Kind::Portable => unsafe { compare_all::<Portable, 4, 4, G>(a, b) },
        }
    }

    /// [`for_each_candidate`] on this instruction set. Rows and columns are bounded by
    /// [`MAX_ENTRY`](crate::packed::MAX_ENTRY) and [`MAX_SQUARE`](crate::packed::MAX_SQUARE).
    pub(crate) fn for_each_candidate<const G: usize>(
        self,
        rows: &impl Vectors<G>,
        columns: &Packed<G>,
        min_scores: &mut [i32],
        on_candidate: impl FnMut(usize, u32, &mut i32) -> Option<()>,
    ) -> Option<()> {
        // SAFETY: an `Isa` is only constructed if the CPU supports it; the portable implementation
        // runs on every CPU.
        unsafe {
            match self.0 {
                #[cfg(target_arch = "x86_64")]
                Kind::Avx512Vnni => {
                    x86::for_each_candidate_avx512_vnni(rows, columns, min_scores, on_candidate)
                }
                #[cfg(target_arch = "x86_64")]
                Kind::AvxVnni => {
                    x86::for_each_candidate_avx_vnni(rows, columns, min_scores, on_candidate)
                }
                #[cfg(target_arch = "x86_64")]
                Kind::Avx2 => x86::for_each_candidate_avx2(rows, columns, min_scores, on_candidate),
                Kind::Portable => {
                    for_each_candidate::<Portable, 4, 4, G>(rows, columns, min_scores, on_candidate)
                }
            }
        }
    }
}

impl fmt::Display for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512Vnni => "avx512-vnni",
            #[cfg(target_arch = "x86_64")]
            Kind::AvxVnni => "avx-vnni",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            Kind::Portable => "portable",
        })
    }
}
