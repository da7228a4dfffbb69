//! The vocabulary tree: visual words whose number grows with the number of images.

use rayon::prelude::*;
use tiepoint_features::SiftDescriptor;

use super::vocabulary::{Vocabulary, VocabularyOptions};
use crate::distance::squared_distance;
use crate::prepared::Prepared;

/// Number of descriptors per parallel task.
const TASK_SIZE: usize = 4096;
/// Descriptors for each node in the sample that the nodes are learnt from. As in
/// [`Vocabulary::learn`], a few hundred are sufficient.
const SAMPLE_PER_NODE: usize = 256;

/// A vocabulary tree of two levels (Nistér and Stewénius, "Scalable recognition with a vocabulary
/// tree", CVPR 2006).
///
/// Both levels are learnt by k-means. With W words the tree has √W nodes, and each node has words
/// in proportion to its descriptors in the sample. The nearest word of a descriptor is that among
/// the words of its nearest node, so that it takes about 2 √W distances.
#[derive(Clone, Debug)]
pub struct VocabularyTree {
    nodes: Vocabulary,
    words: Vec<SiftDescriptor>,
    /// Index of the first word of each node, and the number of words.
    starts: Vec<u32>,
}

impl VocabularyTree {
    /// Learns about `words` words from a sample of descriptors, which should have several times as
    /// many.
    pub fn learn(sample: &[SiftDescriptor], words: usize, seed: u64) -> Self {
        let num_nodes = words.isqrt().max(1);
        let step = (sample.len() / (num_nodes * SAMPLE_PER_NODE)).max(1);
        let few: Vec<SiftDescriptor> = sample.iter().step_by(step).copied().collect();
        let options = VocabularyOptions { words: num_nodes, seed, ..VocabularyOptions::default() };
        let nodes = Vocabulary::learn(&few, &options);
        let mut of_nodes: Vec<Vec<SiftDescriptor>> = vec![Vec::new(); nodes.words().len()];
        let assigned: Vec<Vec<u32>> =
            sample.par_chunks(TASK_SIZE).map(|chunk| nodes.assign(&Prepared::new(chunk))).collect();
        for (&node, descriptor) in assigned.iter().flatten().zip(sample) {
            of_nodes[node as usize].push(*descriptor);
        }
        let learn = |of_node: &Vec<SiftDescriptor>| -> Vec<SiftDescriptor> {
            let words = (of_node.len() * words).div_ceil(sample.len()).max(1);
            Vocabulary::learn(of_node, &VocabularyOptions { words, ..options }).into_words()
        };
        let words: Vec<Vec<SiftDescriptor>> = of_nodes.par_iter().map(learn).collect();
        let mut starts = vec![0];
        for of_node in &words {
            starts.push(starts[starts.len() - 1] + of_node.len() as u32);
        }
        VocabularyTree { nodes, words: words.concat(), starts }
    }

    /// Number of words.
    pub fn len(&self) -> usize {
        self.words.len()
    }

    /// Whether there are no words, because the sample was empty.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// The centre of a word.
    pub(super) fn word(&self, word: u32) -> &SiftDescriptor {
        &self.words[word as usize]
    }

    /// The word of every descriptor, the first of equally near ones; empty if there are no words.
    pub(super) fn assign(&self, descriptors: &[SiftDescriptor]) -> Vec<u32> {
        if self.is_empty() {
            return Vec::new();
        }
        let nodes = self.nodes.assign(&Prepared::new(descriptors));
        descriptors
            .iter()
            .zip(nodes)
            .map(|(descriptor, node)| self.nearest(descriptor, node))
            .collect()
    }

    /// The nearest word of a node. A node without descriptors in the sample has none; the word
    /// before its place stands for it.
    fn nearest(&self, descriptor: &SiftDescriptor, node: u32) -> u32 {
        let [start, end] = [self.starts[node as usize], self.starts[node as usize + 1]];
        (start..end)
            .min_by_key(|&word| squared_distance(descriptor, self.word(word)))
            .unwrap_or(start.saturating_sub(1))
    }
}
