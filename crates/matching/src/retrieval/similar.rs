//! How alike two images are.

/// An image of a bank that looks like another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similar {
    /// Its place in the bank.
    pub image: u32,
    /// Cosine of the angle between the global descriptors: 1 for the same image, around 0 for
    /// unrelated ones.
    pub similarity: f32,
}
