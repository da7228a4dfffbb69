//! What the factors add to the kept variables' own part of the normal equations: C, g_c and the
//! diagonal of C, a bundle of factors with the same blocks at a time, so that sums stay in
//! registers.

use super::product::{Listed, Of, SumProduct, over_lanes};
use super::simd::{Isa, Task, Vector, WIDE};
use super::workspace::Room;
use crate::structure::{Bundle, Chunk, padded, tile_index};

/// Adds bundles of factors, whose rows are in `room.rows`.
pub(super) struct Add<'a, 'r> {
    pub(super) room: &'a mut Room<'r>,
    pub(super) chunk: &'a Chunk,
    pub(super) bundles: &'a [Bundle],
}

impl Task for Add<'_, '_> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        for bundle in self.bundles {
            add::<I>(self.room, self.chunk, bundle);
        }
    }
}

#[inline(always)]
fn add<I: Isa>(room: &mut Room<'_>, chunk: &Chunk, bundle: &Bundle) {
    let shape = &chunk.factors.shapes[bundle.shape as usize];
    let Room { tiles, vectors, rows, .. } = room;
    let rows = Listed { numbers: rows, starts: chunk.bundles.rows[bundle.rows.clone()].iter() };
    let (ats, pairs) = chunk.bundles.places[bundle.places..].split_at(shape.segments.len());
    let mut pairs = pairs.iter();
    for (s, (segment, &at)) in shape.segments.iter().zip(ats).enumerate() {
        let lanes = padded(segment.block_dof);
        let (gradient, rest) = vectors[3 * at as usize..][..3 * lanes].split_at_mut(lanes);
        let diagonal = &mut rest[lanes..];
        if segment.whole {
            over_lanes!(
                lanes,
                add_to_vectors::<I>(&rows, segment.column, shape.residual, gradient, diagonal)
            );
        } else {
            for row in rows.clone() {
                for (i, j) in row[segment.column..][..segment.dof].iter().enumerate() {
                    let at = segment.offset + i;
                    gradient[at] = I::mul_add_one(*j, row[shape.residual], gradient[at]);
                    diagonal[at] = I::mul_add_one(*j, *j, diagonal[at]);
                }
            }
        }
        for ((other, other_at), &tile) in shape.segments[..=s].iter().zip(ats).zip(pairs.by_ref()) {
            // The columns of a tile are those of the earlier block, and of parts of one block those
            // of the earlier part.
            let (a, b) = if (other_at, other.offset) <= (&at, segment.offset) {
                (other, segment)
            } else {
                (segment, other)
            };
            let tile = &mut tiles[tile as usize..];
            if a.whole && b.whole {
                let (a, b) =
                    (Of { column: a.column, dof: a.dof }, Of { column: b.column, dof: b.dof });
                I::run(SumProduct::<_, true> { rows: rows.clone(), a, b, tile });
                continue;
            }
            for row in rows.clone() {
                for j in 0..a.dof {
                    for i in 0..b.dof {
                        let to = &mut tile
                            [tile_index(a.block_dof, b.block_dof, a.offset + j, b.offset + i)];
                        *to = I::mul_add_one(row[a.column + j], row[b.column + i], *to);
                    }
                }
            }
        }
    }
}

/// Gradient and diagonal of one block.
#[inline(always)]
fn add_to_vectors<V: Vector>(
    lane: usize,
    rows: &Listed<'_>,
    column: usize,
    residual: usize,
    gradient: &mut [f64],
    diagonal: &mut [f64],
) {
    let (mut g, mut d) = (V::load(&gradient[lane..]), V::load(&diagonal[lane..]));
    for row in rows.clone() {
        let j = V::load(&row[column + lane..]);
        g = j.mul_add(V::splat(row[residual]), g);
        d = j.mul_add(j, d);
    }
    g.store(&mut gradient[lane..]);
    d.store(&mut diagonal[lane..]);
}
