//! Global descriptors side by side, and the most similar ones among them.

use rayon::prelude::*;

use super::GlobalDescriptor;
use super::similar::Similar;
use super::walks::{BESIDE, EDGES, Graph, Row, spread};
use crate::brute::Isa;
#[cfg(target_arch = "x86_64")]
use crate::brute::Kind;
use crate::pairs::{Pair, normalise};

/// Images that are looked up as one task: the bank travels through the caches once for all of them,
/// and they stay.
const CHUNK: usize = BESIDE;

/// The global descriptors of many images.
#[derive(Clone, Debug, Default)]
pub struct Bank {
    entries: Vec<i8>,
    /// Entries of an image.
    len: usize,
    /// 1 over the length of each; 0 for an image without features.
    inverse_norms: Vec<f32>,
}

impl FromIterator<GlobalDescriptor> for Bank {
    fn from_iter<I: IntoIterator<Item = GlobalDescriptor>>(images: I) -> Self {
        let mut bank = Bank::default();
        images.into_iter().for_each(|image| bank.push(&image));
        bank
    }
}

impl Bank {
    /// Adds an image. All must be described by one vocabulary.
    pub fn push(&mut self, image: &GlobalDescriptor) {
        assert!(
            self.is_empty() || image.entries.len() == self.len,
            "global descriptors of one bank are of one vocabulary"
        );
        self.len = image.entries.len();
        self.inverse_norms.push(inverse_norm(&image.entries));
        self.entries.extend(&image.entries);
    }

    /// How many images there are.
    pub fn len(&self) -> usize {
        self.inverse_norms.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.inverse_norms.is_empty()
    }

    /// The `count` images most similar to another, among those for which `is_candidate` holds; the
    /// most similar first, of equal ones the first. The image need not be in the bank, but of its
    /// vocabulary.
    pub fn most_similar(
        &self,
        image: &GlobalDescriptor,
        count: usize,
        is_candidate: impl Fn(u32) -> bool,
    ) -> Vec<Similar> {
        let scale = inverse_norm(&image.entries);
        let similarities: Vec<f32> = (0..self.len())
            .map(|at| self.similarity(Isa::best(), at, &image.entries, scale))
            .collect();
        best(&similarities, count, is_candidate)
    }

    /// For every image the `count` others that it most likely sees something in common with, among
    /// those for which `is_candidate(image, other)` holds; the likeliest first. First come those
    /// that are alike by way of others that look alike, the candidate or not (neighbours in time,
    /// say); where these are too few, the most similar ones.
    pub fn related(
        &self,
        count: usize,
        is_candidate: impl Fn(u32, u32) -> bool + Sync,
    ) -> Vec<Vec<u32>> {
        let images: Vec<u32> = (0..self.len() as u32).collect();
        let looked_up = |chunk: &[u32]| -> Vec<(Row, Vec<Similar>)> {
            let row = |(&image, mut similarities): (&u32, Vec<f32>)| {
                let edges = best(&similarities, EDGES, |other| other != image);
                let similar = best(&similarities, count, |other| {
                    other != image && is_candidate(image, other)
                });
                similarities.swap_remove(image as usize);
                (Row { edges, spread: spread(&mut similarities) }, similar)
            };
            chunk.iter().zip(self.similarities(chunk)).map(row).collect()
        };
        let (rows, similar): (Vec<Row>, Vec<Vec<Similar>>) = images
            .par_chunks(CHUNK)
            .map(looked_up)
            .collect::<Vec<_>>()
            .into_iter()
            .flatten()
            .unzip();
        let graph = Graph::new(&rows);
        let ranked = |chunk: &[u32]| -> Vec<Vec<u32>> {
            let ends = graph.walk(chunk);
            let one = |(lane, &image): (usize, &u32)| {
                let reached = ends.iter().filter(|(_, shares)| shares[lane] > 0.0);
                let reached =
                    reached.map(|&(image, shares)| Similar { image, similarity: shares[lane] });
                let others = |other| other != image && is_candidate(image, other);
                let first = ranked(reached.filter(|end| others(end.image)).collect(), count);
                let mut related: Vec<u32> = first.iter().map(|end| end.image).collect();
                for other in similar[image as usize].iter().map(|similar| similar.image) {
                    if related.len() < count && !related.contains(&other) {
                        related.push(other);
                    }
                }
                related
            };
            chunk.iter().enumerate().map(one).collect()
        };
        images.par_chunks(CHUNK).map(ranked).collect::<Vec<_>>().concat()
    }

    /// Pairs every image with the `count` that are most [`related`](Self::related) to it, where a
    /// pair is not in `known` (sorted, the lower index first): with the neighbours in time left
    /// out, the candidates for loops.
    pub fn pairs(&self, count: usize, known: &[Pair]) -> Vec<Pair> {
        let is_new = |a: u32, b: u32| known.binary_search(&(a.min(b), a.max(b))).is_err();
        let related = (0..).zip(self.related(count, is_new));
        normalise(related.flat_map(|(a, others)| others.into_iter().map(move |b| (a, b))).collect())
    }

    /// Of some images to all.
    fn similarities(&self, images: &[u32]) -> Vec<Vec<f32>> {
        let isa = Isa::best();
        let mut all = vec![Vec::with_capacity(self.len()); images.len()];
        for at in 0..self.len() {
            for (&image, similarities) in images.iter().zip(&mut all) {
                let image = image as usize;
                similarities.push(self.similarity(
                    isa,
                    at,
                    self.row(image),
                    self.inverse_norms[image],
                ));
            }
        }
        all
    }

    fn row(&self, image: usize) -> &[i8] {
        &self.entries[image * self.len..][..self.len]
    }

    fn similarity(&self, isa: Isa, at: usize, other: &[i8], inverse_norm: f32) -> f32 {
        dot(isa, self.row(at), other) as f32 * (self.inverse_norms[at] * inverse_norm)
    }
}

fn inverse_norm(entries: &[i8]) -> f32 {
    match dot(Isa::best(), entries, entries) {
        0 => 0.0,
        square => 1.0 / (square as f32).sqrt(),
    }
}

fn best(similarities: &[f32], count: usize, is_candidate: impl Fn(u32) -> bool) -> Vec<Similar> {
    let all =
        similarities.iter().zip(0..).map(|(&similarity, image)| Similar { image, similarity });
    ranked(all.filter(|similar| is_candidate(similar.image)).collect(), count)
}

/// The `count` most similar ones, of equal ones the first.
fn ranked(mut candidates: Vec<Similar>, count: usize) -> Vec<Similar> {
    let order = |a: &Similar, b: &Similar| {
        b.similarity.total_cmp(&a.similarity).then(a.image.cmp(&b.image))
    };
    if count < candidates.len() {
        candidates.select_nth_unstable_by(count, order);
        candidates.truncate(count);
    }
    candidates.sort_unstable_by(order);
    candidates
}

/// Scalar product, exact: a million entries of 127 would fit.
pub(super) fn dot(isa: Isa, a: &[i8], b: &[i8]) -> i64 {
    // Short enough for sums of 32 bits.
    const PART: usize = 1 << 16;
    let part = |(a, b)| match isa.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `Isa` is made only where the processor has the features it stands for.
        Kind::Avx512Vnni => unsafe { dot_avx512(a, b) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `Isa` is made only where the processor has the features it stands for.
        Kind::AvxVnni | Kind::Avx2 => unsafe { dot_avx2(a, b) },
        _ => dot_any(a, b),
    };
    a.chunks(PART).zip(b.chunks(PART)).map(|parts| i64::from(part(parts))).sum()
}

/// For the compiler to vectorise, with what the processor has.
#[inline(always)]
fn dot_any(a: &[i8], b: &[i8]) -> i32 {
    a.iter().zip(b).map(|(&x, &y)| i32::from(x) * i32::from(y)).sum()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn dot_avx2(a: &[i8], b: &[i8]) -> i32 {
    dot_any(a, b)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn dot_avx512(a: &[i8], b: &[i8]) -> i32 {
    dot_any(a, b)
}
