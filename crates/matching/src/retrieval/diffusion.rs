//! Diffusion: ranking by random walks on the graph of similar images.
//!
//! Two images of a place from very different viewpoints have no features in common, but images
//! between the viewpoints are similar to both. Images are therefore ranked by random walks from the
//! query image (Zhou et al., "Ranking on data manifolds", NIPS 2003; Donoser and Bischof,
//! "Diffusion processes for retrieval revisited", CVPR 2013). With W the matrix of similarities, D
//! the diagonal matrix of its row sums and P = D^-1/2 W D^-1/2, the scores are the row of Σ αᵏ Pᵏ.
//!
//! The graph must not have edges between unrelated images. Most pairs of images are unrelated, so
//! the median of all similarities is that of unrelated images, and the lower half of the
//! similarities gives their standard deviation. Only similarities far above become edges.
//!
//! Sums are in a fixed order. The results are the same on all CPUs and for any number of threads.

use super::similar::Similar;

/// Maximum number of edges that an image selects. Edges that other images select are added.
pub(super) const MAX_EDGES: usize = 32;
/// Minimum similarity of an edge: the median of unrelated images plus this many standard
/// deviations. Values from 3 to 5 find the same number of rendered loops within 0.5 %.
const EDGE_SIGMAS: f32 = 4.0;
/// The quantile of a normal distribution one standard deviation below the mean.
const LOWER_QUANTILE: f64 = 0.1587;
/// The probability α that a walk continues.
const ALPHA: f32 = 0.8;
/// Maximum length of a walk.
const MAX_STEPS: usize = 30;
/// Initial value of the query image, large enough that the scores of long walks do not underflow.
const INITIAL_SCORE: f32 = 1e18;
/// Number of query images whose walks are computed together, in one SIMD vector.
pub(super) const QUERIES: usize = 16;

/// Edges of an image and statistics of its similarities to all other images.
pub(super) struct ImageSimilarities {
    /// The most similar other images.
    pub(super) edges: Vec<Similar>,
    /// Median and standard deviation of the similarities; `None` if there are no other images.
    pub(super) median_and_sigma: Option<[f32; 2]>,
}

/// Median and standard deviation of values. The standard deviation is estimated from the lower
/// half.
pub(super) fn median_and_sigma(values: &mut [f32]) -> Option<[f32; 2]> {
    let index = |quantile: f64| (quantile * values.len() as f64) as usize;
    let (middle, low) = (index(0.5), index(LOWER_QUANTILE));
    if values.is_empty() {
        return None;
    }
    let (below, &mut median, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    let low = match below.len() {
        0 => median,
        _ => *below.select_nth_unstable_by(low, f32::total_cmp).1,
    };
    Some([median, median - low])
}

/// The symmetric graph of similar images, in compressed sparse rows.
pub(super) struct Graph {
    /// Index of the first edge of every image, and the number of edges.
    starts: Vec<u32>,
    /// The other image and the entry of P.
    edges: Vec<(u32, f32)>,
}

impl Graph {
    /// The graph of the edges above the minimum similarity. Entry `i` of `images` is image `i`.
    pub(super) fn new(images: &[ImageSimilarities]) -> Self {
        let median_of = |which: usize| {
            let mut all: Vec<f32> = images
                .iter()
                .filter_map(|image| image.median_and_sigma)
                .map(|s| s[which])
                .collect();
            median_and_sigma(&mut all).map_or(0.0, |[median, _]| median)
        };
        let min_similarity = median_of(0) + EDGE_SIGMAS * median_of(1);
        let mut edges = Vec::new();
        for (a, image) in (0..).zip(images) {
            for edge in image.edges.iter().filter(|edge| edge.similarity > min_similarity) {
                let weight = edge.similarity - min_similarity;
                edges.extend([(a, edge.image, weight), (edge.image, a, weight)]);
            }
        }
        edges.sort_unstable_by_key(|&(a, b, _)| (a, b));
        edges.dedup_by_key(|&mut (a, b, _)| (a, b));
        let mut starts = vec![0; images.len() + 1];
        let mut inverse_sqrt_sums = vec![0f32; images.len()];
        for &(a, _, weight) in &edges {
            starts[a as usize + 1] += 1;
            inverse_sqrt_sums[a as usize] += weight;
        }
        for i in 0..images.len() {
            starts[i + 1] += starts[i];
            inverse_sqrt_sums[i] = 1.0 / inverse_sqrt_sums[i].sqrt();
        }
        let edge = |(a, b, weight): (u32, u32, f32)| {
            (b, weight * (inverse_sqrt_sums[a as usize] * inverse_sqrt_sums[b as usize]))
        };
        Graph { starts, edges: edges.into_iter().map(edge).collect() }
    }

    /// The edges of an image.
    fn edges_of(&self, image: u32) -> &[(u32, f32)] {
        let image = image as usize;
        &self.edges[self.starts[image] as usize..self.starts[image + 1] as usize]
    }

    /// The diffusion scores of all reachable images for at most [`QUERIES`] query images. Returns
    /// the reachable images in ascending order, with one score per query.
    pub(super) fn diffuse(&self, queries: &[u32]) -> Vec<(u32, [f32; QUERIES])> {
        let images = self.reachable(queries);
        let mut positions = vec![u32::MAX; self.starts.len() - 1];
        (0..).zip(&images).for_each(|(position, &image)| positions[image as usize] = position);
        let mut initial = vec![[0.0; QUERIES]; images.len()];
        for (lane, &image) in queries.iter().enumerate() {
            initial[positions[image as usize] as usize][lane] = INITIAL_SCORE;
        }
        // The subgraph of the reachable images.
        let mut ends = Vec::with_capacity(images.len());
        let mut edges = Vec::new();
        for &image in &images {
            let subgraph_edges = self
                .edges_of(image)
                .iter()
                .map(|&(other, p)| (positions[other as usize], ALPHA * p));
            edges.extend(subgraph_edges.filter(|&(position, _)| position != u32::MAX));
            ends.push(edges.len());
        }
        let mut scores = initial.clone();
        let mut next_scores = initial.clone();
        for _ in 0..MAX_STEPS {
            let mut first = 0;
            for ((next, initial), &end) in next_scores.iter_mut().zip(&initial).zip(&ends) {
                *next = *initial;
                for &(other, p) in &edges[first..end] {
                    for (sum, x) in next.iter_mut().zip(scores[other as usize]) {
                        *sum += p * x;
                    }
                }
                first = end;
            }
            std::mem::swap(&mut scores, &mut next_scores);
        }
        images.into_iter().zip(scores).collect()
    }

    /// The images within [`MAX_STEPS`] steps of the query images, in ascending order.
    fn reachable(&self, queries: &[u32]) -> Vec<u32> {
        let mut is_reached = vec![false; self.starts.len() - 1];
        let mut reached: Vec<u32> = Vec::new();
        let mut frontier = queries.to_vec();
        frontier.iter().for_each(|&image| is_reached[image as usize] = true);
        for _ in 0..=MAX_STEPS {
            let mut next = Vec::new();
            for &image in &frontier {
                for &(other, _) in self.edges_of(image) {
                    if !std::mem::replace(&mut is_reached[other as usize], true) {
                        next.push(other);
                    }
                }
            }
            reached.append(&mut frontier);
            frontier = next;
        }
        reached.sort_unstable();
        reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    /// Similarities of a sequence of images. Images at most three positions apart are similar; all
    /// others are unrelated.
    fn rows(images: u32) -> Vec<ImageSimilarities> {
        let mut random = stream(1, 2);
        let mut unrelated = || 0.1 + 0.01 * random.below(3) as f32;
        let mut similarities = vec![vec![0f32; images as usize]; images as usize];
        for (a, b) in (0..images as usize).flat_map(|a| (0..a).map(move |b| (a, b))) {
            let similarity = if a - b <= 3 { 0.8 - 0.15 * (a - b) as f32 } else { unrelated() };
            similarities[a][b] = similarity;
            similarities[b][a] = similarity;
        }
        let row = |(a, similarities): (usize, Vec<f32>)| {
            let others = (0..).zip(&similarities).filter(|&(b, _)| b as usize != a);
            let mut edges: Vec<Similar> =
                others.map(|(image, &similarity)| Similar { image, similarity }).collect();
            edges.sort_by(|a, b| b.similarity.total_cmp(&a.similarity));
            let mut values: Vec<f32> = edges.iter().map(|edge| edge.similarity).collect();
            edges.truncate(8);
            ImageSimilarities { edges, median_and_sigma: median_and_sigma(&mut values) }
        };
        similarities.into_iter().enumerate().map(row).collect()
    }

    #[test]
    fn unrelated_images_have_no_edge() {
        let graph = Graph::new(&rows(50));
        for a in 0..50u32 {
            let others: Vec<u32> = graph.edges_of(a).iter().map(|&(b, _)| b).collect();
            let expected: Vec<u32> =
                (a.saturating_sub(3)..=(a + 3).min(49)).filter(|&b| b != a).collect();
            assert_eq!(others, expected);
        }
    }

    /// The reference implementation: powers of the whole matrix, in double precision.
    #[test]
    fn scores_match_powers_of_the_matrix() {
        // Rounding error of thirty successive sums in single precision.
        const TOLERANCE: f64 = 1e-5;
        const IMAGES: usize = 150;
        let graph = Graph::new(&rows(IMAGES as u32));
        let from = [0, 1, 2, 75, 149];
        let ends = graph.diffuse(&from);
        // Thirty steps of up to three positions: the five query images reach all images, the last
        // one alone does not.
        assert!(ends.len() == IMAGES && ends.windows(2).all(|two| two[0].0 < two[1].0));
        let few = graph.diffuse(&[149]);
        assert_eq!(few.len(), 3 * MAX_STEPS + 1);
        for (lane, &image) in from.iter().enumerate() {
            let mut x = vec![0f64; IMAGES];
            for _ in 0..=MAX_STEPS {
                let mut next = vec![0f64; IMAGES];
                next[image as usize] = f64::from(INITIAL_SCORE);
                for (a, next) in next.iter_mut().enumerate() {
                    let p = graph.edges_of(a as u32).iter();
                    *next += p
                        .map(|&(b, p)| f64::from(ALPHA) * f64::from(p) * x[b as usize])
                        .sum::<f64>();
                }
                x = next;
            }
            for &(a, ref scores) in &ends {
                let expected = x[a as usize];
                assert!(
                    (f64::from(scores[lane]) - expected).abs() <= TOLERANCE * expected,
                    "{a}: {scores:?} {expected}"
                );
            }
        }
        assert_eq!(
            few.iter().map(|end| end.1[0]).collect::<Vec<_>>(),
            ends[IMAGES - few.len()..].iter().map(|end| end.1[4]).collect::<Vec<_>>()
        );
    }

    #[test]
    fn median_and_sigma_of_few_values() {
        assert_eq!(median_and_sigma(&mut []), None);
        assert_eq!(median_and_sigma(&mut [3.0]), Some([3.0, 0.0]));
        assert_eq!(median_and_sigma(&mut [5.0, 3.0]), Some([5.0, 2.0]));
        let mut many: Vec<f32> = (0..1000).rev().map(|x| x as f32).collect();
        assert_eq!(median_and_sigma(&mut many), Some([500.0, 500.0 - 158.0]));
    }
}
