//! How well the points seen so far are spread over an image that is still to be registered.
//!
//! Schönberger & Frahm 2016, section 4.2: the image is divided into 2ˡ × 2ˡ cells for l = 1..=L;
//! every occupied cell of level l counts 2ˡ × 2ˡ, so that many points in one corner score less than
//! as many all over.

use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, Reconstruction};

use crate::image_grid::cell;

/// Levels of the pyramid; the finest has 2⁶ × 2⁶ cells (COLMAP's).
const NUM_LEVELS: u32 = 6;

/// What an unregistered image sees of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Visibility {
    /// Keypoints that match a keypoint which sees a point.
    pub num_points: usize,
    /// Their spread; larger is better.
    pub score: u64,
}

/// What `image` sees of the model.
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
            occupied[cell(camera, &keypoint.pixel, side)] = true;
        }
    }
    Visibility { num_points, score: spread(occupied, side) }
}

/// Σ over levels of occupied cells × cells of that level.
fn spread(mut occupied: Vec<bool>, mut side: usize) -> u64 {
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
    use super::spread;

    #[test]
    fn points_all_over_beat_as_many_in_a_corner() {
        let side = 8;
        let corner: Vec<bool> = (0..side * side).map(|i| i / side < 2 && i % side < 2).collect();
        let everywhere: Vec<bool> =
            (0..side * side).map(|i| (i / side) % 4 == 1 && i % side % 4 == 1).collect();
        assert_eq!(
            corner.iter().filter(|o| **o).count(),
            everywhere.iter().filter(|o| **o).count()
        );
        assert!(spread(everywhere, side) > spread(corner, side));
    }
}
