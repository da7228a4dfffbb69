//! SIMD vectors of 32-bit integers with the operations of the kernel.

use crate::packed::{PANEL, Panel};

/// Row operands are the bytes of descriptor `a` as `a − 128`, which fit into `i8`.
pub(super) const OFFSET: i32 = 128;

/// The dot products of an instruction set, with the operations of both kernels.
///
/// # Safety
/// The CPU must support the instruction set for every method.
pub(super) trait Lanes {
    /// The register.
    type Vector: Copy;
    /// Number of lanes of a vector, one for each column: 4, 8 or 16.
    const LANES: usize;
    /// Number of 32-bit words of a vector.
    const WORDS: usize;
    /// Number of multiply-adds per group of four bytes: one, or two for instructions on two
    /// integers.
    const STEPS: usize;

    /// The row operands of a group of four bytes, as `byte − 128`. The first `STEPS` are used.
    unsafe fn row_words(word: u32) -> [i32; 2];
    /// The column operands of some panels, `[panel][step][column]`: the panels themselves, or
    /// converted values in `buffer`.
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32;

    unsafe fn load(from: *const i32) -> Self::Vector;
    unsafe fn store(to: *mut i32, v: Self::Vector);
    /// A vector of equal words.
    unsafe fn splat(x: i32) -> Self::Vector;
    /// `sum` plus the dot product of the column and row operands of a step, per lane.
    unsafe fn multiply_add(
        sum: Self::Vector,
        column: Self::Vector,
        row: Self::Vector,
    ) -> Self::Vector;
    /// Wrapping difference.
    unsafe fn subtract(x: Self::Vector, y: Self::Vector) -> Self::Vector;
    unsafe fn max(x: Self::Vector, y: Self::Vector) -> Self::Vector;
}

/// Lanes of 32 bits, with the operations on keys.
///
/// # Safety
/// The CPU must support the instruction set for every method.
pub(super) trait KeyLanes: Lanes {
    unsafe fn shift_left<const BITS: u32>(x: Self::Vector) -> Self::Vector;
    unsafe fn min(x: Self::Vector, y: Self::Vector) -> Self::Vector;
}

/// Lanes of 32 or 16 bits, with the comparison of scores.
///
/// # Safety
/// The CPU must support the instruction set for every method.
pub(super) trait ScoreLanes: Lanes {
    /// The result of a comparison.
    type Mask: Copy;
    /// Whether lanes have 16 bits.
    const IS_NARROW: bool;

    unsafe fn is_above(x: Self::Vector, y: Self::Vector) -> Self::Mask;
    unsafe fn or(x: Self::Mask, y: Self::Mask) -> Self::Mask;
    unsafe fn is_any(mask: Self::Mask) -> bool;
    /// One bit for each lane.
    unsafe fn bits(mask: Self::Mask) -> u32;
}

/// Converts every group of four bytes to two words of two 16-bit integers: the even and the odd
/// bytes.
#[inline(always)]
pub(super) fn widen<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32 {
    let groups = panels.iter().flat_map(|panel| &panel.0);
    for (group, words) in groups.zip(buffer.as_chunks_mut::<{ 2 * PANEL }>().0) {
        let (even, odd) = words.split_at_mut(PANEL);
        for ((word, even), odd) in group.iter().zip(even).zip(odd) {
            *even = (word & 0x00FF_00FF) as i32;
            *odd = ((word >> 8) & 0x00FF_00FF) as i32;
        }
    }
    buffer.as_ptr()
}

/// The row operands for the column operands of [`widen`].
#[inline(always)]
pub(super) fn widen_signed(word: u32) -> [i32; 2] {
    let pair = |low: u8, high: u8| {
        let [low, high] = [low, high].map(|x| (i32::from(x) - OFFSET) as u16);
        (u32::from(high) << 16 | u32::from(low)) as i32
    };
    let [b0, b1, b2, b3] = word.to_le_bytes();
    [pair(b0, b2), pair(b1, b3)]
}

/// Portable Rust, which the compiler vectorises for the baseline of the target.
pub(super) struct Portable;

const LANES: usize = 4;

#[inline(always)]
fn zip(x: [i32; LANES], y: [i32; LANES], f: impl Fn(i32, i32) -> i32) -> [i32; LANES] {
    std::array::from_fn(|lane| f(x[lane], y[lane]))
}

impl Lanes for Portable {
    type Vector = [i32; LANES];
    const LANES: usize = LANES;
    const WORDS: usize = LANES;
    const STEPS: usize = 2;

    #[inline(always)]
    unsafe fn row_words(word: u32) -> [i32; 2] {
        widen_signed(word)
    }
    #[inline(always)]
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32 {
        widen(panels, buffer)
    }
    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self::Vector {
        // SAFETY: the caller guarantees LANES integers at `from`.
        unsafe { from.cast::<Self::Vector>().read() }
    }
    #[inline(always)]
    unsafe fn store(to: *mut i32, v: Self::Vector) {
        // SAFETY: the caller guarantees memory for LANES integers at `to`.
        unsafe { to.cast::<Self::Vector>().write(v) }
    }
    #[inline(always)]
    unsafe fn splat(x: i32) -> Self::Vector {
        [x; LANES]
    }
    #[inline(always)]
    unsafe fn multiply_add(
        sum: Self::Vector,
        column: Self::Vector,
        row: Self::Vector,
    ) -> Self::Vector {
        let low = |x: i32| i32::from(x as i16);
        let dot = zip(column, row, |c, r| low(c) * low(r) + (c >> 16) * (r >> 16));
        zip(sum, dot, i32::wrapping_add)
    }
    #[inline(always)]
    unsafe fn subtract(x: Self::Vector, y: Self::Vector) -> Self::Vector {
        zip(x, y, i32::wrapping_sub)
    }
    #[inline(always)]
    unsafe fn max(x: Self::Vector, y: Self::Vector) -> Self::Vector {
        zip(x, y, i32::max)
    }
}

impl KeyLanes for Portable {
    #[inline(always)]
    unsafe fn shift_left<const BITS: u32>(x: Self::Vector) -> Self::Vector {
        x.map(|x| x << BITS)
    }
    #[inline(always)]
    unsafe fn min(x: Self::Vector, y: Self::Vector) -> Self::Vector {
        zip(x, y, i32::min)
    }
}

impl ScoreLanes for Portable {
    /// -1 where true.
    type Mask = [i32; LANES];
    const IS_NARROW: bool = false;

    #[inline(always)]
    unsafe fn is_above(x: Self::Vector, y: Self::Vector) -> Self::Mask {
        zip(x, y, |x, y| -i32::from(x > y))
    }
    #[inline(always)]
    unsafe fn or(x: Self::Mask, y: Self::Mask) -> Self::Mask {
        zip(x, y, |x, y| x | y)
    }
    #[inline(always)]
    unsafe fn is_any(mask: Self::Mask) -> bool {
        mask.into_iter().fold(0, |any, lane| any | lane) != 0
    }
    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        (0..).zip(mask).fold(0, |bits, (lane, is)| bits | (is as u32 & 1) << lane)
    }
}
