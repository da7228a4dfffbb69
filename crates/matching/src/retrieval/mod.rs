//! Which images look alike: global descriptors, for loops that a drive closes and for photos in no
//! order.
//!
//! A vector of locally aggregated descriptors (Jégou et al., "Aggregating local descriptors into a
//! compact image representation", CVPR 2010; normalised as in Arandjelović and Zisserman, "All
//! about VLAD", CVPR 2013): a vocabulary of a hundred words is learnt from some descriptors of the
//! images themselves; an image then is, word by word, the sum of what its descriptors differ from
//! their nearest word by. Images of the same place have similar vectors; those that see it from too
//! different sides are found by way of others.
//!
//! Descriptors are exact in integers but for the roots at the end, which IEEE 754 rounds the same
//! way everywhere: the same candidates on every machine, for any number of threads.

mod bank;
mod similar;
mod vocabulary;
mod walks;

pub use bank::Bank;
pub use similar::Similar;
pub use vocabulary::{GlobalDescriptor, Vocabulary, VocabularyOptions};

#[cfg(test)]
mod tests;
