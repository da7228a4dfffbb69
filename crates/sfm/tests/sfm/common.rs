//! Shared measures and seeds of the tests.

use tiepoint_eval::{Alignment, Statistics, compare_poses};
use tiepoint_scene::Reconstruction;

/// The seeds of a test, or other cases: the first of the grid, or all of them if the environment
/// has `TIEPOINT_ALL_SEEDS`, which `bench/seeds.py` sets.
pub(crate) fn sample<T>(grid: &[T]) -> &[T] {
    if std::env::var_os("TIEPOINT_ALL_SEEDS").is_some() { grid } else { &grid[..1] }
}

/// ATE: root mean square error of the camera centres after similarity alignment, in metres.
pub(crate) fn ate_m(model: &Reconstruction, truth: &Reconstruction) -> f64 {
    let found: Vec<_> = model.images().map(|(_, image)| image.cam_from_world().copied()).collect();
    let true_poses: Vec<_> = truth
        .images()
        .map(|(_, image)| *image.cam_from_world().expect("the truth has all poses"))
        .collect();
    let compared = compare_poses(&found, &true_poses, Alignment::Similarity).expect("a trajectory");
    let errors: Vec<f64> = compared.centre_errors.into_iter().flatten().collect();
    Statistics::of(&errors).expect("images with poses").rmse
}
