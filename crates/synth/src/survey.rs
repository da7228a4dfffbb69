//! Points of a scene as a survey would have them: far from each other, each in several images.

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_scene::{ImageId, Reconstruction, Track};

/// A point that is measured on the spot and marked in images.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyedPoint {
    /// Its true place, in metres.
    pub xyz: Vector3<f64>,
    /// The images that observe it, with its true pixels.
    pub marks: Vec<(ImageId, Vector2<f64>)>,
}

/// Least angle between two rays to a point (6°): marks from one direction tell no depth.
const MIN_ANGLE_RAD: f64 = 0.1;

/// Whether a point is seen from different directions.
fn is_seen_around(truth: &Reconstruction, track: &Track) -> bool {
    let images = track.observations.iter().map(|observation| truth.image(observation.image));
    let rays: Vec<Vector3<f64>> = images
        .filter_map(|image| Some(image.cam_from_world()?.origin_in_a() - track.xyz))
        .collect();
    rays.iter().any(|ray| ray.angle(&rays[0]) > MIN_ANGLE_RAD)
}

/// At most `count` points of the truth with at least `min_marks` observations from different
/// directions: first the one
/// farthest from the middle, then always the one farthest from those before.
pub fn surveyed_points(
    truth: &Reconstruction,
    count: usize,
    min_marks: usize,
) -> Vec<SurveyedPoint> {
    let seen: Vec<&Track> = truth
        .tracks()
        .map(|(_, track)| track)
        .filter(|track| track.observations.len() >= min_marks && is_seen_around(truth, track))
        .collect();
    let sum: Vector3<f64> = seen.iter().map(|track| track.xyz).sum();
    let middle = sum / seen.len().max(1) as f64;
    // The second round measures from the first point in place of the middle.
    let mut distances: Vec<f64> = seen.iter().map(|track| (track.xyz - middle).norm()).collect();
    let mut chosen: Vec<&Track> = Vec::new();
    while chosen.len() < count.min(seen.len()) {
        let farthest = (0..seen.len()).max_by(|a, b| distances[*a].total_cmp(&distances[*b]));
        let Some(track) = farthest.map(|index| seen[index]) else { break };
        for (distance, other) in distances.iter_mut().zip(&seen) {
            let to_track = (other.xyz - track.xyz).norm();
            *distance = if chosen.is_empty() { to_track } else { distance.min(to_track) };
        }
        chosen.push(track);
    }
    let surveyed = |track: &Track| {
        let mark = |image: ImageId| {
            let in_camera = *truth.image(image).cam_from_world()? * track.xyz;
            Some((image, truth.camera_of(image).intrinsics.project(&in_camera)?))
        };
        let images = track.observations.iter().map(|observation| observation.image);
        SurveyedPoint { xyz: track.xyz, marks: images.filter_map(mark).collect() }
    };
    chosen.into_iter().map(surveyed).collect()
}
