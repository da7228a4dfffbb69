//! The similarity of images.

/// An image of a [`Bank`](crate::Bank) and its similarity to a query image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similar {
    /// Index of the image in the bank.
    pub image: u32,
    /// Cosine similarity of the global descriptors: 1 for the same image, near 0 for unrelated
    /// images.
    pub similarity: f32,
}
