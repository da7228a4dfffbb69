//! Known rigs from files, and the photos and frames that they are of.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use tiepoint_input::Error as InputError;
use tiepoint_input::cameras::{camera_of_photo, is_named};
use tiepoint_io::rig_calibration::{self, CameraOnRig, PhotosOfCamera};
use tiepoint_sfm::frame_names::pairs_by_name;
use tiepoint_sfm::rigs::frames_by_time;
use tiepoint_sfm::scene::KnownRigs;
use tiepoint_sfm::scene::rig::KnownFrame;
use tiepoint_sfm::scene::{Camera, CameraId, ImageId, Reconstruction, Rig, RigId, RigSensor};

use crate::Error;

/// Reads the rigs of a file for the photos of a scene. Cameras without known intrinsics get those
/// of the file, if it has them and `takes_intrinsics`.
///
/// Photos of one frame have the same name after their prefix or folder, as in COLMAP. If no two
/// cameras of a rig have such photos, frames come from the times of the photos, corrected by the
/// time offsets of the file ([`frames_by_time`]), or without times from the numbers in their names
/// ([`pairs_by_name`]).
///
/// # Errors
///
/// The file cannot be read or is damaged; a camera of it has no photos, or photos of several
/// cameras or of a camera of another entry; no frame has two photos; intrinsics do not fit.
pub fn known_rigs(
    path: &Path,
    scene: &mut Reconstruction,
    refine_extrinsics: bool,
) -> Result<KnownRigs, Error> {
    let fails =
        |what: String| Error::Input(InputError::Calibration { path: path.to_owned(), what });
    let mut known = KnownRigs { refine_extrinsics, ..KnownRigs::default() };
    let mut photos_of_cameras: BTreeMap<CameraId, String> = BTreeMap::new();
    for cameras in rig_calibration::read(path)? {
        let photos = photos_of(&cameras, scene).map_err(fails)?;
        let mut sensors = Vec::new();
        for (camera_on_rig, photos) in cameras.iter().zip(&photos) {
            let camera = only_camera(scene, photos).map_err(fails)?;
            if let Some(other) = photos_of_cameras.insert(camera, photos.what.clone()) {
                return Err(fails(format!(
                    "{} and {other} are photos of one camera: put the photos of each camera into a \
                    folder of its own, and run `stage.features` without `features.cameras` single",
                    photos.what
                )));
            }
            sensors.push(RigSensor { camera, cam_from_rig: Some(camera_on_rig.cam_from_rig) });
            if !scene.calibrated.contains(&camera) {
                set_intrinsics(scene, camera, camera_on_rig).map_err(fails)?;
            }
        }
        let rig = RigId::from_index(known.rigs.len());
        known.rigs.push(Rig { sensors });
        let frames = frames_of(scene, &cameras, &photos);
        if cameras.len() > 1 && frames.iter().all(|images| images.len() < 2) {
            let whats: Vec<&str> = photos.iter().map(|photos| photos.what.as_str()).collect();
            return Err(fails(format!(
                "no two of {} are of one frame: give the photos of a frame the same name or \
                number, or their times with `features.timestamps`",
                whats.join(", ")
            )));
        }
        known.frames.extend(frames.into_iter().map(|images| KnownFrame { rig, images }));
    }
    if known.rigs.iter().all(|rig| rig.sensors.len() < 2) {
        return Err(fails("no rig in it has two cameras: leave the option out".to_owned()));
    }
    Ok(known)
}

/// The photos of a camera of a file.
struct Photos {
    /// Their description for messages.
    what: String,
    /// The images, each with its name after the prefix or folder.
    images: Vec<(String, ImageId)>,
}

/// The photos of each camera of a rig.
fn photos_of(cameras: &[CameraOnRig], scene: &Reconstruction) -> Result<Vec<Photos>, String> {
    let folders: BTreeSet<String> =
        scene.images().map(|(_, image)| image.stream.to_string()).collect();
    let listed = || folders.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    let in_folder = |folder: &str| Photos {
        what: format!("the photos of {folder}"),
        images: scene
            .images()
            .filter(|(_, image)| *image.stream == *folder)
            .map(|(id, image)| (file_name(&image.name).to_owned(), id))
            .collect(),
    };
    let by_name: Vec<Option<&String>> = cameras
        .iter()
        .map(|camera| match &camera.photos {
            PhotosOfCamera::Prefix(_) => None,
            PhotosOfCamera::Named { name, topic } => {
                folders.iter().find(|folder| is_named(name, topic.as_deref(), folder))
            }
        })
        .collect();
    let has_all_names = by_name.iter().all(Option::is_some);
    let names = || -> Vec<&str> { cameras.iter().map(|camera| name_of(&camera.photos)).collect() };
    cameras
        .iter()
        .enumerate()
        .map(|(index, camera)| match &camera.photos {
            PhotosOfCamera::Prefix(prefix) => {
                let images: Vec<(String, ImageId)> = scene
                    .images()
                    .filter(|(_, image)| longest_prefix(&names(), &image.name) == Some(index))
                    .map(|(id, image)| (image.name[prefix.len()..].to_owned(), id))
                    .collect();
                if images.is_empty() {
                    return Err(format!(
                        "no photo has the image_prefix {prefix:?}: there are the folders {}",
                        listed()
                    ));
                }
                Ok(Photos { what: format!("the photos with the prefix {prefix:?}"), images })
            }
            PhotosOfCamera::Named { .. } if has_all_names => {
                Ok(in_folder(by_name[index].map_or("", String::as_str)))
            }
            PhotosOfCamera::Named { .. } if folders.len() == cameras.len() => {
                Ok(in_folder(folders.iter().nth(index).map_or("", String::as_str)))
            }
            PhotosOfCamera::Named { .. } => Err(format!(
                "has the cameras {}, and the photos have the folders {}: name the folders as the \
                cameras, or give as many of both in the same order",
                names().join(", "),
                listed()
            )),
        })
        .collect()
}

/// The index of the longest prefix of a name.
fn longest_prefix(prefixes: &[&str], name: &str) -> Option<usize> {
    let matching = prefixes.iter().enumerate().filter(|(_, prefix)| name.starts_with(**prefix));
    matching.max_by_key(|(_, prefix)| prefix.len()).map(|(index, _)| index)
}

fn file_name(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// The prefix or name of a camera.
fn name_of(photos: &PhotosOfCamera) -> &str {
    match photos {
        PhotosOfCamera::Prefix(prefix) => prefix,
        PhotosOfCamera::Named { name, .. } => name,
    }
}

/// The camera of photos, if it is one.
fn only_camera(scene: &Reconstruction, photos: &Photos) -> Result<CameraId, String> {
    let cameras: BTreeSet<CameraId> =
        photos.images.iter().map(|(_, image)| scene.image(*image).camera).collect();
    match (cameras.first(), cameras.len()) {
        (Some(camera), 1) => Ok(*camera),
        (_, count) => Err(format!(
            "{} are of {count} cameras, and a camera of a rig is one: put the photos of each \
            camera into a folder of its own, and run `stage.features` with `features.cameras` \
            folder",
            photos.what
        )),
    }
}

/// Sets the intrinsics of a camera to those of the file, which bundle adjustment keeps.
fn set_intrinsics(
    scene: &mut Reconstruction,
    id: CameraId,
    camera_on_rig: &CameraOnRig,
) -> Result<(), String> {
    let Some(calibration) = &camera_on_rig.calibration else { return Ok(()) };
    let Some((_, photo)) = scene.images().find(|(_, image)| image.camera == id) else {
        return Ok(());
    };
    let Camera { width, height, .. } = *scene.camera(id);
    *scene.camera_mut(id) = camera_of_photo(calibration, &photo.name.clone(), [width, height])?;
    scene.calibrated.insert(id);
    Ok(())
}

/// The frames of a rig: by equal names, else by time, else by the number that varies in the names.
/// Photos without a partner are frames of one.
fn frames_of(
    scene: &Reconstruction,
    cameras: &[CameraOnRig],
    photos: &[Photos],
) -> Vec<Vec<ImageId>> {
    let mut by_name: BTreeMap<&str, Vec<ImageId>> = BTreeMap::new();
    for (name, image) in photos.iter().flat_map(|photos| &photos.images) {
        by_name.entry(name).or_default().push(*image);
    }
    let frames: Vec<Vec<ImageId>> = by_name.into_values().collect();
    if frames.iter().any(|images| images.len() > 1) {
        return frames;
    }
    let images: Vec<(Vec<ImageId>, f64)> = photos
        .iter()
        .zip(cameras)
        .map(|(photos, camera)| {
            (photos.images.iter().map(|(_, image)| *image).collect(), camera.time_offset_s)
        })
        .collect();
    frames_by_time(scene, &images).unwrap_or_else(|| frames_by_number(photos))
}

/// The frames by the names of the photos of each camera beside those of the first.
fn frames_by_number(photos: &[Photos]) -> Vec<Vec<ImageId>> {
    let Some((first, others)) = photos.split_first() else { return Vec::new() };
    fn names(photos: &Photos) -> Vec<&str> {
        photos.images.iter().map(|(name, _)| name.as_str()).collect()
    }
    let of_first = names(first);
    let mut frames: Vec<Vec<ImageId>> = first.images.iter().map(|(_, id)| vec![*id]).collect();
    for camera in others {
        let of_camera = names(camera);
        let mut alone: BTreeSet<usize> = (0..of_camera.len()).collect();
        for (frame, index) in pairs_by_name(&of_first, &of_camera) {
            frames[frame].push(camera.images[index].1);
            alone.remove(&index);
        }
        frames.extend(alone.into_iter().map(|index| vec![camera.images[index].1]));
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_prefix_counts() {
        let prefixes = ["cam1", "cam10/", "left/"];
        assert_eq!(longest_prefix(&prefixes, "cam10/a.png"), Some(1));
        assert_eq!(longest_prefix(&prefixes, "cam1/a.png"), Some(0));
        assert_eq!(longest_prefix(&prefixes, "right/a.png"), None);
    }
}
