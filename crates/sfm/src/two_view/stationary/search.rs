//! Spots that stand still, from the matches of all pairs.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{ImagePair, Keypoint, Match};

use super::candidates::Candidates;
use super::displacement::{MOVING_PX, STILL_PX, displacement_px};
use super::spot::Spot;

/// Largest RMS distance of the keypoints of a spot from their mean, in pixels: twice the noise of
/// SIFT at its finest scales. On the sets of `bench/overlays.py`, half finds one time stamp more
/// and less dirt; with double, a slow drive and two stops lose a fifth of their matches.
const MAX_SPREAD_PX: f64 = 0.5;
/// Fewest images of a spot: six pairs, of which half must agree. On the sets of
/// `bench/overlays.py`, of 12 to 24 images, half and double change nothing.
const MIN_IMAGES: usize = 4;
/// Smallest share of the pairs of a spot's images in which it matches itself. Distant points do so
/// in adjacent images alone. On the sets of `bench/overlays.py`, half changes nothing; double asks
/// for all pairs, and a fifth of a time stamp stays.
const MIN_SHARE_OF_PAIRS: f64 = 0.5;
/// Smallest share of all pairs of a spot's images, with images of the same camera, in which it
/// matches itself. On the sets of `bench/overlays.py`, a slow drive loses a fifth of its matches
/// with half; with double, an overlay on half of the photos stays.
const MIN_SHARE_OF_ALL_PAIRS: f64 = 0.3;
/// Largest number of moving inlier matches of a spot relative to those that stand still: wrong
/// matches of repeated letters. Half and double change nothing on the sets of `bench/overlays.py`.
const MAX_MOVING: f64 = 0.1;

/// Collects the matches of all pairs, as evidence for [`Candidates`].
#[derive(Debug)]
pub struct StationarySearch<'a> {
    keypoints: &'a [&'a [Keypoint]],
    groups: &'a [usize],
    /// The number of the first keypoint of each image.
    offsets: Vec<u32>,
    /// Matches that stand still, by the numbers of their keypoints.
    still: Vec<[u32; 2]>,
    /// Number of moving inlier matches of each keypoint.
    moving: Vec<u16>,
    /// Later images of the same camera with matches, of each image.
    later: Vec<Vec<u32>>,
    /// Number of images of the same camera with matches, of each image.
    degrees: Vec<usize>,
}

impl<'a> StationarySearch<'a> {
    /// `keypoints`: those of each image. `groups`: the camera of each image; images of different
    /// cameras are not compared.
    pub fn new(keypoints: &'a [&'a [Keypoint]], groups: &'a [usize]) -> Self {
        let mut offsets = vec![0];
        for image in keypoints {
            offsets.push(offsets[offsets.len() - 1] + image.len() as u32);
        }
        let moving = vec![0; offsets[offsets.len() - 1] as usize];
        let later = vec![Vec::new(); keypoints.len()];
        let degrees = vec![0; keypoints.len()];
        Self { keypoints, groups, offsets, still: Vec::new(), moving, later, degrees }
    }

    /// Whether the images of a pair are compared.
    pub fn takes(&self, pair: ImagePair) -> bool {
        self.groups[pair.a.index()] == self.groups[pair.b.index()]
    }

    /// Adds a pair with its descriptor matches, and those of them that are inliers of its two-view
    /// geometry. Matches of keypoints that do not exist are left out.
    pub fn add(&mut self, pair: ImagePair, matches: &[Match], inliers: &[Match]) {
        if !self.takes(pair) || matches.is_empty() {
            return;
        }
        self.later[pair.a.index()].push(pair.b.0);
        [pair.a, pair.b].iter().for_each(|image| self.degrees[image.index()] += 1);
        for m in matches {
            if displacement_px(self.keypoints, pair, m).is_some_and(|px| px < STILL_PX) {
                self.still.push(self.numbers(pair, m));
            }
        }
        for m in inliers {
            if displacement_px(self.keypoints, pair, m).is_some_and(|px| px >= MOVING_PX) {
                for number in self.numbers(pair, m) {
                    let count = &mut self.moving[number as usize];
                    *count = count.saturating_add(1);
                }
            }
        }
    }

    fn numbers(&self, pair: ImagePair, m: &Match) -> [u32; 2] {
        [self.offsets[pair.a.index()] + m.a, self.offsets[pair.b.index()] + m.b]
    }

    /// The spots that stand exactly still.
    pub fn candidates(mut self) -> Candidates<'a> {
        self.later.iter_mut().for_each(|images| images.sort_unstable());
        let mut sets = DisjointSets { parents: (0..self.moving.len() as u32).collect() };
        self.still.iter().for_each(|[one, other]| sets.join(*one, *other));
        let mut num_still: BTreeMap<u32, usize> = BTreeMap::new();
        for [one, _] in &self.still {
            *num_still.entry(sets.root(*one)).or_default() += 1;
        }
        let mut numbers: Vec<u32> = self.still.iter().flatten().copied().collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut members: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
        for number in numbers {
            let image = self.offsets.partition_point(|first| *first <= number) - 1;
            let keypoint = (image as u32, number - self.offsets[image]);
            members.entry(sets.root(number)).or_default().push(keypoint);
        }
        let spots: Vec<Spot> = members
            .into_iter()
            .filter_map(|(root, keypoints)| self.spot(keypoints, num_still[&root]))
            .collect();
        let mut unmoved = vec![BTreeSet::new(); self.keypoints.len()];
        for (image, keypoint) in
            spots.iter().filter(|spot| !spot.moves).flat_map(|spot| &spot.keypoints)
        {
            unmoved[*image as usize].insert(*keypoint);
        }
        let Self { keypoints, groups, later, .. } = self;
        Candidates { keypoints, groups, later, spots, unmoved }
    }

    /// The component of these keypoints if it stands exactly still.
    fn spot(&self, keypoints: Vec<(u32, u32)>, num_still: usize) -> Option<Spot> {
        let mut images: Vec<u32> = keypoints.iter().map(|(image, _)| *image).collect();
        images.dedup();
        if images.len() < MIN_IMAGES {
            return None;
        }
        let count = keypoints.len() as f64;
        let of =
            |&(image, keypoint): &(u32, u32)| &self.keypoints[image as usize][keypoint as usize];
        let pixel = keypoints.iter().map(|k| of(k).pixel).sum::<Vector2<f64>>() / count;
        let square: f64 = keypoints.iter().map(|k| (of(k).pixel - pixel).norm_squared()).sum();
        if square > MAX_SPREAD_PX * MAX_SPREAD_PX * count {
            return None;
        }
        let is_one = |image: &&u32| images.binary_search(image).is_ok();
        let pairs = |image: &u32| self.later[*image as usize].iter().filter(is_one).count();
        let num_pairs: usize = images.iter().map(pairs).sum();
        let num_all: usize = images.iter().map(|image| self.degrees[*image as usize]).sum();
        if (num_still as f64) < MIN_SHARE_OF_PAIRS * num_pairs as f64
            || ((2 * num_still) as f64) < MIN_SHARE_OF_ALL_PAIRS * num_all as f64
        {
            return None;
        }
        let moving = |&(image, keypoint): &(u32, u32)| {
            usize::from(self.moving[(self.offsets[image as usize] + keypoint) as usize])
        };
        let num_moving: usize = keypoints.iter().map(moving).sum();
        let scale_px = keypoints.iter().map(|k| f64::from(of(k).scale_px)).sum::<f64>() / count;
        let (is_moved, moves) = (num_moving > 0, num_moving as f64 > MAX_MOVING * num_still as f64);
        if num_moving > num_still {
            return None;
        }
        Some(Spot { keypoints, images, pixel, scale_px, is_moved, moves })
    }
}

/// Union-find with path halving; the smallest number is the root.
struct DisjointSets {
    parents: Vec<u32>,
}

impl DisjointSets {
    fn root(&mut self, mut of: u32) -> u32 {
        while self.parents[of as usize] != of {
            let grandparent = self.parents[self.parents[of as usize] as usize];
            self.parents[of as usize] = grandparent;
            of = grandparent;
        }
        of
    }

    fn join(&mut self, one: u32, other: u32) {
        let (one, other) = (self.root(one), self.root(other));
        self.parents[one.max(other) as usize] = one.min(other);
    }
}
