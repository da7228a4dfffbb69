//! The frame of the caller's terms, such as that of measured positions.
//!
//! A model begins in a frame of its own. Before each global adjustment the terms are asked for the
//! similarity to theirs, and the model is moved; the first term that knows it decides for all. From
//! then on all terms take part, and they fix the gauge. Before, only those take part whose
//! measurements hold in any frame.

use tiepoint_adjust::{Term, TermFrame};
use tiepoint_geometry::Sim3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::Reconstruction;

use super::solution::Solution;

/// The similarity `term_from_model` of the first term that knows it.
pub(super) fn term_from_model(terms: &[&mut dyn Term], model: &Reconstruction) -> Option<Sim3> {
    terms.iter().find_map(|term| match term.frame(model) {
        TermFrame::TermFromModel(similarity) => Some(similarity),
        TermFrame::Any | TermFrame::Undetermined => None,
    })
}

/// The terms that take part in an adjustment of a solution.
pub(super) fn active<'a>(
    terms: &'a mut [&mut dyn Term],
    solution: &Solution,
) -> Vec<&'a mut dyn Term> {
    let is_active = |term: &&mut dyn Term| {
        solution.is_in_frame_of_terms || term.frame(&solution.model) == TermFrame::Any
    };
    terms.iter_mut().map(|term| &mut **term as &mut dyn Term).filter(is_active).collect()
}

/// The rigid transform that moves the mean centre of the images as the similarity does.
pub(super) fn without_scaling(similarity: &Sim3, model: &Reconstruction) -> Sim3 {
    let sum: Vector3<f64> = model.registered().map(|(_, _, pose)| pose.origin_in_a()).sum();
    let centre = sum / model.num_registered() as f64;
    let translation = *similarity * centre - similarity.rotation * centre;
    Sim3 { scale: 1.0, translation, ..*similarity }
}
