//! Searching all trees at once.
//!
//! A branch not taken waits in one queue for all trees, keyed by a bound on the distance of its
//! points: the squared gaps between the query and the splits on the way (as in FLANN, a dimension
//! that was split twice counts twice, so that the bound is an estimate). Each tree is descended
//! once; then the best branches of all are taken, until enough leaves were looked at. A point that
//! several trees offer is looked at once.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use tiepoint_features::Descriptor;

use super::options::Checks;
use super::tree::{Forest, NodeKind, Row};
use crate::brute::{Isa, Kind};
use crate::matches::Nearest;

/// Leaves that are fetched together. At a million points almost every leaf and every point is a
/// wait for main memory, and four that overlap take half the time of one after the other; the order
/// of the search hardly changes.
const ROUND: usize = 4;

/// Room for what one search needs, kept from query to query.
struct Scratch {
    /// Branches by ascending bound; the bound above, the node below.
    queue: BinaryHeap<Reverse<u64>>,
    /// Leaves of this round: ranges of `Forest::points`.
    leaves: Vec<(usize, usize)>,
    /// One bit for each point that was looked at.
    seen: Vec<u64>,
    /// Those points, to take the bits back.
    looked_at: Vec<u32>,
}

impl Forest {
    /// For every query, the two nearest neighbours among the points that the search came across.
    pub fn nearest(&self, queries: &[Descriptor], checks: Checks) -> Vec<Nearest> {
        self.nearest_on(Isa::best(), queries, checks)
    }

    /// As [`Self::nearest`], on a given instruction set: for tests and measurements. All give the
    /// same result.
    pub fn nearest_on(&self, isa: Isa, queries: &[Descriptor], checks: Checks) -> Vec<Nearest> {
        search(self, isa, queries.iter().map(|&query| Row(query)), checks)
    }

    /// The neighbours of another forest's descriptors.
    pub(crate) fn nearest_of(&self, other: &Forest, checks: Checks) -> Vec<Nearest> {
        search(self, Isa::best(), other.descriptors.iter().copied(), checks)
    }
}

fn search(
    forest: &Forest,
    isa: Isa,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    match isa.0 {
        // SAFETY: an `Isa` is made only where the processor has the features it stands for.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { search_avx512(forest, queries, checks) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::AvxVnni | Kind::Avx2 => unsafe { search_avx2(forest, queries, checks) },
        Kind::Portable => search_all(forest, queries, checks),
    }
}

/// The same source, compiled for wider vectors.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn search_avx512(
    forest: &Forest,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    search_all(forest, queries, checks)
}

/// As [`search_avx512`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn search_avx2(
    forest: &Forest,
    queries: impl Iterator<Item = Row>,
    checks: Checks,
) -> Vec<Nearest> {
    search_all(forest, queries, checks)
}

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
        looked_at: Vec::new(),
    };
    let mut found = Vec::with_capacity(queries.size_hint().0);
    for query in queries {
        found.push(search_one(forest, &query, checks, &mut scratch));
    }
    found
}

#[inline(always)]
fn search_one(forest: &Forest, query: &Row, checks: u64, scratch: &mut Scratch) -> Nearest {
    let mut nearest = Nearest::NONE;
    for roots in forest.roots.chunks(ROUND) {
        for &root in roots {
            descend(forest, query, 0, root, nearest.second, scratch);
        }
        look_at_leaves(forest, query, &mut nearest, scratch);
    }
    let mut checked = forest.roots.len() as u64;
    while checked < checks || nearest.second == u32::MAX {
        for _ in 0..(checks.saturating_sub(checked)).clamp(1, ROUND as u64) {
            let Some(Reverse(branch)) = scratch.queue.pop() else { break };
            let bound = (branch >> 32) as u32;
            if bound > nearest.second {
                break;
            }
            descend(forest, query, bound, branch as u32, nearest.second, scratch);
            checked += 1;
        }
        if scratch.leaves.is_empty() {
            break;
        }
        look_at_leaves(forest, query, &mut nearest, scratch);
    }
    scratch.queue.clear();
    for point in scratch.looked_at.drain(..) {
        scratch.seen[point as usize / 64] = 0;
    }
    nearest
}

/// Goes down to a leaf on the query's side of every split, queues the other sides, and notes the
/// leaf.
#[inline(always)]
fn descend(
    forest: &Forest,
    query: &Row,
    bound: u32,
    mut at: u32,
    worst: u32,
    scratch: &mut Scratch,
) {
    loop {
        match forest.nodes[at as usize].kind() {
            NodeKind::Inner { dimension, split, right } => {
                let (x, split) = (u32::from(query.0[dimension]), u32::from(split));
                // The nearest byte on the other side is the split itself, or the one below it.
                let (near, far, gap) = if x < split {
                    (at + 1, right, split - x)
                } else {
                    (right, at + 1, x + 1 - split)
                };
                let far_bound = bound.saturating_add(gap * gap);
                if far_bound <= worst {
                    scratch.queue.push(Reverse(u64::from(far_bound) << 32 | u64::from(far)));
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

/// Asks for a cache line that will be read soon.
#[inline(always)]
fn prefetch<T>(place: &T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a hint; it neither reads nor writes.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(place).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = place;
}

/// Compares the query with the points of the noted leaves that it has not met before.
#[inline(always)]
fn look_at_leaves(forest: &Forest, query: &Row, nearest: &mut Nearest, scratch: &mut Scratch) {
    let begin = scratch.looked_at.len();
    for (first, len) in scratch.leaves.drain(..) {
        for &point in &forest.points[first..first + len] {
            let (word, bit) = (point as usize / 64, 1 << (point % 64));
            if scratch.seen[word] & bit == 0 {
                scratch.seen[word] |= bit;
                let row = &forest.descriptors[point as usize].0;
                prefetch(&row[0]);
                prefetch(&row[64]);
                scratch.looked_at.push(point);
            }
        }
    }
    for &point in &scratch.looked_at[begin..] {
        nearest.offer(point, squared_distance(query, &forest.descriptors[point as usize]));
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
