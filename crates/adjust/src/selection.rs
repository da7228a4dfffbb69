//! Grid-based track selection: the longest tracks, distributed over every image.
//!
//! The information of a point on the poses grows with its number of observations, and neighbouring
//! points are redundant. While a model grows, some hundreds of points an image determine the poses
//! as well as ten thousand, and an iteration costs proportionally less.

use tiepoint_scene::{ImageId, Observation, PointId, Reconstruction};

use crate::image_grid::grid_cell;

/// Cells along each side of an image. At least one point of each occupied cell is selected.
const CELLS: usize = 10;
/// Minimum number of selected points in every image that has them.
const MIN_POINTS: u32 = 200;

/// Selects the points that the images accepted by `is_variable` need, longest tracks first. Ties go
/// to the earlier point. The result has the order of `points`.
pub(crate) fn select_points(
    model: &Reconstruction,
    points: Vec<PointId>,
    is_variable: impl Fn(ImageId) -> bool,
) -> Vec<PointId> {
    let mut tracks: Vec<_> = points
        .iter()
        .enumerate()
        .filter_map(|(place, point)| Some((place, model.track(*point)?)))
        .collect();
    tracks.sort_by_key(|(place, track)| (std::cmp::Reverse(track.observations.len()), *place));
    let mut is_covered = vec![false; CELLS * CELLS * model.images().count()];
    let mut num_selected = vec![0; model.images().count()];
    let mut is_selected = vec![false; points.len()];
    for (place, track) in tracks {
        let moving = || track.observations.iter().filter(|o| is_variable(o.image));
        let is_needed = |o: &Observation| {
            num_selected[o.image.index()] < MIN_POINTS || !is_covered[cell(model, o)]
        };
        is_selected[place] = moving().any(is_needed);
        if is_selected[place] {
            for observation in moving() {
                is_covered[cell(model, observation)] = true;
                num_selected[observation.image.index()] += 1;
            }
        }
    }
    points
        .into_iter()
        .zip(is_selected)
        .filter_map(|(point, is_selected)| is_selected.then_some(point))
        .collect()
}

/// Index of a keypoint's cell among the cells of all images.
fn cell(model: &Reconstruction, observation: &Observation) -> usize {
    let pixel = &model.image(observation.image).keypoints[observation.keypoint as usize].pixel;
    let of_image = grid_cell(model.camera_of(observation.image), pixel, CELLS);
    observation.image.index() * CELLS * CELLS + of_image
}
