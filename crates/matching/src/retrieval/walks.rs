//! Which images are alike by way of others: random walks on the graph of images that look alike.
//!
//! Seen from another street, a facade has no feature in common with how it looked from this one;
//! but in between, where the drive turned the corner, there are images that look like both. So
//! images are ranked by where a walk from one of them ends (Zhou et al., "Ranking on data
//! manifolds", NIPS 2003; Donoser and Bischof, "Diffusion processes for retrieval revisited", CVPR
//! 2013): with W the similarities, D their sums by image and P = D^-1/2 W D^-1/2, by the walks of
//! every length, Σ αᵏ Pᵏ. What makes it work is to leave out edges between unrelated images. There
//! are many more of these than others, so that their similarities show in the middle of all, and
//! how they spread in the lower half.
//!
//! Sums of floats are taken in a fixed order, image by image: the same on every machine, for any
//! number of threads.

use super::similar::Similar;

/// Edges of an image, at most; it may have more to those whose edge it is.
pub(super) const EDGES: usize = 32;
/// An edge is more similar than unrelated images by this many of their standard deviations. Of
/// rendered loops as many are found within 0.5 %, if it is 3 to 5.
const ABOVE: f32 = 4.0;
/// Where the lower half of a normal distribution has spread by one standard deviation.
const LOWER: f64 = 0.1587;
/// Chance that a walk goes on.
const ON: f32 = 0.8;
/// The longest walk.
const STEPS: usize = 30;
/// Where walks start. Large, since a long walk with few chances shall still be a number.
const START: f32 = 1e18;
/// Walks from this many images are computed together: those of one vector.
pub(super) const BESIDE: usize = 16;

/// What the similarities of one image to the others say.
pub(super) struct Row {
    /// The most similar others.
    pub(super) edges: Vec<Similar>,
    /// Median, and how far below it one standard deviation is; nothing if there are no others.
    pub(super) spread: Option<[f32; 2]>,
}

/// Median and standard deviation of values, the latter from the lower half.
pub(super) fn spread(values: &mut [f32]) -> Option<[f32; 2]> {
    let at = |share: f64| (share * values.len() as f64) as usize;
    let (middle, low) = (at(0.5), at(LOWER));
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

/// A graph in rows, both directions of every edge in it.
pub(super) struct Graph {
    starts: Vec<u32>,
    /// Image and entry of P.
    edges: Vec<(u32, f32)>,
}

impl Graph {
    pub(super) fn new(rows: &[Row]) -> Self {
        let median = |which: usize| {
            let mut all: Vec<f32> =
                rows.iter().filter_map(|row| row.spread).map(|s| s[which]).collect();
            spread(&mut all).map_or(0.0, |[median, _]| median)
        };
        let level = median(0) + ABOVE * median(1);
        let mut edges = Vec::new();
        for (a, row) in (0..).zip(rows) {
            for edge in row.edges.iter().filter(|edge| edge.similarity > level) {
                let weight = edge.similarity - level;
                edges.extend([(a, edge.image, weight), (edge.image, a, weight)]);
            }
        }
        edges.sort_unstable_by_key(|&(a, b, _)| (a, b));
        edges.dedup_by_key(|&mut (a, b, _)| (a, b));
        let mut starts = vec![0; rows.len() + 1];
        let mut roots = vec![0f32; rows.len()];
        for &(a, _, weight) in &edges {
            starts[a as usize + 1] += 1;
            roots[a as usize] += weight;
        }
        for i in 0..rows.len() {
            starts[i + 1] += starts[i];
            roots[i] = 1.0 / roots[i].sqrt();
        }
        let edge =
            |(a, b, weight): (u32, u32, f32)| (b, weight * (roots[a as usize] * roots[b as usize]));
        Graph { starts, edges: edges.into_iter().map(edge).collect() }
    }

    fn of(&self, image: u32) -> &[(u32, f32)] {
        let image = image as usize;
        &self.edges[self.starts[image] as usize..self.starts[image + 1] as usize]
    }

    /// Where walks from some images end, at most [`BESIDE`]: images in order, with a number for
    /// each of them.
    pub(super) fn walk(&self, from: &[u32]) -> Vec<(u32, [f32; BESIDE])> {
        let images = self.reached(from);
        let mut at = vec![u32::MAX; self.starts.len() - 1];
        (0..).zip(&images).for_each(|(place, &image)| at[image as usize] = place);
        let mut start = vec![[0.0; BESIDE]; images.len()];
        for (lane, &image) in from.iter().enumerate() {
            start[at[image as usize] as usize][lane] = START;
        }
        // The graph of these alone; what lies beyond is reached by no walk.
        let mut ends = Vec::with_capacity(images.len());
        let mut edges = Vec::new();
        for &image in &images {
            let placed = self.of(image).iter().map(|&(other, p)| (at[other as usize], ON * p));
            edges.extend(placed.filter(|&(place, _)| place != u32::MAX));
            ends.push(edges.len());
        }
        let mut here = start.clone();
        let mut next = start.clone();
        for _ in 0..STEPS {
            let mut first = 0;
            for ((next, start), &end) in next.iter_mut().zip(&start).zip(&ends) {
                *next = *start;
                for &(other, p) in &edges[first..end] {
                    for (sum, x) in next.iter_mut().zip(here[other as usize]) {
                        *sum += p * x;
                    }
                }
                first = end;
            }
            std::mem::swap(&mut here, &mut next);
        }
        images.into_iter().zip(here).collect()
    }

    /// The images that walks can reach, in order.
    fn reached(&self, from: &[u32]) -> Vec<u32> {
        let mut is_reached = vec![false; self.starts.len() - 1];
        let mut reached: Vec<u32> = Vec::new();
        let mut front = from.to_vec();
        front.iter().for_each(|&image| is_reached[image as usize] = true);
        for _ in 0..=STEPS {
            let mut next = Vec::new();
            for &image in &front {
                for &(other, _) in self.of(image) {
                    if !std::mem::replace(&mut is_reached[other as usize], true) {
                        next.push(other);
                    }
                }
            }
            reached.append(&mut front);
            front = next;
        }
        reached.sort_unstable();
        reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    /// Images in a row of which each looks like those at most three places away, above a similarity
    /// that all have.
    fn rows(images: u32) -> Vec<Row> {
        let mut random = SplitMix64::new(1, 2);
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
            Row { edges, spread: spread(&mut values) }
        };
        similarities.into_iter().enumerate().map(row).collect()
    }

    #[test]
    fn unrelated_images_share_no_edge() {
        let graph = Graph::new(&rows(50));
        for a in 0..50u32 {
            let others: Vec<u32> = graph.of(a).iter().map(|&(b, _)| b).collect();
            let expected: Vec<u32> =
                (a.saturating_sub(3)..=(a + 3).min(49)).filter(|&b| b != a).collect();
            assert_eq!(others, expected);
        }
    }

    /// The slow twin: powers of the whole matrix, in double precision.
    #[test]
    fn walks_end_where_the_powers_of_the_matrix_say() {
        // Some thirty sums of single precision in a row.
        const TOLERANCE: f64 = 1e-5;
        const IMAGES: usize = 150;
        let graph = Graph::new(&rows(IMAGES as u32));
        let from = [0, 1, 2, 75, 149];
        let ends = graph.walk(&from);
        // Thirty steps of three places: from these images walks reach all, from the last one alone
        // they do not.
        assert!(ends.len() == IMAGES && ends.windows(2).all(|two| two[0].0 < two[1].0));
        let few = graph.walk(&[149]);
        assert_eq!(few.len(), 3 * STEPS + 1);
        for (lane, &image) in from.iter().enumerate() {
            let mut x = vec![0f64; IMAGES];
            for _ in 0..=STEPS {
                let mut next = vec![0f64; IMAGES];
                next[image as usize] = f64::from(START);
                for (a, next) in next.iter_mut().enumerate() {
                    let p = graph.of(a as u32).iter();
                    *next +=
                        p.map(|&(b, p)| f64::from(ON) * f64::from(p) * x[b as usize]).sum::<f64>();
                }
                x = next;
            }
            for &(a, ref shares) in &ends {
                let expected = x[a as usize];
                assert!(
                    (f64::from(shares[lane]) - expected).abs() <= TOLERANCE * expected,
                    "{a}: {shares:?} {expected}"
                );
            }
        }
        assert_eq!(
            few.iter().map(|end| end.1[0]).collect::<Vec<_>>(),
            ends[IMAGES - few.len()..].iter().map(|end| end.1[4]).collect::<Vec<_>>()
        );
    }

    #[test]
    fn spread_of_few_values() {
        assert_eq!(spread(&mut []), None);
        assert_eq!(spread(&mut [3.0]), Some([3.0, 0.0]));
        assert_eq!(spread(&mut [5.0, 3.0]), Some([5.0, 2.0]));
        let mut many: Vec<f32> = (0..1000).rev().map(|x| x as f32).collect();
        assert_eq!(spread(&mut many), Some([500.0, 500.0 - 158.0]));
    }
}
