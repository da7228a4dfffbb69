//! What is known of pairs of images: which are near each other, and which verified pairs contradict
//! the poses.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};

use crate::two_view::agreement;

/// Indices are into the list of registered images, in the order of their ids.
pub(super) struct Relations {
    /// All images in the order of their distance from each one, itself first.
    pub(super) nearest: Vec<Vec<usize>>,
    /// Verified pairs of which most matches disagree with the poses: the model has put at least one
    /// of the images at a wrong place.
    pub(super) contradictions: Vec<(usize, usize)>,
}

impl Relations {
    /// A match agrees with the poses to `max_error_px`.
    pub(super) fn new(
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        max_error_px: f64,
    ) -> Self {
        let images: Vec<ImageId> = model.registered().map(|(id, ..)| id).collect();
        let centres: Vec<Vector3<f64>> =
            model.registered().map(|(_, _, pose)| pose.origin_in_a()).collect();
        let nearest = |from: &Vector3<f64>| {
            let distance = |image: &usize| (centres[*image] - from).norm_squared();
            let mut order: Vec<usize> = (0..centres.len()).collect();
            order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            order
        };
        let contradiction = |pair: &ImagePair| {
            let pose = |image| model.image(image).cam_from_world();
            let poses = [pose(pair.a)?, pose(pair.b)?];
            let agrees = agreement(graph, model, *pair, poses, max_error_px);
            let index = |image| images.binary_search(&image).ok();
            (2 * agrees.num_agreeing < agrees.num_matches)
                .then_some((index(pair.a)?, index(pair.b)?))
        };
        let pairs: Vec<ImagePair> = graph.pairs().keys().copied().collect();
        let contradictions = pairs.par_iter().filter_map(contradiction).collect();
        Self { nearest: centres.par_iter().map(nearest).collect(), contradictions }
    }
}
