//! The cut of many images into parts, which [`crate::Mapper::submap`] maps one by one.
//!
//! It follows from the data alone. Images of sequences are cut in their order, others into regions
//! of the view graph: a region begins at an image with few links, and takes the image with the most
//! matches to it, one after another. Small components of the graph share parts. Parts overlap, so
//! that their models have images in common.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{ImageId, ImagePair, Reconstruction};

use crate::frame_names::natural_order;

/// Images of a part: that of the leaves of COLMAP's hierarchical mapper (`leaf_max_num_images`).
pub const SUBMAP_SIZE: usize = 500;
/// Images that two neighbours have in common: COLMAP's `image_overlap`.
const OVERLAP: usize = 50;
/// Images are in an order if this part of them has a verified pair with the next one of its
/// stream: a photo may be too blurred for one.
const MIN_LINKED: f64 = 0.9;
/// A region below this part of the size is added to the one that it has most matches with.
const MIN_REGION: f64 = 0.25;

/// Cuts the images with verified pairs into parts of about `size` images, and the overlap. `links`:
/// the verified pairs with their numbers of inliers. The first part is the begin of sequences, and
/// else the largest region: the other parts begin with its intrinsics.
pub fn cut(
    scene: &Reconstruction,
    links: &[(ImagePair, usize)],
    size: usize,
) -> Vec<BTreeSet<ImageId>> {
    let linked: BTreeSet<ImageId> = links.iter().flat_map(|(pair, _)| [pair.a, pair.b]).collect();
    let num_parts = linked.len().div_ceil(size.max(1)).max(1);
    if num_parts == 1 {
        return vec![linked];
    }
    let size = linked.len().div_ceil(num_parts);
    let overlap = OVERLAP.min(size / 2);
    match in_order(scene, &linked, links) {
        Some(images) => {
            let bound = |index: usize| images.len() * index / num_parts;
            let part = |index: usize| {
                let first = bound(index).saturating_sub(overlap / 2);
                let last = (bound(index + 1) + overlap / 2).min(images.len());
                images[first..last].iter().copied().collect()
            };
            (0..num_parts).map(part).collect()
        }
        None => ViewGraph::new(links).regions(linked, size, overlap),
    }
}

/// Whether the images are sequences, which [`cut`] cuts in their order.
pub fn are_sequences(scene: &Reconstruction, links: &[(ImagePair, usize)]) -> bool {
    let linked: BTreeSet<ImageId> = links.iter().flat_map(|(pair, _)| [pair.a, pair.b]).collect();
    in_order(scene, &linked, links).is_some()
}

/// The images of sequences in their order, all streams side by side: by time, or, if some have
/// none, by their places in their streams. `None` if the images do not see what the next ones see.
fn in_order(
    scene: &Reconstruction,
    images: &BTreeSet<ImageId>,
    links: &[(ImagePair, usize)],
) -> Option<Vec<ImageId>> {
    let are_timed = images.iter().all(|id| scene.image(*id).time_s.is_some());
    let time = |id: &ImageId| scene.image(*id).time_s.unwrap_or_default();
    let mut streams: BTreeMap<&str, Vec<ImageId>> = BTreeMap::new();
    for &id in images {
        streams.entry(&scene.image(id).stream).or_default().push(id);
    }
    let pairs: BTreeSet<ImagePair> = links.iter().map(|(pair, _)| *pair).collect();
    let (mut linked, mut steps, mut places) = (0, 0, Vec::new());
    for stream in streams.values_mut() {
        let by_name =
            |a: &ImageId, b: &ImageId| natural_order(&scene.image(*a).name, &scene.image(*b).name);
        match are_timed {
            true => stream.sort_by(|a, b| time(a).total_cmp(&time(b)).then(a.cmp(b))),
            false => stream.sort_by(by_name),
        }
        steps += stream.len() - 1;
        let is_linked = |two: &&[ImageId]| {
            ImagePair::new(two[0], two[1]).is_some_and(|pair| pairs.contains(&pair))
        };
        linked += stream.windows(2).filter(is_linked).count();
        // Streams of other rates have other numbers of images.
        let part = |index: usize| (index as f64 + 0.5) / stream.len() as f64;
        let place =
            |(index, id): (usize, &ImageId)| (if are_timed { time(id) } else { part(index) }, *id);
        places.extend(stream.iter().enumerate().map(place));
    }
    places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let is_order = linked > 0 && linked as f64 >= MIN_LINKED * steps as f64;
    is_order.then(|| places.into_iter().map(|(_, id)| id).collect())
}

/// The neighbours of each image, with the numbers of matches.
struct ViewGraph {
    neighbours: BTreeMap<ImageId, Vec<(ImageId, usize)>>,
}

impl ViewGraph {
    fn new(links: &[(ImagePair, usize)]) -> Self {
        let mut neighbours: BTreeMap<ImageId, Vec<(ImageId, usize)>> = BTreeMap::new();
        for &(ImagePair { a, b }, count) in links {
            neighbours.entry(a).or_default().push((b, count));
            neighbours.entry(b).or_default().push((a, count));
        }
        Self { neighbours }
    }

    fn of(&self, image: ImageId) -> impl Iterator<Item = (ImageId, usize)> {
        self.neighbours.get(&image).into_iter().flatten().copied()
    }

    /// The matches of each image outside of a part with the images of the part.
    fn around(&self, part: &BTreeSet<ImageId>) -> BTreeMap<ImageId, usize> {
        let mut around = BTreeMap::new();
        for (other, count) in part.iter().flat_map(|image| self.of(*image)) {
            if !part.contains(&other) {
                *around.entry(other).or_insert(0) += count;
            }
        }
        around
    }

    /// Regions of about `size` images, each with the images around it that have most matches. The
    /// largest is the first.
    fn regions(
        &self,
        mut free: BTreeSet<ImageId>,
        size: usize,
        overlap: usize,
    ) -> Vec<BTreeSet<ImageId>> {
        let mut regions = Vec::new();
        while let Some(region) = self.next_region(&mut free, size) {
            regions.push(region);
        }
        let is_small =
            |region: &BTreeSet<ImageId>| (region.len() as f64) < MIN_REGION * size as f64;
        let mut index = 0;
        while index < regions.len() {
            if is_small(&regions[index])
                && let Some(other) = self.nearest(&regions, index)
            {
                let small = regions.remove(index);
                regions[other - usize::from(other > index)].extend(small);
            } else {
                index += 1;
            }
        }
        // Small components of the graph share parts, which map one after another.
        let mut shared: Vec<BTreeSet<ImageId>> = Vec::new();
        for component in regions.extract_if(.., |region| is_small(region)) {
            match shared.last_mut().filter(|part| part.len() + component.len() <= size) {
                Some(part) => part.extend(component),
                None => shared.push(component),
            }
        }
        regions.append(&mut shared);
        for region in &mut regions {
            let mut around: Vec<(ImageId, usize)> = self.around(region).into_iter().collect();
            around.sort_by_key(|(image, count)| (std::cmp::Reverse(*count), *image));
            region.extend(around.into_iter().take(overlap).map(|(image, _)| image));
        }
        regions.sort_by_key(|region| std::cmp::Reverse(region.len()));
        regions
    }

    /// Takes a region out of the free images; `None` if there are none.
    fn next_region(&self, free: &mut BTreeSet<ImageId>, size: usize) -> Option<BTreeSet<ImageId>> {
        let open = |image: &ImageId| -> usize {
            self.of(*image).filter(|(other, _)| free.contains(other)).map(|(_, count)| count).sum()
        };
        let first = *free.iter().min_by_key(|image| (open(image), **image))?;
        let (mut region, mut frontier) = (BTreeSet::new(), BTreeMap::from([(first, 0)]));
        while region.len() < size {
            let best =
                frontier.iter().max_by_key(|(image, count)| (**count, std::cmp::Reverse(**image)));
            let Some((&image, _)) = best else { break };
            frontier.remove(&image);
            free.remove(&image);
            region.insert(image);
            for (other, count) in self.of(image).filter(|(other, _)| free.contains(other)) {
                *frontier.entry(other).or_insert(0) += count;
            }
        }
        Some(region)
    }

    /// The other region with the most matches to one.
    fn nearest(&self, regions: &[BTreeSet<ImageId>], index: usize) -> Option<usize> {
        let around = self.around(&regions[index]);
        let count = |other: usize| -> usize {
            around
                .iter()
                .filter(|(id, _)| regions[other].contains(id))
                .map(|(_, count)| count)
                .sum()
        };
        let others = (0..regions.len()).filter(|other| *other != index && count(*other) > 0);
        others.max_by_key(|other| (count(*other), std::cmp::Reverse(*other)))
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    const MATCHES: usize = 100;

    fn scene(
        names: impl Iterator<Item = String>,
        time_s: impl Fn(usize) -> Option<f64>,
    ) -> Reconstruction {
        let mut scene = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 9.0, 10, 10);
        let camera = Camera { intrinsics, width: 10, height: 10, has_focal_prior: true };
        let camera = scene.add_camera(camera);
        for (index, name) in names.enumerate() {
            let id = scene.add_image(Image::new(name, camera, Vec::new()));
            scene.set_time(id, time_s(index));
        }
        scene
    }

    fn link(a: usize, b: usize) -> (ImagePair, usize) {
        (ImagePair::new(ImageId::from_index(a), ImageId::from_index(b)).unwrap(), MATCHES)
    }

    fn check_cover(parts: &[BTreeSet<ImageId>], count: usize) {
        let all: BTreeSet<ImageId> = parts.iter().flatten().copied().collect();
        assert_eq!(all.len(), count);
    }

    /// Two streams, one with its names in another order than its times.
    #[test]
    fn sequences_are_cut_in_time() {
        const FRAMES: usize = 300;
        let name = |index: usize| match index < FRAMES {
            true => format!("left/{index}.png"),
            false => format!("right/{}.png", 7 * index % FRAMES),
        };
        let scene = scene((0..2 * FRAMES).map(name), |index| Some((index % FRAMES) as f64));
        let links: Vec<_> = (0..2)
            .flat_map(|stream| (1..FRAMES).map(move |k| stream * FRAMES + k))
            .map(|k| link(k - 1, k))
            .collect();
        let parts = cut(&scene, &links, 200);
        assert_eq!(parts.len(), 3);
        check_cover(&parts, 2 * FRAMES);
        let times = |part: &BTreeSet<ImageId>| -> BTreeSet<usize> {
            part.iter().map(|id| id.index() % FRAMES).collect()
        };
        for (index, part) in parts.iter().enumerate() {
            let times = times(part);
            let span = times.last().unwrap() - times.first().unwrap() + 1;
            assert_eq!(times.len(), span, "no gap");
            // At both ends one of two simultaneous images may be in the next part.
            assert!((2 * span - 2..=2 * span).contains(&part.len()), "both streams");
            if let Some(next) = parts.get(index + 1) {
                assert_eq!(part.intersection(next).count(), OVERLAP);
            }
        }
    }

    /// A grid of photos in no order: neighbours see the same.
    #[test]
    fn other_images_are_cut_into_regions() {
        const SIDE: usize = 20;
        let place = |index: usize| 7 * index % (SIDE * SIDE);
        let scene = scene((0..SIDE * SIDE).map(|k| format!("{k}.png")), |_| None);
        let mut links = Vec::new();
        for a in 0..SIDE * SIDE {
            for b in 0..a {
                let [(ax, ay), (bx, by)] =
                    [a, b].map(place).map(|at| ((at % SIDE) as i64, (at / SIDE) as i64));
                if (ax - bx).abs().max((ay - by).abs()) == 1 {
                    links.push(link(b, a));
                }
            }
        }
        let parts = cut(&scene, &links, 100);
        check_cover(&parts, SIDE * SIDE);
        assert!((3..=5).contains(&parts.len()), "{}", parts.len());
        let graph = ViewGraph::new(&links);
        for part in &parts {
            // A part is connected, and has images in common with another one.
            let mut left = part.clone();
            let mut open = vec![left.pop_first().unwrap()];
            while let Some(image) = open.pop() {
                open.extend(
                    graph.of(image).map(|(other, _)| other).filter(|other| left.remove(other)),
                );
            }
            assert!(left.is_empty());
            let shared = |other: &&BTreeSet<ImageId>| {
                *other != part && other.intersection(part).count() >= OVERLAP / 2
            };
            assert!(parts.iter().any(|other| shared(&other)));
        }
    }

    /// A chain of many images behind components of few.
    #[test]
    fn small_components_share_a_part_behind_larger_ones() {
        const SMALL: usize = 6;
        let scene = scene((0..3 * SMALL + 200).map(|k| format!("{}.png", 7 * k % 400)), |_| None);
        let chain = (3 * SMALL + 1..3 * SMALL + 200).map(|k| link(k - 1, k));
        let small = (0..SMALL).flat_map(|k| [link(3 * k, 3 * k + 1), link(3 * k + 1, 3 * k + 2)]);
        let links: Vec<_> = small.chain(chain).collect();
        let parts = cut(&scene, &links, 100);
        check_cover(&parts, 3 * SMALL + 200);
        let (last, others) = parts.split_last().unwrap();
        assert_eq!(*last, (0..3 * SMALL).map(ImageId::from_index).collect());
        assert!(others.is_sorted_by_key(|part| std::cmp::Reverse(part.len())));
        assert!(others.iter().all(|part| part.is_disjoint(last)));
    }

    #[test]
    fn few_images_are_one_part_without_those_that_have_no_pair() {
        let scene = scene((0..9).map(|k| format!("{k}.png")), |_| None);
        let parts = cut(&scene, &[link(1, 2), link(2, 5)], 4);
        assert_eq!(parts, [BTreeSet::from([1, 2, 5].map(ImageId))]);
    }
}
