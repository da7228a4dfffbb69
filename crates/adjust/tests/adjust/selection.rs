//! Grid-based selection of the tracks of an adjustment.

use std::collections::BTreeSet;

use tiepoint_adjust::{AdjustOptions, Scope, build_problem, grid_cell};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, Image, ImageId, Keypoint, Observation, PointId, Reconstruction, Track,
};

const SEED: u64 = 1;
/// Number of points, and the fraction that each image observes. The last image observes fewer
/// than the minimum.
const POINTS: usize = 3000;
const SEEN: [f64; 4] = [0.9, 0.6, 0.5, 0.03];
/// As in `selection.rs`: cells along each side of an image, and the minimum of points of an image.
const CELLS: usize = 10;
const MIN_POINTS: usize = 200;

fn model() -> Reconstruction {
    let mut rng = Rng::stream(SEED, &[]);
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    let camera =
        model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
    for index in 0..SEEN.len() {
        // The square concentrates the keypoints on one side.
        let keypoint = |u: f64, v: f64| Keypoint {
            pixel: Vector2::new(640.0 * u * u, 480.0 * v),
            scale_px: 2.0,
        };
        let keypoints = (0..POINTS).map(|_| keypoint(rng.uniform(), rng.uniform())).collect();
        let image = model.add_image(Image::new(format!("{index}.png"), camera, keypoints));
        let centre = Vector3::new(index as f64, 0.0, 0.0);
        model.register(image, Rigid3::from_axis_angle(Vector3::zeros(), -centre));
    }
    for keypoint in 0..POINTS as u32 {
        let seen = SEEN.iter().enumerate().filter(|(_, share)| rng.uniform() < **share);
        let observations: Vec<Observation> =
            seen.map(|(index, _)| Observation { image: ImageId(index as u32), keypoint }).collect();
        if observations.len() > 1 {
            model.add_track(Track::new(Vector3::new(0.0, 0.0, 9.0), observations));
        }
    }
    model
}

/// The points that take part in an adjustment.
fn points(model: &Reconstruction, scope: &Scope, select_tracks: bool) -> Vec<PointId> {
    let options = AdjustOptions { select_tracks, ..AdjustOptions::default() };
    let variables = build_problem(model, scope, &options, &mut []).unwrap();
    variables.points().iter().map(|(point, _)| *point).collect()
}

/// Number of observations of an image and their cells.
fn seen(model: &Reconstruction, points: &[PointId], image: ImageId) -> (usize, BTreeSet<usize>) {
    let tracks = points.iter().filter_map(|point| model.track(*point));
    let observations = tracks.flat_map(|t| &t.observations).filter(|o| o.image == image);
    let cell = |o: &Observation| {
        let pixel = model.image(image).keypoints[o.keypoint as usize].pixel;
        grid_cell(model.camera_of(image), &pixel, CELLS)
    };
    let cells: Vec<usize> = observations.map(cell).collect();
    (cells.len(), cells.into_iter().collect())
}

#[test]
fn every_image_keeps_its_cells_and_a_minimum_of_points() {
    let model = model();
    let all = points(&model, &Scope::Global, false);
    let selected = points(&model, &Scope::Global, true);
    assert!(selected.is_sorted(), "the order of points decides sums");
    assert!(selected.len() < all.len() / 2, "{} of {}", selected.len(), all.len());
    for (image, _) in model.images() {
        let (count, cells) = seen(&model, &selected, image);
        let (all_count, all_cells) = seen(&model, &all, image);
        assert_eq!(cells, all_cells);
        assert!(count >= all_count.min(MIN_POINTS), "{count} of {all_count}");
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
    // An image that observes fewer points than the minimum needs all of them.
    let scarce = BTreeSet::from([ImageId(3)]);
    let scope = Scope::Local(&scarce);
    assert_eq!(points(&model, &scope, true), points(&model, &scope, false));
    // One that observes many needs the minimum, and one more for each cell at most. The scarce
    // image, which is constant now, would need more.
    let rich = BTreeSet::from([ImageId(0)]);
    let selected = points(&model, &Scope::Local(&rich), true);
    assert!(selected.len() <= MIN_POINTS + CELLS * CELLS, "{}", selected.len());
    let needed_by_scarce = seen(&model, &points(&model, &scope, false), ImageId(3)).0;
    let left = seen(&model, &selected, ImageId(3)).0;
    assert!(left < needed_by_scarce, "{left} of {needed_by_scarce}");
}
