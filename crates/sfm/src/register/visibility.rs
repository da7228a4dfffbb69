//! Visibility score of an unregistered image.
//!
//! Schönberger & Frahm 2016, section 4.2: the image is divided into 2ˡ × 2ˡ cells for l = 1..=L.
//! Every occupied cell of level l scores 2ˡ × 2ˡ, so that points concentrated in one corner score
//! less than as many distributed points.

use tiepoint_adjust::grid_cell;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, Reconstruction};

/// Levels of the pyramid. The finest has 2⁶ × 2⁶ cells, as in COLMAP.
const NUM_LEVELS: u32 = 6;

/// Visible points of an unregistered image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Visibility {
    /// Number of keypoints with a match that observes a point.
    pub num_points: usize,
    /// Visibility score; larger is better.
    pub score: u64,
}

/// Computes the visibility of `image`.
pub(crate) fn visibility(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
) -> Visibility {
    let side = 1usize << NUM_LEVELS;
    let camera = model.camera_of(image);
    let mut occupied = vec![false; side * side];
    let mut num_points = 0;
    for (index, keypoint) in model.image(image).keypoints.iter().enumerate() {
        let targets = graph.correspondences(Observation { image, keypoint: index as u32 });
        if targets.iter().any(|t| model.image(t.image).point_of(t.keypoint).is_some()) {
            num_points += 1;
            occupied[grid_cell(camera, &keypoint.pixel, side)] = true;
        }
    }
    Visibility { num_points, score: pyramid_score(occupied, side) }
}

/// Sum over levels of the number of occupied cells times the number of cells of the level.
fn pyramid_score(mut occupied: Vec<bool>, mut side: usize) -> u64 {
    let mut score = 0;
    while side > 1 {
        score += occupied.iter().filter(|&&o| o).count() as u64 * (side * side) as u64;
        let half = side / 2;
        let mut coarser = vec![false; half * half];
        for (index, _) in occupied.iter().enumerate().filter(|(_, o)| **o) {
            coarser[(index / side / 2) * half + index % side / 2] = true;
        }
        (occupied, side) = (coarser, half);
    }
    score
}

#[cfg(test)]
mod tests {
    use super::pyramid_score;

    #[test]
    fn distributed_points_score_more_than_as_many_in_a_corner() {
        let side = 8;
        let corner: Vec<bool> = (0..side * side).map(|i| i / side < 2 && i % side < 2).collect();
        let everywhere: Vec<bool> =
            (0..side * side).map(|i| (i / side) % 4 == 1 && i % side % 4 == 1).collect();
        assert_eq!(
            corner.iter().filter(|o| **o).count(),
            everywhere.iter().filter(|o| **o).count()
        );
        assert!(pyramid_score(everywhere, side) > pyramid_score(corner, side));
    }
}
