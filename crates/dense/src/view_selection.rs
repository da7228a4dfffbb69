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
/// Two images have a baseline if a quarter of their shared points have at least this triangulation
/// angle, 0.1°: less than 2 px of parallax at a focal length of 1000 px. COLMAP asks for 1° at that
/// quarter, which neighbours in a slow video do not have.
const MIN_ANGLE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
const MIN_SHARE_APART: f64 = 0.25;

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
/// angle. Of images from one place, such as copies of a photo, one is chosen; they agree on any
/// depth.
pub fn select_views(model: &Reconstruction, max_sources: usize) -> Vec<StereoProblem> {
    let centres: Vec<Option<Vector3<f64>>> = model
        .images()
        .map(|(_, image)| image.cam_from_world().map(|pose| pose.origin_in_a()))
        .collect();
    let mut pairs: BTreeMap<(ImageId, ImageId), SharedPoints> = BTreeMap::new();
    for (_, track) in model.tracks() {
        let mut images: Vec<ImageId> = track.observations.iter().map(|o| o.image).collect();
        images.sort_unstable();
        images.dedup();
        for (index, first) in images.iter().enumerate() {
            for second in &images[index + 1..] {
                if let (Some(one), Some(other)) = (centres[first.index()], centres[second.index()])
                {
                    let angle = (one - track.xyz).angle(&(other - track.xyz));
                    pairs.entry((*first, *second)).or_default().add(angle);
                }
            }
        }
    }
    let mut sources: BTreeMap<ImageId, Vec<(f64, ImageId)>> = BTreeMap::new();
    for ((first, second), shared) in pairs.iter().filter(|(_, shared)| shared.has_baseline()) {
        sources.entry(*first).or_default().push((shared.score, *second));
        sources.entry(*second).or_default().push((shared.score, *first));
    }
    let is_same_place = |one: ImageId, other: ImageId| {
        let shared = pairs.get(&(one.min(other), one.max(other)));
        shared.is_some_and(|shared| !shared.has_baseline())
    };
    let problem = |(image, content, _): (ImageId, &Image, _)| {
        let mut ranked = sources.remove(&image).unwrap_or_default();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut sources: Vec<ImageId> = Vec::new();
        for (_, source) in ranked {
            let is_new = !sources.iter().any(|chosen| is_same_place(*chosen, source));
            if sources.len() < max_sources && is_new {
                sources.push(source);
            }
        }
        StereoProblem { image, sources, seeds: seeds(model, content) }
    };
    model.registered().map(problem).collect()
}

/// The images that may see the surfaces of each image, for [`fuse`](crate::fusion::fuse): its
/// sources, and those it is a source of.
pub fn neighbours(problems: &[StereoProblem]) -> Vec<Vec<usize>> {
    let sources =
        |problem: &StereoProblem| problem.sources.iter().map(|image| image.index()).collect();
    let mut neighbours: Vec<Vec<usize>> = problems.iter().map(sources).collect();
    for (index, problem) in problems.iter().enumerate() {
        for source in problem.sources.iter().map(|image| image.index()) {
            if !neighbours[source].contains(&index) {
                neighbours[source].push(index);
            }
        }
    }
    neighbours
}

/// The points that two images share.
#[derive(Clone, Copy, Debug, Default)]
struct SharedPoints {
    /// Sum of their weights.
    score: f64,
    count: usize,
    /// Number of those with a triangulation angle.
    apart: usize,
}

impl SharedPoints {
    fn add(&mut self, angle_rad: f64) {
        self.score += weight(angle_rad);
        self.count += 1;
        self.apart += usize::from(angle_rad >= MIN_ANGLE_RAD);
    }

    fn has_baseline(&self) -> bool {
        self.apart as f64 >= MIN_SHARE_APART * self.count as f64
    }
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

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Keypoint, Observation, Track};

    use super::*;

    /// Images from these places along x, in units of the depth of the points that all observe.
    fn sources(places: &[f64], max_sources: usize) -> Vec<Vec<u32>> {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
        let camera = model.add_camera(camera);
        let points: Vec<Vector3<f64>> =
            (0..30).map(|k| Vector3::new(0.01 * f64::from(k), 0.0, 1.0)).collect();
        for (index, x) in places.iter().enumerate() {
            let pose = Rigid3::new(Rigid3::identity().rotation, Vector3::new(-x, 0.0, 0.0));
            let pixel = |point: &Vector3<f64>| intrinsics.project(&(pose * *point)).unwrap();
            let keypoints =
                points.iter().map(|point| Keypoint { pixel: pixel(point), scale_px: 1.0 });
            let image = model.add_image(Image::new(index.to_string(), camera, keypoints.collect()));
            model.register(image, pose);
        }
        for (keypoint, xyz) in (0..).zip(points) {
            let image = |index: usize| ImageId::from_index(index);
            let observations =
                (0..places.len()).map(|index| Observation { image: image(index), keypoint });
            model.add_track(Track::new(xyz, observations.collect()));
        }
        let problems = select_views(&model, max_sources);
        problems.iter().map(|problem| problem.sources.iter().map(|id| id.0).collect()).collect()
    }

    #[test]
    fn neighbours_are_mutual() {
        let problem = |index: u32, sources: &[u32]| StereoProblem {
            image: ImageId(index),
            sources: sources.iter().copied().map(ImageId).collect(),
            seeds: Vec::new(),
        };
        let found = neighbours(&[problem(0, &[2, 1]), problem(1, &[0]), problem(2, &[])]);
        assert_eq!(found, [vec![2, 1], vec![0], vec![0]]);
    }

    #[test]
    fn copies_of_a_photo_are_no_sources_of_each_other() {
        // Poses of a photo and its copy differ by errors.
        let copies = [0.0, 1e-4, 0.1, 0.2];
        let found = sources(&copies, 5);
        assert_eq!(found[0], [3, 2]);
        assert_eq!(found[1], [3, 2]);
        // One of the two tells all.
        for of in &found[2..] {
            assert_eq!(of.iter().filter(|id| **id < 2).count(), 1, "{found:?}");
            assert_eq!(of.len(), 2, "{found:?}");
        }
        // A slow video: 1/300 of the depth is 0.2°.
        let slow = [0.0, 1.0 / 300.0, 2.0 / 300.0];
        assert!(sources(&slow, 5).iter().all(|of| of.len() == 2));
        assert_eq!(sources(&slow, 1)[0], [2], "the wider one first");
    }
}
