//! Orientations and descriptors of extrema, from the levels that were kept.

use crate::descriptor::{Frame, describe, radius_of};
use crate::extrema::Extremum;
use crate::gradient::Level;
use crate::octave::Plan;
use crate::options::Orientation;
use crate::orientation::{Directions, MAX_PEAKS, directions};
use crate::simd::{Isa, Simd, Task, dispatch};
use crate::{Descriptor, Options};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Extrema that are measured as one task.
const CHUNK: usize = 64;

/// What is measured at an extremum: a descriptor for each of its directions.
#[derive(Clone, Copy)]
pub(crate) struct Measured {
    /// Dominant directions.
    pub(crate) directions: Directions,
    /// One for each of them, and unused ones.
    pub(crate) descriptors: [Descriptor; MAX_PEAKS],
}

impl Default for Measured {
    fn default() -> Self {
        Measured { directions: Directions::default(), descriptors: [[0; 128]; MAX_PEAKS] }
    }
}

/// Rows above and below an extremum that its measurement reads.
pub(crate) fn window_reach(extrema: &[Extremum], options: &Options) -> usize {
    let sigma = extrema.iter().fold(0.0f32, |a, e| a.max(e.sigma));
    // Samples have neighbours, and the nearest sample is half a sample away.
    radius_of(sigma * options.largest_size().max(1.0)) as usize + 2
}

/// Measures extrema of an octave from the rows of its levels from `first_row` on.
pub(crate) fn measure(
    extrema: &[Extremum],
    plan: &Plan,
    levels: &[&[f32]],
    first_row: usize,
    options: &Options,
    isa: Isa,
    threads: NonZeroUsize,
) -> Vec<Measured> {
    let work = |extrema| dispatch(isa, Measure { extrema, plan, levels, first_row, options });
    if threads.get() == 1 {
        return work(extrema);
    }
    let parts: Vec<Vec<Measured>> = extrema.par_chunks(CHUNK).map(work).collect();
    parts.concat()
}

struct Measure<'a> {
    extrema: &'a [Extremum],
    plan: &'a Plan,
    levels: &'a [&'a [f32]],
    first_row: usize,
    options: &'a Options,
}

impl Task for Measure<'_> {
    type Output = Vec<Measured>;

    #[inline(always)]
    fn run<S: Simd>(self) -> Vec<Measured> {
        let Plan { width, height, .. } = *self.plan;
        let mut all = Vec::with_capacity(self.extrema.len());
        for e in self.extrema {
            let data = self.levels[e.level - 1];
            let level = Level {
                data,
                stride: self.plan.stride(),
                width,
                height,
                first_row: self.first_row,
            };
            let mut measured = Measured {
                directions: match self.options.orientation {
                    Orientation::Upright => Directions::upright(),
                    Orientation::Dominant => {
                        directions::<S>(&level, e, self.options.max_orientations)
                    }
                },
                ..Measured::default()
            };
            for (&angle, out) in
                measured.directions.as_slice().iter().zip(&mut measured.descriptors)
            {
                let frame = Frame { x: e.x, y: e.y, sigma: e.sigma, angle };
                *out = describe::<S>(&level, frame, self.options);
            }
            all.push(measured);
        }
        all
    }
}
