//! Image retrieval for loop closures and unordered photos: by an inverted index of visual words
//! (`tree`, `inverted`), which compares images that share words, and by global descriptors, which
//! are compared all with all.
//!
//! The global descriptor is VLAD (Jégou et al., "Aggregating local descriptors into a compact image
//! representation", CVPR 2010), normalised as in Arandjelović and Zisserman ("All about VLAD", CVPR
//! 2013). A vocabulary of about a hundred visual words is learnt from descriptors of the images.
//! The global descriptor of an image holds, for each word, the sum of the residuals of its
//! descriptors to their nearest word. Images of the same place have similar global descriptors.
//! Images of the same place from very different viewpoints are related by diffusion through images
//! in between.
//!
//! Sums are in exact integers, and IEEE 754 defines the rounding of the square roots. The results
//! are the same on all CPUs and for any number of threads.

mod diffusion;
mod index;
mod inverted;
mod similar;
mod tree;
mod vocabulary;

pub use index::RetrievalIndex;
pub use inverted::{ImageWords, InvertedIndex};
pub use similar::Similar;
pub use tree::VocabularyTree;
pub use vocabulary::{GlobalDescriptor, Vocabulary, VocabularyOptions};

#[cfg(test)]
mod tests;
