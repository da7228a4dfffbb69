//! The poses and points of a model for a scene that holds images of the same names.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{CameraId, Image, ImageId, Observation, Reconstruction, Track};

use crate::Error;

/// Largest difference of a coordinate of the same keypoint, in pixels. The correction of a rolling
/// shutter moves keypoints by less. Of unrelated keypoints in an image of a million pixels, one in
/// a thousand is as near.
const SAME_KEYPOINT_PX: f64 = 16.0;

/// A scene with the poses and points of a model.
#[derive(Clone, Debug)]
pub struct Transferred {
    /// The images of the scene, then those images of the model that the scene lacks.
    pub scene: Reconstruction,
    /// The images with a pose of the model.
    pub existing: BTreeSet<ImageId>,
    /// The cameras with intrinsics of the model.
    pub cameras: BTreeSet<CameraId>,
    /// Number of images of the model that the scene lacks.
    pub num_added_images: usize,
    /// Number of images whose keypoints in the model are not those of the scene. Their
    /// observations are left out.
    pub num_other_keypoints: usize,
}

/// Transfers the cameras, poses and points of `model` to the images of the same names in `scene`,
/// whose own poses and points are dropped.
///
/// - A camera of the scene gets the intrinsics of the model's camera that most of its images have.
///   Its images of other cameras of the model get these cameras, behind those of the scene.
/// - Images of the model that the scene lacks follow behind those of the scene, with their
///   keypoints and points.
/// - A point is transferred with its observations in images that have the same keypoints in both,
///   if there are two or more.
///
/// # Errors
///
/// [`Error::NoCommonImage`] if no image has a pose in the model and a name in the scene;
/// [`Error::OtherSize`] if an image has another size in the model.
pub fn transfer_model(
    scene: &Reconstruction,
    model: &Reconstruction,
) -> Result<Transferred, Error> {
    let by_name: BTreeMap<&str, ImageId> =
        scene.images().map(|(id, image)| (image.name.as_str(), id)).collect();
    let found: Vec<(ImageId, Option<ImageId>)> = model
        .registered()
        .map(|(id, image, _)| (id, by_name.get(image.name.as_str()).copied()))
        .collect();
    for &(id, there) in &found {
        let Some(there) = there else { continue };
        let (one, other) = (model.camera_of(id), scene.camera_of(there));
        if (one.width, one.height) != (other.width, other.height) {
            return Err(Error::OtherSize {
                image: model.image(id).name.clone(),
                in_model: [one.width, one.height],
                in_scene: [other.width, other.height],
            });
        }
    }
    if found.iter().all(|(_, there)| there.is_none()) {
        let example = |model: &Reconstruction| {
            model.images().next().map_or(String::new(), |(_, image)| image.name.clone())
        };
        return Err(Error::NoCommonImage {
            images: found.len(),
            in_model: example(model),
            in_scene: example(scene),
        });
    }

    let mut out = Reconstruction::default();
    out.georeference = model.georeference;
    for (_, camera) in scene.cameras() {
        out.add_camera(*camera);
    }
    let cameras = assign_cameras(&mut out, scene, model, &found);
    for (id, image) in scene.images() {
        let camera = cameras.of_image.get(&id).copied().unwrap_or(image.camera);
        let mut copy = Image::new(image.name.clone(), camera, image.keypoints.to_vec());
        copy.time_s = image.time_s;
        out.add_image(copy);
    }
    let mut existing = BTreeSet::new();
    // For each image of the model: that of the scene, and whether its keypoints are the same.
    let mut images: BTreeMap<ImageId, (ImageId, bool)> = BTreeMap::new();
    let mut num_added_images = 0;
    for (id, image, pose) in model.registered() {
        let there = by_name.get(image.name.as_str()).copied();
        let there = there.unwrap_or_else(|| {
            num_added_images += 1;
            let camera = cameras.of_model[&image.camera];
            out.add_image(Image::new(image.name.clone(), camera, image.keypoints.to_vec()))
        });
        out.register(there, *pose);
        existing.insert(there);
        images.insert(id, (there, has_same_keypoints(image, out.image(there))));
    }
    for (_, track) in model.tracks() {
        let transferred = track.observations.iter().filter_map(|o| {
            let &(image, is_same) = images.get(&o.image)?;
            is_same.then_some(Observation { image, keypoint: o.keypoint })
        });
        let observations: Vec<Observation> = transferred.collect();
        if observations.len() >= 2 {
            out.add_track(Track { color: track.color, ..Track::new(track.xyz, observations) });
        }
    }
    out.calibrated.clone_from(&scene.calibrated);
    out.intrinsics_priors.clone_from(&scene.intrinsics_priors);
    out.portrait_landscape_pairs.clone_from(&scene.portrait_landscape_pairs);
    Ok(Transferred {
        scene: out,
        existing,
        cameras: cameras.from_model,
        num_added_images,
        num_other_keypoints: images.values().filter(|(_, is_same)| !is_same).count(),
    })
}

/// Which cameras the images get.
struct AssignedCameras {
    /// Of images of the scene whose camera changes.
    of_image: BTreeMap<ImageId, CameraId>,
    /// For each camera of the model.
    of_model: BTreeMap<CameraId, CameraId>,
    from_model: BTreeSet<CameraId>,
}

/// Sets the intrinsics of `out`, which has the cameras of `scene`, and adds further cameras of the
/// model. `found`: images of the model, and of the scene.
fn assign_cameras(
    out: &mut Reconstruction,
    scene: &Reconstruction,
    model: &Reconstruction,
    found: &[(ImageId, Option<ImageId>)],
) -> AssignedCameras {
    let mut counts: BTreeMap<CameraId, BTreeMap<CameraId, usize>> = BTreeMap::new();
    for &(id, there) in found {
        if let Some(there) = there {
            let of_camera = counts.entry(scene.image(there).camera).or_default();
            *of_camera.entry(model.image(id).camera).or_default() += 1;
        }
    }
    let mut assigned = AssignedCameras {
        of_image: BTreeMap::new(),
        of_model: BTreeMap::new(),
        from_model: BTreeSet::new(),
    };
    // The model's camera of each camera of the scene.
    let mut chosen: BTreeMap<CameraId, CameraId> = BTreeMap::new();
    for (own, of_model) in counts {
        let most = of_model.into_iter().max_by_key(|&(id, count)| (count, std::cmp::Reverse(id)));
        if let Some((theirs, _)) = most {
            let camera = out.camera_mut(own);
            camera.intrinsics = model.camera(theirs).intrinsics;
            camera.has_focal_prior = true;
            chosen.insert(own, theirs);
            assigned.of_model.entry(theirs).or_insert(own);
            assigned.from_model.insert(own);
        }
    }
    for &(id, there) in found {
        let theirs = model.image(id).camera;
        let own = there.map(|there| scene.image(there).camera);
        if own.is_some_and(|own| chosen.get(&own) == Some(&theirs)) {
            continue;
        }
        let camera = *assigned.of_model.entry(theirs).or_insert_with(|| {
            let mut camera = *model.camera(theirs);
            camera.has_focal_prior = true;
            let added = out.add_camera(camera);
            assigned.from_model.insert(added);
            added
        });
        if let Some(there) = there {
            assigned.of_image.insert(there, camera);
        }
    }
    assigned
}

/// Whether two images have the same keypoints in the same order: equally many, of which more than
/// half are near.
fn has_same_keypoints(one: &Image, other: &Image) -> bool {
    let count = one.keypoints.len();
    let is_near = |k: &usize| {
        (one.keypoints[*k].pixel - other.keypoints[*k].pixel).amax() <= SAME_KEYPOINT_PX
    };
    count == other.keypoints.len() && 2 * (0..count).filter(is_near).count() > count
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Keypoint};

    use super::*;

    fn camera(focal_px: f64, width: u32) -> Camera {
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, focal_px, width, 480);
        Camera { intrinsics, width, height: 480, has_focal_prior: false }
    }

    fn keypoints(offset_px: f64) -> Vec<Keypoint> {
        let at = |k: u32| Vector2::new(10.0 * f64::from(k) + offset_px, 7.0);
        (0..4).map(|k| Keypoint { pixel: at(k), scale_px: 2.0 }).collect()
    }

    fn pose(x: f64) -> Rigid3 {
        Rigid3 { translation: Vector3::new(x, 0.0, 0.0), ..Rigid3::identity() }
    }

    /// A model of images with these names and focal lengths, which observe one point.
    fn model(images: &[(&str, f64, f64)]) -> Reconstruction {
        let mut model = Reconstruction::default();
        let mut observations = Vec::new();
        for (index, &(name, focal_px, offset_px)) in images.iter().enumerate() {
            let known = model.cameras().find(|(_, c)| c.intrinsics.mean_focal_px() == focal_px);
            let known = known.map(|(id, _)| id);
            let own = known.unwrap_or_else(|| model.add_camera(camera(focal_px, 640)));
            let image = model.add_image(Image::new(name, own, keypoints(offset_px)));
            model.register(image, pose(index as f64));
            observations.push(Observation { image, keypoint: 2 });
        }
        model.add_track(Track::new(Vector3::new(1.0, 2.0, 3.0), observations));
        model
    }

    fn scene(names: &[&str], width: u32) -> Reconstruction {
        let mut scene = Reconstruction::default();
        let own = scene.add_camera(camera(500.0, width));
        for name in names {
            scene.add_image(Image::new(*name, own, keypoints(0.0)));
        }
        scene
    }

    #[test]
    fn poses_cameras_and_points_follow_the_names() {
        let model = model(&[("c", 600.0, 0.0), ("gone", 600.0, 0.0), ("a", 600.0, 0.005)]);
        let found = transfer_model(&scene(&["a", "b", "c"], 640), &model).unwrap();
        let names: Vec<&str> = found.scene.images().map(|(_, i)| i.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c", "gone"]);
        assert_eq!(found.existing, [0, 2, 3].map(ImageId).into());
        assert_eq!(found.scene.image(ImageId(0)).cam_from_world(), Some(&pose(2.0)));
        assert_eq!(found.scene.image(ImageId(1)).cam_from_world(), None);
        assert_eq!(found.scene.num_cameras(), 1);
        assert_eq!(found.scene.camera(CameraId(0)).intrinsics.mean_focal_px(), 600.0);
        assert!(found.scene.camera(CameraId(0)).has_focal_prior);
        let (_, track) = found.scene.tracks().next().unwrap();
        let seen: Vec<u32> = track.observations.iter().map(|o| o.image.0).collect();
        assert_eq!((seen, track.xyz), (vec![2, 3, 0], Vector3::new(1.0, 2.0, 3.0)));
        assert_eq!((found.num_added_images, found.num_other_keypoints), (1, 0));
        found.scene.validate().unwrap();
    }

    #[test]
    fn images_of_other_cameras_and_keypoints_keep_their_cameras_and_lose_their_points() {
        let model = model(&[("a", 600.0, 0.0), ("b", 600.0, 30.0), ("c", 700.0, 30.0)]);
        let found = transfer_model(&scene(&["a", "b", "c", "new"], 640), &model).unwrap();
        let focal = |id| found.scene.camera_of(ImageId(id)).intrinsics.mean_focal_px();
        assert_eq!([0, 1, 2, 3].map(focal), [600.0, 600.0, 700.0, 600.0]);
        assert_eq!(found.cameras, [0, 1].map(CameraId).into());
        assert_eq!((found.scene.num_tracks(), found.num_other_keypoints), (0, 2));
        found.scene.validate().unwrap();
    }

    #[test]
    fn models_of_other_images_are_refused() {
        let model = model(&[("a", 600.0, 0.0), ("b", 600.0, 0.0)]);
        let found = transfer_model(&scene(&["x/a"], 640), &model);
        assert!(matches!(found, Err(Error::NoCommonImage { images: 2, .. })), "{found:?}");
        let found = transfer_model(&scene(&["a"], 320), &model);
        assert!(matches!(found, Err(Error::OtherSize { .. })), "{found:?}");
    }
}
