//! The loop over tiles that looks for candidates.
//!
//! Of the centred bytes `byte − 128` of a row `a` and a column `b` the score is `a·b − ⌊|b|²/2⌋`:
//! `(|a|² − |a − b|²) / 2`, rounded up. A column is a candidate of a row if its score is not below
//! the minimum of the row. Few are: of most tiles the kernel only finds out that they have none,
//! with one maximum for each vector and one comparison for each row.
//!
//! Sums of products begin with the term of the column. With a column byte that is not negative, as
//! dot-product instructions want it, a sum exceeds the score by a constant of the row. In lanes of
//! 32 bits that is added to the minimum. In lanes of 16 bits, which wrap, it is subtracted from the
//! sum: all is exact modulo 2¹⁶, and the score fits because of [`MAX_SQUARE`].

use super::kernel::Buffer;
use super::lanes::{OFFSET, ScoreLanes};
use crate::packed::{MAX_ENTRY, MAX_SQUARE, PANEL, Packed, TILE, Vectors, centred_square};

/// Added to scores of 16 bits. With `q` for [`MAX_SQUARE`], scores are from `−3q/2` to `q/2`, and
/// with this from `−q` to `q`, which 16 bits hold.
const NARROW_OFFSET: i32 = MAX_SQUARE / 2;
/// Below all scores, and above those of padding.
const LEAST_SCORE: i32 = i32::MIN / 4;
/// Number of rows in a block, whose operands (12 KiB) stay in the first-level cache. A multiple of
/// the 4 or 6 rows of a tile.
const ROWS: usize = 192;
/// Of one of this number of tiles the best column is looked at first: 25 distances are computed for
/// a feature of fountain-P11 instead of 29.
const TILES_PER_FIRST_TILE: usize = 64;

/// What is found in a tile.
struct Found {
    hits: Vec<Hit>,
    /// The sums of a group of rows.
    sums: Buffer,
}

/// A candidate by the minimum that its row had before the tile.
struct Hit {
    /// Row in the block.
    row: u32,
    /// Column in the tile.
    column: u32,
    /// The sum.
    sum: i32,
}

/// Calls `on_candidate` with the rows and columns whose scores are not below the minimum of the
/// row, some of them more than once. It may change the minimum; a larger one holds at once, a
/// smaller one from the next tile on. The columns of a row have no certain order. Returns `None` if
/// `on_candidate` did.
///
/// # Safety
/// The CPU supports the instruction set of `L`.
#[inline(always)]
pub(super) unsafe fn for_each_candidate<
    L: ScoreLanes,
    const R: usize,
    const C: usize,
    const G: usize,
>(
    rows: &impl Vectors<G>,
    columns: &Packed<G>,
    min_scores: &mut [i32],
    mut on_candidate: impl FnMut(usize, u32, &mut i32) -> Option<()>,
) -> Option<()> {
    const { assert!(ROWS.is_multiple_of(R) && (C * L::LANES).is_multiple_of(PANEL)) };
    const { assert!(TILE.is_multiple_of(C * L::LANES / PANEL)) };
    let tile = C * L::LANES;
    let steps = G * L::STEPS;
    let mut operands = Buffer::new(ROWS * steps, 0);
    let mut converted = Buffer::new(tile * steps, 0);
    let mut constants = Buffer::new(tile, 0);
    let mut packed = PackedRows { offsets: [0; ROWS], limits: [0; ROWS] };
    let mut found = Found { hits: Vec::new(), sums: Buffer::new(R * tile, 0) };
    for block in (0..rows.len()).step_by(ROWS) {
        let count = ROWS.min(rows.len() - block);
        // SAFETY: the CPU supports the instruction set, and the buffers have the required sizes.
        unsafe {
            packed.pack::<L, R, G>(rows, min_scores, block, count, operands.words());
        }
        // The best columns of some tiles first, so that the minima begin high.
        let tiles = columns.len.div_ceil(tile);
        let first = (0..tiles).step_by(TILES_PER_FIRST_TILE).map(|t| (t, true));
        for (t, only_best) in first.chain((0..tiles).map(|t| (t, false))) {
            let panels = &columns.panels[t * tile / PANEL..(t + 1) * tile / PANEL];
            fill_column_constants::<L, G>(columns, t * tile, constants.words());
            // SAFETY: as above.
            unsafe {
                let operands_of_columns = L::columns(panels, converted.words());
                for group in (0..count).step_by(R) {
                    find::<L, R, C, G>(
                        operands.words()[group * steps..].as_ptr(),
                        &packed,
                        group,
                        operands_of_columns,
                        constants.words().as_ptr(),
                        only_best,
                        &mut found,
                    );
                }
            }
            for Hit { row, column, sum } in found.hits.drain(..) {
                let row = row as usize;
                if sum > packed.limits[row] {
                    let min_score = &mut min_scores[block + row];
                    on_candidate(block + row, (t * tile) as u32 + column, min_score)?;
                    packed.limits[row] = limit::<L>(*min_score, packed.offsets[row]);
                }
            }
        }
    }
    Some(())
}

/// The rows of a block.
struct PackedRows {
    /// What sums exceed scores by; in lanes of 16 bits it is subtracted from them.
    offsets: [i32; ROWS],
    /// What sums of candidates exceed.
    limits: [i32; ROWS],
}

impl PackedRows {
    /// Packs rows as `[group of R rows][step][row]`.
    #[inline(always)]
    unsafe fn pack<L: ScoreLanes, const R: usize, const G: usize>(
        &mut self,
        rows: &impl Vectors<G>,
        min_scores: &[i32],
        block: usize,
        count: usize,
        operands: &mut [i32],
    ) {
        for row in 0..count.next_multiple_of(R) {
            let at = row / R * R * G * L::STEPS + row % R;
            let mut sum = 0;
            for group in 0..G {
                let word = if row < count { rows.word(block + row, group) } else { 0x8080_8080 };
                sum += word.to_le_bytes().iter().map(|&x| i32::from(x) - OFFSET).sum::<i32>();
                // SAFETY: the caller guarantees the instruction set.
                let words = unsafe { L::row_words(word) };
                for (part, word) in words.iter().take(L::STEPS).enumerate() {
                    operands[at + (group * L::STEPS + part) * R] = *word;
                }
            }
            let min_score = if row < count { min_scores[block + row] } else { i32::MAX };
            self.offsets[row] = if L::IS_NARROW { MAX_ENTRY * sum } else { OFFSET * sum };
            self.limits[row] = limit::<L>(min_score, self.offsets[row]);
        }
    }
}

/// What the sums of candidates exceed, for the least score of a candidate and the offset of the
/// row.
#[inline(always)]
fn limit<L: ScoreLanes>(min_score: i32, offset: i32) -> i32 {
    if L::IS_NARROW {
        let limit = min_score.saturating_add(NARROW_OFFSET - 1);
        limit.clamp(i16::MIN.into(), i16::MAX.into())
    } else {
        (min_score.max(LEAST_SCORE) - 1).saturating_add(offset)
    }
}

/// A vector of an integer in each lane.
#[inline(always)]
unsafe fn splat<L: ScoreLanes>(x: i32) -> L::Vector {
    // SAFETY: guaranteed by the caller.
    unsafe { L::splat(if L::IS_NARROW { x << 16 | x & 0xFFFF } else { x }) }
}

/// The sums begin with these constants, of the columns from `at` on.
#[inline(always)]
fn fill_column_constants<L: ScoreLanes, const G: usize>(
    columns: &Packed<G>,
    at: usize,
    constants: &mut [i32],
) {
    let offset = if L::IS_NARROW { NARROW_OFFSET } else { 0 };
    // The scores of padding are below all others.
    constants.fill(if L::IS_NARROW { i16::MIN.into() } else { 2 * LEAST_SCORE });
    for (constant, term) in constants.iter_mut().zip(&columns.terms[at..]) {
        *constant = offset - centred_square::<G>(*term) / 2;
    }
    if L::IS_NARROW {
        for k in 0..constants.len() / 2 {
            constants[k] = constants[2 * k] & 0xFFFF | constants[2 * k + 1] << 16;
        }
    }
}

/// Finds the candidates among the rows from `group` on and one tile of columns; of each row only
/// the one with the largest score if `only_best`.
///
/// # Safety
/// The CPU supports the instruction set. `rows` holds `[step][R]`, `columns` the operands of `C`
/// vectors as [`super::lanes::Lanes::columns`] gives them, `column_constants` `[C][lane]`.
#[inline(always)]
unsafe fn find<L: ScoreLanes, const R: usize, const C: usize, const G: usize>(
    rows: *const i32,
    packed: &PackedRows,
    group: usize,
    columns: *const i32,
    column_constants: *const i32,
    only_best: bool,
    found: &mut Found,
) {
    let limits = &packed.limits[group..group + R];
    // SAFETY: guaranteed by the caller; the sums of a row are `C` vectors in memory.
    unsafe {
        let offsets = &packed.offsets[group..group + R];
        let sums = multiply::<L, R, C, G>(rows, offsets, columns, column_constants);
        // No lane is above itself.
        let mut has_hits = [L::is_above(sums[0][0], sums[0][0]); R];
        for ((has_hits, sums), limit) in has_hits.iter_mut().zip(&sums).zip(limits) {
            let largest = sums[1..].iter().fold(sums[0], |largest, sum| L::max(largest, *sum));
            *has_hits = L::is_above(largest, splat::<L>(*limit));
        }
        if !L::is_any(has_hits[1..].iter().fold(has_hits[0], |any, mask| L::or(any, *mask))) {
            return;
        }
        // The registers go to memory, because they cannot be indexed by a variable.
        let stored = found.sums.words().as_mut_ptr();
        let mut rows_with_hits = 0_u32;
        for (r, (mask, sums)) in has_hits.iter().zip(&sums).enumerate() {
            rows_with_hits |= u32::from(L::is_any(*mask)) << r;
            for (c, sum) in sums.iter().enumerate() {
                L::store(stored.add((r * C + c) * L::WORDS), *sum);
            }
        }
        while rows_with_hits != 0 {
            let r = rows_with_hits.trailing_zeros() as usize;
            rows_with_hits &= rows_with_hits - 1;
            let sums = stored.add(r * C * L::WORDS);
            let hit = |column: u32| {
                let sum = if L::IS_NARROW {
                    sums.cast::<i16>().add(column as usize).read().into()
                } else {
                    sums.add(column as usize).read()
                };
                Hit { row: (group + r) as u32, column, sum }
            };
            let mut columns = 0;
            for c in 0..C {
                let is_above = L::is_above(L::load(sums.add(c * L::WORDS)), splat::<L>(limits[r]));
                columns |= u64::from(L::bits(is_above)) << (c * L::LANES);
            }
            let hits = std::iter::from_fn(|| {
                let column = columns.trailing_zeros();
                columns &= columns.wrapping_sub(1);
                (column < u64::BITS).then(|| hit(column))
            });
            if only_best {
                found.hits.extend(hits.max_by_key(|hit| hit.sum));
            } else {
                hits.for_each(|hit| found.hits.push(hit));
            }
        }
    }
}

/// The sums of products of a group of rows and one tile of columns.
///
/// # Safety
/// As [`find`].
#[inline(always)]
unsafe fn multiply<L: ScoreLanes, const R: usize, const C: usize, const G: usize>(
    rows: *const i32,
    offsets: &[i32],
    columns: *const i32,
    column_constants: *const i32,
) -> [[L::Vector; C]; R] {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let mut sums = [[L::splat(0); C]; R];
        for c in 0..C {
            let constants = L::load(column_constants.add(c * L::WORDS));
            for (sums, offset) in sums.iter_mut().zip(offsets) {
                sums[c] = if L::IS_NARROW {
                    L::subtract(constants, splat::<L>(*offset))
                } else {
                    constants
                };
            }
        }
        let words_of_panel = PANEL * L::WORDS / L::LANES;
        for step in 0..G * L::STEPS {
            let mut column = [L::splat(0); C];
            for (c, column) in column.iter_mut().enumerate() {
                let (panel, lane) = (c * L::LANES / PANEL, c * L::LANES % PANEL);
                let at = (panel * G * L::STEPS + step) * words_of_panel + lane;
                *column = L::load(columns.add(at));
            }
            for (r, sums) in sums.iter_mut().enumerate() {
                let row = L::splat(*rows.add(step * R + r));
                for (sum, column) in sums.iter_mut().zip(column) {
                    *sum = L::multiply_add(*sum, column, row);
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::brute::Isa;
    use crate::random::stream;

    const GROUPS: usize = 8;

    /// Vectors of the largest entries and squares that are allowed, and of all others.
    fn vectors(count: usize, seed: u64) -> Packed<GROUPS> {
        let mut random = stream(seed, 0);
        Packed::new(count, OFFSET as u8, |_| {
            let largest = random.below(MAX_ENTRY as usize + 1) as i32;
            let mut entries = [0; 4 * GROUPS];
            let mut square = 0;
            for entry in &mut entries {
                let sign = 1 - 2 * random.below(2) as i32;
                let x = if random.below(3) == 0 { largest } else { random.below(91) as i32 };
                if square + x * x <= MAX_SQUARE {
                    *entry = sign * x;
                    square += x * x;
                }
            }
            std::array::from_fn(|g| std::array::from_fn(|k| (entries[4 * g + k] + OFFSET) as u8))
        })
    }

    fn score(a: &Packed<GROUPS>, i: usize, b: &Packed<GROUPS>, j: usize) -> i32 {
        let entries = |vectors: &Packed<GROUPS>, at: usize| -> Vec<i32> {
            let bytes = (0..GROUPS).flat_map(|g| vectors.word(at, g).to_le_bytes());
            bytes.map(|x| i32::from(x) - OFFSET).collect()
        };
        let (x, y) = (entries(a, i), entries(b, j));
        let product: i32 = x.iter().zip(&y).map(|(x, y)| x * y).sum();
        product - y.iter().map(|y| y * y).sum::<i32>() / 2
    }

    /// Small enough for Miri: an incomplete block of rows, and tiles with padding.
    #[test]
    fn candidates_are_those_of_the_definition() {
        for (n, m, seed) in [(1, 1, 1), (13, 67, 2), (7, 130, 3)] {
            let (a, b) = (vectors(n, seed), vectors(m, 10 + seed));
            let mut scores = BTreeMap::new();
            for i in 0..n {
                scores.extend((0..m).map(|j| ((i, j as u32), score(&a, i, &b, j))));
            }
            let mut sorted: Vec<i32> = scores.values().copied().collect();
            sorted.sort_unstable();
            // None, all, and from the smallest to the largest score.
            let some = (0..=4).map(|k| sorted[(sorted.len() - 1) * k / 4]);
            for min_score in some.chain([i32::MIN, i32::MAX, sorted[0] - 1]) {
                let mut expected = scores.clone();
                expected.retain(|_, score| *score >= min_score);
                for isa in Isa::supported() {
                    let mut found = BTreeMap::new();
                    let mut least = vec![min_score; n];
                    let end = isa.for_each_candidate(&a, &b, &mut least, |row, column, _| {
                        found.insert((row, column), scores[&(row, column)]);
                        Some(())
                    });
                    assert_eq!((end, &found), (Some(()), &expected), "{isa} {n} {m} {min_score}");
                }
            }
        }
    }

    #[test]
    fn a_larger_minimum_holds_at_once_and_none_ends() {
        let (a, b) = (vectors(3, 1), vectors(200, 2));
        for isa in Isa::supported() {
            let mut calls = [0; 3];
            isa.for_each_candidate(&a, &b, &mut [i32::MIN; 3], |row, _, least| {
                calls[row] += 1;
                *least = i32::MAX;
                Some(())
            });
            assert_eq!(calls, [1; 3], "{isa}");
            let mut calls = 0;
            let end = isa.for_each_candidate(&a, &b, &mut [i32::MIN; 3], |_, _, _| {
                calls += 1;
                (calls < 5).then_some(())
            });
            assert_eq!((end, calls), (None, 5), "{isa}");
        }
    }
}
