//! Which instruction set to run on.

#[cfg(target_arch = "x86_64")]
use super::avx2;
#[cfg(target_arch = "x86_64")]
use super::avx512;
use super::lanes::Task;
use super::portable;

/// An instruction set that this machine has; values for others cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Isa(Kind);

/// An instruction set that code was written for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 256-bit vectors with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Plain Rust.
    Portable,
}

impl Isa {
    /// What every machine can run.
    #[cfg(test)]
    pub(crate) const PORTABLE: Isa = Isa(Kind::Portable);

    /// What this machine can run, best first.
    pub(crate) fn available() -> Vec<Isa> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                sets.push(Isa(Kind::Avx512));
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                sets.push(Isa(Kind::Avx2));
            }
        }
        sets.push(Isa(Kind::Portable));
        sets
    }

    /// The best one.
    pub(crate) fn best() -> Isa {
        Isa::available()[0]
    }
}

/// Runs `task` compiled for `isa`.
pub(crate) fn dispatch<T: Task>(isa: Isa, task: T) -> T::Output {
    match isa.0 {
        // SAFETY: [`Isa::available`] alone makes an `Isa` of this kind, after detection.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512 => unsafe { avx512::enter(task) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { avx2::enter(task) },
        Kind::Portable => portable::enter(task),
    }
}
