//! Why photos that look like those of cameras of one vehicle are no rig.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_input::sequences::prefix;
use tiepoint_sfm::frame_names::pairs_by_name;
use tiepoint_sfm::rigs::{rig_candidates, rig_pairs, successive_cameras};
use tiepoint_sfm::scene::{CameraId, Reconstruction};

use crate::workspace::image_names::stream_of;

/// Fewest photos of a camera of a vehicle.
const MIN_PHOTOS: usize = 3;
/// Cameras of a vehicle take about as many photos each: the fewest have this share of the most.
const MIN_SHARE: f64 = 0.5;
/// Most cameras that ends of names tell: multispectral cameras have up to ten.
const MAX_CAMERAS: usize = 10;

/// A sentence on photos that look like those of cameras of one vehicle, of which no frame is known:
/// why, and what to do. `None` if nothing looks like it, or if frames are known.
pub(crate) fn why_no_rig(scene: &Reconstruction) -> Option<String> {
    let follows = |[first, later]: [CameraId; 2]| {
        format!("{} follows {}", stream_of(scene, later), stream_of(scene, first))
    };
    let clips: Vec<String> = successive_cameras(scene).into_iter().map(follows).collect();
    if !clips.is_empty() {
        return Some(format!(
            "no rig: {} and is nowhere beside it: recordings that follow each other are of one \
            camera",
            clips.join(", ")
        ));
    }
    let names: Vec<Vec<&str>> = rig_candidates(scene)
        .values()
        .map(|images| images.iter().map(|id| scene.image(*id).name.as_str()).collect())
        .collect();
    match &names[..] {
        [] => None,
        [photos] => cameras_in_one_folder(photos),
        cameras => {
            if !rig_pairs(scene).is_empty() || !are_alike(cameras.iter().map(Vec::len)) {
                return None;
            }
            let folder = |names: &Vec<&str>| {
                let folder = names.first().and_then(|name| name.rsplit_once('/'));
                folder.map_or("", |(folder, _)| folder).to_owned()
            };
            let folders: Vec<String> = cameras.iter().map(folder).collect();
            Some(format!(
                "no rig: {} have no photos of one instant in common by times, names or numbers in \
                names; if they are cameras of one vehicle, give times with `features.timestamps` \
                or the same number to the photos of an instant",
                folders.join(", ")
            ))
        }
    }
}

/// The sentence on photos of one folder whose names are those of several cameras.
fn cameras_in_one_folder(photos: &[&str]) -> Option<String> {
    let mut groups: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for name in photos {
        groups.entry(prefix(name)).or_default().push(name);
    }
    let (first, others) = {
        let mut groups = groups.values();
        (groups.next()?, groups)
    };
    let have_common_numbers = others.clone().all(|other| {
        let common = pairs_by_name(first, other).len();
        common as f64 >= MIN_SHARE * first.len().min(other.len()) as f64
    });
    let shown: Vec<String> =
        if others.len() > 0 && have_common_numbers && are_alike(groups.values().map(Vec::len)) {
            groups.keys().map(|prefix| format!("{prefix}*")).collect()
        } else {
            suffixes_of_cameras(photos)?.iter().map(|suffix| format!("*{suffix}")).collect()
        };
    Some(format!(
        "no rig: the photos {} of one folder are taken as those of one camera; if they are cameras \
        of one vehicle, put the photos of each into a folder of its own",
        shown.join(" and ")
    ))
}

/// The ends of names that tell cameras, as `_1` and `_2` of `IMG_0007_1.tif` and `IMG_0007_2.tif`:
/// few ends, each with about the same beginnings, which end in a digit.
fn suffixes_of_cameras<'a>(photos: &[&'a str]) -> Option<Vec<&'a str>> {
    let mut groups: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for name in photos {
        let stem = name.rsplit_once('.').map_or(*name, |(stem, _)| stem);
        let at = stem.rfind(['_', '-', ' '])?;
        let (instant, suffix) = stem.split_at(at);
        if !instant.ends_with(|c: char| c.is_ascii_digit()) {
            return None;
        }
        groups.entry(suffix).or_default().insert(instant);
    }
    let first = groups.values().next()?;
    let is_common = |other: &BTreeSet<&str>| {
        let common = first.intersection(other).count();
        common as f64 >= MIN_SHARE * first.len().min(other.len()) as f64
    };
    let is_of_cameras = (2..=MAX_CAMERAS).contains(&groups.len())
        && groups.values().all(is_common)
        && are_alike(groups.values().map(BTreeSet::len));
    is_of_cameras.then(|| groups.into_keys().collect())
}

fn are_alike(counts: impl Iterator<Item = usize>) -> bool {
    let counts: Vec<usize> = counts.collect();
    let (Some(&least), Some(&most)) = (counts.iter().min(), counts.iter().max()) else {
        return false;
    };
    least >= MIN_PHOTOS && least as f64 >= MIN_SHARE * most as f64
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::nalgebra::Vector3;
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_sfm::scene::{Camera, Image};

    use super::*;

    /// The sentence on cameras with photos of these names.
    fn reason(cameras: &[&[&str]]) -> Option<String> {
        let mut scene = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        for names in cameras {
            let camera = scene.add_camera(Camera {
                intrinsics,
                width: 640,
                height: 480,
                has_focal_prior: true,
            });
            for name in *names {
                scene.add_image(Image::new(*name, camera, Vec::new()));
            }
        }
        why_no_rig(&scene)
    }

    #[test]
    fn folders_without_frames_are_named_with_what_to_do() {
        let left: &[&str] = &["left/a1.png", "left/a2.png", "left/a3.png"];
        let later: &[&str] = &["right/b7.png", "right/b8.png", "right/b9.png"];
        let alike: &[&str] = &["right/b1.png", "right/b2.png", "right/b3.png"];
        let found = reason(&[left, later]).unwrap();
        assert!(
            found.contains("left, right") && found.contains("`features.timestamps`"),
            "{found}"
        );
        assert_eq!(reason(&[left, alike]), None);
        assert_eq!(reason(&[left, &later[..2]]), None, "too few");
        assert_eq!(reason(&[left]), None);
        assert_eq!(reason(&[]), None);
    }

    #[test]
    fn recordings_that_follow_each_other_are_named() {
        let mut scene = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
        for (index, clip) in ["clip1", "clip2"].into_iter().enumerate() {
            let camera = scene.add_camera(camera);
            for k in 0..9 {
                let image = Image::new(format!("{clip}/{k}.png"), camera, Vec::new());
                let image = scene.add_image(image);
                let along = -Vector3::z() * (9 * index + k) as f64;
                scene.register(image, Rigid3::new(Rigid3::identity().rotation, along));
            }
        }
        let found = why_no_rig(&scene).unwrap();
        assert!(found.contains("no rig: clip2 follows clip1"), "{found}");
    }

    #[test]
    fn cameras_in_one_folder_are_named_with_what_to_do() {
        let flat: Vec<String> = (0..8).map(|k| format!("cam{}_{:03}.png", k % 2, k / 2)).collect();
        let flat: Vec<&str> = flat.iter().map(String::as_str).collect();
        let found = reason(&[&flat]).unwrap();
        assert!(found.contains("cam0_* and cam1_*"), "{found}");
        assert!(found.contains("a folder of its own"), "{found}");
        for ends in [["_1", "_2"], ["_left", "_right"]] {
            let name = |k: usize| format!("IMG_{:04}{}.png", k / 2, ends[k % 2]);
            let names: Vec<String> = (0..8).map(name).collect();
            let found = reason(&[&names.iter().map(String::as_str).collect::<Vec<_>>()]).unwrap();
            assert!(found.contains(&format!("*{} and *{}", ends[0], ends[1])), "{found}");
        }
        // Single photos, of which one number counts up to two and starts again.
        let alone: Vec<String> = (0..8).map(|k| format!("{:04}_{}.png", k, k % 2)).collect();
        assert_eq!(reason(&[&alone.iter().map(String::as_str).collect::<Vec<_>>()]), None);
        // Photos of two days, and one camera.
        let days: Vec<String> = (0..8).map(|k| format!("day{}_{:03}.png", k / 4, k)).collect();
        assert_eq!(reason(&[&days.iter().map(String::as_str).collect::<Vec<_>>()]), None);
    }
}
