//! Image retrieval by an inverted index of visual words.
//!
//! The similarity of two images is the aggregated selective match kernel on binary vectors (ASMK*;
//! Tolias, Avrithis and Jégou, "Image search with selective match kernels: aggregating
//! across single and multiple images", IJCV 2016). All descriptors of an image that have the same
//! word become one binary vector: the signs of the sum of their residuals to the word. Repeated
//! structures (windows, leaves) thus count once. Two images are similar if they have the same rare
//! words, with similar vectors.
//!
//! An image is compared only with those that share a word with it. If the number of words grows
//! with the number of images, a word has the same number of images on average in any collection,
//! so that a query compares the same number of binary vectors.
//!
//! Weights are integers, so that sums are exact in any order.

use rayon::prelude::*;
use tiepoint_features::SiftDescriptor;

use super::Vocabulary;
use super::index::ranked;
use super::similar::Similar;
use super::tree::VocabularyTree;

/// Exponent α of the selectivity function (section 5.1 of the paper: 3).
const SELECTIVITY: i32 = 3;
/// Scale of integer weights of Hamming distances and of words.
const WEIGHT_SCALE: f64 = 65536.0;
/// Number of query images per parallel task.
const TASK_SIZE: usize = 16;

/// The binary vector of a word in an image: 128 bits.
type Signature = [u64; 2];
const BITS: u32 = 128;

/// The visual words of an image with their binary vectors, in ascending order of words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImageWords {
    words: Vec<u32>,
    signatures: Vec<Signature>,
}

#[cfg(test)]
impl ImageWords {
    pub(super) fn words(&self) -> &[u32] {
        &self.words
    }

    pub(super) fn signatures(&self) -> &[Signature] {
        &self.signatures
    }
}

impl VocabularyTree {
    /// The visual words of an image, from its first [`Vocabulary::LEADING`] descriptors.
    pub fn describe(&self, descriptors: &[SiftDescriptor]) -> ImageWords {
        let descriptors = &descriptors[..descriptors.len().min(Vocabulary::LEADING)];
        let words = self.assign(descriptors);
        let mut order: Vec<u32> = (0..words.len() as u32).collect();
        order.sort_unstable_by_key(|&i| (words[i as usize], i));
        let mut image = ImageWords::default();
        for same in order.chunk_by(|&i, &j| words[i as usize] == words[j as usize]) {
            let word = words[same[0] as usize];
            let centre = self.word(word);
            let mut sums = [0i32; 128];
            for &i in same {
                for ((sum, &x), &c) in sums.iter_mut().zip(&descriptors[i as usize]).zip(centre) {
                    *sum += i32::from(x) - i32::from(c);
                }
            }
            image.words.push(word);
            image.signatures.push(signs(&sums));
        }
        image
    }
}

/// Bit k is set if entry k is positive.
fn signs(sums: &[i32; 128]) -> Signature {
    let mut signature = [0; 2];
    for (k, _) in sums.iter().enumerate().filter(|&(_, &sum)| sum > 0) {
        signature[k / 64] |= 1 << (k % 64);
    }
    signature
}

/// The weight of a pair of binary vectors by their Hamming distance: the selectivity function of
/// their cosine, 0 for a negative one.
fn selectivity() -> [u64; BITS as usize + 1] {
    std::array::from_fn(|distance| {
        let cosine = 1.0 - 2.0 * distance as f64 / f64::from(BITS);
        (WEIGHT_SCALE * cosine.max(0.0).powi(SELECTIVITY)).round() as u64
    })
}

fn hamming(a: Signature, b: Signature) -> usize {
    ((a[0] ^ b[0]).count_ones() + (a[1] ^ b[1]).count_ones()) as usize
}

/// The inverted index: for each visual word, the images that have it.
#[derive(Clone, Debug)]
pub struct InvertedIndex {
    /// For each word: index of its first entry; and the number of entries.
    starts: Vec<u32>,
    /// For each entry: image, in ascending order in a word.
    images: Vec<u32>,
    signatures: Vec<Signature>,
    /// For each word: its inverse document frequency.
    weights: Vec<u64>,
    /// For each image: index of its first entry in `words`; and the number of all.
    image_starts: Vec<u32>,
    words: Vec<u32>,
    /// For each image: the reciprocal square root of its similarity to itself; 0 without words.
    inverse_norms: Vec<f64>,
    selectivity: [u64; BITS as usize + 1],
}

impl InvertedIndex {
    /// The index of images with the words of a vocabulary. Entry `i` of `images` is image `i`.
    pub fn new(vocabulary: &VocabularyTree, images: &[ImageWords]) -> Self {
        let mut starts = vec![0u32; vocabulary.len() + 1];
        for &word in images.iter().flat_map(|image| &image.words) {
            starts[word as usize + 1] += 1;
        }
        let idf = |&count: &u32| match count {
            0 => 0,
            _ => (WEIGHT_SCALE * (images.len() as f64 / f64::from(count)).ln()).round() as u64,
        };
        let weights: Vec<u64> = starts[1..].iter().map(idf).collect();
        for word in 0..vocabulary.len() {
            starts[word + 1] += starts[word];
        }
        let num_entries = starts[vocabulary.len()] as usize;
        let mut index = InvertedIndex {
            images: vec![0; num_entries],
            signatures: vec![[0; 2]; num_entries],
            weights,
            image_starts: vec![0],
            words: Vec::with_capacity(num_entries),
            inverse_norms: Vec::with_capacity(images.len()),
            selectivity: selectivity(),
            starts,
        };
        let mut next = index.starts.clone();
        for (id, image) in (0..).zip(images) {
            let mut square = 0;
            for (&word, &signature) in image.words.iter().zip(&image.signatures) {
                let entry = &mut next[word as usize];
                index.images[*entry as usize] = id;
                index.signatures[*entry as usize] = signature;
                *entry += 1;
                square += index.selectivity[0] * index.weights[word as usize];
            }
            index.words.extend(&image.words);
            index.image_starts.push(index.words.len() as u32);
            let norm = (square as f64).sqrt();
            index.inverse_norms.push(if square == 0 { 0.0 } else { 1.0 / norm });
        }
        index
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.inverse_norms.len()
    }

    /// Whether there are no images.
    pub fn is_empty(&self) -> bool {
        self.inverse_norms.is_empty()
    }

    /// For every image, the at most `count` most similar other images that share a word with it, in
    /// descending order of similarity, then in ascending order of image number.
    pub fn most_similar(&self, count: usize) -> Vec<Vec<Similar>> {
        let images: Vec<u32> = (0..self.len() as u32).collect();
        let of_task = |scores: &mut Vec<u64>, task: &[u32]| -> Vec<Vec<Similar>> {
            task.iter().map(|&image| self.query(image, count, scores)).collect()
        };
        let tasks = images.par_chunks(TASK_SIZE);
        tasks.map_init(|| vec![0; self.len()], of_task).collect::<Vec<_>>().concat()
    }

    /// The most similar images to one. `scores` are zeros, before and after.
    fn query(&self, image: u32, count: usize, scores: &mut [u64]) -> Vec<Similar> {
        let mut reached = Vec::new();
        let of_image = self.image_starts[image as usize]..self.image_starts[image as usize + 1];
        for word in of_image.map(|at| self.words[at as usize] as usize) {
            let weight = self.weights[word];
            let entries = self.starts[word] as usize..self.starts[word + 1] as usize;
            let (others, signatures) = (&self.images[entries.clone()], &self.signatures[entries]);
            let own = others.binary_search(&image).map(|own| signatures[own]);
            let Ok(own) = own else { continue };
            for (&other, &signature) in others.iter().zip(signatures) {
                let score = weight * self.selectivity[hamming(own, signature)];
                let sum = &mut scores[other as usize];
                if *sum == 0 && score > 0 {
                    reached.push(other);
                }
                *sum += score;
            }
        }
        let scale = self.inverse_norms[image as usize];
        let similar = |&other: &u32| {
            let score = std::mem::take(&mut scores[other as usize]) as f64;
            let similarity = score * scale * self.inverse_norms[other as usize];
            Similar { image: other, similarity: similarity as f32 }
        };
        let mut all: Vec<Similar> = reached.iter().map(similar).collect();
        all.retain(|similar| similar.image != image);
        ranked(all, count)
    }
}
