//! Which spots are on overlays: those in whose images the scene moves.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{ImageId, ImagePair, Keypoint, Match};

use super::cells::{CELLS, around, bounds, cell_of, regions};
use super::displacement::{MOVING_PX, displacement_px};
use super::overlay::{Overlay, Stationary};
use super::spot::{Spot, images_of};

/// Smallest share of spots without any moving inlier match among those that stand still in the same
/// images, in the whole image and around. On the sets of `bench/overlays.py`, half finds two time
/// stamps more, but a slow drive and a stop lose 12 and 19 % of their matches; double is more than
/// all, and finds nothing.
const MIN_SHARE_OF_NEIGHBOURS: f64 = 0.7;
/// Smallest number of moving inlier matches of a pair relative to all its matches, for the scene to
/// move. On the sets of `bench/overlays.py`, half changes nothing; with double, the still
/// surroundings of one drive stay.
const MIN_MOVING: f64 = 0.03;
/// Smallest share of a spot's images which the scene moves in. On the sets of `bench/overlays.py`,
/// half changes nothing; double asks for all images, and still surroundings stay.
const MIN_SHARE_MOVED: f64 = 0.5;
/// Fewest adjacent spots of an overlay, unless it is on half of [`MANY_IMAGES`] or more: half of
/// the inliers that a pair needs. Half and double change nothing on the sets of
/// `bench/overlays.py`.
const MIN_SPOTS: usize = 8;
/// Fewest images in which fewer adjacent spots are an overlay, if these are half of all: dirt.
/// Chosen after two false alarms: 6 spots in 5 of 10 images of a real turntable, and 2 distant ones
/// beside the road in 8 and 9 of 12 images of a rendered drive of 9 m. On the sets of
/// `bench/overlays.py`, 3 % less of the dirt of a drive stays with half; they have 12 to 24 images,
/// and tell nothing of double.
const MANY_IMAGES: usize = 16;
/// Keypoints within so many scales of a stationary one are on the same overlay. Its letters and
/// digits may change. On the sets of `bench/overlays.py`, half and double change 1 % of the matches
/// at most.
const REACH_SCALES: f64 = 2.0;

/// Largest distance of a spot from the epipoles of its pairs, relative to the larger side: where a
/// camera moves to, nothing moves.
const MAX_EPIPOLE_DISTANCE: f64 = 0.125;

/// Pairs whose scene moves, and their epipoles in the first and second image, in pixels.
pub type MovedPairs = BTreeMap<ImagePair, Option<[Vector2<f64>; 2]>>;

/// Spots that stand exactly still in all of their images.
#[derive(Debug)]
pub struct Candidates<'a> {
    pub(super) keypoints: &'a [&'a [Keypoint]],
    pub(super) groups: &'a [usize],
    pub(super) later: Vec<Vec<u32>>,
    pub(super) spots: Vec<Spot>,
    /// The keypoints of spots without moving matches, of each image.
    pub(super) unmoved: Vec<BTreeSet<u32>>,
}

impl Candidates<'_> {
    /// The pairs whose images share spots without moving matches, sorted. Whether the rest of them
    /// moves decides.
    pub fn pairs(&self) -> Vec<ImagePair> {
        let mut pairs = BTreeSet::new();
        for spot in self.spots.iter().filter(|spot| !spot.moves) {
            for &image in &spot.images {
                let later = &self.later[image as usize];
                let common = later.iter().filter(|other| spot.images.binary_search(other).is_ok());
                pairs.extend(common.filter_map(|b| ImagePair::new(ImageId(image), ImageId(*b))));
            }
        }
        pairs.into_iter().collect()
    }

    /// The matches of a pair that move and are on none of the spots; none if they are too few for
    /// the scene to move.
    pub fn moving(&self, pair: ImagePair, matches: &[Match]) -> Vec<Match> {
        let [a, b] = [pair.a, pair.b].map(|image| &self.unmoved[image.index()]);
        let is_moving = |m: &&Match| {
            !a.contains(&m.a)
                && !b.contains(&m.b)
                && displacement_px(self.keypoints, pair, m).is_some_and(|px| px >= MOVING_PX)
        };
        let moving: Vec<Match> = matches.iter().filter(is_moving).copied().collect();
        moving
    }

    /// Whether `num_inliers` moving matches of a pair with `num_matches` matches show that its
    /// scene moves.
    pub fn is_moved(num_inliers: usize, num_matches: usize) -> bool {
        num_inliers as f64 >= MIN_MOVING * num_matches as f64
    }

    /// The keypoints on overlays. `moved`: the pairs of [`Candidates::pairs`] whose scene moves.
    pub fn select(&self, moved: &MovedPairs) -> Stationary<'_> {
        let shares = self.shares_without_motion();
        let mut chosen: BTreeMap<usize, Vec<&Spot>> = BTreeMap::new();
        for (spot, share) in self.spots.iter().zip(shares) {
            let group = self.groups[spot.images[0] as usize];
            let is_overlay =
                !spot.moves && share >= MIN_SHARE_OF_NEIGHBOURS && has_moved(spot, moved);
            if is_overlay && !is_at_epipoles(spot, moved, self.extent_px(group)) {
                chosen.entry(group).or_default().push(spot);
            }
        }
        let mut found = Stationary { all: self.keypoints, ..Stationary::default() };
        for (group, spots) in chosen {
            let side = self.extent_px(group) / CELLS;
            let num_all = self.groups.iter().filter(|other| **other == group).count();
            let is_overlay = |region: &Vec<&Spot>| {
                let images = images_of(region).len();
                region.len() >= MIN_SPOTS || (images >= MANY_IMAGES && 2 * images >= num_all)
            };
            let spots = regions(&spots, side).into_iter().filter(is_overlay).flatten().collect();
            let spots = self.grown(group, spots, moved);
            let images = images_of(&spots);
            if spots.is_empty() {
                continue;
            }
            self.mark(&spots, &mut found.keypoints);
            let cells = spots.iter().flat_map(|spot| around(cell_of(spot.pixel, side)));
            found.cells.extend(cells.map(|cell| (group, cell)));
            found.images.extend(images.iter().map(|image| (ImageId(*image), (group, side))));
            found.overlays.push(Overlay {
                group,
                images: images.len(),
                spots: spots.len(),
                regions: regions(&spots, side).iter().map(|region| bounds(region)).collect(),
            });
        }
        found
    }

    /// Adds spots around those of an overlay that are in half of its images or more.
    /// Letters and digits match each other, so that some of them move.
    fn grown<'b>(
        &'b self,
        group: usize,
        mut spots: Vec<&'b Spot>,
        moved: &MovedPairs,
    ) -> Vec<&'b Spot> {
        let side = self.extent_px(group) / CELLS;
        let num_images = images_of(&spots).len();
        let is_like = |spot: &&Spot| {
            self.groups[spot.images[0] as usize] == group
                && 2 * spot.images.len() >= num_images
                && has_moved(spot, moved)
        };
        let mut others: Vec<&Spot> = self.spots.iter().filter(is_like).collect();
        loop {
            let cells: BTreeSet<[i64; 2]> =
                spots.iter().flat_map(|spot| around(cell_of(spot.pixel, side))).collect();
            let is_near = |spot: &&Spot| cells.contains(&cell_of(spot.pixel, side));
            let (near, far): (Vec<_>, Vec<_>) = others.into_iter().partition(is_near);
            let known: BTreeSet<(u32, u32)> = spots.iter().map(|spot| spot.keypoints[0]).collect();
            let new = near.into_iter().filter(|spot| !known.contains(&spot.keypoints[0]));
            let before = spots.len();
            spots.extend(new);
            if spots.len() == before {
                return spots;
            }
            others = far;
        }
    }

    /// The extent of the keypoints of a group, in pixels: about the larger side of its images.
    fn extent_px(&self, group: usize) -> f64 {
        let images = self.keypoints.iter().zip(self.groups);
        let keypoints = images.filter(|(_, other)| **other == group).flat_map(|(all, _)| *all);
        keypoints.map(|keypoint| keypoint.pixel.max()).fold(1.0, f64::max)
    }

    /// For each component, the smaller share of spots without moving matches among those in
    /// its images and among those around it: the mean over its images.
    fn shares_without_motion(&self) -> Vec<f64> {
        let extents: BTreeMap<usize, f64> = self
            .groups
            .iter()
            .collect::<BTreeSet<_>>()
            .into_iter()
            .map(|group| (*group, self.extent_px(*group)))
            .collect();
        let cell = |spot: &Spot| {
            let side = extents[&self.groups[spot.images[0] as usize]] / CELLS;
            cell_of(spot.pixel, side)
        };
        let mut in_image: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
        let mut in_cell: BTreeMap<(u32, [i64; 2]), [usize; 2]> = BTreeMap::new();
        for spot in &self.spots {
            let cell = cell(spot);
            for &image in &spot.images {
                let counts = in_image.entry(image).or_default();
                counts[usize::from(spot.is_moved)] += 1;
                let counts = in_cell.entry((image, cell)).or_default();
                counts[usize::from(spot.is_moved)] += 1;
            }
        }
        let share = |[unmoved, moved]: [usize; 2]| unmoved as f64 / (unmoved + moved) as f64;
        let near = |image: u32, cell: [i64; 2]| {
            let mut sum = [0; 2];
            for cell in around(cell) {
                if let Some([unmoved, moved]) = in_cell.get(&(image, cell)) {
                    sum = [sum[0] + unmoved, sum[1] + moved];
                }
            }
            sum
        };
        let shares = self.spots.iter().map(|spot| {
            let cell = cell(spot);
            let count = spot.images.len() as f64;
            let whole: f64 = spot.images.iter().map(|image| share(in_image[image])).sum();
            let local: f64 = spot.images.iter().map(|image| share(near(*image, cell))).sum();
            whole.min(local) / count
        });
        shares.collect()
    }

    /// Marks the keypoints of spots and those around them, in the images of the spots.
    fn mark(&self, spots: &[&Spot], marked: &mut BTreeMap<ImageId, BTreeSet<u32>>) {
        let mut by_image: BTreeMap<u32, Vec<&Spot>> = BTreeMap::new();
        for spot in spots {
            for &(image, keypoint) in &spot.keypoints {
                marked.entry(ImageId(image)).or_default().insert(keypoint);
            }
            spot.images.iter().for_each(|image| by_image.entry(*image).or_default().push(spot));
        }
        for (image, spots) in by_image {
            let reach_px = |spot: &Spot| REACH_SCALES * spot.scale_px;
            let side = spots.iter().map(|spot| reach_px(spot)).fold(1.0, f64::max);
            let mut grid: BTreeMap<[i64; 2], Vec<&Spot>> = BTreeMap::new();
            spots
                .iter()
                .for_each(|spot| grid.entry(cell_of(spot.pixel, side)).or_default().push(spot));
            let is_near = |pixel: Vector2<f64>| {
                around(cell_of(pixel, side))
                    .filter_map(|cell| grid.get(&cell))
                    .flatten()
                    .any(|spot| (spot.pixel - pixel).norm() < reach_px(spot))
            };
            let marked = marked.entry(ImageId(image)).or_default();
            for (index, keypoint) in self.keypoints[image as usize].iter().enumerate() {
                if is_near(keypoint.pixel) {
                    marked.insert(index as u32);
                }
            }
        }
    }
}

/// Whether the scene moves in enough of a spot's images.
fn has_moved(spot: &Spot, moved: &MovedPairs) -> bool {
    let images = &spot.images;
    let moves = |image: &&u32| {
        let pair = |other: &u32| ImagePair::new(ImageId(**image), ImageId(*other));
        images.iter().filter_map(pair).any(|pair| moved.contains_key(&pair))
    };
    let count = images.iter().filter(moves).count();
    count as f64 >= MIN_SHARE_MOVED * images.len() as f64
}

/// Whether a spot is near both epipoles in half of the pairs of its images whose scene moves.
fn is_at_epipoles(spot: &Spot, moved: &MovedPairs, extent_px: f64) -> bool {
    let (mut near, mut all) = (0, 0);
    for (k, &a) in spot.images.iter().enumerate() {
        for &b in &spot.images[k + 1..] {
            let pair = ImagePair::new(ImageId(a), ImageId(b));
            let Some(epipoles) = pair.and_then(|pair| *moved.get(&pair)?) else { continue };
            let is_near = |epipole: &Vector2<f64>| {
                (spot.pixel - epipole).norm() < MAX_EPIPOLE_DISTANCE * extent_px
            };
            all += 1;
            near += usize::from(epipoles.iter().all(is_near));
        }
    }
    near > 0 && 2 * near >= all
}
