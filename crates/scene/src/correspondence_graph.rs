//! Graph of keypoint correspondences over all verified pairs.

use std::collections::BTreeMap;

use crate::{ImageId, ImagePair, Observation, TwoView};

/// Verified pairs and, for each keypoint of each image, the matching keypoints in other images.
#[derive(Clone, Debug, Default)]
pub struct CorrespondenceGraph {
    pairs: BTreeMap<ImagePair, TwoView>,
    images: Vec<Correspondences>,
    neighbours: Vec<Vec<ImageId>>,
}

/// Correspondences of one image in compressed rows: those of keypoint k are
/// `targets[offsets[k]..offsets[k + 1]]`.
#[derive(Clone, Debug, Default)]
struct Correspondences {
    offsets: Vec<u32>,
    targets: Vec<Observation>,
}

impl CorrespondenceGraph {
    /// Builds the graph from the number of keypoints of each image (indexed by id) and the pairs.
    /// Pairs that are not verified, and matches of keypoints that do not exist, are left out.
    pub fn new(
        keypoint_counts: &[usize],
        two_views: impl IntoIterator<Item = (ImagePair, TwoView)>,
    ) -> Self {
        let mut pairs = BTreeMap::new();
        for (pair, mut two_view) in two_views {
            if !two_view.is_verified() || pair.b.index() >= keypoint_counts.len() {
                continue;
            }
            let (count_a, count_b) =
                (keypoint_counts[pair.a.index()], keypoint_counts[pair.b.index()]);
            two_view.matches.retain(|m| (m.a as usize) < count_a && (m.b as usize) < count_b);
            pairs.insert(pair, two_view);
        }
        let mut images: Vec<Correspondences> = keypoint_counts
            .iter()
            .map(|&count| Correspondences { offsets: vec![0; count + 1], targets: Vec::new() })
            .collect();
        // Counts, prefix sums, then entries. Pairs come in order, so every row is sorted by image.
        for (pair, two_view) in &pairs {
            for m in &two_view.matches {
                images[pair.a.index()].offsets[m.a as usize + 1] += 1;
                images[pair.b.index()].offsets[m.b as usize + 1] += 1;
            }
        }
        let mut cursors = Vec::with_capacity(images.len());
        for image in &mut images {
            for k in 1..image.offsets.len() {
                image.offsets[k] += image.offsets[k - 1];
            }
            let total = image.offsets.last().copied().unwrap_or(0) as usize;
            image.targets = vec![Observation { image: ImageId(0), keypoint: 0 }; total];
            cursors.push(image.offsets.clone());
        }
        let mut put = |from: Observation, to: Observation| {
            let cursor = &mut cursors[from.image.index()][from.keypoint as usize];
            images[from.image.index()].targets[*cursor as usize] = to;
            *cursor += 1;
        };
        for (pair, two_view) in &pairs {
            for m in &two_view.matches {
                let (a, b) = (
                    Observation { image: pair.a, keypoint: m.a },
                    Observation { image: pair.b, keypoint: m.b },
                );
                put(a, b);
                put(b, a);
            }
        }
        let mut neighbours = vec![Vec::new(); keypoint_counts.len()];
        for pair in pairs.keys() {
            neighbours[pair.a.index()].push(pair.b);
            neighbours[pair.b.index()].push(pair.a);
        }
        Self { pairs, images, neighbours }
    }

    /// Returns the graph with additional verified pairs. They replace pairs of the same images.
    pub fn extended(&self, two_views: impl IntoIterator<Item = (ImagePair, TwoView)>) -> Self {
        Self::new(&self.keypoint_counts(), self.pairs.clone().into_iter().chain(two_views))
    }

    /// Returns the graph of those verified pairs that `is_kept` keeps.
    pub fn filtered(&self, is_kept: impl Fn(&ImagePair) -> bool) -> Self {
        let pairs = self.pairs.iter().filter(|(pair, _)| is_kept(pair));
        let pairs = pairs.map(|(pair, two_view)| (*pair, two_view.clone()));
        Self::new(&self.keypoint_counts(), pairs)
    }

    fn keypoint_counts(&self) -> Vec<usize> {
        self.images.iter().map(|image| image.offsets.len() - 1).collect()
    }

    /// Number of images of the graph.
    pub fn num_images(&self) -> usize {
        self.images.len()
    }

    /// The verified pairs, sorted.
    pub fn pairs(&self) -> &BTreeMap<ImagePair, TwoView> {
        &self.pairs
    }

    /// The images with a verified pair to an image, sorted.
    pub fn neighbours(&self, of: ImageId) -> &[ImageId] {
        &self.neighbours[of.index()]
    }

    /// The keypoints that match a keypoint, sorted by image.
    pub fn correspondences(&self, of: Observation) -> &[Observation] {
        let image = &self.images[of.image.index()];
        let k = of.keypoint as usize;
        &image.targets[image.offsets[k] as usize..image.offsets[k + 1] as usize]
    }

    /// Whether any keypoint matches this one.
    pub fn has_correspondences(&self, of: Observation) -> bool {
        !self.correspondences(of).is_empty()
    }

    /// Whether a keypoint and its only match have no other matches. No third image can then
    /// contradict a point triangulated from them.
    pub fn is_two_view(&self, of: Observation) -> bool {
        match self.correspondences(of) {
            [only] => self.correspondences(*only).len() == 1,
            _ => false,
        }
    }

    /// Number of keypoints of an image with a match.
    pub fn num_matched_keypoints(&self, image: ImageId) -> usize {
        self.images[image.index()].offsets.windows(2).filter(|w| w[0] < w[1]).count()
    }

    /// Number of correspondences of an image over all its pairs.
    pub fn num_correspondences(&self, image: ImageId) -> usize {
        self.images[image.index()].targets.len()
    }
}
