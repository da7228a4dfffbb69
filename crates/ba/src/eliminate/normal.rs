//! Normal equations of the variables that are not eliminated: C = J_cᵀJ_c, the gradient g_c and the
//! diagonal of C. One rank-k update adds all factors on the same variables, so that the sums stay
//! in registers.

use super::product::{ColumnSpan, GatheredRows, SumProduct, over_lanes};
use super::simd::{Isa, Kernel, Vector, WIDE};
use super::workspace::Workspace;
use crate::structure::{RankUpdate, Task, padded, tile_index};

/// Adds rank-k updates, whose rows are in `workspace.rows`.
pub(super) struct AddRankUpdates<'a, 'r> {
    pub(super) workspace: &'a mut Workspace<'r>,
    pub(super) task: &'a Task,
    pub(super) rank_updates: &'a [RankUpdate],
}

impl Kernel for AddRankUpdates<'_, '_> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        for rank_update in self.rank_updates {
            add::<I>(self.workspace, self.task, rank_update);
        }
    }
}

#[inline(always)]
fn add<I: Isa>(workspace: &mut Workspace<'_>, task: &Task, rank_update: &RankUpdate) {
    let shape = &task.factors.shapes[rank_update.shape as usize];
    let Workspace { tiles, vectors, rows, .. } = workspace;
    let rows = GatheredRows {
        numbers: rows,
        starts: task.rank_updates.rows[rank_update.rows.clone()].iter(),
    };
    let (vector_offsets, pairs) =
        task.rank_updates.targets[rank_update.targets..].split_at(shape.segments.len());
    let mut pairs = pairs.iter();
    for (s, (segment, &at)) in shape.segments.iter().zip(vector_offsets).enumerate() {
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
        for ((other, other_at), &tile) in
            shape.segments[..=s].iter().zip(vector_offsets).zip(pairs.by_ref())
        {
            // The columns of a tile belong to the earlier block; for two segments of one block, to
            // the earlier segment.
            let (a, b) = if (other_at, other.offset) <= (&at, segment.offset) {
                (other, segment)
            } else {
                (segment, other)
            };
            let tile = &mut tiles[tile as usize..];
            if a.whole && b.whole {
                let (a, b) = (
                    ColumnSpan { column: a.column, dof: a.dof },
                    ColumnSpan { column: b.column, dof: b.dof },
                );
                I::run(SumProduct { rows: rows.clone(), a, b, tile });
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

/// Adds to the gradient and the diagonal of one block.
#[inline(always)]
fn add_to_vectors<V: Vector>(
    lane: usize,
    rows: &GatheredRows<'_>,
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
