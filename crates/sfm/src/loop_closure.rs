//! Loops that did not close.
//!
//! A drive that comes back is mapped from both sides towards where the two meet. If it has drifted by more than points may be off
//! there, the images on both sides stay apart although their matches say that they see the same: the model is torn. Such pairs are
//! easily told from others: nearly none of their matches became one point. So these points are made one, whatever their errors, and
//! everything is adjusted without a robust loss (which would let go of what it should bring together), so that the drift spreads over the
//! whole loop; then all tracks are made anew. The loop stays closed if that makes more of all verified matches one point, about as many
//! as were torn: wrong pairs, which look alike and are not, cost others what they gain.

use tiepoint_scene::{CorrespondenceGraph, ImagePair, Observation, PointId, Reconstruction, TwoView};

use crate::tracks::middle;

/// Pairs of which fewer matches see points on both sides tell nothing.
const MIN_MATCHES: usize = 15;
/// A pair is torn when no more than this share of those is one point: of other pairs it is 0.9 and more.
const MAX_JOINED: f64 = 0.1;
/// Drift tears many pairs apart at once: those on both sides of where the model meets itself. One or two are pairs that look alike.
const MIN_PAIRS: usize = 3;
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

/// Pairs whose images see the same by their matches, and not by their points; none where these are too few to be a loop.
pub(crate) fn torn_pairs(graph: &CorrespondenceGraph, model: &Reconstruction) -> Vec<ImagePair> {
    let is_torn = |pair: &(&ImagePair, &TwoView)| {
        let (mut joined, mut seen) = (0, 0);
        for (a, b) in points(model, *pair) {
            joined += usize::from(a == b);
            seen += 1;
        }
        seen >= MIN_MATCHES && joined as f64 <= MAX_JOINED * seen as f64
    };
    let torn: Vec<ImagePair> = graph.pairs().iter().filter(is_torn).map(|(pair, _)| *pair).collect();
    if torn.len() < MIN_PAIRS { Vec::new() } else { torn }
}

/// Whether a model that was made of another one by closing loops has made enough more matches one point.
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
pub(crate) fn join(graph: &CorrespondenceGraph, model: &mut Reconstruction, pairs: &[ImagePair]) {
    for pair in pairs {
        let Some(two_view) = graph.pairs().get(pair) else { continue };
        for m in &two_view.matches {
            let point = |o: Observation| model.image(o.image).point_of(o.keypoint);
            let (a, b) =
                (Observation { image: pair.a, keypoint: m.a }, Observation { image: pair.b, keypoint: m.b });
            let (Some(one), Some(other)) = (point(a), point(b)) else { continue };
            let (Some(track), Some(other_track)) = (model.track(one), model.track(other)) else { continue };
            let xyz = middle(track, other_track);
            model.merge_tracks(one, other, xyz);
        }
    }
}
