//! Memory that the kernels work in: aligned for vectors, and rings of rows.

/// Values in a cache line; rows start at multiples of it.
pub(crate) const LINE: usize = 16;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct CacheLine([f32; LINE]);

/// A slice of `f32` that starts on a cache line. Grows, never shrinks, so that it can serve image
/// after image without new pages from the operating system.
#[derive(Default)]
pub(crate) struct AlignedBuf {
    lines: Vec<CacheLine>,
}

impl AlignedBuf {
    /// At least `len` values with arbitrary contents.
    pub(crate) fn reserve(&mut self, len: usize) -> &mut [f32] {
        let lines = len.div_ceil(LINE);
        if self.lines.len() < lines {
            self.lines = Vec::new();
            self.lines.resize(lines, CacheLine([0.0; LINE]));
        }
        &mut self.as_mut_slice()[..len]
    }

    /// All values.
    pub(crate) fn as_slice(&self) -> &[f32] {
        // SAFETY: a `CacheLine` is sixteen `f32` without padding.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * LINE) }
    }

    fn as_mut_slice(&mut self) -> &mut [f32] {
        // SAFETY: as above.
        unsafe {
            std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * LINE)
        }
    }
}

/// The latest rows of an image that is produced from top to bottom.
#[derive(Default)]
pub(crate) struct Ring {
    buf: AlignedBuf,
    stride: usize,
    capacity: usize,
    /// The row that is produced next.
    pub(crate) next: usize,
}

impl Ring {
    /// Forgets all rows; from now on holds the latest `capacity` ones, of `stride` values each.
    pub(crate) fn reset(&mut self, capacity: usize, stride: usize, first: usize) {
        self.buf.reserve(capacity * stride);
        self.capacity = capacity;
        self.stride = stride;
        self.next = first;
    }

    /// The start of a row that is still held. What lies behind it in memory may be read through the
    /// pointer.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize) -> *const f32 {
        self.from(y).as_ptr()
    }

    /// The values of a row that is still held.
    #[inline(always)]
    pub(crate) fn values(&self, y: usize) -> &[f32] {
        &self.from(y)[..self.stride]
    }

    /// A row that is still held, and the memory behind it.
    #[inline(always)]
    fn from(&self, y: usize) -> &[f32] {
        debug_assert!(y < self.next && y + self.capacity >= self.next, "row {y} of {}", self.next);
        &self.buf.as_slice()[y % self.capacity * self.stride..]
    }

    /// The start of the row that is produced next, in place of the oldest one.
    #[inline(always)]
    pub(crate) fn next_row(&mut self) -> *mut f32 {
        let at = self.next % self.capacity * self.stride;
        self.next += 1;
        // The pointer is that of the slice and not of its first value, since whole rows are written
        // through it.
        self.buf.as_mut_slice()[at..].as_mut_ptr()
    }
}

#[cfg(test)]
mod tests {
    use super::{LINE, Ring};

    /// Whole rows are written and read through the pointers: under Miri, they have to be those of
    /// rows and not of single values.
    #[test]
    fn rows_lie_behind_their_pointers() {
        const STRIDE: usize = 2 * LINE;
        let mut ring = Ring::default();
        ring.reset(3, STRIDE, 5);
        for y in 5..10 {
            let row = ring.next_row();
            for x in 0..STRIDE {
                // SAFETY: a row has `STRIDE` values.
                unsafe { *row.add(x) = (100 * y + x) as f32 };
            }
        }
        for y in 7..10 {
            let expected: Vec<f32> = (0..STRIDE).map(|x| (100 * y + x) as f32).collect();
            assert_eq!(ring.values(y), expected);
            // SAFETY: as above.
            let read: Vec<f32> = (0..STRIDE).map(|x| unsafe { *ring.row(y).add(x) }).collect();
            assert_eq!(read, expected);
        }
        // Of the first row in memory, the others may be read through the pointer too: kernels load
        // beyond the end. SAFETY: row 9 is the first in memory and row 7 the second.
        assert_eq!(unsafe { *ring.row(9).add(STRIDE) }, 700.0);
    }
}
