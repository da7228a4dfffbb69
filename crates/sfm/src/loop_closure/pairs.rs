//! Detection of loops that drift left open.
//!
//! A trajectory that returns to a place is mapped up to that place from both ends. If the drift
//! exceeds the tolerance of track merging, the images of both ends have no common points, although
//! they have verified matches. Such a pair of images is an open-loop pair. Two criteria separate
//! open-loop pairs from others: nearly none of their matches are merged into common points, and no
//! short path in the covisibility graph connects the two images. A pair with a short path is a
//! wrong match: windows of a facade, seen from positions that differ by their spacing, fit the
//! epipolar geometry of a camera that drives along it.
//!
//! The matches of each open-loop pair give a similarity between the two images. Pose-graph
//! optimisation distributes the drift ([`super::pose_graph`]). Then the matched points are merged,
//! everything is adjusted, and tracks are re-created. The closure is accepted if the number of
//! verified matches with a common point grows by about the number of matches of the open-loop
//! pairs. Wrong pairs destroy as many correct tracks as they create.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{
    CorrespondenceGraph, ImageId, ImagePair, Observation, PointId, Reconstruction, TwoView,
};

use crate::tracks::mean_position;

/// Minimum number of matches whose keypoints observe points on both sides.
const MIN_MATCHES: usize = 15;
/// A pair is an open-loop pair if at most this fraction of its matches has a common point. Other
/// pairs have 0.9 and more.
const MAX_COMMON_FRACTION: f64 = 0.1;
/// Minimum number of open-loop pairs. Drift separates many pairs at once; one or two are wrong
/// matches.
pub(crate) const MIN_PAIRS: usize = 3;
/// Maximum length of a covisibility path that excludes drift between its ends.
const MAX_PATH_LENGTH: usize = 4;
/// Minimum gain of matches with a common point, relative to the matches of the open-loop pairs.
const MIN_GAIN: f64 = 0.5;

/// Returns the points that a pair's matches observe on both sides.
fn points_of_matches<'a>(
    model: &'a Reconstruction,
    (pair, two_view): (&'a ImagePair, &'a TwoView),
) -> impl Iterator<Item = (PointId, PointId)> + 'a {
    let (a, b) = (model.image(pair.a), model.image(pair.b));
    two_view.matches.iter().filter_map(|m| Some((a.point_of(m.a)?, b.point_of(m.b)?)))
}

/// Image pairs classified by their matches.
pub(crate) struct ClassifiedPairs {
    /// Pairs with matches but without common points; empty if there are too few for a loop.
    pub(crate) open_loop: Vec<ImagePair>,
    /// Graph of the pairs with common points.
    pub(crate) covisibility: CovisibilityGraph,
}

/// Images connected by common points.
#[derive(Default)]
pub(crate) struct CovisibilityGraph(BTreeMap<ImageId, Vec<ImageId>>);

impl CovisibilityGraph {
    fn insert(&mut self, pair: ImagePair) {
        self.0.entry(pair.a).or_default().push(pair.b);
        self.0.entry(pair.b).or_default().push(pair.a);
    }

    /// Returns each pair once.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = ImagePair> {
        self.0.iter().flat_map(|(a, others)| {
            others.iter().filter_map(|b| ImagePair::new(*a, *b)).filter(|pair| pair.a == *a)
        })
    }

    /// Returns the images within [`MAX_PATH_LENGTH`] edges of an image, including itself.
    pub(crate) fn within_path_length(&self, image: ImageId) -> BTreeSet<ImageId> {
        let others = |of: &ImageId| self.0.get(of).into_iter().flatten().copied();
        let mut visited = BTreeSet::from([image]);
        let mut boundary = visited.clone();
        for _ in 0..MAX_PATH_LENGTH {
            boundary =
                boundary.iter().flat_map(others).filter(|image| !visited.contains(image)).collect();
            visited.extend(&boundary);
        }
        visited
    }
}

/// Classifies the pairs of a model.
pub(crate) fn classify_pairs(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
) -> ClassifiedPairs {
    let (mut open_loop, mut covisibility) = (Vec::new(), CovisibilityGraph::default());
    for pair in graph.pairs() {
        let (mut num_common, mut num_matches) = (0, 0);
        for (a, b) in points_of_matches(model, pair) {
            num_common += usize::from(a == b);
            num_matches += 1;
        }
        if num_matches < MIN_MATCHES {
            continue;
        }
        if num_common as f64 <= MAX_COMMON_FRACTION * num_matches as f64 {
            open_loop.push(*pair.0);
        } else {
            covisibility.insert(*pair.0);
        }
    }
    open_loop.retain(|pair| !covisibility.within_path_length(pair.a).contains(&pair.b));
    if open_loop.len() < MIN_PAIRS {
        open_loop.clear();
    }
    ClassifiedPairs { open_loop, covisibility }
}

/// Whether loop closure increased the number of verified matches with a common point enough.
pub(crate) fn is_closed(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    before: &Reconstruction,
    open_loop: &[ImagePair],
) -> bool {
    let pairs = open_loop.iter().filter_map(|pair| graph.pairs().get_key_value(pair));
    let num_open_matches = pairs.flat_map(|pair| points_of_matches(before, pair)).count();
    num_matches_with_common_point(graph, model) as f64
        >= num_matches_with_common_point(graph, before) as f64 + MIN_GAIN * num_open_matches as f64
}

/// Number of verified matches with a common point.
fn num_matches_with_common_point(graph: &CorrespondenceGraph, model: &Reconstruction) -> usize {
    graph
        .pairs()
        .iter()
        .flat_map(|pair| points_of_matches(model, pair))
        .filter(|(a, b)| a == b)
        .count()
}

/// Merges the two points of every match of these pairs, at the mean weighted by observations.
pub(crate) fn merge_matched_points(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    pairs: impl IntoIterator<Item = ImagePair>,
) {
    for pair in pairs {
        let Some(two_view) = graph.pairs().get(&pair) else { continue };
        for m in &two_view.matches {
            let point = |o: Observation| model.image(o.image).point_of(o.keypoint);
            let (a, b) = (
                Observation { image: pair.a, keypoint: m.a },
                Observation { image: pair.b, keypoint: m.b },
            );
            let (Some(one), Some(other)) = (point(a), point(b)) else { continue };
            let (Some(track), Some(other_track)) = (model.track(one), model.track(other)) else {
                continue;
            };
            let xyz = mean_position(track, other_track);
            model.merge_tracks(one, other, xyz);
        }
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Image, Keypoint, Match, Track, TwoViewKind};

    use super::*;

    /// Images in a row. Each has common points with the next one.
    const IMAGES: usize = 12;
    /// Index difference of the pairs with wrong matches.
    const WRONG_DISTANCE: usize = 3;

    /// Every image has as many keypoints for the previous image as for the next one, and a point
    /// for each match.
    fn sequence() -> (Reconstruction, Vec<ImageId>) {
        let mut model = Reconstruction::default();
        let intrinsics =
            Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 320.0, 240.0]).unwrap();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let keypoint = Keypoint { pixel: Vector2::new(320.0, 240.0), scale_px: 1.0 };
        let images: Vec<ImageId> = (0..IMAGES)
            .map(|i| {
                model.add_image(Image::new(i.to_string(), camera, vec![keypoint; 2 * MIN_MATCHES]))
            })
            .collect();
        images.iter().for_each(|&image| model.register(image, Rigid3::identity()));
        for pair in images.windows(2) {
            for k in 0..MIN_MATCHES as u32 {
                let behind = Observation { image: pair[0], keypoint: MIN_MATCHES as u32 + k };
                let before = Observation { image: pair[1], keypoint: k };
                model.add_track(Track::new(Vector3::z(), vec![behind, before]));
            }
        }
        (model, images)
    }

    /// The neighbouring pairs, whose matches have common points, and other pairs, whose matches
    /// have different points on each side.
    fn graph(
        images: &[ImageId],
        others: impl Iterator<Item = (usize, usize)>,
    ) -> CorrespondenceGraph {
        let pair = |a: usize, b: usize| {
            let matches = (0..MIN_MATCHES as u32)
                .map(|k| Match { a: MIN_MATCHES as u32 + k, b: k })
                .collect();
            let two_view =
                TwoView { kind: TwoViewKind::Uncalibrated, matches, ..TwoView::default() };
            Some((ImagePair::new(images[a], images[b])?, two_view))
        };
        let neighbours = (1..IMAGES).filter_map(|i| pair(i - 1, i));
        let others = others.filter_map(|(a, b)| pair(a, b));
        CorrespondenceGraph::new(&[2 * MIN_MATCHES; IMAGES], neighbours.chain(others))
    }

    #[test]
    fn pairs_with_a_short_covisibility_path_are_no_open_loop() {
        let (model, images) = sequence();
        let wrong = || (0..IMAGES - WRONG_DISTANCE).map(|i| (i, i + WRONG_DISTANCE));
        assert_eq!(classify_pairs(&graph(&images, wrong()), &model).open_loop, []);
        let ends = || (0..MIN_PAIRS).map(|i| (i, IMAGES - 1 - i));
        let open_loop: Vec<_> =
            ends().filter_map(|(a, b)| ImagePair::new(images[a], images[b])).collect();
        assert_eq!(
            classify_pairs(&graph(&images, wrong().chain(ends())), &model).open_loop,
            open_loop
        );
    }
}
