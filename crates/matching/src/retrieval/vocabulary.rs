//! Words, and images as sums of differences from them.

use rayon::prelude::*;
use tiepoint_features::Descriptor;

use crate::brute::nearest;
use crate::prepared::Prepared;
use crate::random::SplitMix64;

/// Descriptors that are assigned to words as one task.
const CHUNK: usize = 4096;
/// Entries of a global descriptor are bytes: this many times what all would be if they were equally
/// large, at 32.
const BYTE_SCALE: f32 = 32.0 * 11.313_708;
/// Largest entry.
const LARGEST: f32 = 127.0;

/// How to learn a vocabulary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VocabularyOptions {
    /// Number of words; each is 128 bytes of every global descriptor. Fewer where the sample is
    /// smaller.
    pub words: usize,
    /// Rounds of k-means; it has settled by then as far as retrieval can tell.
    pub rounds: usize,
    /// Seed of the choice of first words.
    pub seed: u64,
}

impl Default for VocabularyOptions {
    fn default() -> Self {
        VocabularyOptions { words: 128, rounds: 8, seed: 0 }
    }
}

/// Typical descriptors of some images.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    words: Vec<Descriptor>,
    packed: Prepared,
}

/// What an image looks like as a whole. Meaningful beside others of the same vocabulary.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GlobalDescriptor {
    /// 128 for each word.
    pub(crate) entries: Vec<i8>,
}

impl Vocabulary {
    /// How many descriptors of an image say what it looks like. SIFT has the largest features
    /// first, which are those that stay when the camera moves on.
    pub const LEADING: usize = 1000;

    /// Learns words from a sample of descriptors by k-means; a few hundred descriptors for each
    /// word suffice.
    pub fn learn(sample: &[Descriptor], options: &VocabularyOptions) -> Self {
        let mut order: Vec<u32> = (0..sample.len() as u32).collect();
        SplitMix64::new(options.seed, 0).shuffle(&mut order);
        let words = order.iter().take(options.words).map(|&i| sample[i as usize]).collect();
        let mut vocabulary = Vocabulary::from_words(words);
        let chunks: Vec<Prepared> = sample.par_chunks(CHUNK).map(Prepared::new).collect();
        for _ in 0..options.rounds {
            vocabulary = vocabulary.refined(sample, &chunks);
        }
        vocabulary
    }

    #[cfg(test)]
    pub(super) fn packed(&self) -> &Prepared {
        &self.packed
    }

    fn from_words(words: Vec<Descriptor>) -> Self {
        let packed = Prepared::new(&words);
        Vocabulary { words, packed }
    }

    /// Every word becomes the mean of the descriptors that it is nearest to; one that has none
    /// stays.
    fn refined(&self, sample: &[Descriptor], chunks: &[Prepared]) -> Self {
        let assigned: Vec<Vec<u32>> = chunks.par_iter().map(|chunk| self.assign(chunk)).collect();
        let mut sums = vec![[0u64; 128]; self.words.len()];
        let mut counts = vec![0u64; self.words.len()];
        for (descriptor, &word) in sample.iter().zip(assigned.iter().flatten()) {
            counts[word as usize] += 1;
            for (sum, &x) in sums[word as usize].iter_mut().zip(descriptor) {
                *sum += u64::from(x);
            }
        }
        let mean = |((word, sum), &count): ((&Descriptor, [u64; 128]), &u64)| match count {
            0 => *word,
            _ => sum.map(|sum| ((sum + count / 2) / count) as u8),
        };
        Vocabulary::from_words(self.words.iter().zip(sums).zip(&counts).map(mean).collect())
    }

    /// The nearest word of every descriptor, the first among equals.
    fn assign(&self, descriptors: &Prepared) -> Vec<u32> {
        nearest(descriptors, &self.packed).of_a.iter().map(|nearest| nearest.index).collect()
    }

    /// About so many of an image's [leading](Self::LEADING) descriptors, evenly spread, to learn
    /// from.
    pub fn sample(descriptors: &[Descriptor], count: usize) -> impl Iterator<Item = &Descriptor> {
        let leading = &descriptors[..descriptors.len().min(Self::LEADING)];
        leading.iter().step_by(leading.len().div_ceil(count).max(1))
    }

    /// The global descriptor of an image, of its [leading](Self::LEADING) descriptors. One without
    /// features is like no other.
    pub fn describe(&self, descriptors: &[Descriptor]) -> GlobalDescriptor {
        let descriptors = &descriptors[..descriptors.len().min(Self::LEADING)];
        let mut sums = vec![[0i32; 128]; self.words.len()];
        if !self.words.is_empty() {
            for (descriptor, word) in
                descriptors.iter().zip(self.assign(&Prepared::new(descriptors)))
            {
                let word = word as usize;
                for ((sum, &x), &w) in sums[word].iter_mut().zip(descriptor).zip(&self.words[word])
                {
                    *sum += i32::from(x) - i32::from(w);
                }
            }
        }
        GlobalDescriptor { entries: sums.iter().flat_map(quantised).collect() }
    }
}

/// The signed roots of a word's sums, as long together for every word: what is seen often shall not
/// drown the rest.
fn quantised(sums: &[i32; 128]) -> [i8; 128] {
    // The squared length of the roots.
    let total = sums.iter().map(|&sum| u64::from(sum.unsigned_abs())).sum::<u64>().max(1) as f32;
    sums.map(|sum| {
        let root = (sum.unsigned_abs() as f32 / total).sqrt();
        (BYTE_SCALE * root).min(LARGEST).round().copysign(sum as f32) as i8
    })
}
