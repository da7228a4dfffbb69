//! Whether a model holds two places that look alike as one.

use tiepoint_scene::ImageId;

use super::refiner::Refiner;
use crate::mapped_model::OtherPlace;
use crate::register::duplicate_place;
use crate::timeline::{images_in_time, images_of_cameras};

impl Refiner<'_> {
    /// The smaller of two places that the model holds as one. Not looked for in models of known
    /// rigs and of given poses, and where times of cameras are known: their continuity is better
    /// evidence.
    pub(super) fn other_place(&self) -> Option<OtherPlace> {
        let input = self.input;
        let is_timed = |images: &Vec<ImageId>| images_in_time(input.scene, images).is_some();
        if input.known_rigs.is_some()
            || self.existing.is_some()
            || images_of_cameras(input.scene).values().any(is_timed)
        {
            return None;
        }
        let options = input.options;
        duplicate_place(
            input.graph,
            &self.solution.model,
            options.min_model_size,
            options.register.max_error_px,
            options.seed,
        )
    }
}
