//! Frames of a rig with known extrinsics by the times of its images.

use std::collections::BTreeMap;

use tiepoint_rig::interval_s;
use tiepoint_scene::{ImageId, Reconstruction};

use super::pairs::by_time;
use crate::timeline::images_in_time;

/// Largest difference between the times of images of one frame, as a share of the interval between
/// images of the reference camera. The images get one rig pose, whose error is then at most this
/// share of the step between two images.
const MAX_TIME_DIFFERENCE: f64 = 0.05;

/// Returns the frames of a rig: the images of one instant. `images` has the images of each camera,
/// the reference camera first, and the time of the reference camera's clock minus that of the
/// camera's in seconds. An image without others is a frame of one. `None` unless most images of
/// each camera have a time.
pub fn frames_by_time(
    scene: &Reconstruction,
    images: &[(Vec<ImageId>, f64)],
) -> Option<Vec<Vec<ImageId>>> {
    let timelines: Vec<Vec<(f64, ImageId)>> = images
        .iter()
        .map(|(images, offset_s)| {
            let mut times = images_in_time(scene, images)?;
            times.iter_mut().for_each(|(time_s, _)| *time_s += offset_s);
            Some(times)
        })
        .collect::<Option<_>>()?;
    let references = timelines.first()?;
    let interval = interval_s(&references.iter().map(|(time_s, _)| *time_s).collect::<Vec<f64>>());
    let mut frames: BTreeMap<ImageId, Vec<ImageId>> =
        references.iter().map(|(_, image)| (*image, vec![*image])).collect();
    let mut alone = Vec::new();
    for others in &timelines[1..] {
        let times: BTreeMap<ImageId, f64> =
            references.iter().chain(others).map(|(time_s, image)| (*image, *time_s)).collect();
        let reference_of: BTreeMap<ImageId, ImageId> = by_time(references, others)
            .into_iter()
            .filter(|pair| {
                let difference_s = (times[&pair.reference] - times[&pair.other]).abs();
                difference_s <= MAX_TIME_DIFFERENCE * interval
            })
            .map(|pair| (pair.other, pair.reference))
            .collect();
        for (_, image) in others {
            match reference_of.get(image).and_then(|reference| frames.get_mut(reference)) {
                Some(frame) => frame.push(*image),
                None => alone.push(vec![*image]),
            }
        }
    }
    let has_no_time = |id: &&ImageId| scene.image(**id).time_s.is_none();
    let without = images.iter().flat_map(|(images, _)| images).filter(has_no_time);
    alone.extend(without.map(|image| vec![*image]));
    Some(frames.into_values().chain(alone).collect())
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    #[test]
    fn images_of_one_instant_are_a_frame() {
        let mut scene = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
        let mut images_at = |times: &[f64]| -> Vec<ImageId> {
            let camera = scene.add_camera(camera);
            let add = |time_s: &f64| {
                let image =
                    scene.add_image(Image::new(format!("{camera:?}{time_s}"), camera, vec![]));
                scene.set_time(image, Some(*time_s));
                image
            };
            times.iter().map(add).collect()
        };
        let references = images_at(&[0.0, 0.1, 0.2, 0.3]);
        // The second clock is 2 s behind; its third image is 20 ms late, the fourth is missing.
        let others = images_at(&[-1.999, -1.9, -1.78]);
        let [a, b, c, d] = references[..] else { unreachable!() };
        let [e, f, g] = others[..] else { unreachable!() };
        let cameras = [(references, 0.0), (others, 2.0)];
        let frames = frames_by_time(&scene, &cameras).expect("all have times");
        assert_eq!(frames, [vec![a, e], vec![b, f], vec![c], vec![d], vec![g]]);
        // An image that lost its time is a frame of one; where most did, times tell nothing.
        scene.set_time(f, None);
        let frames = frames_by_time(&scene, &cameras).expect("most have times");
        assert_eq!(frames, [vec![a, e], vec![b], vec![c], vec![d], vec![g], vec![f]]);
        scene.set_time(g, None);
        assert_eq!(frames_by_time(&scene, &cameras), None);
    }
}
