//! Grid-based track selection: the longest tracks, distributed over every image.
//!
//! The information of a point on the poses grows with its number of observations, and neighbouring
//! points are redundant. While a model grows, some hundreds of points an image determine the poses
//! as well as ten thousand, and an iteration costs proportionally less.

use tiepoint_scene::{ImageId, Observation, PointId, Reconstruction};

use crate::image_grid;

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
    let of_image = image_grid::cell(model.camera_of(observation.image), pixel, CELLS);
    observation.image.index() * CELLS * CELLS + of_image
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng};
    use tiepoint_scene::{Camera, Image, Keypoint, Track};

    use super::*;

    const SEED: u64 = 1;
    /// Number of points, and the fraction that each image observes. The last image observes fewer
    /// than the minimum.
    const POINTS: usize = 3000;
    const SEEN: [f64; 4] = [0.9, 0.6, 0.5, 0.03];

    fn model() -> Reconstruction {
        let mut rng = Rng::stream(SEED, &[]);
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        for (index, seen) in SEEN.iter().enumerate() {
            // The square concentrates the keypoints on one side.
            let keypoint = |u: f64, v: f64| Keypoint {
                pixel: Vector2::new(640.0 * u * u, 480.0 * v),
                scale_px: 2.0,
            };
            let keypoints = (0..POINTS).map(|_| keypoint(rng.uniform(), rng.uniform())).collect();
            let image = model.add_image(Image::new(format!("{index}.png"), camera, keypoints));
            assert_eq!((image.index(), *seen > 0.0), (index, true));
        }
        for keypoint in 0..POINTS as u32 {
            let seen = SEEN.iter().enumerate().filter(|(_, share)| rng.uniform() < **share);
            let observations: Vec<Observation> = seen
                .map(|(index, _)| Observation { image: ImageId(index as u32), keypoint })
                .collect();
            if observations.len() > 1 {
                model.add_track(Track::new(Vector3::zeros(), observations));
            }
        }
        model
    }

    /// Number of observations of an image and their cells.
    fn seen(
        model: &Reconstruction,
        points: &[PointId],
        image: ImageId,
    ) -> (usize, std::collections::BTreeSet<usize>) {
        let tracks = points.iter().filter_map(|point| model.track(*point));
        let cells: Vec<usize> = tracks
            .flat_map(|t| &t.observations)
            .filter(|o| o.image == image)
            .map(|o| cell(model, o))
            .collect();
        (cells.len(), cells.into_iter().collect())
    }

    #[test]
    fn every_image_keeps_its_cells_and_a_minimum_of_points() {
        let model = model();
        let all: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
        let selected = select_points(&model, all.clone(), |_| true);
        assert!(
            selected.is_sorted() && selected.len() < all.len() / 2,
            "{} of {}",
            selected.len(),
            all.len()
        );
        for (image, _) in model.images() {
            let (count, cells) = seen(&model, &selected, image);
            let (all_count, all_cells) = seen(&model, &all, image);
            assert_eq!(cells, all_cells);
            assert!(count >= all_count.min(MIN_POINTS as usize), "{count} of {all_count}");
        }
        // Long tracks are preferred.
        let mean = |points: &[PointId]| {
            let lengths =
                points.iter().filter_map(|p| model.track(*p)).map(|track| track.observations.len());
            lengths.sum::<usize>() as f64 / points.len() as f64
        };
        assert!(mean(&selected) > mean(&all));
    }

    #[test]
    fn constant_images_need_no_points() {
        let model = model();
        let all: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
        let moving = ImageId(3);
        let selected = select_points(&model, all.clone(), |image| image == moving);
        let expected = seen(&model, &all, moving);
        assert_eq!((selected.len(), seen(&model, &selected, moving)), (expected.0, expected));
    }
}
