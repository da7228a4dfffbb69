//! Vector code by compiling plain loops again for wider instruction sets and choosing at run time.
//! Rust neither contracts nor reassociates floating-point operations, so that every instruction set
//! gives the same bits.

use std::ops::Range;

/// Numbers per vector: one of AVX-512, two of AVX2.
pub(crate) const LANES: usize = 8;

/// One number for each of eight data.
pub(crate) type Lanes = [f64; LANES];

/// Defines a function that runs as compiled for the best instruction set of the machine. Only what
/// is inlined is compiled again: no closures inside, and called functions are `#[inline(always)]`.
macro_rules! dispatch {
    (
        $(#[$meta:meta])*
        fn $name:ident$(<$M:ident: $bound:path>)?($($arg:ident: $type:ty),* $(,)?) $body:block
    ) => {
        $(#[$meta])*
        fn $name$(<$M: $bound>)?($($arg: $type),*) {
            #[inline(always)]
            fn portable$(<$M: $bound>)?($($arg: $type),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn avx512$(<$M: $bound>)?($($arg: $type),*) {
                    portable$(::<$M>)?($($arg),*);
                }
                #[target_feature(enable = "avx2")]
                fn avx2$(<$M: $bound>)?($($arg: $type),*) {
                    portable$(::<$M>)?($($arg),*);
                }
                if is_x86_feature_detected!("avx512f") {
                    // SAFETY: the machine has what the function is compiled for.
                    return unsafe { avx512$(::<$M>)?($($arg),*) };
                }
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: as above.
                    return unsafe { avx2$(::<$M>)?($($arg),*) };
                }
            }
            portable$(::<$M>)?($($arg),*);
        }
    };
}

/// Packs data by eights, component by component; the last block is filled up with its first datum.
pub(crate) fn pack<T, const N: usize>(
    data: &[T],
    components: impl Fn(&T) -> [f64; N],
) -> Vec<[Lanes; N]> {
    let block = |data: &[T]| {
        let mut block = [[0.0; LANES]; N];
        for lane in 0..LANES {
            let datum = components(data.get(lane).unwrap_or(&data[0]));
            for (component, value) in block.iter_mut().zip(datum) {
                component[lane] = value;
            }
        }
        block
    };
    data.chunks(LANES).map(block).collect()
}

/// The blocks that hold the data in `range`.
pub(crate) fn blocks_of(range: &Range<usize>) -> Range<usize> {
    range.start / LANES..range.end.div_ceil(LANES)
}

/// Writes what block `index` gives for the data in `range` where `out`, which is for `range`, has
/// it.
#[inline(always)]
pub(crate) fn store(lanes: &Lanes, index: usize, range: &Range<usize>, out: &mut [f64]) {
    let begin = range.start.max(index * LANES);
    let end = range.end.min((index + 1) * LANES);
    out[begin - range.start..end - range.start]
        .copy_from_slice(&lanes[begin - index * LANES..end - index * LANES]);
}
