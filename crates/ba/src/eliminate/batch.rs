//! Elimination of one batch, compiled once per instruction set.
//!
//! Rows are padded to multiples of [`LANES`](super::simd::LANES); the padding is never used.

use super::cursor::Cursor;
use super::general;
use super::normal;
use super::simd::{Isa, Kernel, dispatch};
use super::single;
use super::workspace::Workspace;
use crate::damping::marquardt;
use crate::structure::{Batch, LandmarkBlock, Task, stash_head, triangle_row};

/// Elimination of a batch whose rows are in `workspace.rows`.
pub(super) struct BatchElimination<'a, 'r> {
    pub(super) workspace: &'a mut Workspace<'r>,
    pub(super) task: &'a Task,
    pub(super) batch: &'a Batch,
    pub(super) lambda: f64,
    pub(super) cursor: &'a mut Cursor,
}

impl BatchElimination<'_, '_> {
    /// Adds the batch to the task's sums.
    pub(super) fn eliminate(self) {
        dispatch(self);
    }
}

impl Kernel for BatchElimination<'_, '_> {
    /// Factorises all landmarks first. Each factorisation is short and waits for square roots and
    /// divisions, which overlap between landmarks.
    fn run<I: Isa>(self) {
        let Self { workspace, task, batch, lambda, cursor } = self;
        cursor.row = 0;
        let mut ahead = *cursor;
        let all = &task.landmarks[batch.landmarks.clone()];
        for landmarks in all.chunk_by(|a, b| a.dof == b.dof) {
            match landmarks[0].dof {
                0 => factorise_landmarks::<0, I>(workspace, task, landmarks, lambda, &mut ahead),
                1 => factorise_landmarks::<1, I>(workspace, task, landmarks, lambda, &mut ahead),
                2 => factorise_landmarks::<2, I>(workspace, task, landmarks, lambda, &mut ahead),
                3 => factorise_landmarks::<3, I>(workspace, task, landmarks, lambda, &mut ahead),
                4 => factorise_landmarks::<4, I>(workspace, task, landmarks, lambda, &mut ahead),
                5 => factorise_landmarks::<5, I>(workspace, task, landmarks, lambda, &mut ahead),
                _ => factorise_landmarks::<6, I>(workspace, task, landmarks, lambda, &mut ahead),
            }
        }
        if !batch.rank_updates.is_empty() {
            I::run(normal::AddRankUpdates {
                workspace,
                task,
                rank_updates: &task.rank_updates.list[batch.rank_updates.clone()],
            });
        }
        let alike = |a: &LandmarkBlock, b: &LandmarkBlock| {
            (a.pattern, a.dof, a.single) == (b.pattern, b.dof, b.single)
        };
        for landmarks in all.chunk_by(alike) {
            match landmarks[0].dof {
                0 => cursor.skip(task, landmarks),
                1 => I::run(general::Eliminate::<1> { workspace, task, landmarks, cursor }),
                2 => I::run(general::Eliminate::<2> { workspace, task, landmarks, cursor }),
                3 if landmarks[0].single => match task.patterns.of(&landmarks[0]).dof {
                    6 => I::run(single::Eliminate::<6> { workspace, task, landmarks, cursor }),
                    9 => I::run(single::Eliminate::<9> { workspace, task, landmarks, cursor }),
                    _ => I::run(single::Eliminate::<0> { workspace, task, landmarks, cursor }),
                },
                3 => I::run(general::Eliminate::<3> { workspace, task, landmarks, cursor }),
                4 => I::run(general::Eliminate::<4> { workspace, task, landmarks, cursor }),
                5 => I::run(general::Eliminate::<5> { workspace, task, landmarks, cursor }),
                _ => I::run(general::Eliminate::<6> { workspace, task, landmarks, cursor }),
            }
        }
    }
}

/// [`factorise_landmark`] for each of `landmarks`.
fn factorise_landmarks<const P: usize, I: Isa>(
    workspace: &mut Workspace<'_>,
    task: &Task,
    landmarks: &[LandmarkBlock],
    lambda: f64,
    cursor: &mut Cursor,
) {
    struct FactoriseLandmarks<'a, 'r, const P: usize>(
        &'a mut Workspace<'r>,
        &'a Task,
        &'a [LandmarkBlock],
        f64,
        &'a mut Cursor,
    );
    impl<const P: usize> Kernel for FactoriseLandmarks<'_, '_, P> {
        #[inline(always)]
        fn run<I: Isa>(self) {
            let Self(workspace, task, landmarks, lambda, cursor) = self;
            for landmark in landmarks {
                factorise_landmark::<P, I>(workspace, task, landmark, lambda, cursor);
            }
        }
    }
    I::run(FactoriseLandmarks::<P>(workspace, task, landmarks, lambda, cursor));
}

/// Writes V = LLᵀ and y of one landmark to its stash, and zeros the columns of fixed directions.
#[inline(always)]
fn factorise_landmark<const P: usize, I: Isa>(
    workspace: &mut Workspace<'_>,
    task: &Task,
    landmark: &LandmarkBlock,
    lambda: f64,
    cursor: &mut Cursor,
) {
    let Workspace { stash, rows, gradient_max, .. } = workspace;
    let (mut v, mut g) = ([[0.0; P]; P], [0.0; P]);
    while cursor.factor < landmark.end as usize {
        let shape = task.factors.shape(cursor.factor);
        cursor.factor += 1;
        let rows = &mut rows[cursor.row..][..shape.rows * shape.stride];
        cursor.row += rows.len();
        for &column in &shape.fixed_columns {
            for row in rows.chunks_exact_mut(shape.stride) {
                row[column] = 0.0;
            }
        }
        for row in rows.chunks_exact(shape.stride) {
            let jp: &[f64; P] =
                row[shape.eliminated..].first_chunk().expect("rows hold the eliminated variable");
            let residual = row[shape.residual];
            for i in 0..P {
                for j in 0..=i {
                    v[i][j] = I::mul_add_one(jp[i], jp[j], v[i][j]);
                }
                g[i] = I::mul_add_one(jp[i], residual, g[i]);
            }
        }
    }
    if P == 0 {
        return;
    }
    let mut is_seen = [true; P];
    for i in 0..P {
        is_seen[i] = v[i][i] != 0.0;
        *gradient_max = gradient_max.max(g[i].abs());
        v[i][i] += marquardt(v[i][i], lambda);
    }
    let mut inverse = [0.0; P];
    cholesky::<P>(&mut v, &mut inverse);
    let mut y = g;
    for i in 0..P {
        if !is_seen[i] {
            inverse[i] = 0.0;
        }
        for j in 0..i {
            y[i] -= v[i][j] * y[j];
        }
        y[i] *= inverse[i];
    }
    let head = &mut stash[landmark.stash..][..stash_head(P)];
    for i in 0..P {
        head[triangle_row(i)..][..i].copy_from_slice(&v[i][..i]);
        head[triangle_row(i) + i] = inverse[i];
        head[triangle_row(P) + i] = y[i];
    }
}

/// In-place lower Cholesky factor of a damped and therefore positive definite matrix, and the
/// inverse of its diagonal.
#[inline(always)]
fn cholesky<const P: usize>(v: &mut [[f64; P]; P], inverse: &mut [f64; P]) {
    for j in 0..P {
        for k in 0..j {
            v[j][j] -= v[j][k] * v[j][k];
        }
        v[j][j] = v[j][j].sqrt();
        inverse[j] = 1.0 / v[j][j];
        for i in j + 1..P {
            for k in 0..j {
                v[i][j] -= v[i][k] * v[j][k];
            }
            v[i][j] *= inverse[j];
        }
    }
}
