//! Automatic choice of image pairs: which images are sequences, and which pairs are matched.

use crate::pairs::{Pair, Sequence, normalise};
use crate::retrieval::Similar;

/// Most cameras in parallel whose neighbours [`num_similar`] allows for. An image of a larger rig
/// may have fewer loops.
const MAX_PARALLEL: usize = 8;
/// An order is that of a sequence if in this share of the images the next image is among the most
/// similar ones. It is nearly 1 in a sequence, and at most [`MAX_REACH`] in a random order of 20
/// images or more.
const MIN_ORDERED: f64 = 0.5;
/// The most similar ones are at most this share of the images of a camera, of fewer than 20 images
/// the most similar two: those before and after. The share is that of 20 of 200 images, below which
/// all pairs were matched; half and double were not tried.
const MAX_REACH: f64 = 0.1;
const MIN_REACH: usize = 2;
/// Of few images, times show a recording if they are less apart, in seconds: nobody takes photos by
/// hand at shorter intervals.
const MAX_INTERVAL_S: f64 = 1.0;

/// Source of the order of the images of a camera. Positions from different sources are not
/// comparable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SequenceOrder {
    /// Nothing: the images are no sequence.
    Unknown,
    /// Their times.
    Times,
    /// The numbers in their names.
    Numbers,
}

/// The images of a camera, in their order if they have one.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraImages {
    /// The images, with their times or numbers in ascending order if there is an order.
    pub sequence: Sequence,
    /// Source of the order.
    pub order: SequenceOrder,
}

/// The pairs that [`PairSelection::Auto`](crate::PairSelection::Auto) selects.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AutoPairs {
    /// The pairs, sorted.
    pub pairs: Vec<Pair>,
    /// Whether the images of each camera are a sequence.
    pub is_sequence: Vec<bool>,
}

impl AutoPairs {
    /// Largest number of images of which all pairs are matched unless they are recordings: 19,900
    /// pairs, minutes on a few cores. 100 images have a quarter of these pairs, 400 four times as
    /// many.
    pub const MAX_EXHAUSTIVE: usize = 200;
    /// Largest number of images of which all pairs are matched: the neighbours and loops of a
    /// recording would be as many.
    pub const MAX_ALWAYS_EXHAUSTIVE: usize = 2 * (Self::OVERLAP as usize + Self::NUM_LOOP_IMAGES);
    /// Number of neighbours before and after an image of a sequence: the default overlap of
    /// COLMAP's sequential matcher. The time of matching is proportional to it; similar images
    /// close gaps.
    pub const OVERLAP: u32 = 10;
    /// Number of similar images with which an image of a sequence is matched beside its neighbours,
    /// for loops. If the camera comes back once, as many images see a place again as there are
    /// neighbours.
    pub const NUM_LOOP_IMAGES: usize = 2 * Self::OVERLAP as usize;
    /// Number of similar images with which an image of no sequence is matched: the default of
    /// COLMAP's vocabulary tree matcher. Of 1,000 rendered photos with 90 true pairs each
    /// (`docs/benchmarks/matching.md`), half as many hold 0.53 of the true pairs with half the time
    /// of matching, and twice as many 0.83.
    pub const NUM_SIMILAR_IMAGES: usize = 100;
}

/// Whether images of these cameras may be recordings, of which [`auto_pairs`] selects fewer than
/// all pairs for any number of images above [`AutoPairs::MAX_ALWAYS_EXHAUSTIVE`].
pub fn may_be_recordings(cameras: &[CameraImages]) -> bool {
    let have = |order| cameras.iter().filter(|camera| camera.order == order).count();
    have(SequenceOrder::Times) > 0 || have(SequenceOrder::Numbers) > 1
}

/// Number of similar images of each image that [`auto_pairs`] needs: the neighbours of a sequence
/// in all cameras are among them.
pub fn num_similar(cameras: &[CameraImages]) -> usize {
    let ordered = cameras.iter().filter(|camera| camera.order != SequenceOrder::Unknown).count();
    AutoPairs::NUM_SIMILAR_IMAGES.max(
        AutoPairs::NUM_LOOP_IMAGES
            + ordered.min(MAX_PARALLEL) * (2 * AutoPairs::OVERLAP as usize + 1),
    )
}

/// The pairs of images of which `similar` has the [`num_similar`] most similar images each, the
/// most similar first.
///
/// Images of a sequence have their [`AutoPairs::OVERLAP`] neighbours before and after, and the
/// [`AutoPairs::NUM_LOOP_IMAGES`] most similar other images. All other images have their
/// [`AutoPairs::NUM_SIMILAR_IMAGES`] most similar images. The images of a camera with an order are
/// a sequence if consecutive images are similar. Sequences of two cameras run in parallel if
/// simultaneous images are similar; then each image has the simultaneous image of the other camera
/// and its neighbours, too.
///
/// Of up to [`AutoPairs::MAX_EXHAUSTIVE`] images, only recordings are sequences, and all other
/// images have all images. A sequence is a recording if its times are less than a second apart, or
/// if it runs in parallel to another one. Numbers alone and slower times may be those of photos
/// around one object, which all see each other.
pub fn auto_pairs(cameras: &[CameraImages], similar: &[Vec<Similar>]) -> AutoPairs {
    let is_few = similar.len() <= AutoPairs::MAX_EXHAUSTIVE;
    let ordered: Vec<usize> =
        (0..cameras.len()).filter(|k| follows(&cameras[*k], &cameras[*k], similar)).collect();
    let mut is_sequence = vec![false; cameras.len()];
    let mut pairs = Vec::new();
    for (at, &k) in ordered.iter().enumerate() {
        let from = &cameras[k];
        let is_fast = || from.sequence.median_interval_s() < MAX_INTERVAL_S;
        is_sequence[k] |= !is_few || from.order == SequenceOrder::Times && is_fast();
        push_neighbours(&mut pairs, from, from);
        for &other in &ordered[at + 1..] {
            let to = &cameras[other];
            if follows(from, to, similar) {
                (is_sequence[k], is_sequence[other]) = (true, true);
                push_neighbours(&mut pairs, from, to);
                push_neighbours(&mut pairs, to, from);
            }
        }
    }
    let neighbours = normalise(pairs.clone());
    for (camera, is_sequence) in cameras.iter().zip(&is_sequence) {
        let count =
            if *is_sequence { AutoPairs::NUM_LOOP_IMAGES } else { AutoPairs::NUM_SIMILAR_IMAGES };
        for &a in camera.sequence.images() {
            if is_few && !is_sequence {
                pairs.extend((0..similar.len() as u32).map(|b| (a, b)));
                continue;
            }
            let others = similar[a as usize].iter().map(|other| (a, other.image));
            let is_new = |&(a, b): &Pair| neighbours.binary_search(&(a.min(b), a.max(b))).is_err();
            pairs.extend(others.filter(is_new).take(count));
        }
    }
    AutoPairs { pairs: normalise(pairs), is_sequence }
}

/// Whether the images of `to` are in the order of those of `from`: an image of `from` and its
/// simultaneous image of `to`, or the next image if it is the same camera, are similar.
fn follows(from: &CameraImages, to: &CameraImages, similar: &[Vec<Similar>]) -> bool {
    if from.order == SequenceOrder::Unknown || from.order != to.order {
        return false;
    }
    let mut is_of_other = vec![false; similar.len()];
    to.sequence.images().iter().for_each(|&image| is_of_other[image as usize] = true);
    let share = (MAX_REACH * to.sequence.len() as f64) as usize;
    let reach = share.clamp(MIN_REACH, 2 * AutoPairs::OVERLAP as usize);
    let next = usize::from(std::ptr::eq(from, to));
    let [mut ordered, mut all] = [0u32; 2];
    for (&image, position) in from.sequence.images().iter().zip(positions(from, to)) {
        let other = position.and_then(|position| to.sequence.images().get(position + next));
        let Some(&other) = other else { continue };
        let mut of_other = similar[image as usize].iter().filter(|s| is_of_other[s.image as usize]);
        all += 1;
        ordered += u32::from(of_other.by_ref().take(reach).any(|s| s.image == other));
    }
    // More than none: cameras that were never on at the same time have no simultaneous images.
    ordered > 0 && f64::from(ordered) >= MIN_ORDERED * f64::from(all)
}

/// Pairs each image with the neighbours of its simultaneous image, if there is one.
fn push_neighbours(pairs: &mut Vec<Pair>, from: &CameraImages, to: &CameraImages) {
    let reach = AutoPairs::OVERLAP as usize;
    let others = to.sequence.images();
    for (&image, position) in from.sequence.images().iter().zip(positions(from, to)) {
        let Some(centre) = position else { continue };
        let end = (centre + reach + 1).min(others.len());
        pairs.extend(others[centre.saturating_sub(reach)..end].iter().map(|&other| (image, other)));
    }
}

/// For each image of `from`, the position of its simultaneous image in `to`: itself if it is the
/// same camera; none if `to` has no image within its usual interval.
fn positions(from: &CameraImages, to: &CameraImages) -> Vec<Option<usize>> {
    if std::ptr::eq(from, to) {
        return (0..from.sequence.images().len()).map(Some).collect();
    }
    let interval_s = to.sequence.median_interval_s();
    let position = |&time_s: &f64| {
        let position = to.sequence.position_at(time_s);
        let nearest_s = to.sequence.times_s().get(position)?;
        ((nearest_s - time_s).abs() <= interval_s).then_some(position)
    };
    from.sequence.times_s().iter().map(position).collect()
}

#[cfg(test)]
mod tests;
