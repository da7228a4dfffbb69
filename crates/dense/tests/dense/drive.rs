//! Depth maps and cloud of a rendered drive, against its exact surfaces.

use std::ops::Range;

use tiepoint_dense::fusion::{FusedPoint, FusionImage, FusionOptions, fuse};
use tiepoint_dense::stereo::{
    DepthMap, FineSource, PlaneMap, StereoImage, estimate_coarse, estimate_fine,
};
use tiepoint_dense::undistort::Undistortion;
use tiepoint_dense::{Grey, PixelPoses, PosedPinhole, StereoProblem, select_views};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{RowPoses, so3};
use tiepoint_scene::{CameraId, Image, ImageId, Keypoint, Observation, Reconstruction, Track};
use tiepoint_synth::world::SurfacePoint;
use tiepoint_synth::{Drive, DriveOptions, Effects, Mount, RouteKind, ViewDirection};

/// Number of pixels between two seeds of an image, along each axis: as sparse as a sparse model.
const SEED_STEP: usize = 24;

/// A rendered drive with true poses and some true points.
struct Scene {
    drive: Drive,
    model: Reconstruction,
    views: Vec<StereoImage>,
    colors: Vec<Vec<u8>>,
    /// Camera and time of each image.
    exposures: Vec<(usize, f64)>,
}

impl Scene {
    fn new(width: u32, height: u32, frames: usize, direction: ViewDirection) -> Self {
        Self::of(
            &DriveOptions {
                route: RouteKind::Open,
                length_m: 60.0,
                mounts: Mount::stereo(direction, 0.5).to_vec(),
                width,
                height,
                rate_hz: 4.0,
                ..DriveOptions::default()
            },
            0..frames,
        )
    }

    /// The images of these frames of a drive.
    fn of(options: &DriveOptions, frames: Range<usize>) -> Self {
        let mut drive = Drive::new(options).unwrap();
        drive.keep_first(frames.end);
        let truth = drive.truth();
        let mut model = Reconstruction::default();
        let (mut views, mut colors, mut exposures) = (Vec::new(), Vec::new(), Vec::new());
        for (index, camera) in drive.cameras().iter().enumerate() {
            let renderer = drive.renderer(index);
            let of_camera = model.add_camera(*truth.camera(CameraId::from_index(index)));
            for exposure in &camera.exposures[frames.clone()] {
                let rgb = drive.render(index, exposure, &renderer).into_raw();
                let pose = drive.cam_from_world(index, exposure.time_s);
                let image =
                    model.add_image(Image::new(exposure.name.clone(), of_camera, Vec::new()));
                model.register(image, pose);
                let mut camera = PosedPinhole::new(model.camera(of_camera), &pose).unwrap();
                camera.rows = row_poses(&drive, index, exposure.time_s);
                let grey = Grey::from_rgb(camera.width, camera.height, &rgb);
                views.push(StereoImage { camera, grey });
                colors.push(rgb);
                exposures.push((index, exposure.time_s));
            }
        }
        let mut scene = Self { model, drive, views, colors, exposures };
        scene.add_seeds();
        scene
    }

    /// The true surface of a pixel: the point and its depth.
    fn truth(&self, image: usize, pixel: &Vector2<f64>) -> Option<(SurfacePoint, f64)> {
        let (camera, time_s) = self.exposures[image];
        let surface = self.drive.surface_at(camera, time_s, pixel)?;
        let row = self.drive.row_pose(camera, time_s, pixel.y);
        let depth = (row.world_from_cam.inverse() * surface.point_in_world).z;
        (!surface.is_moving).then_some((surface, depth))
    }

    fn centre(&self, image: usize) -> Vector3<f64> {
        self.views[image].camera.cam_from_world.origin_in_a()
    }

    /// Adds the true points of a grid of pixels of each image, as tracks in all images that see
    /// them.
    fn add_seeds(&mut self) {
        let mut points: Vec<Vec<(usize, Vector2<f64>)>> = Vec::new();
        let mut places = Vec::new();
        for image in 0..self.views.len() {
            let camera = &self.views[image].camera;
            for y in (SEED_STEP / 2..camera.height).step_by(SEED_STEP) {
                for x in (SEED_STEP / 2..camera.width).step_by(SEED_STEP) {
                    let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                    let Some((surface, _)) = self.truth(image, &pixel) else { continue };
                    let point = surface.point_in_world;
                    let seen = (0..self.views.len()).filter_map(|other| {
                        let (camera, time_s) = self.exposures[other];
                        let place = self.drive.project(camera, time_s, &point)?;
                        let (there, _) = self.truth(other, &place)?;
                        let pinhole = &self.views[other].camera;
                        let is_inside = place.x >= 0.0
                            && place.y >= 0.0
                            && place.x < pinhole.width as f64
                            && place.y < pinhole.height as f64;
                        (is_inside && (there.point_in_world - point).norm() < 0.05)
                            .then_some((other, place))
                    });
                    points.push(seen.collect());
                    places.push(point);
                }
            }
        }
        let mut model = Reconstruction::default();
        for (_, camera) in self.model.cameras() {
            model.add_camera(*camera);
        }
        for (id, image, pose) in self.model.registered() {
            let seen = points.iter().flatten().filter(|(other, _)| *other == id.index());
            let keypoints = seen.map(|(_, pixel)| Keypoint { pixel: *pixel, scale_px: 2.0 });
            let id =
                model.add_image(Image::new(image.name.clone(), image.camera, keypoints.collect()));
            model.register(id, *pose);
        }
        let mut next = vec![0; self.views.len()];
        for (seen, xyz) in points.iter().zip(places) {
            let observations = seen.iter().map(|(image, _)| {
                next[*image] += 1;
                Observation { image: ImageId::from_index(*image), keypoint: next[*image] - 1 }
            });
            let observations: Vec<Observation> = observations.collect();
            if observations.len() >= 2 {
                model.add_track(Track::new(xyz, observations));
            }
        }
        self.model = model;
    }

    fn problems(&self) -> Vec<StereoProblem> {
        select_views(&self.model, 5)
    }
}

/// The true motion of a camera at the time of an image; `None` for a global shutter.
fn row_poses(drive: &Drive, index: usize, time_s: f64) -> Option<PixelPoses> {
    let camera = &drive.cameras()[index];
    let (readout_s, height_px) = (camera.readout_s, f64::from(camera.height));
    let side = |side: f64| drive.cam_from_world(index, time_s + side * readout_s);
    let (first, last) = (side(-0.5), side(0.5));
    let turn = so3::log(&(last.rotation * first.rotation.inverse()));
    let rows = RowPoses {
        velocity_in_world: (last.origin_in_a() - first.origin_in_a()) / readout_s,
        angular_velocity_rad_s: turn / readout_s,
        readout_s,
        height_px,
    };
    let camera = *drive.truth().camera(CameraId::from_index(index));
    (readout_s != 0.0).then(|| PixelPoses::new(rows, &Undistortion::new(&camera, &camera)))
}

/// Depth maps of all images.
fn depth_maps(scene: &Scene, problems: &[StereoProblem]) -> Vec<DepthMap> {
    let sources = |problem: &StereoProblem| -> Vec<&StereoImage> {
        problem.sources.iter().map(|image| &scene.views[image.index()]).collect()
    };
    let coarse: Vec<PlaneMap> = problems
        .iter()
        .zip(&scene.views)
        .zip(0..)
        .map(|((problem, view), random)| {
            estimate_coarse(view, &sources(problem), &problem.seeds, random).unwrap()
        })
        .collect();
    problems
        .iter()
        .zip(&scene.views)
        .zip(0..)
        .map(|((problem, view), random)| {
            let sources = problem.sources.iter().map(|image| FineSource {
                view: &scene.views[image.index()],
                planes: coarse[image.index()].clone(),
            });
            let own = &coarse[problem.image.index()];
            estimate_fine(view, sources.collect(), &problem.seeds, own, random).unwrap().depths
        })
        .collect()
}

fn fused(scene: &Scene, problems: &[StereoProblem], depths: &[DepthMap]) -> Vec<FusedPoint> {
    let neighbours: Vec<Vec<usize>> = problems
        .iter()
        .map(|problem| problem.sources.iter().map(|image| image.index()).collect())
        .collect();
    let load = |index: usize| {
        let (view, depths) = (&scene.views[index], depths[index].clone());
        FusionImage::new(view.camera.clone(), depths, scene.colors[index].clone())
    };
    let mut points = Vec::new();
    let take = |point| {
        points.push(point);
        Ok(())
    };
    fuse(&neighbours, &FusionOptions::default(), load, take).unwrap();
    points
}

/// What the confidences promise: of the depths of a probability of at least 0.8, at most 5 % are
/// off by more than five footprints. 80 % of those that are not are among them with eight sources;
/// here, with five, 79 %. On a street, depths are right by up to a tenth more often than their
/// probabilities say, and points by up to a twentieth (`docs/benchmarks/dense.md`).
#[test]
fn confidences_are_the_shares_of_right_depths_and_points() {
    let scene = Scene::new(320, 240, 4, ViewDirection::Right);
    let problems = scene.problems();
    let depths = depth_maps(&scene, &problems);
    let (mut all, mut right, mut sure, mut sure_right, mut expected) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (image, map) in depths.iter().enumerate() {
        let focal = scene.views[image].camera.focal[0] as f32;
        for (index, (depth, confidence)) in map.depths.iter().zip(&map.confidences).enumerate() {
            assert_eq!(*depth > 0.0, *confidence > 0.0);
            let (x, y) = ((index % map.width) as f64 + 0.5, (index / map.width) as f64 + 0.5);
            let truth = scene.truth(image, &Vector2::new(x, y)).filter(|_| *depth > 0.0);
            let Some((_, truth)) = truth else { continue };
            let truth = truth as f32;
            let is_right = f32::from(u8::from((depth - truth).abs() <= 5.0 * truth / focal));
            let is_sure = f32::from(u8::from(*confidence >= 0.8));
            (all, right) = (all + 1.0, right + is_right);
            (sure, sure_right) = (sure + is_sure, sure_right + is_sure * is_right);
            expected += f64::from(*confidence);
        }
    }
    assert!(sure_right / sure >= 0.95 && sure_right / right >= 0.75, "{sure_right} {sure} {right}");
    assert!((expected / f64::from(all) - f64::from(right / all)).abs() < 0.1, "{expected}");
    let points = fused(&scene, &problems, &depths);
    let mean = points.iter().map(|point| point.confidence).sum::<f32>() / points.len() as f32;
    assert!((0.95..1.0).contains(&mean), "{mean}");
}

/// Shares of found depths, and of distances to the true surface below 1, 2 and 5 footprints of a
/// pixel, among the pixels with a surface that two images see.
struct Quality {
    found: f64,
    within: [f64; 3],
}

fn quality(scene: &Scene, depths: &[DepthMap]) -> Quality {
    let (mut with_truth, mut found, mut within) = (0.0, 0.0, [0.0; 3]);
    for (image, map) in depths.iter().enumerate() {
        let focal = scene.views[image].camera.focal[0];
        for (index, depth) in map.depths.iter().enumerate() {
            let (x, y) = ((index % map.width) as f64 + 0.5, (index / map.width) as f64 + 0.5);
            let Some((surface, truth)) = scene.truth(image, &Vector2::new(x, y)) else { continue };
            with_truth += 1.0;
            if *depth > 0.0 {
                found += 1.0;
                let ray = (surface.point_in_world - scene.centre(image)).normalize();
                let offset = (f64::from(*depth) / truth - 1.0) * surface.distance;
                let distance = (offset * ray.dot(&surface.normal)).abs();
                for (count, footprints) in within.iter_mut().zip([1.0, 2.0, 5.0]) {
                    *count += f64::from(u8::from(distance < footprints * truth / focal));
                }
            }
        }
    }
    Quality { found: found / with_truth, within: within.map(|count| count / found) }
}

#[test]
fn depth_maps_and_cloud_are_accurate_and_complete() {
    let scene = Scene::new(320, 240, 4, ViewDirection::Right);
    let problems = scene.problems();
    let depths = depth_maps(&scene, &problems);
    let Quality { found, within } = quality(&scene, &depths);
    assert!(found > 0.6, "{found}");
    assert!(within[0] > 0.7 && within[1] > 0.8 && within[2] > 0.9, "{within:?}");
    let points = fused(&scene, &problems, &depths);
    let CloudQuality { accurate, normals, duplicates, visible } = cloud_quality(&scene, &points);
    assert!(accurate > 0.8 && normals > 0.85, "{accurate} {normals}");
    assert!(duplicates < 0.01 && visible > 0.9, "{duplicates} {visible}");
    // Each surface is in the cloud about once, and not once for each of the images that see it.
    let pixels: usize = depths.iter().map(|map| map.depths.len()).sum();
    assert!(points.len() > pixels / 16 && points.len() < pixels / 3, "{}", points.len());
}

/// Of a cloud: share of the points within two footprints of the true surface, mean cosine of the
/// angles to the true normals, share of the points with another point within a quarter of a
/// footprint, share of the visible views that truly see the point.
struct CloudQuality {
    accurate: f64,
    normals: f64,
    duplicates: f64,
    visible: f64,
}

fn cloud_quality(scene: &Scene, points: &[FusedPoint]) -> CloudQuality {
    let (mut accurate, mut normals, mut visible, mut views) = (0.0, 0.0, 0.0, 0.0);
    let mut cells = std::collections::BTreeMap::new();
    let mut duplicates = 0.0;
    for point in points {
        let xyz = Vector3::from(point.xyz.map(f64::from));
        let image = point.views[0] as usize;
        let camera = &scene.views[image].camera;
        let in_camera = camera.cam_from_world * xyz;
        let footprint = in_camera.z / camera.focal[0];
        let (of_camera, time_s) = scene.exposures[image];
        let pixel = scene.drive.project(of_camera, time_s, &xyz).unwrap();
        if let Some((surface, _)) = scene.truth(image, &pixel) {
            let distance = (xyz - surface.point_in_world).dot(&surface.normal).abs();
            accurate += f64::from(u8::from(distance < 2.0 * footprint));
            normals += surface.normal.dot(&Vector3::from(point.normal.map(f64::from)));
        }
        for view in &point.views {
            views += 1.0;
            let (camera, time_s) = scene.exposures[*view as usize];
            let sees = scene.drive.project(camera, time_s, &xyz).and_then(|pixel| {
                let (surface, _) = scene.truth(*view as usize, &pixel)?;
                Some((surface.point_in_world - xyz).norm() < 0.05 * in_camera.z)
            });
            visible += f64::from(u8::from(sees == Some(true)));
        }
        let cell = xyz.map(|value| (value / (0.25 * footprint)).floor() as i64);
        if cells.insert([cell.x, cell.y, cell.z], ()).is_some() {
            duplicates += 1.0;
        }
    }
    let count = points.len() as f64;
    CloudQuality {
        accurate: accurate / count,
        normals: normals / count,
        duplicates: duplicates / count,
        visible: visible / views,
    }
}

/// With the poses of rows, at most 1.1 times as many points are off the surface as with a global
/// shutter; with one pose an image, 1.5 times as many and more.
#[test]
fn a_rolling_shutter_has_the_cloud_of_a_global_one() {
    let off_surface = |readout_s: f64, has_rows: bool| {
        let effects = Effects {
            readout_s,
            suspension: 1.0,
            vibration_rad: 0.05f64.to_radians(),
            ..Effects::default()
        };
        let options = DriveOptions {
            mounts: Mount::stereo(ViewDirection::Front, 0.5).to_vec(),
            width: 320,
            height: 240,
            rate_hz: 4.0,
            effects,
            ..DriveOptions::default()
        };
        // The vehicle begins to move at the time of the first frame, amid its readout.
        let mut scene = Scene::of(&options, 1..5);
        if !has_rows {
            scene.views.iter_mut().for_each(|view| view.camera.rows = None);
        }
        let problems = scene.problems();
        let points = fused(&scene, &problems, &depth_maps(&scene, &problems));
        1.0 - cloud_quality(&scene, &points).accurate
    };
    // The readout of a phone.
    let global = off_surface(0.0, true);
    let (rows, images) = (off_surface(0.033, true), off_surface(0.033, false));
    assert!(rows < 1.1 * global && images > 1.5 * global, "{global} {rows} {images}");
}
