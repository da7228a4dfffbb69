//! Data in blocks of eight, for loops that [`tiepoint_simd::dispatch`] compiles for wide registers.

use std::ops::Range;

/// Data per block: one AVX-512 register of `f64`, or two AVX2 registers.
pub(crate) const LANES: usize = 8;

/// One component of the eight data of a block.
pub(crate) type Lanes = [f64; LANES];

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
