//! Aligned buffers and ring buffers of rows.

/// Number of `f32` values in a cache line. Rows start at multiples of it.
pub(crate) const LINE: usize = 16;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct CacheLine([f32; LINE]);

/// A buffer of `f32` that is aligned to cache lines. It never shrinks, so that it is allocated once
/// for images of the same size.
#[derive(Default)]
pub(crate) struct AlignedBuf {
    lines: Vec<CacheLine>,
}

impl AlignedBuf {
    /// The first `len` values, allocated if necessary, with arbitrary contents.
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
        // SAFETY: a `CacheLine` has the layout of sixteen `f32`.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * LINE) }
    }

    fn as_mut_slice(&mut self) -> &mut [f32] {
        // SAFETY: as above.
        unsafe {
            std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * LINE)
        }
    }
}

/// A ring buffer of the latest rows of an image that is computed from top to bottom.
#[derive(Default)]
pub(crate) struct Ring {
    buf: AlignedBuf,
    stride: usize,
    capacity: usize,
    /// Index of the next row.
    pub(crate) next: usize,
}

impl Ring {
    /// Clears the ring buffer. It then holds the latest `capacity` rows of `stride` values, from
    /// row `first` on.
    pub(crate) fn reset(&mut self, capacity: usize, stride: usize, first: usize) {
        self.buf.reserve(capacity * stride);
        self.capacity = capacity;
        self.stride = stride;
        self.next = first;
    }

    /// Pointer to a stored row. Reads through it may extend to the end of the buffer.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize) -> *const f32 {
        self.from(y).as_ptr()
    }

    /// The values of a stored row.
    #[inline(always)]
    pub(crate) fn values(&self, y: usize) -> &[f32] {
        &self.from(y)[..self.stride]
    }

    /// A stored row and the rest of the buffer after it.
    #[inline(always)]
    fn from(&self, y: usize) -> &[f32] {
        debug_assert!(y < self.next && y + self.capacity >= self.next, "row {y} of {}", self.next);
        &self.buf.as_slice()[y % self.capacity * self.stride..]
    }

    /// Pointer to the next row, which replaces the oldest row.
    #[inline(always)]
    pub(crate) fn next_row(&mut self) -> *mut f32 {
        let at = self.next % self.capacity * self.stride;
        self.next += 1;
        // A pointer to the slice and not to its first value, because whole rows are written through
        // it.
        self.buf.as_mut_slice()[at..].as_mut_ptr()
    }
}

#[cfg(test)]
mod tests {
    use super::{LINE, Ring};

    /// Rows are written and read through the pointers. Miri checks that the pointers are valid for
    /// whole rows.
    #[test]
    fn pointers_are_valid_for_whole_rows() {
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
        // Kernels load beyond the end of a row: the pointer to a row is valid for the next row in
        // memory.
        // SAFETY: row 9 is the first in memory and row 7 the second.
        assert_eq!(unsafe { *ring.row(9).add(STRIDE) }, 700.0);
    }
}
