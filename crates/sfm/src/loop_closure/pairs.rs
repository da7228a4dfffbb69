//! Loops that did not close.
//!
//! A drive that comes back is mapped from both sides towards where the two meet. If it has drifted
//! by more than points may be off there, the images on both sides stay apart although their matches
//! say that they see the same: the model is torn. Such pairs are easily told from others: nearly
//! none of their matches became one point, and no chain of few images that do see points in common
//! leads from one to the other (where it does, the pair is a wrong one: windows of a facade, seen
//! from places that differ by their distance, agree with the epipolar geometry of a camera that
//! drives along it). What their matches say of how they stand to each other is brought about by
//! moving all images a little ([`crate::pose_graph`]); then these points are made one, everything
//! is adjusted, and all tracks are made anew. The loop stays closed if that makes more of all
//! verified matches one point, about as many as were torn: wrong pairs, which look alike and are
//! not, cost others what they gain.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{
    CorrespondenceGraph, ImageId, ImagePair, Observation, PointId, Reconstruction, TwoView,
};

use crate::tracks::middle;

/// Pairs of which fewer matches see points on both sides tell nothing.
const MIN_MATCHES: usize = 15;
/// A pair is torn when no more than this share of those is one point: of other pairs it is 0.9 and
/// more.
const MAX_JOINED: f64 = 0.1;
/// Drift tears many pairs apart at once: those on both sides of where the model meets itself. One
/// or two are pairs that look alike.
pub(crate) const MIN_PAIRS: usize = 3;
/// A model cannot tear between images that so few pairs in a row join, which see points in common.
const MAX_STEPS: usize = 4;
/// A loop is closed when so many of the torn matches have become one point, in total.
const MIN_GAIN: f64 = 0.5;

/// The points that a pair's matches see on both sides.
fn points<'a>(
    model: &'a Reconstruction,
    (pair, two_view): (&'a ImagePair, &'a TwoView),
) -> impl Iterator<Item = (PointId, PointId)> + 'a {
    let (a, b) = (model.image(pair.a), model.image(pair.b));
    two_view.matches.iter().filter_map(|m| Some((a.point_of(m.a)?, b.point_of(m.b)?)))
}

/// Pairs of images whose matches see points.
pub(crate) struct Pairs {
    /// Whose images see the same by their matches, and not by their points; none where these are
    /// too few to be a loop.
    pub(crate) torn: Vec<ImagePair>,
    /// Whose images see points in common.
    pub(crate) joined: CovisibilityGraph,
}

/// Which images see points in common with which others.
#[derive(Default)]
pub(crate) struct CovisibilityGraph(BTreeMap<ImageId, Vec<ImageId>>);

impl CovisibilityGraph {
    fn insert(&mut self, pair: ImagePair) {
        self.0.entry(pair.a).or_default().push(pair.b);
        self.0.entry(pair.b).or_default().push(pair.a);
    }

    /// Each pair once.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = ImagePair> {
        self.0.iter().flat_map(|(a, others)| {
            others.iter().filter_map(|b| ImagePair::new(*a, *b)).filter(|pair| pair.a == *a)
        })
    }

    /// The images that at most [`MAX_STEPS`] pairs lead to from an image, itself among them.
    pub(crate) fn near(&self, image: ImageId) -> BTreeSet<ImageId> {
        let others = |of: &ImageId| self.0.get(of).into_iter().flatten().copied();
        let mut reached = BTreeSet::from([image]);
        let mut last = reached.clone();
        for _ in 0..MAX_STEPS {
            last = last.iter().flat_map(others).filter(|image| !reached.contains(image)).collect();
            reached.extend(&last);
        }
        reached
    }
}

/// Tells the pairs that are torn from the others.
pub(crate) fn pairs(graph: &CorrespondenceGraph, model: &Reconstruction) -> Pairs {
    let (mut torn, mut joined) = (Vec::new(), CovisibilityGraph::default());
    for pair in graph.pairs() {
        let (mut same, mut seen) = (0, 0);
        for (a, b) in points(model, pair) {
            same += usize::from(a == b);
            seen += 1;
        }
        if seen < MIN_MATCHES {
            continue;
        }
        if same as f64 <= MAX_JOINED * seen as f64 {
            torn.push(*pair.0);
        } else {
            joined.insert(*pair.0);
        }
    }
    torn.retain(|pair| !joined.near(pair.a).contains(&pair.b));
    if torn.len() < MIN_PAIRS {
        torn.clear();
    }
    Pairs { torn, joined }
}

/// Whether a model that was made of another one by closing loops has made enough more matches one
/// point.
pub(crate) fn is_closed(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    before: &Reconstruction,
    torn: &[ImagePair],
) -> bool {
    let pairs = torn.iter().filter_map(|pair| graph.pairs().get_key_value(pair));
    let wanted = pairs.flat_map(|pair| points(before, pair)).count();
    num_joined(graph, model) as f64 >= num_joined(graph, before) as f64 + MIN_GAIN * wanted as f64
}

/// How many of all verified matches are one point.
fn num_joined(graph: &CorrespondenceGraph, model: &Reconstruction) -> usize {
    graph.pairs().iter().flat_map(|pair| points(model, pair)).filter(|(a, b)| a == b).count()
}

/// Makes the two points of every match of these pairs one, in the middle of their observations.
pub(crate) fn join(
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
            let xyz = middle(track, other_track);
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

    /// Images in a row, of which each sees points with the next one; the last ones are so many
    /// pairs from the first ones.
    const IMAGES: usize = 12;
    /// Pairs that look alike: so many pairs apart, from each image that has one.
    const ALIKE: usize = 3;

    /// Every image has as many keypoints for the one before as for the one behind, and a point for
    /// each two that match.
    fn row() -> (Reconstruction, Vec<ImageId>) {
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

    /// The pairs of neighbours, whose matches are points, and others, whose matches see other
    /// points on each side.
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
    fn images_that_few_pairs_join_only_look_alike() {
        let (model, images) = row();
        let alike = || (0..IMAGES - ALIKE).map(|i| (i, i + ALIKE));
        assert_eq!(pairs(&graph(&images, alike()), &model).torn, []);
        let ends = || (0..MIN_PAIRS).map(|i| (i, IMAGES - 1 - i));
        let torn: Vec<_> =
            ends().filter_map(|(a, b)| ImagePair::new(images[a], images[b])).collect();
        assert_eq!(pairs(&graph(&images, alike().chain(ends())), &model).torn, torn);
    }
}
