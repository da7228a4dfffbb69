//! Which instruction set to run on.

use std::fmt;

use tiepoint_features::Descriptor;

use super::kernel::{RowLanes, Totals, sweep};
use super::lanes::Portable;
use crate::distance::squared_distance;
use crate::packed::{Packed, Vectors};

/// An instruction set that this machine has; values for others cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(pub(crate) Kind);

/// Instruction sets that code was written for.
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

/// Fastest first.
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
    /// The fastest one of this machine.
    pub fn best() -> Self {
        Isa(KINDS.iter().copied().find(|kind| kind.is_supported()).unwrap_or(Kind::Portable))
    }

    /// All that this machine has, the fastest first; the portable one is always there.
    pub fn supported() -> impl Iterator<Item = Self> {
        KINDS.iter().copied().filter(|kind| kind.is_supported()).map(Isa)
    }

    /// Time that brute force takes for a pair of descriptors, both directions, as measured on one
    /// core of Zen 5.
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
    pub(crate) fn squared_distance(self, a: &Descriptor, b: &Descriptor) -> u32 {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is made only where the processor has the features it stands for, and
            // all of these have AVX2.
            Kind::Avx512Vnni | Kind::AvxVnni | Kind::Avx2 => unsafe {
                super::x86::squared_distance(a, b)
            },
            Kind::Portable => squared_distance(a, b),
        }
    }

    /// Compares all with all: what each row has found goes to `finish_row`, in order; what the
    /// columns have found comes back.
    pub(super) fn sweep<const G: usize>(
        self,
        a: &impl Vectors<G>,
        b: &Packed<G>,
        finish_row: impl FnMut(usize, RowLanes<'_>),
    ) -> Totals {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is made only where the processor has the features it stands for.
            Kind::Avx512Vnni => unsafe { super::x86::sweep_avx512_vnni(a, b, finish_row) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is made only where the processor has the features it stands for.
            Kind::AvxVnni => unsafe { super::x86::sweep_avx_vnni(a, b, finish_row) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `Isa` is made only where the processor has the features it stands for.
            Kind::Avx2 => unsafe { super::x86::sweep_avx2(a, b, finish_row) },
            // SAFETY: needs no particular processor.
            Kind::Portable => unsafe { sweep::<Portable, 4, 4, G>(a, b, finish_row) },
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
