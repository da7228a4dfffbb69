//! The source of an octave: rows of the image, the doubled image or the previous octave.

use crate::GrayView;
use crate::simd::{LANES, Simd};

/// The value of white in an 8-bit image.
const WHITE: f32 = 255.0;

/// The source of an octave.
#[derive(Clone, Copy)]
pub(crate) enum Source<'a> {
    /// The image.
    Image(GrayView<'a>),
    /// The image at double resolution by linear interpolation: pixels alternate with the means of
    /// neighbours. Border pixels are repeated.
    Doubled(GrayView<'a>),
    /// Every second sample of level S of the previous octave, which is level 0 without a blur.
    Halved {
        /// The samples.
        data: &'a [f32],
        /// Distance between rows, in samples.
        stride: usize,
    },
}

impl Source<'_> {
    /// Writes columns `from..to` of row `y` to `out`, which points to column `from`. Black is 0 and
    /// white is 1.
    ///
    /// # Safety
    /// The row and the columns are in the octave. `out` is writable from one value before column
    /// `from` to `LANES` values after column `to`. `temp` has the length of half a row plus
    /// `2 · LANES`.
    #[inline(always)]
    pub(crate) unsafe fn fill_row<S: Simd>(
        &self,
        y: usize,
        (from, to): (usize, usize),
        out: *mut f32,
        temp: &mut [f32],
    ) {
        // SAFETY: guaranteed by the caller.
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

/// Converts bytes to values from 0 to 1.
///
/// # Safety
/// `out` is writable for the length of `row`, rounded up to `LANES`.
#[inline(always)]
unsafe fn convert<S: Simd>(row: &[u8], out: *mut f32) {
    let scale = S::splat(1.0 / WHITE);
    let vector_end = row.len() / LANES * LANES;
    for x in (0..vector_end).step_by(LANES) {
        // SAFETY: `x + LANES <= vector_end`.
        unsafe { S::store(out.add(x), S::mul(S::load_u8(row.as_ptr().add(x)), scale)) };
    }
    for (x, &v) in row.iter().enumerate().skip(vector_end) {
        // SAFETY: guaranteed by the caller.
        unsafe { *out.add(x) = f32::from(v) * (1.0 / WHITE) };
    }
}

/// The mean of two rows, from 0 to 1.
///
/// # Safety
/// Both rows have the same length, and `out` is writable for it.
#[inline(always)]
unsafe fn mean<S: Simd>(upper: &[u8], lower: &[u8], out: *mut f32) {
    const HALF: f32 = 0.5 / WHITE;
    let scale = S::splat(HALF);
    let vector_end = upper.len() / LANES * LANES;
    for x in (0..vector_end).step_by(LANES) {
        // SAFETY: `x + LANES <= vector_end`, which is at most the length of either row.
        unsafe {
            let sum = S::add(S::load_u8(upper.as_ptr().add(x)), S::load_u8(lower.as_ptr().add(x)));
            S::store(out.add(x), S::mul(sum, scale));
        }
    }
    for x in vector_end..upper.len() {
        // SAFETY: guaranteed by the caller.
        unsafe { *out.add(x) = (f32::from(upper[x]) + f32::from(lower[x])) * HALF };
    }
}

/// Doubles a row by linear interpolation.
///
/// # Safety
/// `out` is writable for `2 · pairs` values, and `row` has `pairs + 1` values.
#[inline(always)]
unsafe fn double(row: &[f32], out: *mut f32, pairs: usize) {
    // SAFETY: guaranteed by the caller.
    let out = unsafe { std::slice::from_raw_parts_mut(out, 2 * pairs) };
    for (out, pair) in out.chunks_exact_mut(2).zip(row.windows(2)) {
        out[0] = pair[0];
        out[1] = 0.5 * (pair[0] + pair[1]);
    }
}
