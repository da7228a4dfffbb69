//! Cameras that recorded side by side, without times: along a road each of them may find little of
//! what the others see, and a division between them is none of two places.

use std::collections::BTreeSet;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{ImageId, Reconstruction};

use crate::timeline::same_numbers;

/// Fewest images with a number of both cameras. Not varied.
const MIN_FRAMES: usize = 10;
/// Images of the same number are beside each other if the median of their distances is at most this
/// share of the rms distance of the images from their centre: of a straight way a seventh, which
/// leaves room for clocks some frames apart. On circles around two equal buildings, begun anywhere,
/// it would be 1.4 in the median. Not varied.
const MAX_DISTANCE: f64 = 0.5;

/// Whether most images of a camera are in the group and those of the same number, of another camera
/// beside it, are not.
pub(super) fn separates_cameras(model: &Reconstruction, group: &BTreeSet<ImageId>) -> bool {
    let centre = |id: ImageId| model.image(id).cam_from_world().map(Rigid3::origin_in_a);
    same_numbers(model).iter().any(|pairs| {
        let mut separated = 0;
        let mut frames: Vec<[Vector3<f64>; 2]> = Vec::new();
        for &[one, other] in pairs {
            let (Some(a), Some(b)) = (centre(one), centre(other)) else { continue };
            frames.push([a, b]);
            separated += usize::from(group.contains(&one) != group.contains(&other));
        }
        frames.len() >= MIN_FRAMES && 2 * separated > frames.len() && are_beside(&frames)
    })
}

/// Whether the centres of the same number are near each other, beside the extent of the way.
fn are_beside(frames: &[[Vector3<f64>; 2]]) -> bool {
    let num = frames.len() as f64;
    let middle: Vector3<f64> = frames.iter().map(|[a, _]| a).sum::<Vector3<f64>>() / num;
    let extent = frames.iter().map(|[a, _]| (a - middle).norm_squared()).sum::<f64>() / num;
    let mut distances: Vec<f64> = frames.iter().map(|[a, b]| (a - b).norm()).collect();
    distances.sort_by(f64::total_cmp);
    distances[frames.len() / 2] <= MAX_DISTANCE * extent.sqrt()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use tiepoint_geometry::nalgebra::UnitQuaternion;
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    const FRAMES: usize = 24;

    /// Two cameras at `place` of each frame; `group`: the images of the second one.
    fn recorded(
        folders: [&str; 2],
        place: impl Fn(usize, usize) -> Vector3<f64>,
    ) -> (Reconstruction, BTreeSet<ImageId>) {
        let mut model = Reconstruction::default();
        let mut group = BTreeSet::new();
        for (folder, name) in folders.into_iter().enumerate() {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
            let camera = model.add_camera(camera);
            for frame in 0..FRAMES {
                let name = format!("{name}/{frame:06}.png");
                let image = model.add_image(Image::new(name, camera, Vec::new()));
                let pose = Rigid3::new(UnitQuaternion::identity(), -place(folder, frame));
                model.register(image, pose);
                if folder == 1 {
                    group.insert(image);
                }
            }
        }
        (model, group)
    }

    #[test]
    fn a_division_between_cameras_that_ride_together_is_recognised() {
        let straight = |folder: usize, frame: usize| {
            Vector3::new(folder as f64 * 0.3, 0.0, frame as f64 + 2.0 * folder as f64)
        };
        let (model, group) = recorded(["left", "right"], straight);
        assert!(separates_cameras(&model, &group));
        // The second half of the way is no camera.
        let second: BTreeSet<ImageId> =
            model.images().map(|(id, _)| id).filter(|id| id.index() % FRAMES >= 12).collect();
        assert!(!separates_cameras(&model, &second));
    }

    #[test]
    fn two_ways_around_a_building_with_the_same_numbers_are_no_recording() {
        let around = |folder: usize, frame: usize| {
            let turn = TAU * (frame as f64 / FRAMES as f64 + 0.3 * folder as f64);
            Vector3::new(turn.cos(), turn.sin(), 0.0)
        };
        let (model, group) = recorded(["one", "two"], around);
        assert!(!separates_cameras(&model, &group));
    }
}
