//! Plausibility of a pose by the continuity of the camera's motion.
//!
//! With repeated texture (windows of a facade) a wrong pose may have as many inliers as the correct
//! one, or more. The times of the images exclude poses that the camera cannot have reached from its
//! neighbours. Only neighbouring images have that information, so images are registered in order of
//! time if possible.
//!
//! Frames without times have their numbers instead, if each has a verified pair with the next one
//! and the camera moves as smoothly as a vehicle. Then the unit of time is a frame.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::evidence::Evidence;
use super::sequences::{Sequence, Times, sequences};
use crate::timeline::{MAX_CHANGE, usual};

/// The usual speed is the 90 % quantile over this many steps before and after an image, because the
/// scale of a long drive drifts until lens and shutter are estimated. With fewer than `MIN_STEPS`
/// steps the speed is unknown.
const KNOWN_STEPS: usize = 300;
const MIN_STEPS: usize = 10;
/// Maximum deviation from the position that the neighbours' velocity predicts, relative to the
/// distance travelled at the usual speed. An immediate reversal gives 2. Windows 8.7 m apart moved
/// a camera that makes 1 m a frame by 8.7 times, next to a wrongly registered frame by 4.
const MAX_DEVIATION: f64 = 2.0;
/// A deviation of this fraction is plausible for any camera. Half and double change nothing on four
/// rendered streets.
const MIN_DEVIATION: f64 = 0.5;
/// Of frames without times, one may be missing: then a step is twice as long. Chosen on seeds 14
/// and 15 of the streets without times (docs/benchmarks/drives.md). Half is [`MIN_DEVIATION`], with
/// which seed 14 gives two models. Double was not tried.
const MIN_DEVIATION_OF_FRAMES: f64 = 1.0;
/// Between both, the limit is the deviation that so many times the usual acceleration causes. Half
/// changes the error of one of the four streets from 14.4 to 13.6 cm, double changes nothing.
const MAX_ACCELERATIONS: f64 = 3.0;
/// Number of images before and after an image that are searched for a registered one.
const MAX_SEARCH: usize = 20;
/// Number of images before and after an image that are checked for a jump.
const MAX_NEIGHBOURS: usize = 3;

/// The images of each camera in order of time.
pub(crate) struct Timelines {
    sequences: Vec<Sequence>,
    /// The sequence of each image, and its place there.
    places: BTreeMap<ImageId, (usize, usize)>,
}

/// The usual motion of a camera around an image. Where times are numbers of frames, a second stands
/// for a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct UsualMotion {
    /// Units of the model a second.
    speed: f64,
    /// Units of the model a square second.
    acceleration: f64,
    /// [`MIN_DEVIATION`] or [`MIN_DEVIATION_OF_FRAMES`].
    min_deviation: f64,
}

/// What the poses around an image tell of the motion of its camera.
enum Motion {
    /// They are too few, or the times tell none.
    Unknown,
    /// Numbers of frames are no times here.
    Irregular,
    Usual(UsualMotion),
}

/// A camera centre at a time.
#[derive(Clone, Copy)]
struct Place {
    time_s: f64,
    centre: Vector3<f64>,
}

impl Place {
    fn of(model: &Reconstruction, (time_s, image): &(f64, ImageId)) -> Option<Self> {
        Some(Self { time_s: *time_s, centre: centre_of(model, *image)? })
    }

    /// In units of the model a second; `None` for equal times.
    fn velocity_to(&self, to: &Self) -> Option<Vector3<f64>> {
        let velocity = (to.centre - self.centre) / (to.time_s - self.time_s);
        velocity.iter().all(|number| number.is_finite()).then_some(velocity)
    }
}

impl UsualMotion {
    /// Whether the motion from `beyond` to `near` does not lead to a place. Without `beyond` the
    /// velocity is zero.
    fn is_out_of_reach(&self, place: &Place, near: &Place, beyond: Option<&Place>) -> bool {
        let elapsed_s = place.time_s - near.time_s;
        let reach = self.speed * elapsed_s.abs();
        let known = beyond.and_then(|one| Some((one.time_s, one.velocity_to(near)?)));
        let (velocity, limit) = match known {
            Some((beyond_s, velocity)) => {
                let span_s = (place.time_s - beyond_s).abs();
                let change = self.acceleration * elapsed_s.abs() * span_s / 2.0;
                let least = self.min_deviation * reach;
                (velocity, (MAX_ACCELERATIONS * change).max(least).min(MAX_DEVIATION * reach))
            }
            None => (Vector3::zeros(), MAX_DEVIATION * reach),
        };
        elapsed_s != 0.0 && (place.centre - near.centre - velocity * elapsed_s).norm() > limit
    }
}

impl Timelines {
    pub(crate) fn new(graph: &CorrespondenceGraph, model: &Reconstruction) -> Self {
        let sequences = sequences(graph, model);
        let mut places = BTreeMap::new();
        for (index, sequence) in sequences.iter().enumerate() {
            let images = sequence.images.iter().enumerate();
            places.extend(images.map(|(place, (_, image))| (*image, (index, place))));
        }
        Self { sequences, places }
    }

    /// The sequence of an image, and its place there.
    fn place(&self, image: ImageId) -> Option<(&Sequence, usize)> {
        self.places.get(&image).map(|(sequence, place)| (&self.sequences[*sequence], *place))
    }

    /// Returns the images of the same camera before and after an image, nearest first.
    fn sides(&self, image: ImageId) -> Option<[Vec<&(f64, ImageId)>; 2]> {
        let (Sequence { images, .. }, place) = self.place(image)?;
        let before = images[..place].iter().rev().take(MAX_SEARCH).collect();
        Some([before, images[place + 1..].iter().take(MAX_SEARCH).collect()])
    }

    /// Whether a candidate lies between this image and the nearest registered image of its camera.
    /// Numbers of frames may be no times. Where the motion does not show it yet, no image waits for
    /// one that has too little evidence.
    pub(crate) fn must_wait(
        &self,
        model: &Reconstruction,
        image: ImageId,
        candidates: &BTreeSet<ImageId>,
        evidence: Evidence,
    ) -> bool {
        let Some((sequence, _)) = self.place(image) else { return false };
        let Some(sides) = self.sides(image) else { return false };
        if sequence.times == Times::Frames {
            match self.motion(model, image) {
                Motion::Irregular => return false,
                Motion::Unknown if evidence == Evidence::Significant => return false,
                Motion::Unknown | Motion::Usual(_) => {}
            }
        }
        let has_pose = |other: &&(f64, ImageId)| model.image(other.1).cam_from_world().is_some();
        let nearest = sides.iter().filter_map(|side| Some((side.iter().position(has_pose)?, side)));
        nearest.min_by_key(|(steps, _)| *steps).is_some_and(|(steps, side)| {
            side[..steps].iter().any(|(_, other)| candidates.contains(other))
        })
    }

    /// Returns the usual motion of the camera around an image; `None` with too few registered
    /// neighbours, or if the times tell no motion.
    fn usual_motion(&self, model: &Reconstruction, image: ImageId) -> Option<UsualMotion> {
        match self.motion(model, image) {
            Motion::Usual(usual) => Some(usual),
            Motion::Unknown | Motion::Irregular => None,
        }
    }

    fn motion(&self, model: &Reconstruction, image: ImageId) -> Motion {
        let Some((Sequence { images, times }, place)) = self.place(image) else {
            return Motion::Unknown;
        };
        let around = place.saturating_sub(KNOWN_STEPS)..images.len().min(place + KNOWN_STEPS);
        let around = &images[around];
        let speed = |pair: &[(f64, ImageId)]| Some(velocity(model, &pair[0], &pair[1])?.norm());
        let speeds: Vec<f64> = around.windows(2).filter_map(speed).collect();
        if *times == Times::RoundedToSeconds || speeds.len() < MIN_STEPS {
            return Motion::Unknown;
        }
        let acceleration = |three: &[(f64, ImageId)]| {
            let before = velocity(model, &three[0], &three[1])?;
            let after = velocity(model, &three[1], &three[2])?;
            Some(2.0 * (after - before).norm() / (three[2].0 - three[0].0))
        };
        let accelerations: Vec<f64> = around.windows(3).filter_map(acceleration).collect();
        // Without three images in a row, any acceleration is usual.
        let are_known = accelerations.len() + 1 >= MIN_STEPS;
        let acceleration = usual(accelerations).filter(|_| are_known).unwrap_or(f64::INFINITY);
        let speed = usual(speeds).unwrap_or(0.0);
        if *times == Times::Seconds {
            let min_deviation = MIN_DEVIATION;
            return Motion::Usual(UsualMotion { speed, acceleration, min_deviation });
        }
        let mut intervals: Vec<f64> = around.windows(2).map(|two| two[1].0 - two[0].0).collect();
        let change = acceleration * median(&mut intervals).unwrap_or(0.0);
        if !are_known {
            return Motion::Unknown;
        }
        if change > MAX_CHANGE * speed {
            return Motion::Irregular;
        }
        let min_deviation = MIN_DEVIATION_OF_FRAMES;
        Motion::Usual(UsualMotion { speed, acceleration, min_deviation })
    }

    /// A part of a drive that is out of reach of the images before and after it, although these are
    /// in reach of each other: at most [`MAX_SEARCH`] images of a camera, as at the wrong copy of a
    /// place. `may_be` tells which images may be in it.
    pub(crate) fn part_out_of_reach(
        &self,
        model: &Reconstruction,
        may_be: &dyn Fn(ImageId) -> bool,
    ) -> Option<Vec<ImageId>> {
        self.sequences.iter().find_map(|Sequence { images, .. }| {
            let place = |image: &(f64, ImageId)| Some((image.1, Place::of(model, image)?));
            let posed: Vec<(ImageId, Place)> = images.iter().filter_map(place).collect();
            let at = |index: usize| &posed[index].1;
            // The motion before the first or after the second does not lead to the other.
            let contradictions = |usual: &UsualMotion, one: usize, next: usize| {
                [
                    usual.is_out_of_reach(at(next), at(one), Some(at(one - 1))),
                    usual.is_out_of_reach(at(one), at(next), Some(at(next + 1))),
                ]
            };
            (1..posed.len().saturating_sub(3)).find_map(|before| {
                let usual = self.usual_motion(model, posed[before].0)?;
                let is_jump = |one: usize| contradictions(&usual, one, one + 1) == [true; 2];
                let last = (posed.len() - 2).min(before + MAX_SEARCH + 1);
                let is_after = |after: &usize| {
                    is_jump(after - 1)
                        && contradictions(&usual, before, *after) == [false; 2]
                        && posed[before + 1..*after].iter().all(|(image, _)| may_be(*image))
                };
                let after = (before + 2..=last).find(is_after).filter(|_| is_jump(before))?;
                Some(posed[before + 1..after].iter().map(|(image, _)| *image).collect())
            })
        })
    }

    /// What the motion of the camera tells of the pose of an image; `None` as for
    /// [`Timelines::usual_motion`].
    pub(crate) fn expected_motion<'a>(
        &'a self,
        model: &'a Reconstruction,
        image: ImageId,
    ) -> Option<ExpectedMotion<'a>> {
        let usual = self.usual_motion(model, image)?;
        let (Sequence { images, .. }, place) = self.place(image)?;
        let (time_s, sides) = (images[place].0, self.sides(image)?);
        Some(ExpectedMotion { model, usual, time_s, sides })
    }
}

/// The motion of the images before and after an image.
pub(crate) struct ExpectedMotion<'a> {
    model: &'a Reconstruction,
    usual: UsualMotion,
    time_s: f64,
    /// The images before and after, nearest first.
    sides: [Vec<&'a (f64, ImageId)>; 2],
}

impl ExpectedMotion<'_> {
    /// Whether a pose contradicts the motion.
    pub(crate) fn contradicts(&self, cam_from_world: &Rigid3) -> bool {
        let place = Place { time_s: self.time_s, centre: cam_from_world.origin_in_a() };
        let contradicts = |side: &[&(f64, ImageId)], step: usize| {
            let near = Place::of(self.model, side[step]);
            let beyond = side.get(step + 1).and_then(|beyond| Place::of(self.model, beyond));
            near.is_some_and(|near| self.usual.is_out_of_reach(&place, &near, beyond.as_ref()))
        };
        self.sides
            .iter()
            .any(|side| (0..side.len().min(MAX_NEIGHBOURS)).any(|step| contradicts(side, step)))
    }

    /// The centre at constant velocity from the nearest two images in a row with poses, the next of
    /// them within [`MAX_NEIGHBOURS`].
    pub(crate) fn centre(&self) -> Option<Vector3<f64>> {
        let from_side = |side: &Vec<&(f64, ImageId)>| {
            side.windows(2).take(MAX_NEIGHBOURS).find_map(|two| {
                let elapsed_s = self.time_s - two[0].0;
                let velocity = velocity(self.model, two[1], two[0])?;
                Some((elapsed_s, centre_of(self.model, two[0].1)? + velocity * elapsed_s))
            })
        };
        let both = self.sides.iter().filter_map(from_side);
        both.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).map(|(_, centre)| centre)
    }
}

fn centre_of(model: &Reconstruction, image: ImageId) -> Option<Vector3<f64>> {
    Some(model.image(image).cam_from_world()?.origin_in_a())
}

/// Velocity between two registered images, in units of the model a second; `None` for equal times.
fn velocity(
    model: &Reconstruction,
    from: &(f64, ImageId),
    to: &(f64, ImageId),
) -> Option<Vector3<f64>> {
    Place::of(model, from)?.velocity_to(&Place::of(model, to)?)
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image, ImagePair, TwoView, TwoViewKind};

    use super::*;

    const IMAGES: usize = 32;

    fn unconnected() -> CorrespondenceGraph {
        CorrespondenceGraph::new(&[0; IMAGES], [])
    }

    fn at(x: f64) -> Rigid3 {
        Rigid3 { translation: Vector3::new(-x, 0.0, 0.0), ..Rigid3::identity() }
    }

    /// Images of one camera, one second and one unit apart, of which the first `num_registered` are
    /// registered. Their ids are not in order of time.
    fn drive(num_registered: usize) -> (Reconstruction, Vec<ImageId>) {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let mut images: Vec<ImageId> = (0..IMAGES)
            .map(|i| model.add_image(Image::new(format!("{i}.jpg"), camera, Vec::new())))
            .collect();
        images.reverse();
        for (place, &image) in images.iter().enumerate() {
            model.set_time(image, Some(place as f64));
            if place < num_registered {
                model.register(image, at(place as f64));
            }
        }
        (model, images)
    }

    #[test]
    fn an_image_waits_for_candidates_between_it_and_the_model() {
        let (model, images) = drive(4);
        let timelines = Timelines::new(&unconnected(), &model);
        let candidates = BTreeSet::from([images[4], images[7]]);
        assert!(!timelines.must_wait(&model, images[4], &candidates, Evidence::Usual));
        assert!(timelines.must_wait(&model, images[7], &candidates, Evidence::Usual));
        // No candidate lies between.
        assert!(!timelines.must_wait(
            &model,
            images[7],
            &BTreeSet::from([images[7], images[9]]),
            Evidence::Usual
        ));
    }

    #[test]
    fn cameras_without_times_do_not_wait() {
        let (mut model, images) = drive(4);
        images.iter().for_each(|&image| model.set_time(image, None));
        let timelines = Timelines::new(&unconnected(), &model);
        assert!(!timelines.must_wait(
            &model,
            images[7],
            &images.iter().copied().collect(),
            Evidence::Usual
        ));
        assert_eq!(timelines.usual_motion(&model, images[7]), None);
    }

    /// Verified pairs of images that are next to each other in a list.
    fn linked(images: &[ImageId]) -> CorrespondenceGraph {
        let two_view = TwoView { kind: TwoViewKind::Calibrated, ..TwoView::default() };
        let pairs = images.windows(2).filter_map(|two| ImagePair::new(two[0], two[1]));
        let pairs: Vec<_> = pairs.map(|pair| (pair, two_view.clone())).collect();
        CorrespondenceGraph::new(&[0; IMAGES], pairs)
    }

    /// The motion at an image, of cameras without times.
    #[test]
    fn frames_with_numbers_have_a_motion_if_it_is_smooth() {
        let known = MIN_STEPS + 2;
        let (mut model, images) = drive(known);
        images.iter().for_each(|&image| model.set_time(image, None));
        let next = images[known];
        let contradicts = |graph: &CorrespondenceGraph, model: &Reconstruction, x: f64| {
            let timelines = Timelines::new(graph, model);
            let expected = timelines.expected_motion(model, next)?;
            Some(expected.contradicts(&at(x)))
        };
        let graph = linked(&images);
        // The names count down.
        let place = known as f64;
        assert_eq!(contradicts(&graph, &model, place), Some(false));
        // A frame may be missing.
        assert_eq!(contradicts(&graph, &model, place + 0.9), Some(false));
        assert_eq!(contradicts(&graph, &model, place + 1.1), Some(true));
        let candidates = BTreeSet::from([images[known], images[known + 3]]);
        let must_wait = |graph: &CorrespondenceGraph, model: &Reconstruction| {
            Timelines::new(graph, model).must_wait(
                model,
                images[known + 3],
                &candidates,
                Evidence::Usual,
            )
        };
        assert!(must_wait(&graph, &model));
        // A sequence ends where the next image shows something else.
        let cut = linked(&images[known..]);
        assert_eq!(contradicts(&cut, &model, place), None);
        assert!(!must_wait(&cut, &model));
        // Photos of a walk in all directions.
        for (k, image) in images[..known].iter().enumerate() {
            model.register(*image, at((k * 7 % known) as f64));
        }
        assert_eq!(contradicts(&graph, &model, place), None);
        assert!(!must_wait(&graph, &model));
    }

    #[test]
    fn a_pose_beyond_the_reach_of_the_camera_contradicts_its_motion() {
        let last = MIN_STEPS + 1;
        let (model, images) = drive(last);
        let timelines = Timelines::new(&unconnected(), &model);
        let expected = timelines.expected_motion(&model, images[last]).expect("steps enough");
        let centre = expected.centre().expect("two images before have poses");
        assert!((centre.x - last as f64).abs() < 1e-12, "{centre}");
        let usual = expected.usual;
        assert!((usual.speed - 1.0).abs() < 1e-12);
        let contradicts_motion = |x: f64, acceleration: f64| {
            let usual = UsualMotion { acceleration, ..usual };
            let expected = timelines.expected_motion(&model, images[last]).expect("steps enough");
            let expected = ExpectedMotion { usual, ..expected };
            expected.contradicts(&at(last as f64 + x))
        };
        // Of a camera that brakes and turns at will, stopping and reversing are plausible; larger
        // deviations are not.
        assert!([0.0, -1.0, -1.9, 1.0].iter().all(|x| !contradicts_motion(*x, 1.0)));
        assert!(contradicts_motion(2.1, 1.0) && contradicts_motion(-2.1, 1.0));
        // The images are at constant speed, up to the noise of their poses.
        assert!(usual.acceleration < 1e-9);
        assert!(!contradicts_motion(0.4, 0.0) && !contradicts_motion(-0.4, 0.0));
        assert!(contradicts_motion(0.6, 0.0) && contradicts_motion(-0.6, 0.0));
        assert!(!contradicts_motion(-0.8, 0.3) && contradicts_motion(-1.0, 0.3));
        // Equal times give no velocity.
        let (mut twice, images) = drive(last + 1);
        for (place, &image) in images.iter().enumerate() {
            twice.set_time(image, Some(place as f64 + 0.5));
        }
        twice.set_time(images[last + 1], Some(last as f64 + 0.5));
        let timelines = Timelines::new(&unconnected(), &twice);
        let expected = timelines.expected_motion(&twice, images[last + 1]).expect("steps enough");
        assert!(!expected.contradicts(&at(last as f64)));
        // Times that were rounded to seconds tell no motion.
        for (place, &image) in images.iter().enumerate() {
            twice.set_time(image, Some((place / 2) as f64));
        }
        assert!(
            Timelines::new(&unconnected(), &twice)
                .expected_motion(&twice, images[last + 1])
                .is_none()
        );
        let (model, images) = drive(last - 1);
        assert_eq!(Timelines::new(&unconnected(), &model).usual_motion(&model, images[last]), None);
    }

    /// Windows of a facade apart, as the wrong copies of a place are.
    #[test]
    fn parts_at_a_wrong_copy_of_a_place_are_out_of_reach() {
        const DISPLACED: f64 = 4.0;
        let out_of_reach = |displaced: &[usize]| {
            let (mut model, images) = drive(IMAGES);
            for &place in displaced {
                model.register(images[place], at(place as f64 + DISPLACED));
            }
            let timelines = Timelines::new(&unconnected(), &model);
            let mut found = Vec::new();
            while let Some(part) = timelines.part_out_of_reach(&model, &|_| true) {
                part.iter().for_each(|image| model.deregister(*image));
                let place = |image| images.iter().position(|other| *other == image).unwrap();
                found.extend(part.into_iter().map(place));
            }
            found
        };
        let wrong: [&[usize]; 3] = [&[], &[9], &[20, 21, 22]];
        wrong.iter().for_each(|wrong| assert_eq!(out_of_reach(wrong), *wrong));
        // The ends of a drive, and parts that do not come back, may be right.
        let from_ten: Vec<usize> = (10..IMAGES).collect();
        let right: [&[usize]; 3] = [&[0, 1], &[30, 31], &from_ten];
        right.iter().for_each(|right| assert_eq!(out_of_reach(right), [0; 0]));
        // A camera that stops and starts again is where its motion leads.
        let (mut model, images) = drive(IMAGES);
        for (place, image) in images.iter().enumerate() {
            model.register(*image, at(place.min(12).max(place.saturating_sub(6)) as f64));
        }
        assert_eq!(
            Timelines::new(&unconnected(), &model).part_out_of_reach(&model, &|_| true),
            None
        );
    }
}
