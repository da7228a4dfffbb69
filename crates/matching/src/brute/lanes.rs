//! A vector of 32-bit integers and the few operations that the kernel needs of it.

use crate::packed::{PANEL, Panel};

/// A row's half of the product: the bytes of descriptor `a` as `a − 128`, so that they fit into
/// `i8`.
pub(super) const OFFSET: i32 = 128;

/// An instruction set's vector of 32-bit integers.
///
/// # Safety
/// Calling any method needs a processor that has the instruction set.
pub(super) trait Lanes {
    /// The register.
    type Vector: Copy;
    /// How many integers it holds: 4, 8 or 16.
    const LANES: usize;
    /// Multiply-adds for a group of four bytes: one, or two where they take two 16-bit numbers.
    const STEPS: usize;

    /// Row operands of the steps that one group of four bytes gives, of bytes taken as
    /// `byte − 128`; `STEPS` of them are used.
    unsafe fn row_words(word: u32) -> [i32; 2];
    /// Column operands of some panels, `[panel][step][column]`: the panels themselves, or something
    /// made of them in `buffer`, which has room for it.
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32;

    unsafe fn load(from: *const i32) -> Self::Vector;
    unsafe fn store(to: *mut i32, v: Self::Vector);
    unsafe fn splat(x: i32) -> Self::Vector;
    /// `sum` plus the dot product, lane by lane, of one step's column and row operands.
    unsafe fn multiply_add(
        sum: Self::Vector,
        column: Self::Vector,
        row: Self::Vector,
    ) -> Self::Vector;
    /// Wrapping difference.
    unsafe fn subtract(x: Self::Vector, y: Self::Vector) -> Self::Vector;
    unsafe fn shift_left<const BITS: u32>(x: Self::Vector) -> Self::Vector;
    unsafe fn min(x: Self::Vector, y: Self::Vector) -> Self::Vector;
    unsafe fn max(x: Self::Vector, y: Self::Vector) -> Self::Vector;
}

/// Splits every group of four bytes into two words of two 16-bit numbers: those at even and those
/// at odd places.
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

/// The row operands that go with [`widen`].
#[inline(always)]
pub(super) fn widen_signed(word: u32) -> [i32; 2] {
    let pair = |low: u8, high: u8| {
        let [low, high] = [low, high].map(|x| (i32::from(x) - OFFSET) as u16);
        (u32::from(high) << 16 | u32::from(low)) as i32
    };
    let [b0, b1, b2, b3] = word.to_le_bytes();
    [pair(b0, b2), pair(b1, b3)]
}

/// Plain Rust, which the compiler turns into whatever vectors the target has at least.
pub(super) struct Portable;

const LANES: usize = 4;

#[inline(always)]
fn zip(x: [i32; LANES], y: [i32; LANES], f: impl Fn(i32, i32) -> i32) -> [i32; LANES] {
    std::array::from_fn(|lane| f(x[lane], y[lane]))
}

impl Lanes for Portable {
    type Vector = [i32; LANES];
    const LANES: usize = LANES;
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
        // SAFETY: the caller vouches for LANES integers at `from`.
        unsafe { from.cast::<Self::Vector>().read() }
    }
    #[inline(always)]
    unsafe fn store(to: *mut i32, v: Self::Vector) {
        // SAFETY: the caller vouches for room for LANES integers at `to`.
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
    unsafe fn shift_left<const BITS: u32>(x: Self::Vector) -> Self::Vector {
        x.map(|x| x << BITS)
    }
    #[inline(always)]
    unsafe fn min(x: Self::Vector, y: Self::Vector) -> Self::Vector {
        zip(x, y, i32::min)
    }
    #[inline(always)]
    unsafe fn max(x: Self::Vector, y: Self::Vector) -> Self::Vector {
        zip(x, y, i32::max)
    }
}
