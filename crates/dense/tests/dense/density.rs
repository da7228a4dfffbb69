//! Density of the fused cloud of images at two distances, whatever their order.

use tiepoint_dense::PosedPinhole;
use tiepoint_dense::fusion::{FusionImage, FusionOptions, fuse};
use tiepoint_dense::stereo::DepthMap;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;

const FOCAL: f64 = 50.0;
const SIZE: [usize; 2] = [64, 48];

/// A camera that looks along z at the plane z = 0, and its exact depths.
fn image(x: f64, distance: f64) -> FusionImage {
    let [width, height] = SIZE;
    let camera = PosedPinhole {
        width,
        height,
        focal: [FOCAL; 2],
        centre: SIZE.map(|size| 0.5 * size as f64),
        cam_from_world: Rigid3::new(Rigid3::identity().rotation, Vector3::new(-x, 0.0, distance)),
        rows: None,
    };
    let count = width * height;
    let (depths, confidences) = (vec![distance as f32; count], vec![0.5; count]);
    let depths = DepthMap { width, height, depths, confidences };
    FusionImage::new(camera, depths, vec![128; 3 * width * height]).unwrap()
}

#[test]
fn a_surface_has_the_points_of_its_nearest_image_in_any_order() {
    // Three images at a distance of 10, and three at 5, whose pixels are half as large.
    let images = [(-0.3, 10.0), (0.0, 10.0), (0.3, 10.0), (-0.3, 5.0), (0.0, 5.0), (0.3, 5.0)];
    for order in [[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [2, 4, 0, 5, 3, 1]] {
        let neighbours: Vec<Vec<usize>> =
            (0..6).map(|own| (0..6).filter(|other| *other != own).collect()).collect();
        let load = |index: usize| {
            let (x, distance) = images[order[index]];
            Ok::<_, std::convert::Infallible>(image(x, distance))
        };
        let mut points: Vec<Vector3<f64>> = Vec::new();
        let take = |point: tiepoint_dense::fusion::FusedPoint| {
            points.push(Vector3::from(point.xyz.map(f64::from)));
            Ok(())
        };
        let Ok(()) = fuse(&neighbours, &FusionOptions::default(), load, take);
        // What all near images see, and what only far images see: half widths less two pixels.
        let half = SIZE.map(|size| 0.5 * size as f64 - 2.0);
        let near = half.map(|half| 5.0 / FOCAL * half);
        let far = half.map(|half| 10.0 / FOCAL * half);
        let all_near = |p: &&Vector3<f64>| p.x.abs() < near[0] - 0.3 && p.y.abs() < near[1];
        let only_far = |p: &&Vector3<f64>| p.y.abs() > near[1] + 0.4 && p.y.abs() < far[1];
        let area_near = 4.0 * (near[0] - 0.3) * near[1] / (5.0 / FOCAL).powi(2);
        let found = points.iter().filter(all_near).count() as f64;
        // One point a pixel: lines along which two images change places and borders of the area
        // are a few rows and columns of 20 and 27.
        assert!((0.9..1.1).contains(&(found / area_near)), "{order:?}: {found} of {area_near}");
        let is_within = |p: &&Vector3<f64>| p.x.abs() < far[0] - 0.3;
        let area_far = 4.0 * (far[0] - 0.3) * (far[1] - near[1] - 0.4) / (10.0 / FOCAL).powi(2);
        let found = points.iter().filter(only_far).filter(is_within).count() as f64;
        assert!((0.9..1.1).contains(&(found / area_far)), "{order:?}: {found} of {area_far}");
    }
}
