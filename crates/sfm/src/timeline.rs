//! The images of a camera in order of time.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::{interval_s, timestamp_jitter_s};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::frame_names::frame_numbers;

/// Returns the images of each camera.
pub(crate) fn images_of_cameras(scene: &Reconstruction) -> BTreeMap<CameraId, Vec<ImageId>> {
    let mut images: BTreeMap<CameraId, Vec<ImageId>> = BTreeMap::new();
    for (id, image) in scene.images() {
        images.entry(image.camera).or_default().push(id);
    }
    images
}

/// Returns the times of the images that have one, in order; `None` unless most images have a time,
/// and if they are in whole seconds, as most in EXIF, that do not tell instants.
/// A photo that lost its time is in no frame by time, and leaves the others their frames.
pub(crate) fn images_in_time(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    images_in_coarse_time(scene, images)
        .filter(|times| !is_rounded(times.iter().map(|(time_s, _)| *time_s)))
}

/// Whether times were rounded to seconds: all are whole, and several images have one, or they are
/// not as regular as those of an interval timer, whose times are exact but for one offset.
pub(crate) fn is_rounded(times_s: impl Iterator<Item = f64>) -> bool {
    let times_s: Vec<f64> = times_s.collect();
    times_s.iter().all(|time_s| time_s.fract() == 0.0)
        && (interval_s(&times_s) < 1.0 || timestamp_jitter_s(&times_s) > 0.0)
}

/// [`images_in_time`], also of times that were rounded to seconds.
pub(crate) fn images_in_coarse_time(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    let mut times: Vec<(f64, ImageId)> =
        images.iter().filter_map(|&id| Some((scene.image(id).time_s?, id))).collect();
    if 2 * times.len() <= images.len() && !images.is_empty() {
        return None;
    }
    times.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Some(times)
}

/// Numbered frames without times count as so many seconds apart. Their rate is not known, and what
/// is estimated with it is told in frames. At 10 Hz the constants of clocks were chosen.
pub const NUMBERED_FRAME_S: f64 = 0.1;

/// Share of the images of numbered frames whose next number is there. Frames are left out where a
/// camera stands still, or are lost. Not varied.
const MIN_CONSECUTIVE: f64 = 0.75;

/// Times of the images of two cameras.
pub(crate) struct TwoTimelines {
    pub(crate) references: Vec<(f64, ImageId)>,
    pub(crate) others: Vec<(f64, ImageId)>,
    /// Whether these are the numbers of frames, times [`NUMBERED_FRAME_S`].
    pub(crate) are_numbers: bool,
}

/// The times of the images of two cameras ([`images_in_time`]), or, where no image has one, the
/// numbers of their frames; `None` if there are neither.
pub(crate) fn two_timelines(
    scene: &Reconstruction,
    [references, others]: [&[ImageId]; 2],
) -> Option<TwoTimelines> {
    let timed = (images_in_time(scene, references), images_in_time(scene, others));
    if let (Some(references), Some(others)) = timed {
        return Some(TwoTimelines { references, others, are_numbers: false });
    }
    if [references, others].into_iter().flatten().any(|id| scene.image(*id).time_s.is_some()) {
        return None;
    }
    let (references, others) = (numbered(scene, references)?, numbered(scene, others)?);
    Some(TwoTimelines { references, others, are_numbers: true })
}

/// Images with the same number, of each two streams without times whose numbers count frames.
pub(crate) fn same_numbers(scene: &Reconstruction) -> Vec<Vec<[ImageId; 2]>> {
    let mut streams: BTreeMap<&str, Vec<ImageId>> = BTreeMap::new();
    for (id, image) in scene.images() {
        streams.entry(&image.stream).or_default().push(id);
    }
    let is_untimed =
        |images: &&Vec<ImageId>| images.iter().all(|id| scene.image(*id).time_s.is_none());
    let numbers = streams.values().filter(is_untimed).filter_map(|images| numbered(scene, images));
    // Products of integers and one constant: equal numbers have equal bits.
    let numbers: Vec<BTreeMap<u64, ImageId>> = numbers
        .map(|images| images.into_iter().map(|(number, id)| (number.to_bits(), id)).collect())
        .collect();
    let common = |one: &BTreeMap<u64, ImageId>, other: &BTreeMap<u64, ImageId>| {
        one.iter().filter_map(|(number, id)| Some([*id, *other.get(number)?])).collect()
    };
    let of = |(k, one)| numbers[..k].iter().map(move |other| common(one, other));
    numbers.iter().enumerate().flat_map(of).collect()
}

/// Images of one stream with numbers that count frames: most are followed by the next number.
fn numbered(scene: &Reconstruction, images: &[ImageId]) -> Option<Vec<(f64, ImageId)>> {
    let stream = &scene.image(*images.first()?).stream;
    if images.iter().any(|id| scene.image(*id).stream != *stream) {
        return None;
    }
    let mut numbered = images_by_number(scene, images)?;
    let num_next = numbered.windows(2).filter(|two| two[1].0 - two[0].0 == 1.0).count();
    numbered.iter_mut().for_each(|(number, _)| *number *= NUMBERED_FRAME_S);
    (num_next as f64 >= MIN_CONSECUTIVE * (images.len() - 1) as f64).then_some(numbered)
}

/// Returns the registered images of a camera with a time, in order of time; none if the times were
/// rounded to seconds, which tell no motion.
pub(crate) fn posed_in_time(
    model: &Reconstruction,
    camera: CameraId,
) -> Vec<(f64, ImageId, Rigid3)> {
    let images = model.registered().filter(|(_, image, _)| image.camera == camera);
    let mut posed: Vec<_> =
        images.filter_map(|(id, image, pose)| Some((image.time_s?, id, *pose))).collect();
    posed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    if is_rounded(posed.iter().map(|(time_s, ..)| *time_s)) { Vec::new() } else { posed }
}

/// Returns the images of a stream without times by the numbers of their frames, in order; `None` if
/// no number in their names tells them apart ([`frame_numbers`]).
pub(crate) fn images_by_number(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    let names: Vec<&str> = images.iter().map(|id| scene.image(*id).name.as_str()).collect();
    let mut numbered: Vec<(f64, ImageId)> =
        frame_numbers(&names)?.into_iter().zip(images.iter().copied()).collect();
    numbered.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Some(numbered)
}

/// Returns the registered images of a camera by the numbers of their frames, for each stream that
/// has some.
pub(crate) fn posed_by_number(
    model: &Reconstruction,
    camera: CameraId,
) -> Vec<Vec<(f64, ImageId, Rigid3)>> {
    let mut streams: BTreeMap<&str, Vec<ImageId>> = BTreeMap::new();
    for (id, image, _) in model.registered().filter(|(_, image, _)| image.camera == camera) {
        streams.entry(&image.stream).or_default().push(id);
    }
    let posed =
        |(number, id): (f64, ImageId)| Some((number, id, *model.image(id).cam_from_world()?));
    let numbered = streams.values().filter_map(|images| images_by_number(model, images));
    numbered.map(|images| images.into_iter().filter_map(posed).collect()).collect()
}

/// Largest change of the velocity from one image to the next, relative to the usual speed, of
/// frames that follow a smooth motion. As usual, both are 90 % quantiles. Not varied.
pub(crate) const MAX_CHANGE: f64 = 0.5;

/// Quantile of speeds or accelerations that defines the usual one.
const USUAL_QUANTILE: f64 = 0.9;

/// Returns the 90 % quantile of speeds, steps or accelerations.
pub(crate) fn usual(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((USUAL_QUANTILE * values.len().saturating_sub(1) as f64) as usize).copied()
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    const FRAMES: usize = 20;

    /// Folders of frames, one camera each, with the numbers that `is_there` tells.
    fn recorded(has_times: bool, is_there: impl Fn(usize, usize) -> bool) -> Reconstruction {
        let mut scene = Reconstruction::default();
        for (folder, stream) in ["left", "right"].into_iter().enumerate() {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
            let camera = scene.add_camera(camera);
            for number in (0..4 * FRAMES).filter(|number| is_there(folder, *number)) {
                let name = format!("{stream}/{number:06}.png");
                let mut image = Image::new(name, camera, Vec::new());
                image.time_s = has_times.then_some(number as f64);
                scene.add_image(image);
            }
        }
        scene
    }

    #[test]
    fn images_with_the_same_number_are_found() {
        let shifted = |has_times, shift: usize| {
            recorded(has_times, move |folder, number| {
                (folder * shift..folder * shift + FRAMES).contains(&number)
            })
        };
        let num = |scene: &Reconstruction| -> Vec<usize> {
            same_numbers(scene).iter().map(Vec::len).collect()
        };
        assert_eq!(num(&shifted(false, 0)), [FRAMES]);
        let scene = shifted(false, 15);
        assert_eq!(num(&scene), [FRAMES - 15]);
        for [right, left] in &same_numbers(&scene)[0] {
            let names = [right, left].map(|id| scene.image(*id).name.as_str());
            assert_eq!(names[0].replace("right", "left"), names[1]);
        }
        assert!(num(&shifted(true, 0)).is_empty());
        // Photos: every third number, and one folder alone.
        assert!(num(&recorded(false, |_, number| number % 3 == 0)).is_empty());
        let one_folder = recorded(false, |folder, number| folder == 0 && number < FRAMES);
        assert!(num(&one_folder).is_empty());
    }
}
