//! Small copies of the photos of a model, and its keypoints, for `report.html`.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::Path;

use serde::Serialize;
use tiepoint_pipeline::input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_pipeline::input::{ImageFolder, Rgb};
use tiepoint_pipeline::sfm::scene::{Camera, Image, Keypoint, Reconstruction};
use tiepoint_pipeline::workspace::{decoder_bytes, fingerprints_of, inputs_of, is_unchanged};

use super::coding::{base64, evenly};

/// Largest number of photos of a model in a page: all are decoded, which takes most of the time.
const MAX_PHOTOS: usize = 500;
/// Largest side of a copy, in pixels.
const MAX_SIDE: u32 = 512;
const JPEG_QUALITY: u8 = 80;
/// Bytes of a copy per pixel, of textured photos with [`JPEG_QUALITY`].
const BYTES_PER_PIXEL: f64 = 0.25;

/// Small copies of photos.
#[derive(Clone, Debug, Default)]
pub struct Thumbnails {
    /// JPEG files by the names of the images.
    pub(super) by_name: BTreeMap<String, Vec<u8>>,
}

impl Thumbnails {
    /// Bytes of all photos of a page with one model; its text grows by 4/3 of them.
    pub const MAX_BYTES: usize = 6_000_000;

    /// Reads the photos of a model's images, at most 500 of them evenly, and reduces them so that
    /// they take at most `max_bytes` in all. Images whose photo is missing, cannot be read or has
    /// another size than its camera have none, and so have all if `workspace` is only a folder with
    /// a model: a page without photos is better than no page.
    pub fn of_workspace(workspace: &Path, model: &Reconstruction, max_bytes: usize) -> Self {
        let inputs = inputs_of(workspace).unwrap_or_default();
        // The inputs of a workspace from elsewhere might name anybody's photos. Who made it does
        // not have those.
        let known = fingerprints_of(workspace).unwrap_or_default();
        let Ok(folder) = ImageFolder::open(&inputs, None) else { return Self::default() };
        let listed = folder.images().iter().enumerate();
        let by_name: BTreeMap<&str, usize> =
            listed.map(|(index, image)| (image.name.as_str(), index)).collect();
        let step = model.num_registered().div_ceil(MAX_PHOTOS).max(1);
        let photos: Vec<(&Image, &Camera, &Path)> = model
            .registered()
            .step_by(step)
            .filter_map(|(_, image, _)| {
                let path = folder.path(*by_name.get(image.name.as_str())?);
                is_unchanged(path, known.get(&image.name)?).then_some(())?;
                Some((image, model.camera(image.camera), path))
            })
            .collect();
        let pixels = max_bytes as f64 / photos.len().max(1) as f64 / BYTES_PER_PIXEL;
        let reduce = |(_, camera, path): &(&Image, &Camera, &Path)| {
            let photo = Rgb::read_of_size(path, camera.width, camera.height).ok()?;
            photo.fitted(MAX_SIDE, pixels as u64).jpeg(JPEG_QUALITY).ok()
        };
        let (mut all, mut left) = (Self::default(), max_bytes);
        let bytes = |(_, camera, _): &(&Image, &Camera, &Path)| decoder_bytes(camera);
        let take = |(image, ..): &(&Image, &Camera, &Path), jpeg: Option<Vec<u8>>| {
            // The estimate of the bytes may be wrong; the bound holds.
            if let Some(jpeg) = jpeg.filter(|jpeg| jpeg.len() <= left) {
                left -= jpeg.len();
                all.by_name.insert(image.name.clone(), jpeg);
            }
            Ok::<(), Infallible>(())
        };
        let Ok(()) = for_each_within_budget(budget_bytes(), bytes, &photos, reduce, take);
        all
    }
}

/// An image in the page, for the picture of its keypoints.
#[derive(Serialize)]
pub(super) struct ShownImage<'a> {
    name: &'a str,
    width: u32,
    height: u32,
    num_keypoints: usize,
    num_with_point: usize,
    /// Base64 of two little-endian `u16` a keypoint: the position as shares of width and height.
    /// Those with a point come first.
    keypoints: String,
    /// How many of these have a point.
    keypoints_with_point: usize,
}

impl<'a> ShownImage<'a> {
    /// An image with at most `max_keypoints` of its keypoints.
    pub(super) fn of(image: &'a Image, camera: &Camera, max_keypoints: usize) -> Self {
        let (with, without): (Vec<_>, Vec<_>) =
            image.keypoints.iter().zip(image.points()).partition(|(_, point)| point.is_some());
        let (all, with_point) = (image.keypoints.len(), with.len());
        let share = with_point * max_keypoints.min(all) / all.max(1);
        let kept = thinned(&with, share);
        let keypoints_with_point = kept.len();
        let rest = thinned(&without, max_keypoints.min(all) - share);
        let coded = |(keypoint, _): &(&Keypoint, _)| {
            let share = |place: f64, size: u32| {
                // Saturates outside of the image.
                ((place / f64::from(size) * f64::from(u16::MAX)).round() as u16).to_le_bytes()
            };
            let (x, y) = (keypoint.pixel.x, keypoint.pixel.y);
            [share(x, camera.width), share(y, camera.height)].concat()
        };
        let bytes: Vec<u8> = kept.into_iter().chain(rest).flat_map(coded).collect();
        Self {
            name: &image.name,
            width: camera.width,
            height: camera.height,
            num_keypoints: all,
            num_with_point: with_point,
            keypoints: base64(&bytes),
            keypoints_with_point,
        }
    }
}

/// `count` of the elements, evenly; all if there are fewer.
fn thinned<T>(elements: &[T], count: usize) -> Vec<&T> {
    let kept = evenly(elements.len(), count);
    elements.iter().enumerate().filter(|(index, _)| kept(*index)).map(|(_, kept)| kept).collect()
}
