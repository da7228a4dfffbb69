//! Poses that jump: a camera centre far from where the images before and after place it.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_scene::{ImageId, Reconstruction};

use crate::timeline::{MAX_CHANGE, posed_by_number, posed_in_time, usual};

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

/// The images of each camera whose centres are off: of images with capture times, and of frames
/// without them (or in whole seconds) that are numbered and follow a smooth motion.
pub fn jumps(model: &Reconstruction) -> Vec<Jump> {
    let of_camera = |camera| match posed_in_time(model, camera) {
        posed if !posed.is_empty() => jumps_of(&posed, |_, _| true),
        _ => {
            let sequences = posed_by_number(model, camera).into_iter();
            sequences.flat_map(|posed| jumps_of(&posed, is_smooth)).collect()
        }
    };
    model.registered_cameras().into_iter().flat_map(of_camera).collect()
}

/// The jumps of images in order, with their times. `follow_a_motion` is asked for their centres and
/// the usual step.
fn jumps_of(
    posed: &[(f64, ImageId, Rigid3)],
    follow_a_motion: impl Fn(&[Vector3<f64>], f64) -> bool,
) -> Vec<Jump> {
    if posed.len() < MIN_IMAGES {
        return Vec::new();
    }
    let centres: Vec<Vector3<f64>> = posed.iter().map(|(.., pose)| pose.origin_in_a()).collect();
    let steps: Vec<f64> = centres.windows(2).map(|c| (c[1] - c[0]).norm()).collect();
    let mut intervals: Vec<f64> = posed.windows(2).map(|p| p[1].0 - p[0].0).collect();
    let (Some(step), Some(interval)) = (usual(steps), median(&mut intervals)) else {
        return Vec::new();
    };
    if step <= 0.0 || interval <= 0.0 || !follow_a_motion(&centres, step) {
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

/// Whether the step changes little from one image to the next ([`MAX_CHANGE`]).
fn is_smooth(centres: &[Vector3<f64>], step: f64) -> bool {
    let changes = centres.windows(3).map(|c| (c[2] - c[1] - (c[1] - c[0])).norm());
    usual(changes.collect()).is_some_and(|change| change <= MAX_CHANGE * step)
}
