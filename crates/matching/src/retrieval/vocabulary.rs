//! The vocabulary of visual words and the VLAD descriptors of images.

use rayon::prelude::*;
use tiepoint_features::SiftDescriptor;

use crate::brute::nearest;
use crate::prepared::Prepared;
use crate::random::stream;

/// Number of descriptors per parallel task.
const TASK_SIZE: usize = 4096;
/// Scale of the entries of a unit vector of 128 entries: equal entries become 32.
const BYTE_SCALE: f32 = 32.0 * 11.313_708;
/// Maximum absolute value of an entry.
const MAX_ENTRY: f32 = 127.0;

/// Options of [`Vocabulary::learn`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VocabularyOptions {
    /// Number of words, at most the size of the sample. A global descriptor has 128 bytes per word.
    pub words: usize,
    /// Number of iterations of k-means. More iterations did not improve retrieval.
    pub rounds: usize,
    /// Seed of the random initial words.
    pub seed: u64,
}

impl Default for VocabularyOptions {
    fn default() -> Self {
        VocabularyOptions { words: 128, rounds: 8, seed: 0 }
    }
}

/// A vocabulary of visual words: the k-means centres of descriptors.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    words: Vec<SiftDescriptor>,
    packed: Prepared,
}

/// The VLAD global descriptor of an image. Comparable with those of the same vocabulary.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GlobalDescriptor {
    /// 128 entries per word.
    pub(crate) entries: Vec<i8>,
}

impl Vocabulary {
    /// Number of descriptors of an image in its global descriptor. `tiepoint-features` sorts
    /// features by descending scale, and features of large scale are visible over large camera
    /// motions.
    pub const LEADING: usize = 1000;

    /// Learns the words from a sample of descriptors by k-means. A few hundred descriptors per word
    /// are sufficient.
    pub fn learn(sample: &[SiftDescriptor], options: &VocabularyOptions) -> Self {
        let mut order: Vec<u32> = (0..sample.len() as u32).collect();
        stream(options.seed, 0).shuffle(&mut order);
        let words = order.iter().take(options.words).map(|&i| sample[i as usize]).collect();
        let mut vocabulary = Vocabulary::from_words(words);
        let chunks: Vec<Prepared> = sample.par_chunks(TASK_SIZE).map(Prepared::new).collect();
        for _ in 0..options.rounds {
            vocabulary = vocabulary.refined(sample, &chunks);
        }
        vocabulary
    }

    #[cfg(test)]
    pub(super) fn packed(&self) -> &Prepared {
        &self.packed
    }

    fn from_words(words: Vec<SiftDescriptor>) -> Self {
        let packed = Prepared::new(&words);
        Vocabulary { words, packed }
    }

    /// One iteration of k-means. A word without assigned descriptors does not change.
    fn refined(&self, sample: &[SiftDescriptor], chunks: &[Prepared]) -> Self {
        let assigned: Vec<Vec<u32>> = chunks.par_iter().map(|chunk| self.assign(chunk)).collect();
        let mut sums = vec![[0u64; 128]; self.words.len()];
        let mut counts = vec![0u64; self.words.len()];
        for (descriptor, &word) in sample.iter().zip(assigned.iter().flatten()) {
            counts[word as usize] += 1;
            for (sum, &x) in sums[word as usize].iter_mut().zip(descriptor) {
                *sum += u64::from(x);
            }
        }
        let mean = |((word, sum), &count): ((&SiftDescriptor, [u64; 128]), &u64)| match count {
            0 => *word,
            _ => sum.map(|sum| ((sum + count / 2) / count) as u8),
        };
        Vocabulary::from_words(self.words.iter().zip(sums).zip(&counts).map(mean).collect())
    }

    /// The centres of the words.
    pub(super) fn words(&self) -> &[SiftDescriptor] {
        &self.words
    }

    /// The centres of the words alone.
    pub(super) fn into_words(self) -> Vec<SiftDescriptor> {
        self.words
    }

    /// The nearest word of every descriptor, the first of equally near ones.
    pub(super) fn assign(&self, descriptors: &Prepared) -> Vec<u32> {
        nearest(descriptors, &self.packed).of_a.iter().map(|nearest| nearest.index).collect()
    }

    /// A sample for learning: at most `count` equally spaced descriptors among the first
    /// [`LEADING`](Self::LEADING) of an image.
    pub fn sample(
        descriptors: &[SiftDescriptor],
        count: usize,
    ) -> impl Iterator<Item = &SiftDescriptor> {
        let leading = &descriptors[..descriptors.len().min(Self::LEADING)];
        leading.iter().step_by(leading.len().div_ceil(count).max(1))
    }

    /// The global descriptor of an image, from its first [`LEADING`](Self::LEADING) descriptors. An
    /// image without features has similarity 0 to all images.
    pub fn describe(&self, descriptors: &[SiftDescriptor]) -> GlobalDescriptor {
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
        GlobalDescriptor { entries: sums.iter().flat_map(normalised).collect() }
    }
}

/// The signed square roots of the sums of a word, normalised to the same norm for every word, so
/// that frequent words do not dominate.
fn normalised(sums: &[i32; 128]) -> [i8; 128] {
    // The squared norm of the roots.
    let total = sums.iter().map(|&sum| u64::from(sum.unsigned_abs())).sum::<u64>().max(1) as f32;
    sums.map(|sum| {
        let root = (sum.unsigned_abs() as f32 / total).sqrt();
        (BYTE_SCALE * root).min(MAX_ENTRY).round().copysign(sum as f32) as i8
    })
}
