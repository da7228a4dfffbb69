//! The retrieval index: global descriptors of all images, and queries for similar images.

use rayon::prelude::*;

use super::GlobalDescriptor;
use super::diffusion::{Graph, ImageSimilarities, MAX_EDGES, QUERIES, median_and_sigma};
use super::similar::Similar;
use crate::brute::Isa;
#[cfg(target_arch = "x86_64")]
use crate::brute::Kind;
use crate::pairs::{Pair, normalise};

/// Number of query images per parallel task. The index is read from memory once per task.
const TASK_SIZE: usize = QUERIES;

/// The retrieval index: the global descriptors of a set of images.
#[derive(Clone, Debug, Default)]
pub struct RetrievalIndex {
    entries: Vec<i8>,
    /// Number of entries of a global descriptor.
    len: usize,
    /// Reciprocal norms of the global descriptors; 0 for an image without features.
    inverse_norms: Vec<f32>,
}

impl FromIterator<GlobalDescriptor> for RetrievalIndex {
    fn from_iter<I: IntoIterator<Item = GlobalDescriptor>>(images: I) -> Self {
        let mut index = RetrievalIndex::default();
        images.into_iter().for_each(|image| index.push(&image));
        index
    }
}

impl RetrievalIndex {
    /// Adds an image.
    ///
    /// # Panics
    /// If the global descriptor is of another vocabulary size than those in the retrieval index.
    pub fn push(&mut self, image: &GlobalDescriptor) {
        assert!(
            self.is_empty() || image.entries.len() == self.len,
            "the global descriptors of an index must have the same vocabulary"
        );
        self.len = image.entries.len();
        self.inverse_norms.push(inverse_norm(&image.entries));
        self.entries.extend(&image.entries);
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.inverse_norms.len()
    }

    /// Whether there are no images.
    pub fn is_empty(&self) -> bool {
        self.inverse_norms.is_empty()
    }

    /// The `count` most similar images to a query among those with `is_candidate`, in descending
    /// order of similarity, then in ascending order of image number. The query must have the
    /// vocabulary of the retrieval index; it need not be one of its images.
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

    /// For every image, the `count` other images with `is_candidate(image, other)` that most
    /// probably overlap with it, the most probable first.
    ///
    /// Images are ranked by diffusion on the graph of all similar images, which includes images
    /// that are not candidates, for example neighbours in time. If diffusion reaches fewer than
    /// `count` candidates, the most similar other candidates follow.
    pub fn related(
        &self,
        count: usize,
        is_candidate: impl Fn(u32, u32) -> bool + Sync,
    ) -> Vec<Vec<u32>> {
        let images: Vec<u32> = (0..self.len() as u32).collect();
        let search = |chunk: &[u32]| -> Vec<(ImageSimilarities, Vec<Similar>)> {
            let row = |(&image, mut similarities): (&u32, Vec<f32>)| {
                let edges = best(&similarities, MAX_EDGES, |other| other != image);
                let similar = best(&similarities, count, |other| {
                    other != image && is_candidate(image, other)
                });
                similarities.swap_remove(image as usize);
                (
                    ImageSimilarities {
                        edges,
                        median_and_sigma: median_and_sigma(&mut similarities),
                    },
                    similar,
                )
            };
            chunk.iter().zip(self.similarities(chunk)).map(row).collect()
        };
        let (rows, similar): (Vec<ImageSimilarities>, Vec<Vec<Similar>>) = images
            .par_chunks(TASK_SIZE)
            .map(search)
            .collect::<Vec<_>>()
            .into_iter()
            .flatten()
            .unzip();
        let graph = Graph::new(&rows);
        let ranked = |chunk: &[u32]| -> Vec<Vec<u32>> {
            let scored = graph.diffuse(chunk);
            let related_to = |(lane, &image): (usize, &u32)| {
                let reached = scored.iter().filter(|(_, scores)| scores[lane] > 0.0);
                let reached =
                    reached.map(|&(image, scores)| Similar { image, similarity: scores[lane] });
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
            chunk.iter().enumerate().map(related_to).collect()
        };
        images.par_chunks(TASK_SIZE).map(ranked).collect::<Vec<_>>().concat()
    }

    /// Pairs every image with its `count` most [`related`](Self::related) images, except for pairs
    /// in `known` (sorted, the lower index first). If `known` has the neighbours in time, the
    /// result is the candidates of loop closures.
    pub fn pairs(&self, count: usize, known: &[Pair]) -> Vec<Pair> {
        let is_new = |a: u32, b: u32| known.binary_search(&(a.min(b), a.max(b))).is_err();
        let related = (0..).zip(self.related(count, is_new));
        normalise(related.flat_map(|(a, others)| others.into_iter().map(move |b| (a, b))).collect())
    }

    /// The similarities of some images to all images.
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

    /// The entries of an image.
    fn row(&self, image: usize) -> &[i8] {
        &self.entries[image * self.len..][..self.len]
    }

    /// The cosine similarity of an image of the retrieval index to a global descriptor.
    fn similarity(&self, isa: Isa, at: usize, other: &[i8], inverse_norm: f32) -> f32 {
        dot(isa, self.row(at), other) as f32 * (self.inverse_norms[at] * inverse_norm)
    }
}

/// The reciprocal norm; 0 for a zero vector.
fn inverse_norm(entries: &[i8]) -> f32 {
    match dot(Isa::best(), entries, entries) {
        0 => 0.0,
        square => 1.0 / (square as f32).sqrt(),
    }
}

/// The `count` most similar candidates, as in [`ranked`].
fn best(similarities: &[f32], count: usize, is_candidate: impl Fn(u32) -> bool) -> Vec<Similar> {
    let all =
        similarities.iter().zip(0..).map(|(&similarity, image)| Similar { image, similarity });
    ranked(all.filter(|similar| is_candidate(similar.image)).collect(), count)
}

/// The first `count` images in descending order of similarity, then in ascending order of image
/// number.
pub(super) fn ranked(mut candidates: Vec<Similar>, count: usize) -> Vec<Similar> {
    let order = |a: &Similar, b: &Similar| {
        b.similarity.total_cmp(&a.similarity).then(a.image.cmp(&b.image))
    };
    if count < candidates.len() {
        candidates.select_nth_unstable_by(count, order);
        candidates.truncate(count);
        // The lists of all images are kept: at their capacity they would be all images by all.
        candidates.shrink_to_fit();
    }
    candidates.sort_unstable_by(order);
    candidates
}

/// Exact dot product. It does not overflow for up to a million entries of 127.
pub(super) fn dot(isa: Isa, a: &[i8], b: &[i8]) -> i64 {
    // 32-bit sums do not overflow for this length.
    const PART_LEN: usize = 1 << 16;
    let part = |(a, b)| match isa.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `Isa` is only constructed if the CPU supports it.
        Kind::Avx512Vnni => unsafe { dot_avx512(a, b) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `Isa` is only constructed if the CPU supports it.
        Kind::AvxVnni | Kind::Avx2 => unsafe { dot_avx2(a, b) },
        _ => dot_any(a, b),
    };
    a.chunks(PART_LEN).zip(b.chunks(PART_LEN)).map(|parts| i64::from(part(parts))).sum()
}

/// The dot product as a loop that the compiler vectorises for the enabled target features.
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
