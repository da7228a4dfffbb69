//! Orientations and descriptors of the extrema of an octave.

use std::num::NonZeroUsize;

use rayon::prelude::*;

use crate::descriptor::{Frame, compute_descriptor, window_radius};
use crate::extrema::Extremum;
use crate::gradient::Level;
use crate::octave::OctavePlan;
use crate::options::Orientation;
use crate::orientation::{DominantOrientations, MAX_PEAKS, dominant_orientations};
use crate::simd::{Isa, Simd, Task, dispatch};
use crate::{Options, SiftDescriptor};

/// Number of extrema per parallel task.
const TASK_SIZE: usize = 64;

/// The dominant orientations of an extremum and a descriptor for each of them.
#[derive(Clone, Copy)]
pub(crate) struct Description {
    /// Dominant orientations.
    pub(crate) orientations: DominantOrientations,
    /// Descriptors: entry `i` is for orientation `i`; the others are unused.
    pub(crate) descriptors: [SiftDescriptor; MAX_PEAKS],
}

impl Default for Description {
    fn default() -> Self {
        Description {
            orientations: DominantOrientations::default(),
            descriptors: [[0; 128]; MAX_PEAKS],
        }
    }
}

/// Number of rows above and below an extremum from which its description is computed.
pub(crate) fn window_rows(extrema: &[Extremum], options: &Options) -> usize {
    let sigma = extrema.iter().fold(0.0f32, |a, e| a.max(e.sigma));
    // One row for the gradients, and one because the extremum is between samples.
    window_radius(sigma * options.largest_size().max(1.0)) as usize + 2
}

/// Describes extrema of an octave. `levels` holds rows of levels 1 … S from `first_row` on.
pub(crate) fn describe_extrema(
    extrema: &[Extremum],
    plan: &OctavePlan,
    levels: &[&[f32]],
    first_row: usize,
    options: &Options,
    isa: Isa,
    threads: NonZeroUsize,
) -> Vec<Description> {
    let describe =
        |extrema| dispatch(isa, DescribeTask { extrema, plan, levels, first_row, options });
    if threads.get() == 1 {
        return describe(extrema);
    }
    let parts: Vec<Vec<Description>> = extrema.par_chunks(TASK_SIZE).map(describe).collect();
    parts.concat()
}

/// The description of some extrema on one thread.
struct DescribeTask<'a> {
    extrema: &'a [Extremum],
    plan: &'a OctavePlan,
    levels: &'a [&'a [f32]],
    first_row: usize,
    options: &'a Options,
}

impl Task for DescribeTask<'_> {
    type Output = Vec<Description>;

    #[inline(always)]
    fn run<S: Simd>(self) -> Vec<Description> {
        let OctavePlan { width, height, .. } = *self.plan;
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
            let mut description = Description {
                orientations: match self.options.orientation {
                    Orientation::Upright => DominantOrientations::upright(),
                    Orientation::Dominant => {
                        dominant_orientations::<S>(&level, e, self.options.max_orientations)
                    }
                },
                ..Description::default()
            };
            for (&angle, out) in
                description.orientations.as_slice().iter().zip(&mut description.descriptors)
            {
                let frame = Frame { x: e.x, y: e.y, sigma: e.sigma, angle };
                *out = compute_descriptor::<S>(&level, frame, self.options);
            }
            all.push(description);
        }
        all
    }
}
