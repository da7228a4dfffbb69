//! Selection of the instruction set at run time.

use super::kernel::Task;
use super::portable;
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};

/// An instruction set that the CPU supports. Values of other sets cannot be constructed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Isa(Kind);

/// The implemented instruction sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

impl Isa {
    /// The instruction sets that the CPU supports, the best first.
    pub(crate) fn available() -> Vec<Isa> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
                sets.push(Isa(Kind::Avx512));
            }
            if is_x86_feature_detected!("avx2") {
                sets.push(Isa(Kind::Avx2));
            }
        }
        sets.push(Isa(Kind::Portable));
        sets
    }

    /// The best instruction set of the CPU.
    pub(crate) fn best() -> Isa {
        Isa::available()[0]
    }
}

/// Runs `task` compiled for `isa`.
pub(crate) fn dispatch<T: Task>(isa: Isa, task: T) -> T::Output {
    match isa.0 {
        // SAFETY: only [`Isa::available`] constructs an `Isa` of this kind, after detection.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512 => unsafe { avx512::enter(task) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { avx2::enter(task) },
        Kind::Portable => portable::enter(task),
    }
}
