//! Duplicate structure: two places that look alike, of which a model has made one.
//!
//! With two identical buildings every image has its inliers, and where the buildings are parallel
//! no rotation contradicts. What contradicts are the points beside the buildings, which the images
//! of one place see and those of the other miss (Heinly, Dunn & Frahm 2014). The images are divided
//! into two groups such that many points have all their observers in one group, though images of
//! the other group look at their place from there. The model holds two places if
//!
//! - there are enough parts of images in which a group sees nothing of what the other one sees, and
//! - they are told apart from the rest: in between are few parts of which the groups share some
//!   points, and
//! - in the rest the groups find each other's points about as often as their own.
//!
//! The last two exclude one place that has changed, or was photographed by different cameras or in
//! different light: there, the groups find few of each other's points everywhere. A division
//! between cameras that ride together is none either.

mod connection;
mod division;
mod evidence;
mod expected;
mod moves;
mod nearest;
mod recording;
mod search;
mod spectral;

use std::collections::BTreeSet;

use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use crate::mapped_model::OtherPlace;
use connection::connections;
pub(crate) use connection::find_each_other;
use evidence::Evidence;
use expected::Expectations;
use nearest::nearest;
use recording::separates_cameras;

/// The smaller of two places that the model holds as one; `None` if it holds one place. A group has
/// at least `min_images` images. Matches of verified pairs agree with the poses to `max_error_px`.
pub(crate) fn duplicate_place(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    min_images: usize,
    max_error_px: f64,
    seed: u64,
) -> Option<OtherPlace> {
    if model.num_registered() < 2 * min_images.max(1) {
        return None;
    }
    let expectations = Expectations::new(graph, model);
    let sides = search::best_division(&expectations, &nearest(model), seed)?;
    let num_second = sides.iter().filter(|side| **side).count();
    let num_smaller = num_second.min(sides.len() - num_second);
    if num_smaller < min_images || !Evidence::new(&expectations, &sides).is_of_two_places() {
        return None;
    }
    let is_smaller = |side: &bool| *side == (num_second == num_smaller);
    let images = expectations.images.iter().zip(&sides);
    let images: BTreeSet<ImageId> =
        images.filter(|(_, side)| is_smaller(side)).map(|(image, _)| *image).collect();
    if separates_cameras(model, &images) {
        return None;
    }
    let connections = connections(graph, model, &images, max_error_px);
    Some(OtherPlace { images, connections })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
    use tiepoint_scene::{
        Camera, Image, ImageId, ImagePair, Keypoint, Observation, Track, TwoView, TwoViewKind,
    };

    use super::*;

    const IMAGES: usize = 60;
    const POINTS: usize = 3000;
    /// How often an image finds a point that another image near it observes: as on the rendered
    /// houses (0.59 to 0.70).
    const FOUND: f64 = 0.65;
    /// Wrong matches between the places.
    const FOUND_WRONGLY: f64 = 0.002;
    const MIN_IMAGES: usize = 3;
    const MAX_ERROR_PX: f64 = 12.0;
    const DRAWS: u64 = 2;

    /// How often the images of the first and of the second group find the points of the object that
    /// they look at, and of its surroundings; each point belongs to a group at random.
    struct World {
        object: [[f64; 2]; 2],
        surroundings: [[f64; 2]; 2],
    }

    const ONE: [[f64; 2]; 2] = [[FOUND; 2]; 2];
    const TWO: [[f64; 2]; 2] = [[FOUND, FOUND_WRONGLY], [FOUND_WRONGLY, FOUND]];

    /// Images from all around an object on the ground, every second one of the first group.
    fn scene(world: &World, seed: u64) -> (CorrespondenceGraph, Reconstruction) {
        let mut rng = Rng::stream(seed, &[]);
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        // Only their places over the image matter.
        let place = |at: usize| Vector2::new((at % 32) as f64 * 20.0, (at / 32 % 24) as f64 * 20.0);
        let keypoints: Vec<Keypoint> =
            (0..POINTS).map(|at| Keypoint { pixel: place(at), scale_px: 1.0 }).collect();
        let images: Vec<ImageId> = (0..IMAGES)
            .map(|k| {
                let image = model.add_image(Image::new(format!("{k}"), camera, keypoints.clone()));
                let turn = TAU * rng.uniform();
                let (away, side) = (
                    Vector3::new(turn.cos(), turn.sin(), 0.0),
                    Vector3::new(-turn.sin(), turn.cos(), 0.0),
                );
                let axes = Matrix3::from_columns(&[side, -Vector3::z(), -away]);
                let rotation = Rotation3::from_matrix_unchecked(axes.transpose());
                let centre = away * 12.0 + Vector3::z();
                let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
                model.register(image, Rigid3::new(rotation, -(rotation * centre)));
                image
            })
            .collect();
        for keypoint in 0..POINTS as u32 {
            let [along, across, up] = [0; 3].map(|_| rng.uniform() - 0.5);
            let is_object = keypoint % 3 != 0;
            let xyz = if is_object {
                Vector3::new(5.0 * along, 5.0 * across, 4.0 * (up + 0.5))
            } else {
                Vector3::new(20.0 * along, 20.0 * across, 0.1 * up - 1.0)
            };
            let group = rng.below(2);
            let rates = if is_object { world.object } else { world.surroundings };
            let finds = |image: &ImageId| {
                let pose = model.image(*image).cam_from_world()?;
                let pixel = intrinsics.project(&(*pose * xyz))?;
                let inside = model.camera(camera).contains(&pixel);
                let found = rng.uniform() < rates[group][image.index() % 2];
                (inside && found).then_some(Observation { image: *image, keypoint })
            };
            let observations: Vec<Observation> = images.iter().filter_map(finds).collect();
            if observations.len() >= 2 {
                model.add_track(Track::new(xyz, observations));
            }
        }
        let pairs = images.iter().enumerate().flat_map(|(k, one)| {
            images[..k].iter().filter_map(|other| ImagePair::new(*one, *other))
        });
        let two_view = TwoView { kind: TwoViewKind::Calibrated, ..TwoView::default() };
        let pairs = pairs.map(|pair| (pair, two_view.clone()));
        let graph = CorrespondenceGraph::new(&[POINTS; IMAGES], pairs);
        (graph, model)
    }

    fn divided(world: &World, seed: u64) -> Option<Vec<usize>> {
        let (graph, model) = scene(world, seed);
        let found = duplicate_place(&graph, &model, MIN_IMAGES, MAX_ERROR_PX, seed)?.images;
        Some(found.into_iter().map(|image| image.index()).collect())
    }

    #[test]
    fn two_places_that_share_an_object_are_told_apart() {
        for seed in 0..DRAWS {
            let found = divided(&World { object: ONE, surroundings: TWO }, seed);
            let found = found.unwrap_or_else(|| panic!("seed {seed}: one place"));
            assert_eq!(found.len(), IMAGES / 2, "{seed}");
            assert!(found.iter().all(|image| image % 2 == found[0] % 2), "{seed}: {found:?}");
        }
    }

    #[test]
    fn one_place_stays_whole() {
        for seed in 0..DRAWS {
            assert_eq!(divided(&World { object: ONE, surroundings: ONE }, seed), None, "{seed}");
        }
    }

    /// The surroundings and the object look different to the groups: in other light.
    #[test]
    fn one_place_that_looks_different_stays_whole() {
        for rate in [0.1, 0.2, 0.4] {
            let other = [[FOUND, rate], [rate, FOUND]];
            for seed in 0..DRAWS {
                let world = World { object: other, surroundings: other };
                assert_eq!(divided(&world, seed), None, "{rate}, {seed}");
            }
            // Only the object keeps some of its looks.
            let world = World { object: other, surroundings: TWO };
            assert_eq!(divided(&world, 0), None, "{rate}");
        }
    }

    #[test]
    fn images_of_one_place_find_each_other() {
        let group: BTreeSet<ImageId> = (0..IMAGES).step_by(2).map(|k| ImageId(k as u32)).collect();
        let agree = |world: &World| {
            let (graph, model) = scene(world, 0);
            find_each_other(&graph, &model, &group)
        };
        assert!(agree(&World { object: ONE, surroundings: ONE }));
        assert!(!agree(&World { object: TWO, surroundings: TWO }));
        // A wrong connection: the images look at the same object, and beside it at two places.
        assert!(!agree(&World { object: ONE, surroundings: TWO }));
    }

    #[test]
    fn few_images_are_not_divided() {
        let none = CorrespondenceGraph::new(&[], []);
        assert_eq!(
            duplicate_place(&none, &Reconstruction::default(), MIN_IMAGES, MAX_ERROR_PX, 0),
            None
        );
    }
}
