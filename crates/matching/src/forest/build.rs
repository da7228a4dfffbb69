//! Growing trees, as FLANN does: shuffle the points; split at the mean of a dimension drawn among
//! the five of highest variance, both estimated from the first hundred points of the node.
//!
//! Entries are bytes, so a split is a byte: `x < split` goes left. Sums are integers, so a tree is
//! the same everywhere.

use rayon::prelude::*;
use tiepoint_features::Descriptor;

use super::options::ForestOptions;
use super::tree::{Forest, LEAF_MARK, Node, Row};
use crate::random::SplitMix64;

/// Points from which mean and variance are estimated; FLANN's SAMPLE_MEAN, counted as it does.
const SAMPLE: usize = 101;
/// Most points in a leaf. FLANN's leaves hold one, and going down to the next leaf costs several
/// times as much as looking at a point: with eight, a check takes a quarter longer and finds far
/// more (`bench/matching.py` has the curves).
const LEAF_POINTS: usize = 8;
/// Dimensions of highest variance among which one is drawn; FLANN's RAND_DIM.
const DIMENSIONS: usize = 5;
/// One tree, its links relative to itself.
struct Tree {
    nodes: Vec<Node>,
    points: Vec<u32>,
}

impl Forest {
    /// Grows the trees, in parallel; the result depends on the options only. At least one tree is
    /// grown.
    pub fn new(descriptors: &[Descriptor], options: &ForestOptions) -> Self {
        grow(descriptors.iter().map(|&d| Row(d)).collect(), options)
    }
}

fn grow(descriptors: Vec<Row>, options: &ForestOptions) -> Forest {
    let trees: Vec<Tree> = (0..options.trees.max(1))
        .into_par_iter()
        .map(|tree| grow_tree(&descriptors, &mut SplitMix64::new(options.seed, u64::from(tree))))
        .collect();
    let mut forest =
        Forest { descriptors, nodes: Vec::new(), roots: Vec::new(), points: Vec::new() };
    for tree in trees {
        let (first_node, first_point) = (forest.nodes.len() as u32, forest.points.len() as u32);
        forest.roots.push(first_node);
        forest.points.extend(&tree.points);
        forest.nodes.extend(tree.nodes.iter().map(|node| {
            let first = if node.content & LEAF_MARK == 0 { first_node } else { first_point };
            Node { link: node.link + first, ..*node }
        }));
    }
    forest
}

fn grow_tree(descriptors: &[Row], random: &mut SplitMix64) -> Tree {
    let mut points: Vec<u32> = (0..descriptors.len() as u32).collect();
    random.shuffle(&mut points);
    let mut nodes: Vec<Node> = Vec::with_capacity(2 * points.len() + 1);
    // Ranges of points still to become nodes, and the parent of those that are right children. A
    // list instead of recursion: how deep a tree gets is up to the data.
    let mut pending = vec![(0..points.len(), None)];
    while let Some((range, parent)) = pending.pop() {
        let index = nodes.len();
        if let Some(parent) = parent {
            let parent: &mut Node = &mut nodes[parent];
            parent.link = index as u32;
        }
        match choose_split(descriptors, &points[range.clone()], random) {
            Some((dimension, split)) => {
                let left = partition(&mut points[range.clone()], |p| {
                    descriptors[p as usize].0[dimension] < split
                });
                nodes.push(Node::inner(dimension, split));
                pending.push((range.start + left..range.end, Some(index)));
                pending.push((range.start..range.start + left, None));
            }
            None => nodes
                .push(Node { link: range.start as u32, content: LEAF_MARK | range.len() as u32 }),
        }
    }
    Tree { nodes, points }
}

/// A dimension and a byte that part the points in two, none empty; `None` if they fit into a leaf,
/// or all are equal.
fn choose_split(
    descriptors: &[Row],
    points: &[u32],
    random: &mut SplitMix64,
) -> Option<(usize, u8)> {
    if points.len() <= LEAF_POINTS {
        return None;
    }
    split_from_sample(descriptors, &points[..points.len().min(SAMPLE)], random)
        .or_else(|| split_from_sample(descriptors, points, random))
}

fn split_from_sample(
    descriptors: &[Row],
    sample: &[u32],
    random: &mut SplitMix64,
) -> Option<(usize, u8)> {
    let mut sums = [0u32; 128];
    let mut squares = [0u64; 128];
    // Squares of a hundred bytes fit into 32 bits; only samples of everything need the wider sums.
    for chunk in sample.chunks(SAMPLE) {
        let mut chunk_squares = [0u32; 128];
        for &point in chunk {
            for ((x, sum), square) in
                descriptors[point as usize].0.iter().zip(&mut sums).zip(&mut chunk_squares)
            {
                *sum += u32::from(*x);
                *square += u32::from(*x) * u32::from(*x);
            }
        }
        for (square, chunk_square) in squares.iter_mut().zip(chunk_squares) {
            *square += u64::from(chunk_square);
        }
    }
    let count = sample.len() as u64;
    // The dimensions of highest variance so far, descending; the variance times the square of the
    // count.
    let mut widest = [(0u64, 0usize); DIMENSIONS];
    let mut filled = 0;
    for dimension in 0..128 {
        let sum = u64::from(sums[dimension]);
        let spread = count * squares[dimension] - sum * sum;
        if spread > widest[DIMENSIONS - 1].0 {
            filled = (filled + 1).min(DIMENSIONS);
            let mut place = DIMENSIONS - 1;
            while place > 0 && spread > widest[place - 1].0 {
                widest[place] = widest[place - 1];
                place -= 1;
            }
            widest[place] = (spread, dimension);
        }
    }
    if filled == 0 {
        return None;
    }
    let (_, dimension) = widest[random.below(filled)];
    // x < mean and x < ⌈mean⌉ say the same of an integer. The sample varies, so that it has entries
    // on both sides.
    Some((dimension, u64::from(sums[dimension]).div_ceil(count) as u8))
}

/// Moves the points for which `is_left` holds to the front and returns how many there are.
fn partition(points: &mut [u32], is_left: impl Fn(u32) -> bool) -> usize {
    let mut left = 0;
    for place in 0..points.len() {
        if is_left(points[place]) {
            points.swap(left, place);
            left += 1;
        }
    }
    left
}
