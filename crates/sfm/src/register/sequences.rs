//! The images of a camera in the order in which they were taken.
//!
//! Images with capture times are in their order. Video frames without times have numbers in their
//! names. Photos may have numbers, too: what tells frames from them are the verified matches. A
//! frame has about as many with its neighbours as with any other image, and they are many.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{CameraId, CorrespondenceGraph, ImageId, ImagePair, Reconstruction};

use crate::timeline::{images_by_number, is_rounded};

/// A frame has at least this share of its most matches with the frame before or after it. All
/// frames of rendered streets, of KITTI and of temple_ring do; of four rendered collections of
/// photos in no order, 8 to 37 % do. With half, 18 to 75 % do, and none becomes a sequence; with
/// double, 93 to 100 % of the streets' frames do, and temple_ring (79 %) is none.
const MIN_SHARE_OF_MATCHES: f64 = 0.5;
/// And it shares at least this part of its keypoints with one of them. Chosen on lund, a walk with
/// large steps, of which 62 % of the photos do and which stays without an order. With half it is a
/// sequence (97 %) and loses two of 29 photos; with double, streets, KITTI and temple_ring stay
/// sequences (all frames).
const MIN_SHARE_OF_KEYPOINTS: f64 = 0.05;
/// At least this share of the images of a sequence does so: a frame may be blurred. Not varied.
const MIN_SHARE_OF_FRAMES: f64 = 0.9;

/// Images of one camera in order.
pub(super) struct Sequence {
    pub(super) images: Vec<(f64, ImageId)>,
    pub(super) times: Times,
}

/// What the times of a sequence are.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Times {
    Seconds,
    /// Rounded to seconds, which tells an order but no motion.
    RoundedToSeconds,
    /// Numbers of frames.
    Frames,
}

/// The sequences of all cameras.
pub(super) fn sequences(graph: &CorrespondenceGraph, model: &Reconstruction) -> Vec<Sequence> {
    let mut cameras: BTreeMap<CameraId, Vec<(f64, ImageId)>> = BTreeMap::new();
    for (id, image) in model.images() {
        if let Some(time_s) = image.time_s.filter(|time_s| time_s.is_finite()) {
            cameras.entry(image.camera).or_default().push((time_s, id));
        }
    }
    let mut streams: BTreeMap<(CameraId, &str), Vec<ImageId>> = BTreeMap::new();
    // Images behind those of the graph, as localised ones, have no matches.
    let in_graph = model.images().take(graph.num_images());
    for (id, image) in in_graph.filter(|(_, image)| !cameras.contains_key(&image.camera)) {
        streams.entry((image.camera, &image.stream)).or_default().push(id);
    }
    let numbered = streams.values().filter_map(|images| images_by_number(model, images));
    let numbered: Vec<Sequence> =
        numbered.flat_map(|images| numbered_frames(graph, model, images)).collect();
    let timed = cameras.into_values().map(|mut images| {
        images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let is_rounded = is_rounded(images.iter().map(|(time_s, _)| *time_s));
        let times = if is_rounded { Times::RoundedToSeconds } else { Times::Seconds };
        Sequence { images, times }
    });
    timed.chain(numbered).collect()
}

/// The sequences of frames in images with numbers: parts in which each has a verified pair with the
/// next one. A cut of the video or a missing piece ends one.
fn numbered_frames(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    images: Vec<(f64, ImageId)>,
) -> Vec<Sequence> {
    let stream: BTreeSet<ImageId> = images.iter().map(|(_, id)| *id).collect();
    let num_matches = |one: ImageId, other: ImageId| {
        let view = ImagePair::new(one, other).and_then(|pair| graph.pairs().get(&pair));
        view.map_or(0, |view| view.matches.len())
    };
    let is_linked =
        |one: &(f64, ImageId), next: &(f64, ImageId)| graph.neighbours(one.1).contains(&next.1);
    let are_frames = |part: &&[(f64, ImageId)]| {
        let is_frame = |place: &usize| {
            let image = part[*place].1;
            let others = graph.neighbours(image).iter().filter(|other| stream.contains(other));
            let most = others.map(|other| num_matches(image, *other)).max().unwrap_or(0);
            let next_to_it = [place.checked_sub(1), Some(place + 1)].into_iter().flatten();
            let next_to_it = next_to_it.filter_map(|place| part.get(place));
            let num = next_to_it.map(|(_, other)| num_matches(image, *other)).max().unwrap_or(0);
            let num_keypoints = model.image(image).keypoints.len();
            num as f64 >= MIN_SHARE_OF_MATCHES * most as f64
                && num as f64 >= MIN_SHARE_OF_KEYPOINTS * num_keypoints as f64
        };
        let num_frames = (0..part.len()).filter(is_frame).count();
        part.len() > 1 && num_frames as f64 >= MIN_SHARE_OF_FRAMES * part.len() as f64
    };
    let parts = images.chunk_by(is_linked).filter(are_frames);
    parts.map(|part| Sequence { images: part.to_vec(), times: Times::Frames }).collect()
}
