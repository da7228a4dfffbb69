//! The overlays that were found, and matches without them.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{ImageId, ImagePair, Keypoint, Match};

use super::cells::cell_of;
use super::displacement::{STILL_PX, displacement_px};

/// Keypoints on overlays.
#[derive(Clone, Debug, Default)]
pub struct Stationary<'a> {
    /// The keypoints of all images.
    pub(super) all: &'a [&'a [Keypoint]],
    pub(super) keypoints: BTreeMap<ImageId, BTreeSet<u32>>,
    /// The cells of a group with spots, and those around them.
    pub(super) cells: BTreeSet<(usize, [i64; 2])>,
    /// Group and side of the cells in pixels, of each image with spots.
    pub(super) images: BTreeMap<ImageId, (usize, f64)>,
    /// What was found, for each camera that has any.
    pub overlays: Vec<Overlay>,
}

/// What stands still in the images of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlay {
    /// The group of images, as in [`super::StationarySearch::new`].
    pub group: usize,
    /// Number of images.
    pub images: usize,
    /// Number of spots.
    pub spots: usize,
    /// Where they are: left, top, right and bottom in pixels, the region with most spots first.
    pub regions: Vec<[f64; 4]>,
}

impl Stationary<'_> {
    /// Whether nothing was found.
    pub fn is_empty(&self) -> bool {
        self.overlays.is_empty()
    }

    /// Whether a keypoint is on an overlay.
    pub fn contains(&self, image: ImageId, keypoint: u32) -> bool {
        self.keypoints.get(&image).is_some_and(|keypoints| keypoints.contains(&keypoint))
    }

    /// Whether an image has keypoints on an overlay.
    pub fn is_in(&self, image: ImageId) -> bool {
        self.keypoints.contains_key(&image)
    }

    /// The matches of a pair without those on overlays, and without those around the spots of
    /// an overlay that hardly move: letters that match each other are no spots.
    pub fn without(&self, pair: ImagePair, matches: &[Match]) -> Vec<Match> {
        let is_among = |image: ImageId, keypoint: u32| {
            let pixel = self.all[image.index()][keypoint as usize].pixel;
            self.images
                .get(&image)
                .is_some_and(|&(group, side)| self.cells.contains(&(group, cell_of(pixel, side))))
        };
        let is_kept = |m: &&Match| {
            let is_on = self.contains(pair.a, m.a) || self.contains(pair.b, m.b);
            let is_slow = displacement_px(self.all, pair, m).is_some_and(|px| px < STILL_PX);
            !(is_on || is_slow && is_among(pair.a, m.a) && is_among(pair.b, m.b))
        };
        matches.iter().filter(is_kept).copied().collect()
    }
}
