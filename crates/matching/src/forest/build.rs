//! Construction of the trees, as in FLANN. The points are shuffled. A node is split at the mean of
//! a dimension that is drawn among the five of the highest variance. Mean and variance are
//! estimated from the first hundred points of the node.
//!
//! Split values are bytes: points with `x < split` are in the left child. Sums are integers, so the
//! trees are the same on all CPUs.

use rayon::prelude::*;
use tiepoint_features::SiftDescriptor;
use tiepoint_simd::Rng;

use super::options::ForestOptions;
use super::tree::{Forest, LEAF_MARK, Node, Row};
use crate::random::stream;

/// Number of points from which mean and variance are estimated: FLANN's SAMPLE_MEAN + 1, as
/// FLANN counts.
const SAMPLE_SIZE: usize = 101;
/// Maximum number of points in a leaf. FLANN has one. The descent to a leaf costs several times as
/// much as the comparison with a point: with eight points, a check takes a quarter longer, and the
/// recall is much higher (curves in `bench/matching.py`).
const MAX_LEAF_POINTS: usize = 8;
/// Number of dimensions of the highest variance among which one is drawn: FLANN's RAND_DIM.
const NUM_DIMENSIONS: usize = 5;

/// One tree, with links relative to its own nodes and points.
struct Tree {
    nodes: Vec<Node>,
    points: Vec<u32>,
}

impl Forest {
    /// Builds at least one tree over the descriptors, in parallel. The result does not depend on
    /// the number of threads.
    pub fn new(descriptors: &[SiftDescriptor], options: &ForestOptions) -> Self {
        build_forest(descriptors.iter().map(|&d| Row(d)).collect(), options)
    }
}

fn build_forest(descriptors: Vec<Row>, options: &ForestOptions) -> Forest {
    let trees: Vec<Tree> = (0..options.trees.max(1))
        .into_par_iter()
        .map(|tree| build_tree(&descriptors, &mut stream(options.seed, u64::from(tree))))
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

fn build_tree(descriptors: &[Row], random: &mut Rng) -> Tree {
    let mut points: Vec<u32> = (0..descriptors.len() as u32).collect();
    random.shuffle(&mut points);
    let mut nodes: Vec<Node> = Vec::with_capacity(2 * points.len() + 1);
    // Stack of the point ranges of future nodes, with the parent of right children. It replaces
    // recursion, whose depth would depend on the data.
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

/// Dimension and value of a split with two non-empty parts; `None` if the points fit into a leaf or
/// are equal.
fn choose_split(descriptors: &[Row], points: &[u32], random: &mut Rng) -> Option<(usize, u8)> {
    if points.len() <= MAX_LEAF_POINTS {
        return None;
    }
    split_from_sample(descriptors, &points[..points.len().min(SAMPLE_SIZE)], random)
        .or_else(|| split_from_sample(descriptors, points, random))
}

/// A split of a sample of points; `None` if they are equal.
fn split_from_sample(descriptors: &[Row], sample: &[u32], random: &mut Rng) -> Option<(usize, u8)> {
    let mut sums = [0u32; 128];
    let mut squares = [0u64; 128];
    // The squares of a hundred bytes fit into 32 bits. Only the sums over all points need 64 bits.
    for chunk in sample.chunks(SAMPLE_SIZE) {
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
    // The dimensions of the highest variance so far, in descending order, with the variance times
    // the squared count.
    let mut highest = [(0u64, 0usize); NUM_DIMENSIONS];
    let mut filled = 0;
    for dimension in 0..128 {
        let sum = u64::from(sums[dimension]);
        let variance = count * squares[dimension] - sum * sum;
        if variance > highest[NUM_DIMENSIONS - 1].0 {
            filled = (filled + 1).min(NUM_DIMENSIONS);
            let mut place = NUM_DIMENSIONS - 1;
            while place > 0 && variance > highest[place - 1].0 {
                highest[place] = highest[place - 1];
                place -= 1;
            }
            highest[place] = (variance, dimension);
        }
    }
    if filled == 0 {
        return None;
    }
    let (_, dimension) = highest[random.below(filled)];
    // For integers, x < mean is equivalent to x < ⌈mean⌉. The variance of the sample is positive,
    // so both parts are non-empty.
    Some((dimension, u64::from(sums[dimension]).div_ceil(count) as u8))
}

/// Moves the points with `is_left` to the front and returns their number.
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
