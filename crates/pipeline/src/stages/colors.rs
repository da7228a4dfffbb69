//! Point colours: the mean of the pixels at the observations.

use std::collections::BTreeMap;

use tiepoint_input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_input::{ImageFolder, Rgb};
use tiepoint_sfm::scene::{Camera, Image, PointId, Reconstruction};

use crate::Error;
use crate::workspace::model_photos::decoder_bytes;

/// Sets the colours of the points of all models from the photos. Points without an existing photo
/// stay grey.
///
/// # Errors
///
/// A photo cannot be read.
pub fn color_points<'a>(
    folder: &ImageFolder,
    models: impl Iterator<Item = &'a mut Reconstruction>,
) -> Result<(), Error> {
    let by_name: BTreeMap<&str, usize> = folder
        .images()
        .iter()
        .enumerate()
        .map(|(index, image)| (image.name.as_str(), index))
        .collect();
    for model in models {
        let mut sums = vec![([0u32; 3], 0u32); model.point_id_bound()];
        let images: Vec<(&Image, &Camera, usize)> = model
            .registered()
            .filter_map(|(_, image, _)| {
                let index = *by_name.get(image.name.as_str())?;
                Some((image, model.camera(image.camera), index))
            })
            .collect();
        let work = |(image, camera, index): &(&Image, &Camera, usize)| {
            folder.rgb_of_size(*index, camera.width, camera.height).map(|rgb| colors(image, &rgb))
        };
        let bytes = |(_, camera, _): &(&Image, &Camera, usize)| decoder_bytes(camera);
        for_each_within_budget(budget_bytes(), bytes, &images, work, |_, found| {
            for (point, color) in found? {
                let (sum, count) = &mut sums[point.index()];
                (0..3).for_each(|channel| sum[channel] += u32::from(color[channel]));
                *count += 1;
            }
            Ok::<(), Error>(())
        })?;
        let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
        for point in points {
            let (sum, count) = sums[point.index()];
            if let (Some(track), true) = (model.track_mut(point), count > 0) {
                track.color = sum.map(|channel| ((channel + count / 2) / count) as u8);
            }
        }
    }
    Ok(())
}

/// The colour of the pixel at each observation of an image.
fn colors(image: &Image, rgb: &Rgb) -> Vec<(PointId, [u8; 3])> {
    let seen = image.points().iter().zip(image.keypoints.iter());
    seen.filter_map(|(point, keypoint)| {
        let clamp = |position: f64, size: u32| (position.max(0.0) as u32).min(size - 1);
        let (x, y) = (clamp(keypoint.pixel.x, rgb.width), clamp(keypoint.pixel.y, rgb.height));
        Some(((*point)?, rgb.pixel(x, y)))
    })
    .collect()
}
