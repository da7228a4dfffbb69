//! Selection of the instruction set at run time.

pub(crate) use tiepoint_simd::Isa;
use tiepoint_simd::Level;

use super::kernel::Task;
use super::portable;
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};

/// Runs `task` compiled for `isa`.
pub(crate) fn dispatch<T: Task>(isa: Isa, task: T) -> T::Output {
    match isa.level() {
        // SAFETY: an `Isa` of this level is only constructed after detection.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { avx512::enter(task) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { avx2::enter(task) },
        Level::Portable => portable::enter(task),
    }
}
