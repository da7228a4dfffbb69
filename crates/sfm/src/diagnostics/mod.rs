//! Facts of a finished model that tell a wrong one: images that contradict their shared camera,
//! residuals that the lens model leaves, places where a lens has no rays, images with few
//! observations, points behind cameras, poses that jump, and images that a camera gives which only
//! turned. And why images are in no model.

mod image_scale;
mod jumps;
mod lens;
mod turning;
mod unregistered;

use tiepoint_scene::{ImageId, Reconstruction};

pub use image_scale::{ImageScale, image_scales};
pub use jumps::{Jump, jumps};
pub use lens::{LensResiduals, lens_residuals};
pub use turning::{Turning, turning};
pub use unregistered::{UnregisteredImage, UnregisteredReason, nearest_pair, unregistered_images};

/// The registered images with fewer observations of points than `min`, and their numbers.
pub fn images_with_few_observations(model: &Reconstruction, min: usize) -> Vec<(ImageId, usize)> {
    let mut counts = vec![0; model.num_images()];
    for observation in model.tracks().flat_map(|(_, track)| &track.observations) {
        counts[observation.image.index()] += 1;
    }
    let count = |(id, ..): (ImageId, _, _)| (id, counts[id.index()]);
    model.registered().map(count).filter(|(_, count)| *count < min).collect()
}

/// The number of observations whose point has no image: it is behind the camera, or outside of what
/// the lens shows.
pub fn num_points_behind(model: &Reconstruction) -> usize {
    let of_track = |track: &tiepoint_scene::Track| {
        let is_behind = |o: &&tiepoint_scene::Observation| {
            model.image(o.image).cam_from_world().is_some()
                && model.observation_error_px(o, &track.xyz).is_none()
        };
        track.observations.iter().filter(is_behind).count()
    };
    model.tracks().map(|(_, track)| of_track(track)).sum()
}
