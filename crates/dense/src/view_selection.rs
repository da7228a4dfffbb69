//! Choice of the source images of each image, from the tracks they share.

use std::collections::BTreeMap;

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{Image, ImageId, Reconstruction};

use crate::pinhole::PosedPinhole;
use crate::stereo::Seed;

/// Triangulation angle up to which the weight of a shared point grows, and from twice which on it
/// shrinks: 10° as in Goesele et al. 2007 (Multi-View Stereo for Community Photo Collections). The
/// precision of a depth grows with the angle; beyond, patches look different.
const FULL_ANGLE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// An image with the images that its depths are estimated from.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoProblem {
    /// The reference image.
    pub image: ImageId,
    /// Its source images, the best first.
    pub sources: Vec<ImageId>,
    /// The points of the sparse model in the reference image.
    pub seeds: Vec<Seed>,
}

/// The source images and seeds of each registered image, in order of the images. At most
/// `max_sources` images are chosen by the number of shared points, weighted by the triangulation
/// angle.
pub fn select_views(model: &Reconstruction, max_sources: usize) -> Vec<StereoProblem> {
    let centres: Vec<Option<Vector3<f64>>> = model
        .images()
        .map(|(_, image)| image.cam_from_world().map(|pose| pose.origin_in_a()))
        .collect();
    let mut scores: BTreeMap<(ImageId, ImageId), f64> = BTreeMap::new();
    for (_, track) in model.tracks() {
        let mut images: Vec<ImageId> = track.observations.iter().map(|o| o.image).collect();
        images.sort_unstable();
        images.dedup();
        for (index, first) in images.iter().enumerate() {
            for second in &images[index + 1..] {
                if let (Some(one), Some(other)) = (centres[first.index()], centres[second.index()])
                {
                    let angle = (one - track.xyz).angle(&(other - track.xyz));
                    *scores.entry((*first, *second)).or_default() += weight(angle);
                }
            }
        }
    }
    let mut sources: BTreeMap<ImageId, Vec<(f64, ImageId)>> = BTreeMap::new();
    for ((first, second), score) in scores.into_iter().filter(|(_, score)| *score > 0.0) {
        sources.entry(first).or_default().push((score, second));
        sources.entry(second).or_default().push((score, first));
    }
    let problem = |(image, content, _): (ImageId, &Image, _)| {
        let mut ranked = sources.remove(&image).unwrap_or_default();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let sources = ranked.into_iter().take(max_sources).map(|(_, image)| image).collect();
        StereoProblem { image, sources, seeds: seeds(model, content) }
    };
    model.registered().map(problem).collect()
}

/// Weight of a shared point seen at a triangulation angle.
fn weight(angle_rad: f64) -> f64 {
    let share = angle_rad / FULL_ANGLE_RAD;
    if share <= 1.0 { share } else { (2.0 / share).min(1.0).powi(2) }
}

/// The points that an image observes in front of it.
fn seeds(model: &Reconstruction, image: &Image) -> Vec<Seed> {
    let camera = model.camera(image.camera);
    let Some(pose) = image.cam_from_world() else { return Vec::new() };
    let Some(camera) = PosedPinhole::new(camera, pose) else { return Vec::new() };
    let points = image.points().iter().flatten();
    let tracks = points.filter_map(|point| model.track(*point));
    let seed = |xyz: Vector3<f64>| {
        let in_camera = *pose * xyz;
        let index = camera.project(&in_camera)?;
        let is_inside = (0.0..camera.width as f64).contains(&index.x)
            && (0.0..camera.height as f64).contains(&index.y);
        is_inside.then(|| Seed {
            pixel: [index.x as f32 + 0.5, index.y as f32 + 0.5],
            inverse_depth: (1.0 / in_camera.z) as f32,
        })
    };
    tracks.filter_map(|track| seed(track.xyz)).collect()
}
