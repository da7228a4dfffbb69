//! Memory layout of the trees and of the points in their leaves.

use tiepoint_features::SiftDescriptor;

/// Randomized kd-trees over the descriptors of one image.
#[derive(Clone, Debug)]
pub struct Forest {
    /// The points.
    pub(super) descriptors: Vec<Row>,
    /// The nodes of all trees, each tree in preorder.
    pub(super) nodes: Vec<Node>,
    /// Index of the root of each tree in `nodes`.
    pub(super) roots: Vec<u32>,
    /// Indices of descriptors, in the order of the leaves of the trees.
    pub(super) points: Vec<u32>,
}

/// A descriptor that is aligned to cache lines: it occupies exactly two.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Row(pub(super) SiftDescriptor);

impl Forest {
    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.descriptors.len()
    }

    /// Whether there are no descriptors.
    pub fn is_empty(&self) -> bool {
        self.descriptors.is_empty()
    }

    /// Number of trees.
    pub fn trees(&self) -> usize {
        self.roots.len()
    }
}

/// Marks a leaf in [`Node::content`].
pub(super) const LEAF_MARK: u32 = 1 << 31;

/// A node of eight bytes. Trees are in preorder: the left child follows its parent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Inner node: index of the right child. Leaf: index of its first point in `Forest::points`.
    pub(super) link: u32,
    /// Inner node: dimension and split value. Leaf: number of points and [`LEAF_MARK`].
    pub(super) content: u32,
}

/// The decoded content of a node.
pub(super) enum NodeKind {
    Inner { dimension: usize, split: u8, right: u32 },
    Leaf { first: usize, len: usize },
}

impl Node {
    pub(super) fn inner(dimension: usize, split: u8) -> Self {
        Node { link: 0, content: (dimension as u32) << 8 | u32::from(split) }
    }

    #[inline(always)]
    pub(super) fn kind(self) -> NodeKind {
        if self.content & LEAF_MARK == 0 {
            let dimension = (self.content >> 8) as usize & 127;
            NodeKind::Inner { dimension, split: self.content as u8, right: self.link }
        } else {
            NodeKind::Leaf { first: self.link as usize, len: (self.content & !LEAF_MARK) as usize }
        }
    }
}
