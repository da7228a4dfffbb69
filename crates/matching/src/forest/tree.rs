//! Trees and the points in their leaves, as they lie in memory.

use tiepoint_features::Descriptor;

/// Randomized kd-trees over the descriptors of one image.
#[derive(Clone, Debug)]
pub struct Forest {
    pub(super) descriptors: Vec<Row>,
    /// All trees one after the other, each in preorder.
    pub(super) nodes: Vec<Node>,
    /// Where each tree begins in `nodes`.
    pub(super) roots: Vec<u32>,
    /// Indices of descriptors in the order of the trees' leaves.
    pub(super) points: Vec<u32>,
}

/// A descriptor that fills two cache lines and touches no third.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Row(pub(super) Descriptor);

impl Forest {
    /// How many descriptors the forest holds.
    pub fn len(&self) -> usize {
        self.descriptors.len()
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.descriptors.is_empty()
    }

    /// The number of trees.
    pub fn trees(&self) -> usize {
        self.roots.len()
    }
}

/// Marks a leaf in [`Node::content`].
pub(super) const LEAF_MARK: u32 = 1 << 31;

/// Eight bytes. A tree lies in preorder: the left child of a node follows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Inner node: index of the right child. Leaf: index of its first entry in `Forest::points`.
    pub(super) link: u32,
    /// Inner node: dimension and split. Leaf: number of points and the mark.
    pub(super) content: u32,
}

/// What a node is.
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
