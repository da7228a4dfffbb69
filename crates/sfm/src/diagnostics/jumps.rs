//! Poses that jump: a camera centre far from where the images before and after place it.

use tiepoint_geometry::numeric::median;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::timeline::{posed_in_time, usual};

/// Smallest distance from the place between the neighbours, relative to the usual step (the 90 %
/// quantile, so that long stops do not shorten it). A vehicle that stops from one image to the next
/// is half a step off. With half, such stops are jumps; with double, a pose that lies one step off
/// is none.
const MIN_STEPS: f64 = 1.0;
/// Images further apart in time than so many usual intervals are no neighbours.
const MAX_INTERVALS: f64 = 3.0;
/// Fewest images of a sequence.
const MIN_IMAGES: usize = 5;

/// An image whose centre is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// The image.
    pub image: ImageId,
    /// Distance of its centre from the place between its neighbours, relative to the usual step.
    pub steps: f64,
}

/// The images of each camera with capture times whose centres are off.
pub fn jumps(model: &Reconstruction) -> Vec<Jump> {
    model.registered_cameras().into_iter().flat_map(|camera| jumps_of(model, camera)).collect()
}

fn jumps_of(model: &Reconstruction, camera: CameraId) -> Vec<Jump> {
    let posed = posed_in_time(model, camera);
    if posed.len() < MIN_IMAGES {
        return Vec::new();
    }
    let centres: Vec<_> = posed.iter().map(|(.., pose)| pose.origin_in_a()).collect();
    let steps: Vec<f64> = centres.windows(2).map(|c| (c[1] - c[0]).norm()).collect();
    let mut intervals: Vec<f64> = posed.windows(2).map(|p| p[1].0 - p[0].0).collect();
    let (Some(step), Some(interval)) = (usual(steps), median(&mut intervals)) else {
        return Vec::new();
    };
    if step <= 0.0 || interval <= 0.0 {
        return Vec::new();
    }
    let of_image = |index: usize| {
        let [before, at, after] = [posed[index - 1].0, posed[index].0, posed[index + 1].0];
        let is_near = after > before && after - before <= 2.0 * MAX_INTERVALS * interval;
        let share = (at - before) / (after - before);
        let between = centres[index - 1] + (centres[index + 1] - centres[index - 1]) * share;
        let steps = (centres[index] - between).norm() / step;
        (is_near && steps > MIN_STEPS).then_some(Jump { image: posed[index].1, steps })
    };
    (1..posed.len() - 1).filter_map(of_image).collect()
}
