//! Cameras that are one camera: recordings that follow each other.
//!
//! Each clip of a camera is a camera of its own. A clip without a date has the times of its first
//! one, and on a straight road at constant speed the poses of one clip relative to those of the
//! other are as constant as on a rig. In a model they follow each other instead: one begins where
//! the other ends, and is nowhere beside it.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::candidates::rig_candidates;
use crate::frame_names::natural_order;
use crate::timeline::images_in_coarse_time;

/// Fewest posed images of a camera, and most that are compared.
const MIN_IMAGES: usize = 4;
const MAX_IMAGES: usize = 200;
/// Share of the images of each camera whose nearest image of the other is its first or last one. On
/// a rig it is the share of the drive that one camera alone recorded, which is below a half where
/// an offset of the clocks is searched.
const MIN_AT_ENDS: f64 = 0.9;
/// Largest distance from the end of one recording to the beginning of the other, relative to the
/// length of the shorter one, and largest angle. A rig that moves by no more than its baseline, in
/// the direction of it, has a gap, too: with 0.2 it is a rig unless it moves by 0.8 of it to 1.1.
const MAX_GAP: f64 = 0.2;
const MAX_TURN_RAD: f64 = 0.5;
/// Recordings whose times have less than this share of the shorter one in common are not taken at
/// the same time, and may be further apart.
const MIN_COMMON_TIME: f64 = 0.5;

/// The images of the cameras that may be on a rig: of cameras whose recordings follow each other
/// the first one. Without poses those of [`rig_candidates`].
pub(super) fn rig_candidates_apart(model: &Reconstruction) -> BTreeMap<CameraId, Vec<ImageId>> {
    let mut candidates = rig_candidates(model);
    for [_, later] in successive_cameras(model) {
        candidates.remove(&later);
    }
    candidates
}

/// The pairs of cameras whose recordings follow each other, which is what one camera does: the
/// first with each later one.
pub fn successive_cameras(model: &Reconstruction) -> Vec<[CameraId; 2]> {
    let candidates = rig_candidates(model);
    let recordings: Vec<Recording> =
        candidates.iter().filter_map(|(id, images)| Recording::new(model, *id, images)).collect();
    // The first recording of each group of recordings that follow each other. Each follows the one
    // whose end is nearest: of two cameras with two clips each, not the clip of the other camera.
    let mut first: Vec<usize> = (0..recordings.len()).collect();
    for (later, recording) in recordings.iter().enumerate() {
        let gap = |earlier: &usize| recordings[*earlier].gap_to(recording);
        let follows = |earlier: &usize| recordings[*earlier].is_followed_by(recording);
        let before = (0..recordings.len()).filter(|other| *other != later).filter(follows);
        if let Some(earlier) = before.min_by(|a, b| gap(a).total_cmp(&gap(b))) {
            let (one, other) = (first[earlier], first[later]);
            let (kept, joined) = (one.min(other), one.max(other));
            first.iter_mut().filter(|group| **group == joined).for_each(|group| *group = kept);
        }
    }
    let groups = first.into_iter().enumerate().filter(|(index, group)| index != group);
    groups.map(|(index, group)| [recordings[group].camera, recordings[index].camera]).collect()
}

/// The poses of a camera in their order.
struct Recording {
    camera: CameraId,
    poses: Vec<Rigid3>,
    /// The first and the last time, if the images have times.
    span_s: Option<[f64; 2]>,
}

impl Recording {
    fn new(model: &Reconstruction, camera: CameraId, images: &[ImageId]) -> Option<Self> {
        let times = images_in_coarse_time(model, images);
        let span_s = times.as_ref().and_then(|times| Some([times.first()?.0, times.last()?.0]));
        let ordered: Vec<ImageId> = match times {
            Some(times) => times.into_iter().map(|(_, image)| image).collect(),
            None => {
                let mut images = images.to_vec();
                let name = |image: &ImageId| &model.image(*image).name;
                images.sort_by(|a, b| natural_order(name(a), name(b)));
                images
            }
        };
        let poses: Vec<Rigid3> = ordered
            .iter()
            .filter_map(|image| model.image(*image).cam_from_world().copied())
            .collect();
        (poses.len() >= MIN_IMAGES).then_some(Self { camera, poses, span_s })
    }

    /// Whether another recording begins where this one ends, or later, and goes on from there.
    fn is_followed_by(&self, other: &Self) -> bool {
        let (end, begin) = (&self.poses[self.poses.len() - 1], &other.poses[0]);
        let goes_on = self.gap_to(other) <= MAX_GAP * self.length().min(other.length())
            && end.rotation.angle_to(&begin.rotation) <= MAX_TURN_RAD;
        (goes_on || self.is_before(other)) && self.is_beyond(other) && other.is_beyond(self)
    }

    /// The distance from the end of this recording to the beginning of another.
    fn gap_to(&self, other: &Self) -> f64 {
        let end = &self.poses[self.poses.len() - 1];
        (end.origin_in_a() - other.poses[0].origin_in_a()).norm()
    }

    fn length(&self) -> f64 {
        let step = |two: &[Rigid3]| (two[1].origin_in_a() - two[0].origin_in_a()).norm();
        self.poses.windows(2).map(step).sum()
    }

    /// Whether this recording was taken before the other one, by their times.
    fn is_before(&self, other: &Self) -> bool {
        let (Some([begin, end]), Some([other_begin, other_end])) = (self.span_s, other.span_s)
        else {
            return false;
        };
        let shorter = (end - begin).min(other_end - other_begin);
        begin < other_begin && end - other_begin < MIN_COMMON_TIME * shorter
    }

    /// Whether an end of this recording is nearer to nearly all images of the other than what is
    /// between.
    fn is_beyond(&self, other: &Self) -> bool {
        let sampled = |poses: &[Rigid3]| -> Vec<_> {
            let count = poses.len().min(MAX_IMAGES);
            let index = |k: usize| k * (poses.len() - 1) / (count - 1);
            (0..count).map(|k| poses[index(k)].origin_in_a()).collect()
        };
        let (here, there) = (sampled(&self.poses), sampled(&other.poses));
        let is_at_end = |centre: &&tiepoint_geometry::nalgebra::Vector3<f64>| {
            let distance = |index: &usize| (here[*index] - **centre).norm();
            let nearest = (0..here.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            nearest.is_some_and(|nearest| nearest == 0 || nearest + 1 == here.len())
        };
        let at_end = there.iter().filter(is_at_end).count();
        at_end as f64 >= MIN_AT_ENDS * there.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::Vector3;
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;
    use crate::rigs::{rig_pairs, sensor_pairs};

    const NUM_IMAGES: usize = 20;

    /// The centre of an image by its number.
    type Motion<'a> = &'a dyn Fn(f64) -> Vector3<f64>;

    /// Recordings of cameras: their motion, and the time of the first image.
    fn model(recordings: &[(Motion, Option<f64>)]) -> Reconstruction {
        let mut model = Reconstruction::default();
        for (index, (centre, begin_s)) in recordings.iter().enumerate() {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
            let camera = model.add_camera(camera);
            for k in 0..NUM_IMAGES {
                let image = model.add_image(Image::new(format!("{index}/{k}.png"), camera, vec![]));
                model.set_time(image, begin_s.map(|begin_s| begin_s + 0.1 * k as f64));
                let pose = Rigid3::new(Rigid3::identity().rotation, -centre(k as f64));
                model.register(image, pose);
            }
        }
        model
    }

    fn straight(from: f64, aside: f64) -> impl Fn(f64) -> Vector3<f64> {
        move |k| Vector3::new(aside, 0.0, from + k)
    }

    #[test]
    fn clips_of_one_camera_are_no_rig() {
        let next = NUM_IMAGES as f64;
        // Without times, with times from the same beginning as of undated clips, and dated.
        for times in [[None, None], [Some(0.0), Some(0.0)], [Some(0.0), Some(2.0)]] {
            let clips = model(&[(&straight(0.0, 0.0), times[0]), (&straight(next, 0.0), times[1])]);
            assert_eq!(successive_cameras(&clips), [[CameraId(0), CameraId(1)]], "{times:?}");
            assert!(rig_pairs(&clips).is_empty(), "{times:?}");
            assert!(sensor_pairs(&clips).is_empty(), "{times:?}");
        }
        // A pause of the clips: times tell, if there are any.
        for (second_s, is_one) in [(Some(60.0), true), (Some(0.0), false)] {
            let clips =
                model(&[(&straight(0.0, 0.0), Some(0.0)), (&straight(2.0 * next, 0.0), second_s)]);
            assert_eq!(!successive_cameras(&clips).is_empty(), is_one);
        }
        // Three clips round an object, the last given first.
        let arc = |from: f64| {
            move |k: f64| {
                let angle = (from + k) / (3.0 * NUM_IMAGES as f64) * std::f64::consts::TAU;
                Vector3::new(10.0 * angle.sin(), 0.0, 10.0 * angle.cos())
            }
        };
        let clips = model(&[(&arc(2.0 * next), None), (&arc(0.0), None), (&arc(next), None)]);
        assert_eq!(
            successive_cameras(&clips),
            [[CameraId(0), CameraId(1)], [CameraId(0), CameraId(2)]]
        );
    }

    #[test]
    fn cameras_beside_each_other_are_a_rig() {
        let rigs: [(f64, f64, Option<f64>); 5] = [
            // Stereo, one ahead of the other by a quarter of the drive, clocks an hour apart.
            (0.0, 0.5, Some(0.0)),
            (5.0, 0.0, Some(0.0)),
            (0.0, 0.5, Some(3600.0)),
            (5.0, 0.5, None),
            // The second camera began at a third of the drive.
            (7.0, 0.5, Some(0.7)),
        ];
        for (ahead, aside, begin_s) in rigs {
            let rig = model(&[
                (&straight(0.0, 0.0), begin_s.map(|_| 0.0)),
                (&straight(ahead, aside), begin_s),
            ]);
            assert!(successive_cameras(&rig).is_empty(), "{ahead} {aside} {begin_s:?}");
        }
        // A rig that stands, and one that moves sideways by half of its baseline.
        let still = |aside: f64| move |k: f64| Vector3::new(aside, 1e-3 * (7.0 * k).sin(), 0.0);
        assert!(successive_cameras(&model(&[(&still(0.0), None), (&still(0.5), None)])).is_empty());
        let sideways = |from: f64| move |k: f64| Vector3::new(from + k, 0.0, 0.0);
        let far = 2.0 * NUM_IMAGES as f64;
        let moved = model(&[(&sideways(0.0), Some(0.0)), (&sideways(far), Some(0.0))]);
        assert!(successive_cameras(&moved).is_empty());
        // Two clips of each of two cameras are one rig.
        let next = NUM_IMAGES as f64;
        let both = model(&[
            (&straight(0.0, 0.0), Some(0.0)),
            (&straight(next, 0.0), Some(2.0)),
            (&straight(0.0, 0.5), Some(0.0)),
            (&straight(next, 0.5), Some(2.0)),
        ]);
        let pairs: Vec<_> =
            sensor_pairs(&both).iter().map(|pair| (pair.reference.0, pair.other.0)).collect();
        assert_eq!(pairs, [(0, 2)]);
    }
}
