//! Selection of the instruction set at run time.

use std::sync::OnceLock;

/// An instruction set that the CPU supports. Values of other sets cannot be constructed, so that a
/// function that is compiled for the instructions of [`Isa::level`] may be called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Level);

/// The instruction sets that code is compiled for. Those of other architectures are the portable
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// AVX-512 F, BW, DQ and VL, and all of [`Level::Avx2`].
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// The baseline of the target.
    Portable,
}

impl Isa {
    /// Supported by every CPU.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// The instruction sets that the CPU supports, the best first.
    pub fn available() -> Vec<Self> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                sets.push(Self(Level::Avx512));
            }
            sets.push(Self(Level::Avx2));
        }
        sets.push(Self::PORTABLE);
        sets
    }

    /// The best instruction set of the CPU.
    #[inline]
    pub fn best() -> Self {
        static BEST: OnceLock<Isa> = OnceLock::new();
        *BEST.get_or_init(|| Self::available()[0])
    }

    /// The level of the instruction set.
    #[inline]
    pub fn level(self) -> Level {
        self.0
    }
}

/// Defines a function that is compiled for AVX-512, AVX2 and the baseline, and runs the best
/// version for the CPU. A plain loop is vectorised by the compiler, which neither contracts nor
/// reorders floating-point operations: every version gives the same bits. Only inlined code is
/// compiled for the wider instruction sets: the body has no closures, and the functions that it
/// calls are `#[inline(always)]`.
///
/// ```
/// tiepoint_simd::dispatch! {
///     /// Adds `b` to `a`.
///     fn add(a: &mut [f32], b: &[f32]) {
///         for (a, b) in a.iter_mut().zip(b) {
///             *a += *b;
///         }
///     }
/// }
/// let mut sum = [1.0; 100];
/// add(&mut sum, &[2.0; 100]);
/// assert_eq!(sum, [3.0; 100]);
/// ```
#[macro_export]
macro_rules! dispatch {
    (
        $(#[$meta:meta])*
        fn $name:ident$(<$M:ident: $bound:path>)?($($arg:ident: $type:ty),* $(,)?)
        $(-> $output:ty)? $body:block
    ) => {
        $(#[$meta])*
        fn $name$(<$M: $bound>)?($($arg: $type),*) $(-> $output)? {
            #[inline(always)]
            fn portable$(<$M: $bound>)?($($arg: $type),*) $(-> $output)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl")]
            fn avx512$(<$M: $bound>)?($($arg: $type),*) $(-> $output)? {
                portable$(::<$M>)?($($arg),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2$(<$M: $bound>)?($($arg: $type),*) $(-> $output)? {
                portable$(::<$M>)?($($arg),*)
            }
            match $crate::Isa::best().level() {
                // SAFETY: the CPU supports the instruction set of the function: an `Isa` of this
                // level is only constructed after detection.
                #[cfg(target_arch = "x86_64")]
                $crate::Level::Avx512 => unsafe { avx512$(::<$M>)?($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::Level::Avx2 => unsafe { avx2$(::<$M>)?($($arg),*) },
                $crate::Level::Portable => portable$(::<$M>)?($($arg),*),
            }
        }
    };
}
