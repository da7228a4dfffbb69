//! Which images are near each other.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::Reconstruction;

/// All registered images in the order of their distance from each one, itself first. Indices are
/// into the list of registered images, in the order of their ids.
pub(super) fn nearest(model: &Reconstruction) -> Vec<Vec<usize>> {
    let centres: Vec<Vector3<f64>> =
        model.registered().map(|(_, _, pose)| pose.origin_in_a()).collect();
    let nearest = |from: &Vector3<f64>| {
        let distance = |image: &usize| (centres[*image] - from).norm_squared();
        let mut order: Vec<usize> = (0..centres.len()).collect();
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        order
    };
    centres.par_iter().map(nearest).collect()
}
