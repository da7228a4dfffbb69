//! What several tests measure.

use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::Reconstruction;

/// ATE: the root mean square distance of the camera centres from the true ones, after a similarity.
pub(crate) fn ate_m(model: &Reconstruction, truth: &Reconstruction) -> f64 {
    let found: Vec<_> = model.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let true_poses: Vec<_> =
        truth.images().map(|(_, image)| *image.cam_from_world().expect("the truth has all poses")).collect();
    let compared = compare_poses(&found, &true_poses, Alignment::Similarity).expect("a trajectory");
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    Statistics::of(&errors).expect("images with poses").rmse
}
