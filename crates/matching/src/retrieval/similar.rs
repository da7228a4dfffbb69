//! The similarity of images.

/// An image of a [`RetrievalIndex`](super::RetrievalIndex) and its similarity to a query image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similar {
    /// Number of the image: images are numbered from 0 in the order in which they were added.
    pub image: u32,
    /// Cosine similarity of the global descriptors: 1 for the same image, near 0 for unrelated
    /// images.
    pub similarity: f32,
}
