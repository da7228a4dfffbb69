//! Matching of descriptors of any kind: the exact nearest neighbours by Euclidean distance, in
//! plain loops over all pairs of descriptors.
//!
//! The ratio test compares distances (Lowe 2004, section 7.1). The angle between two descriptors
//! follows from their distance and their norms. For descriptors of norm 1 the nearest one by
//! distance is that of the largest cosine.

use tiepoint_features::{DescriptorEntries, Descriptors};
use tiepoint_simd::dispatch;

use crate::matches::Match;
use crate::options::Options;

/// Descriptors of any kind, with their norms.
#[derive(Clone, Debug)]
pub(crate) struct AnyKind {
    descriptors: Descriptors,
    /// Squared norms.
    squares: Vec<f64>,
    /// The features of the largest scales, for preemptive matching.
    leading: Option<Box<AnyKind>>,
}

impl AnyKind {
    pub(crate) fn new(descriptors: Descriptors, leading: Option<Descriptors>) -> Self {
        let dim = descriptors.format().dim;
        let squares = match descriptors.entries() {
            DescriptorEntries::Bytes(entries) => squares_of(entries, dim),
            DescriptorEntries::Floats(entries) => squares_of(entries, dim),
        };
        let leading = leading.map(|leading| Box::new(Self::new(leading, None)));
        Self { descriptors, squares, leading }
    }

    /// The matches of all descriptors. Matches are in ascending order of `a`.
    pub(crate) fn matches(&self, other: &Self, options: &Options) -> Vec<Match> {
        if let (Some(preempt), Some(a), Some(b)) = (options.preempt, &self.leading, &other.leading)
            && a.matches(b, options).len() < preempt.min_matches as usize
        {
            return Vec::new();
        }
        if self.descriptors.format() != other.descriptors.format() {
            return Vec::new();
        }
        let dim = self.descriptors.format().dim;
        let mut found = Neighbours::new(self.squares.len(), other.squares.len());
        match (self.descriptors.entries(), other.descriptors.entries()) {
            (DescriptorEntries::Bytes(a), DescriptorEntries::Bytes(b)) => {
                found.compare_all(a, b, dim);
            }
            (DescriptorEntries::Floats(a), DescriptorEntries::Floats(b)) => {
                found.compare_all(a, b, dim);
            }
            _ => {}
        }
        self.select(other, &found, options)
    }

    /// The matches among the pairs of descriptors that `for_each_candidate` passes to its argument.
    /// Both images have the same format.
    pub(crate) fn matches_among(
        &self,
        other: &Self,
        options: &Options,
        for_each_candidate: impl FnOnce(&mut dyn FnMut(usize, usize)),
    ) -> Vec<Match> {
        let dim = self.descriptors.format().dim;
        let mut found = Neighbours::new(self.squares.len(), other.squares.len());
        match (self.descriptors.entries(), other.descriptors.entries()) {
            (DescriptorEntries::Bytes(a), DescriptorEntries::Bytes(b)) => {
                for_each_candidate(&mut |i, j| found.compare(a, b, dim, i, j));
            }
            (DescriptorEntries::Floats(a), DescriptorEntries::Floats(b)) => {
                for_each_candidate(&mut |i, j| found.compare(a, b, dim, i, j));
            }
            _ => {}
        }
        self.select(other, &found, options)
    }

    /// Applies the ratio test, the maximum angle and the cross check.
    fn select(&self, other: &Self, found: &Neighbours, options: &Options) -> Vec<Match> {
        let tests = Tests::new(options);
        let accepted_match = |(i, forward): (usize, &Neighbour)| {
            let j = forward.index as usize;
            let back = found.of_b.get(j)?;
            let (square, of_other) = (self.squares[i], other.squares[j]);
            let is_mutual = || back.index as usize == i && tests.accepts(back, of_other, square);
            let is_accepted =
                tests.accepts(forward, square, of_other) && (!options.mutual || is_mutual());
            is_accepted.then_some(Match {
                a: i as u32,
                b: forward.index,
                distance: forward.distance,
            })
        };
        found.of_a.iter().enumerate().filter_map(accepted_match).collect()
    }
}

/// The nearest and second nearest neighbour of a descriptor.
#[derive(Clone, Copy)]
struct Neighbour {
    /// Index of the nearest, the lowest of equally near ones; `u32::MAX` if there is none.
    index: u32,
    /// Squared distance to the nearest.
    distance: f64,
    /// Squared distance to the second nearest; infinite if there is none.
    second: f64,
}

impl Neighbour {
    const NONE: Self = Self { index: u32::MAX, distance: f64::INFINITY, second: f64::INFINITY };

    /// Updates the neighbours with a candidate. The order of candidates does not matter.
    fn update(&mut self, index: usize, distance: f64) {
        // Of entries that are infinite or not a number.
        if !distance.is_finite() {
            return;
        }
        let index = index as u32;
        if distance < self.distance || (distance == self.distance && index < self.index) {
            *self = Self { index, distance, second: self.distance };
        } else if distance < self.second {
            self.second = distance;
        }
    }
}

/// The neighbours of the descriptors of two images, in both directions.
struct Neighbours {
    of_a: Vec<Neighbour>,
    of_b: Vec<Neighbour>,
}

impl Neighbours {
    fn new(a: usize, b: usize) -> Self {
        Self { of_a: vec![Neighbour::NONE; a], of_b: vec![Neighbour::NONE; b] }
    }

    fn compare_all<E: Entry>(&mut self, a: &[E], b: &[E], dim: usize) {
        let mut distances = vec![0.0; self.of_b.len()];
        for (i, one) in a.chunks_exact(dim).enumerate() {
            squared_distances(one, b, &mut distances);
            for (j, distance) in distances.iter().enumerate() {
                self.of_a[i].update(j, *distance);
                self.of_b[j].update(i, *distance);
            }
        }
    }

    fn compare<E: Entry>(&mut self, a: &[E], b: &[E], dim: usize, i: usize, j: usize) {
        let of = |place: usize| place * dim..(place + 1) * dim;
        let distance = E::squared_distance(&a[of(i)], &b[of(j)]);
        self.of_a[i].update(j, distance);
        self.of_b[j].update(i, distance);
    }
}

/// The ratio test and the maximum angle of [`Options`].
struct Tests {
    max_ratio: Option<f64>,
    min_cosine: Option<f64>,
}

impl Tests {
    fn new(options: &Options) -> Self {
        let min_cosine = options.max_angle_rad.and_then(|angle| match angle {
            angle if angle >= std::f64::consts::PI => None,
            angle if angle >= 0.0 => Some(angle.cos()),
            // A negative or NaN angle accepts no descriptor.
            _ => Some(f64::INFINITY),
        });
        Self { max_ratio: options.max_ratio, min_cosine }
    }

    /// Whether the nearest neighbour passes, given the squared norms of the descriptor and of its
    /// neighbour.
    fn accepts(&self, found: &Neighbour, square: f64, of_neighbour: f64) -> bool {
        let product = 0.5 * (square + of_neighbour - found.distance);
        found.index != u32::MAX
            && self.max_ratio.is_none_or(|max| found.distance.sqrt() < max * found.second.sqrt())
            && self.min_cosine.is_none_or(|min| product >= min * (square * of_neighbour).sqrt())
    }
}

/// An entry of a descriptor.
trait Entry: Copy + Default {
    /// Squared Euclidean distance.
    fn squared_distance(a: &[Self], b: &[Self]) -> f64;
}

impl Entry for u8 {
    /// Exact.
    #[inline(always)]
    fn squared_distance(a: &[u8], b: &[u8]) -> f64 {
        // 32-bit sums do not overflow for this length.
        const PART_LEN: usize = 1 << 15;
        let mut sum = 0;
        for (a, b) in a.chunks(PART_LEN).zip(b.chunks(PART_LEN)) {
            let mut part = 0;
            for (x, y) in a.iter().zip(b) {
                let difference = i32::from(*x) - i32::from(*y);
                part += (difference * difference) as u32;
            }
            sum += u64::from(part);
        }
        sum as f64
    }
}

impl Entry for f32 {
    /// Sixteen sums, so that the compiler can vectorise the loop: it does not reorder additions of
    /// floating-point numbers.
    #[inline(always)]
    fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
        let mut sums = [0.0_f32; 16];
        for (a, b) in a.chunks(16).zip(b.chunks(16)) {
            for ((sum, x), y) in sums.iter_mut().zip(a).zip(b) {
                let difference = x - y;
                *sum += difference * difference;
            }
        }
        let mut total = 0.0;
        for sum in sums {
            total += f64::from(sum);
        }
        total
    }
}

dispatch! {
    /// The squared distances of a descriptor to others, which are one behind the other.
    fn squared_distances<E: Entry>(one: &[E], others: &[E], distances: &mut [f64]) {
        for (distance, other) in distances.iter_mut().zip(others.chunks_exact(one.len())) {
            *distance = E::squared_distance(one, other);
        }
    }
}

/// The squared norms of descriptors of `dim` entries.
fn squares_of<E: Entry>(entries: &[E], dim: usize) -> Vec<f64> {
    let zero = vec![E::default(); dim];
    let mut squares = vec![0.0; entries.len() / dim];
    squared_distances(&zero, entries, &mut squares);
    squares
}
