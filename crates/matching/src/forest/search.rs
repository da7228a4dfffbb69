//! Best-bin-first search of all trees.
//!
//! Each tree is descended once. Unvisited branches of all trees are in one priority queue, ordered
//! by an estimate of the distance of their points: the sum of the squared distances of the query to
//! the splits on the path. As in FLANN, a dimension that is split twice counts twice, so the
//! estimate is not a bound. The best branches are then descended until the number of leaves is
//! reached. A point that is in several visited leaves is compared once.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use tiepoint_features::SiftDescriptor;

use super::options::Checks;
use super::tree::{Forest, NodeKind, Row};
use crate::brute::{Isa, Kind};
use crate::matches::Nearest;

/// Number of leaves that are visited together. With a million points, almost every leaf and point
/// is a cache miss. Four overlapping memory accesses take half the time of successive ones, and the
/// order of the search changes little.
const LEAVES_PER_ROUND: usize = 4;

/// Working memory of a search, reused for all queries.
struct Scratch {
    /// Branches in ascending order of the estimated distance: upper 32 bits estimate, lower 32 bits
    /// node index.
    queue: BinaryHeap<Reverse<u64>>,
    /// Leaves of the current round: start and length in `Forest::points`.
    leaves: Vec<(usize, usize)>,
    /// One bit per point: whether it was compared.
    seen: Vec<u64>,
    /// The compared points, to reset the bits.
    visited: Vec<u32>,
}

impl Forest {
    /// For every query, the two nearest neighbours among the visited points.
    pub fn nearest(&self, queries: &[SiftDescriptor], checks: Checks) -> Vec<Nearest> {
        self.nearest_on(Isa::best(), queries, checks)
    }

    /// As [`Self::nearest`] on a given instruction set, for tests and measurements. The result is
    /// the same on all instruction sets.
    pub fn nearest_on(&self, isa: Isa, queries: &[SiftDescriptor], checks: Checks) -> Vec<Nearest> {
        search(self, isa, queries.iter().map(|&query| Row(query)), checks)
    }

    /// The nearest neighbours of the descriptors of another forest.
    pub(crate) fn nearest_of(&self, other: &Forest, checks: Checks) -> Vec<Nearest> {
        search(self, Isa::best(), other.descriptors.iter().copied(), checks)
    }
}

/// Searches all queries on an instruction set.
fn search(
    forest: &Forest,
    isa: Isa,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    match isa.0 {
        // SAFETY: an `Isa` is only constructed if the CPU supports it.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { search_avx512(forest, queries, checks) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::AvxVnni | Kind::Avx2 => unsafe { search_avx2(forest, queries, checks) },
        Kind::Portable => search_all(forest, queries, checks),
    }
}

/// [`search_all`], compiled for AVX-512.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn search_avx512(
    forest: &Forest,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    search_all(forest, queries, checks)
}

/// [`search_all`], compiled for AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn search_avx2(
    forest: &Forest,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    search_all(forest, queries, checks)
}

/// Searches all queries.
#[inline(always)]
fn search_all(forest: &Forest, queries: impl Iterator<Item = Row>, checks: Checks) -> Vec<Nearest> {
    let checks = match checks {
        Checks::Total(checks) => u64::from(checks),
        Checks::PerTree(checks) => u64::from(checks) * forest.roots.len() as u64,
    };
    let mut scratch = Scratch {
        queue: BinaryHeap::new(),
        leaves: Vec::new(),
        seen: vec![0; forest.descriptors.len().div_ceil(64)],
        visited: Vec::new(),
    };
    let mut found = Vec::with_capacity(queries.size_hint().0);
    for query in queries {
        found.push(search_one(forest, &query, checks, &mut scratch));
    }
    found
}

/// Searches one query: first the nearest leaf of every tree, then the best branches.
#[inline(always)]
fn search_one(forest: &Forest, query: &Row, checks: u64, scratch: &mut Scratch) -> Nearest {
    let mut nearest = Nearest::NONE;
    for roots in forest.roots.chunks(LEAVES_PER_ROUND) {
        for &root in roots {
            descend(forest, query, 0, root, nearest.second, scratch);
        }
        visit_leaves(forest, query, &mut nearest, scratch);
    }
    let mut checked = forest.roots.len() as u64;
    // Continues beyond `checks` until two neighbours are found.
    while checked < checks || nearest.second == u32::MAX {
        for _ in 0..(checks.saturating_sub(checked)).clamp(1, LEAVES_PER_ROUND as u64) {
            let Some(Reverse(branch)) = scratch.queue.pop() else { break };
            let estimate = (branch >> 32) as u32;
            if estimate > nearest.second {
                break;
            }
            descend(forest, query, estimate, branch as u32, nearest.second, scratch);
            checked += 1;
        }
        if scratch.leaves.is_empty() {
            break;
        }
        visit_leaves(forest, query, &mut nearest, scratch);
    }
    scratch.queue.clear();
    for point in scratch.visited.drain(..) {
        scratch.seen[point as usize / 64] = 0;
    }
    nearest
}

/// Descends to the leaf on the side of the query, pushes the other branches to the queue, and
/// appends the leaf to the current round.
#[inline(always)]
fn descend(
    forest: &Forest,
    query: &Row,
    estimate: u32,
    mut at: u32,
    max_estimate: u32,
    scratch: &mut Scratch,
) {
    loop {
        match forest.nodes[at as usize].kind() {
            NodeKind::Inner { dimension, split, right } => {
                let (x, split) = (u32::from(query.0[dimension]), u32::from(split));
                // The nearest value on the other side is the split value, or one less.
                let (near, far, gap) = if x < split {
                    (at + 1, right, split - x)
                } else {
                    (right, at + 1, x + 1 - split)
                };
                let far_estimate = estimate.saturating_add(gap * gap);
                if far_estimate <= max_estimate {
                    scratch.queue.push(Reverse(u64::from(far_estimate) << 32 | u64::from(far)));
                }
                at = near;
            }
            NodeKind::Leaf { first, len } => {
                if let Some(point) = forest.points.get(first) {
                    prefetch(point);
                }
                scratch.leaves.push((first, len));
                return;
            }
        }
    }
}

/// Prefetches a cache line.
#[inline(always)]
fn prefetch<T>(place: &T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch does not access memory.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(place).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = place;
}

/// Compares the query with the points of the leaves of the current round that were not compared
/// before.
#[inline(always)]
fn visit_leaves(forest: &Forest, query: &Row, nearest: &mut Nearest, scratch: &mut Scratch) {
    let begin = scratch.visited.len();
    for (first, len) in scratch.leaves.drain(..) {
        for &point in &forest.points[first..first + len] {
            let (word, bit) = (point as usize / 64, 1 << (point % 64));
            if scratch.seen[word] & bit == 0 {
                scratch.seen[word] |= bit;
                let row = &forest.descriptors[point as usize].0;
                prefetch(&row[0]);
                prefetch(&row[64]);
                scratch.visited.push(point);
            }
        }
    }
    for &point in &scratch.visited[begin..] {
        nearest.update(point, squared_distance(query, &forest.descriptors[point as usize]));
    }
}

/// Squared Euclidean distance, exact.
#[inline(always)]
fn squared_distance(a: &Row, b: &Row) -> u32 {
    let mut sum = 0;
    for (x, y) in a.0.iter().zip(&b.0) {
        let difference = i16::from(*x) - i16::from(*y);
        sum += i32::from(difference) * i32::from(difference);
    }
    sum as u32
}
