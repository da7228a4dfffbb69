//! SIMD by automatic vectorisation: a plain loop is compiled once per instruction set, and the
//! function for the CPU is selected at run time. Rust neither contracts nor reassociates
//! floating-point operations, so every instruction set gives the same bits.

use std::ops::Range;

/// Data per block: one AVX-512 register of `f64`, or two AVX2 registers.
pub(crate) const LANES: usize = 8;

/// One component of the eight data of a block.
pub(crate) type Lanes = [f64; LANES];

/// Defines a function that is compiled for AVX-512, AVX2 and the baseline, and runs the best
/// version for the CPU. Only inlined code is compiled for the wider instruction sets: the body has
/// no closures, and the functions that it calls are `#[inline(always)]`.
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
                    // SAFETY: the CPU supports the instruction set of the function.
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

/// Packs data in blocks of eight as structure of arrays: entry `k` of a block holds component `k`
/// of its data. The last block is padded with its first datum.
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

/// Indices of the blocks that hold the data in `range`.
pub(crate) fn blocks_of(range: &Range<usize>) -> Range<usize> {
    range.start / LANES..range.end.div_ceil(LANES)
}

/// Writes the results of block `index` to `out`, which has one entry per datum of `range`. Results
/// of data outside `range` are skipped.
#[inline(always)]
pub(crate) fn store(lanes: &Lanes, index: usize, range: &Range<usize>, out: &mut [f64]) {
    let begin = range.start.max(index * LANES);
    let end = range.end.min((index + 1) * LANES);
    out[begin - range.start..end - range.start]
        .copy_from_slice(&lanes[begin - index * LANES..end - index * LANES]);
}
