//! What an octave is made from, row by row.

use crate::GrayView;
use crate::simd::{LANES, Simd};

/// White in an image of 8 bits.
const WHITE: f32 = 255.0;

/// What an octave is made from.
#[derive(Clone, Copy)]
pub(crate) enum Source<'a> {
    /// The image.
    Image(GrayView<'a>),
    /// The image at twice its resolution: pixels interleaved with the means of neighbours, the last
    /// ones repeated.
    Doubled(GrayView<'a>),
    /// Every second sample of a level of the octave before, which is level 0 itself.
    Halved {
        /// The samples.
        data: &'a [f32],
        /// Distance between their rows.
        stride: usize,
    },
}

impl Source<'_> {
    /// Writes columns `from..to` of row `y` to `out`, which points to where column `from` belongs;
    /// black is 0, white 1.
    ///
    /// # Safety
    /// Row and columns are inside of the octave; `out` is writable for `to − from` values, and from
    /// one value before it to `LANES` values after them. `temp` is as long as half a row and
    /// `2 · LANES`.
    #[inline(always)]
    pub(crate) unsafe fn fill_row<S: Simd>(
        &self,
        y: usize,
        (from, to): (usize, usize),
        out: *mut f32,
        temp: &mut [f32],
    ) {
        // SAFETY: the caller's promise.
        unsafe {
            match *self {
                Source::Image(view) => {
                    convert::<S>(&view.row(y)[from..to], out);
                }
                Source::Doubled(view) => {
                    let upper = view.row(y / 2);
                    let lower =
                        if y % 2 == 1 { view.row((y / 2 + 1).min(view.height - 1)) } else { upper };
                    let (first, last) = (from / 2, ((to - 1) / 2 + 1).min(view.width - 1));
                    mean::<S>(&upper[first..=last], &lower[first..=last], temp.as_mut_ptr());
                    // The right neighbour of the last pixel is itself.
                    temp[last + 1 - first] = temp[last - first];
                    let pairs = to.div_ceil(2) - first;
                    double(&temp[..=pairs], out.sub(from % 2), pairs);
                }
                Source::Halved { data, stride } => {
                    let row = &data[y * stride..][from..to];
                    out.copy_from_nonoverlapping(row.as_ptr(), row.len());
                }
            }
        }
    }
}

/// # Safety
/// `out` is writable for as many values as `row` has, rounded up to `LANES`.
#[inline(always)]
unsafe fn convert<S: Simd>(row: &[u8], out: *mut f32) {
    let scale = S::splat(1.0 / WHITE);
    let whole = row.len() / LANES * LANES;
    for x in (0..whole).step_by(LANES) {
        // SAFETY: `x + LANES <= whole`.
        unsafe { S::store(out.add(x), S::mul(S::load_u8(row.as_ptr().add(x)), scale)) };
    }
    for (x, &v) in row.iter().enumerate().skip(whole) {
        // SAFETY: the caller's promise.
        unsafe { *out.add(x) = f32::from(v) * (1.0 / WHITE) };
    }
}

/// # Safety
/// `out` is writable for as many values as the rows have, which are equally long.
#[inline(always)]
unsafe fn mean<S: Simd>(upper: &[u8], lower: &[u8], out: *mut f32) {
    const HALF: f32 = 0.5 / WHITE;
    let scale = S::splat(HALF);
    let whole = upper.len() / LANES * LANES;
    for x in (0..whole).step_by(LANES) {
        // SAFETY: `x + LANES <= whole`, which is at most the length of either row.
        unsafe {
            let sum = S::add(S::load_u8(upper.as_ptr().add(x)), S::load_u8(lower.as_ptr().add(x)));
            S::store(out.add(x), S::mul(sum, scale));
        }
    }
    for x in whole..upper.len() {
        // SAFETY: the caller's promise.
        unsafe { *out.add(x) = (f32::from(upper[x]) + f32::from(lower[x])) * HALF };
    }
}

/// # Safety
/// `out` is writable for `2 · pairs` values; `row` has `pairs + 1`.
#[inline(always)]
unsafe fn double(row: &[f32], out: *mut f32, pairs: usize) {
    // SAFETY: the caller's promise.
    let out = unsafe { std::slice::from_raw_parts_mut(out, 2 * pairs) };
    for (out, pair) in out.chunks_exact_mut(2).zip(row.windows(2)) {
        out[0] = pair[0];
        out[1] = 0.5 * (pair[0] + pair[1]);
    }
}
