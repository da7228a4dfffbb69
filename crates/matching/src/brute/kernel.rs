//! The loop over tiles.
//!
//! With `dot = (a − 128)·b` the nearest neighbours of the two directions are the maxima of
//!
//! - `row value    = 2 dot − (|b|² − 256 Σb) = |a|² − d²`, over all `b` for a fixed `a`,
//! - `column value = 2 dot − |a|²            = |b|² − 256 Σb − d²`, over all `a` for a fixed `b`.
//!
//! Both are within ±(2²³ − 32768) for any bytes. A key `256 value − index`, with an index of 8
//! bits, therefore fits into 32 bits. Of equal values, the lower index has the larger key. The
//! update of the two largest keys takes three operations, without a comparison mask or a vector of
//! indices: `second = max(second, min(key, first))`, `first = max(first, key)`. The index of a row
//! key is the number of the column vector, and the index of a column key is the number of the row.
//! Before an index exceeds 8 bits, the keys are unpacked and merged into the totals.
//!
//! The outer loop is over blocks of rows, whose operands and keys fit into the first-level cache.
//! The inner loop is over column tiles, which are read from the second-level cache. The operands of
//! a tile stay in the first-level cache for all rows of the block.

use std::ops::Range;

use super::lanes::KeyLanes;
use crate::matches::Nearest;
use crate::packed::{PANEL, Packed, TILE, Vectors};

/// Number of rows in a block: a multiple of the 4 or 6 rows of a tile, and at most 256, so that the
/// number of a row fits into a key.
const ROWS: usize = 192;
/// Number of bits of the index in a key.
const INDEX_BITS: u32 = 8;
/// Number of indices of a key.
const INDICES: usize = 1 << INDEX_BITS;
/// Replaces 256 times the constant of the value for padding rows and columns: their keys are below
/// those of all descriptors and above `i32::MIN`.
const PADDING: i32 = i32::MAX - (INDICES as i32 - 1);
/// Below the values of all descriptors and above the values of padding.
const MIN_VALUE: i32 = -(1 << 23) + 16_384;

/// A cache line. Buffers consist of cache lines, so that vectors are aligned.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([i32; 16]);

/// A buffer of integers that is aligned to cache lines.
pub(super) struct Buffer(Vec<Line>);

impl Buffer {
    pub(super) fn new(len: usize, fill: i32) -> Self {
        Buffer(vec![Line([fill; 16]); len.div_ceil(16)])
    }

    #[inline(always)]
    pub(super) fn words(&mut self) -> &mut [i32] {
        // SAFETY: a `Line` has the layout of sixteen integers.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), self.0.len() * 16) }
    }
}

/// The two largest keys of each lane of some rows, or of some columns.
struct Keys {
    first: Buffer,
    second: Buffer,
}

impl Keys {
    fn new(len: usize) -> Self {
        Keys { first: Buffer::new(len, i32::MIN), second: Buffer::new(len, i32::MIN) }
    }
}

/// The two largest values so far, and the full index of the largest.
struct Totals {
    first: Vec<i32>,
    index: Vec<i32>,
    second: Vec<i32>,
}

impl Totals {
    fn new(len: usize) -> Self {
        Totals { first: vec![i32::MIN; len], index: vec![0; len], second: vec![i32::MIN; len] }
    }

    /// Merges `len` keys into the totals from `at` on and resets the keys. Index `i` of a key is
    /// the full index `base + stride * i`. Full indices increase with every merge, so that of equal
    /// values the lower index is kept.
    #[inline(always)]
    fn merge(&mut self, at: usize, len: usize, keys: &mut Keys, base: usize, stride: usize) {
        let (base, stride) = (base as i32, stride as i32);
        let keys = keys.first.words()[..len].iter_mut().zip(&mut keys.second.words()[..len]);
        let totals = (self.first[at..at + len].iter_mut().zip(&mut self.index[at..at + len]))
            .zip(&mut self.second[at..at + len]);
        for ((key, second_key), ((first, index), second)) in keys.zip(totals) {
            let value = value_of(*key);
            let second_value = value_of(*second_key);
            let key_index = (value << INDEX_BITS).wrapping_sub(*key);
            let is_larger = value > *first;
            *second = (*second).max(second_value).max(value.min(*first));
            *index = if is_larger { base + stride * key_index } else { *index };
            *first = value.max(*first);
            *key = i32::MIN;
            *second_key = i32::MIN;
        }
    }

    /// The nearest neighbours of a column, whose values are the squared distances subtracted from
    /// `constant`.
    fn nearest_at(&self, at: usize, constant: i32) -> Nearest {
        let distance = distance_of(constant, self.first[at]);
        let index = if distance == u32::MAX { u32::MAX } else { self.index[at] as u32 };
        Nearest { index, distance, second: distance_of(constant, self.second[at]) }
    }

    /// The nearest neighbours of a row, over its lanes.
    fn nearest(&self, lanes: Range<usize>, constant: i32) -> Nearest {
        let mut merged = Nearest::NONE;
        for (lane, at) in (0..).zip(lanes) {
            let Nearest { index, distance, second } = self.nearest_at(at, constant);
            if distance != u32::MAX {
                merged.update(index + lane, distance);
                merged.second = merged.second.min(second);
            }
        }
        merged
    }
}

/// The value in a key `256 value − index`.
#[inline(always)]
fn value_of(key: i32) -> i32 {
    key.wrapping_add(INDICES as i32 - 1) >> INDEX_BITS
}

/// The squared distance `constant − value`; `u32::MAX` if the value is that of padding.
fn distance_of(constant: i32, value: i32) -> u32 {
    if value < MIN_VALUE { u32::MAX } else { (constant - value) as u32 }
}

/// Compares all rows `a` with all columns `b`, in tiles of `R` rows by `C` vectors of columns.
/// Returns the nearest neighbours of the rows and of the columns.
///
/// # Safety
/// The CPU supports the instruction set of `L`.
#[inline(always)]
pub(super) unsafe fn compare_all<L: KeyLanes, const R: usize, const C: usize, const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
) -> [Vec<Nearest>; 2] {
    const { assert!(ROWS.is_multiple_of(R) && ROWS <= INDICES && INDICES.is_multiple_of(C)) };
    const {
        assert!((C * L::LANES).is_multiple_of(PANEL));
        assert!(TILE.is_multiple_of(C * L::LANES / PANEL));
    }
    let tile = C * L::LANES;
    let tiles = b.len.div_ceil(tile);
    let steps = G * L::STEPS;
    let mut row_operands = Buffer::new(ROWS * steps, 0);
    let mut row_constants = [0; ROWS];
    let mut row_keys = Keys::new(ROWS * L::LANES);
    let mut widened = Buffer::new(tile * steps, 0);
    let mut column_constants = Buffer::new(tile, 0);
    let mut column_keys = Keys::new(tile);
    let mut column_totals = Totals::new(tiles * tile);
    let mut of_rows = Vec::with_capacity(a.len());

    for block in (0..a.len()).step_by(ROWS) {
        let rows = ROWS.min(a.len() - block);
        let groups = rows.div_ceil(R);
        let mut row_totals = Totals::new(ROWS * L::LANES);
        // SAFETY: the CPU supports the instruction set, and the buffers have the required sizes.
        unsafe { pack_rows::<L, R, G>(a, block, groups, row_operands.words(), &mut row_constants) };
        // Number of column vectors since the last merge of the row keys.
        let mut vectors_since_merge = 0;
        for t in 0..tiles {
            let panels = &b.panels[t * tile / PANEL..(t + 1) * tile / PANEL];
            fill_column_constants::<L, G>(
                b,
                t * tile,
                vectors_since_merge,
                &mut column_constants.words()[..tile],
            );
            // SAFETY: as above.
            unsafe {
                let columns = L::columns(panels, widened.words());
                for group in 0..groups {
                    multiply_and_update_keys::<L, R, C, G>(
                        row_operands.words()[group * R * steps..].as_ptr(),
                        &row_constants[group * R..],
                        [row_keys.first.words(), row_keys.second.words()]
                            .map(|k| k[group * R * L::LANES..].as_mut_ptr()),
                        columns,
                        column_constants.words().as_ptr(),
                        [column_keys.first.words(), column_keys.second.words()]
                            .map(|k| k.as_mut_ptr()),
                    );
                }
            }
            column_totals.merge(t * tile, tile, &mut column_keys, block, 1);
            vectors_since_merge += C;
            if vectors_since_merge == INDICES || t + 1 == tiles {
                let base = (t + 1) * tile - vectors_since_merge * L::LANES;
                row_totals.merge(0, groups * R * L::LANES, &mut row_keys, base, L::LANES);
                vectors_since_merge = 0;
            }
        }
        for (row, constant) in row_constants.iter().enumerate().take(rows) {
            let square = (constant - row as i32) >> INDEX_BITS;
            of_rows.push(row_totals.nearest(row * L::LANES..(row + 1) * L::LANES, square));
        }
    }
    let of_column = |column: usize| column_totals.nearest_at(column, b.terms[column]);
    [of_rows, (0..b.len).map(of_column).collect()]
}

/// Packs `groups` groups of `R` rows as `[group][step][row]`, and the constants that column keys
/// subtract from the product: 256 |a|² plus the number of the row.
#[inline(always)]
unsafe fn pack_rows<L: KeyLanes, const R: usize, const G: usize>(
    a: &impl Vectors<G>,
    block: usize,
    groups: usize,
    operands: &mut [i32],
    constants: &mut [i32; ROWS],
) {
    for (row, constant) in constants.iter_mut().enumerate().take(groups * R) {
        let at = row / R * R * G * L::STEPS + row % R;
        let exists = block + row < a.len();
        let mut squares = 0;
        for group in 0..G {
            let words = if exists {
                let word = a.word(block + row, group);
                squares += square(&word.to_le_bytes());
                // SAFETY: the caller guarantees the instruction set.
                unsafe { L::row_words(word) }
            } else {
                [0; 2]
            };
            for (part, word) in words.iter().take(L::STEPS).enumerate() {
                operands[at + (group * L::STEPS + part) * R] = *word;
            }
        }
        let base = if exists { squares << INDEX_BITS } else { PADDING };
        *constant = base + row as i32;
    }
}

/// Computes the constants that row keys subtract from the product, for the columns from `at` on:
/// 256 (|b|² − 256 Σb) plus the number of the column vector.
#[inline(always)]
fn fill_column_constants<L: KeyLanes, const G: usize>(
    b: &Packed<G>,
    at: usize,
    vectors_since_merge: usize,
    constants: &mut [i32],
) {
    constants.fill(PADDING);
    for (constant, term) in constants.iter_mut().zip(&b.terms[at..]) {
        *constant = term << INDEX_BITS;
    }
    for (c, constants) in constants.chunks_mut(L::LANES).enumerate() {
        for constant in constants {
            *constant += (vectors_since_merge + c) as i32;
        }
    }
}

/// Multiplies one group of rows with one tile of columns and updates the two largest keys of both.
///
/// # Safety
/// The CPU supports the instruction set. `rows` holds `[step][R]`, `columns` the operands of `C`
/// vectors as [`super::lanes::Lanes::columns`] gives them, `row_keys` `[R][lane]` each,
/// `column_constants` and `column_keys` `[C][lane]` each; all but the constants of rows are
/// vector-aligned.
#[inline(always)]
unsafe fn multiply_and_update_keys<L: KeyLanes, const R: usize, const C: usize, const G: usize>(
    rows: *const i32,
    row_constants: &[i32],
    row_keys: [*mut i32; 2],
    columns: *const i32,
    column_constants: *const i32,
    column_keys: [*mut i32; 2],
) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let mut dot = [[L::splat(0); C]; R];
        for step in 0..G * L::STEPS {
            let mut column = [L::splat(0); C];
            for (c, column) in column.iter_mut().enumerate() {
                let (panel, lane) = (c * L::LANES / PANEL, c * L::LANES % PANEL);
                *column = L::load(columns.add((panel * G * L::STEPS + step) * PANEL + lane));
            }
            for (r, dot) in dot.iter_mut().enumerate() {
                let row = L::splat(*rows.add(step * R + r));
                for (dot, column) in dot.iter_mut().zip(column) {
                    *dot = L::multiply_add(*dot, column, row);
                }
            }
        }
        let mut column_first = [L::splat(0); C];
        let mut column_second = [L::splat(0); C];
        for c in 0..C {
            column_first[c] = L::load(column_keys[0].add(c * L::LANES));
            column_second[c] = L::load(column_keys[1].add(c * L::LANES));
        }
        for (r, dot) in dot.iter().enumerate() {
            let row_constant = L::splat(row_constants[r]);
            let mut first = L::load(row_keys[0].add(r * L::LANES));
            let mut second = L::load(row_keys[1].add(r * L::LANES));
            for c in 0..C {
                // 256 · 2 dot.
                let scaled = L::shift_left::<{ INDEX_BITS + 1 }>(dot[c]);
                let key = L::subtract(scaled, L::load(column_constants.add(c * L::LANES)));
                second = L::max(second, L::min(key, first));
                first = L::max(first, key);
                let key = L::subtract(scaled, row_constant);
                column_second[c] = L::max(column_second[c], L::min(key, column_first[c]));
                column_first[c] = L::max(column_first[c], key);
            }
            L::store(row_keys[0].add(r * L::LANES), first);
            L::store(row_keys[1].add(r * L::LANES), second);
        }
        for c in 0..C {
            L::store(column_keys[0].add(c * L::LANES), column_first[c]);
            L::store(column_keys[1].add(c * L::LANES), column_second[c]);
        }
    }
}

/// `|x|²` of bytes.
#[inline(always)]
fn square(bytes: &[u8]) -> i32 {
    bytes.iter().map(|&x| i32::from(x) * i32::from(x)).sum()
}
