//! Undistortion: sizes as COLMAP's, exact reprojection, images and masks.

use tiepoint_dense::undistort::{
    UndistortOptions, Undistortion, undistort_camera, undistort_model,
};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_scene::{Camera, Image, Keypoint, Observation, Reconstruction, Track};

fn camera(kind: CameraModelKind, params: &[f64], width: u32, height: u32) -> Camera {
    let intrinsics = Intrinsics::new(kind, params).unwrap();
    Camera { intrinsics, width, height, has_focal_prior: true }
}

/// One camera of each model that has a PINHOLE camera, with distortion where it is listed.
fn cameras() -> Vec<Camera> {
    use CameraModelKind::*;
    let of = |kind: CameraModelKind| -> Vec<f64> {
        match kind {
            SimplePinhole => vec![120.0, 81.0, 59.0],
            Pinhole => vec![120.0, 118.0, 81.0, 59.0],
            SimpleRadial => vec![120.0, 81.0, 59.0, -0.12],
            Radial => vec![120.0, 81.0, 59.0, 0.1, -0.02],
            Opencv => vec![120.0, 118.0, 81.0, 59.0, -0.1, 0.02, 0.003, -0.002],
            OpencvFisheye => vec![90.0, 91.0, 81.0, 59.0, 0.02, -0.01, 0.003, 0.0],
            ThinPrismFisheye => {
                vec![90.0, 91.0, 81.0, 59.0, 0.02, -0.01, 0.001, 0.001, 0.0, 0.0, 0.001, 0.001]
            }
            _ => Intrinsics::centred(kind, 110.0, 160, 120).params().to_vec(),
        }
    };
    let kinds = CameraModelKind::ALL.iter().filter(|kind| **kind != Equirectangular);
    kinds.map(|kind| camera(*kind, &of(*kind), 160, 120)).collect()
}

#[test]
fn panoramas_have_no_pinhole() {
    let kind = CameraModelKind::Equirectangular;
    let panorama = camera(kind, Intrinsics::centred(kind, 25.0, 160, 80).params(), 160, 80);
    let error = undistort_camera(&panorama, &UndistortOptions::default()).unwrap_err();
    assert_eq!(error, tiepoint_dense::Error::NoPinhole { model: "EQUIRECTANGULAR" });
}

fn undistorted(camera: &Camera, options: &UndistortOptions) -> Camera {
    undistort_camera(camera, options).unwrap()
}

/// The sizes that COLMAP's own test asks of its `UndistortCamera`.
#[test]
fn sizes_are_those_of_colmap() {
    let options = UndistortOptions::default();
    let with = |k: f64| {
        let distorted = camera(CameraModelKind::SimpleRadial, &[100.0, 50.0, 50.0, k], 100, 100);
        undistorted(&distorted, &options)
    };
    let straight = with(0.5);
    assert_eq!((straight.width, straight.height), (84, 84));
    assert_eq!(straight.intrinsics.params(), [100.0, 100.0, 42.0, 42.0]);
    let limited = undistorted(
        &camera(CameraModelKind::SimplePinhole, &[100.0, 50.0, 40.0], 100, 80),
        &UndistortOptions { max_image_size: Some(50), ..options },
    );
    assert_eq!((limited.width, limited.height), (50, 40));
    assert_eq!(limited.intrinsics.params(), [50.0, 50.0, 25.0, 20.0]);
}

#[test]
fn rays_are_kept_exactly() {
    for camera in cameras() {
        for blank_pixels in [0.0, 0.4, 1.0] {
            let options = UndistortOptions { blank_pixels, ..UndistortOptions::default() };
            let to = undistorted(&camera, &options);
            let undistortion = Undistortion::new(&camera, &to);
            for (x, y) in [(0.5, 0.5), (80.0, 60.0), (159.5, 119.5), (30.25, 100.75), (150.0, 3.0)]
            {
                let pixel = Vector2::new(x, y);
                let ray = camera.intrinsics.unproject(&pixel).unwrap();
                let place = undistortion.pixel(&pixel).unwrap();
                let error = to.intrinsics.unproject(&place).unwrap() - ray;
                assert!(error.norm() < 1e-12, "{:?} {pixel:?}: {error:?}", camera.intrinsics);
            }
        }
    }
}

/// Without blank pixels, every pixel has a source; with all of them, every source has a pixel.
#[test]
fn blank_pixels_are_those_asked_for() {
    for camera in cameras() {
        let none = undistorted(&camera, &UndistortOptions::default());
        let mask = Undistortion::new(&camera, &none).mask(None).unwrap();
        let blank = mask.iter().filter(|pixel| **pixel == 0).count();
        // COLMAP's borders are lines of pixel centres, so that the outermost half pixel may lie
        // outside; its sizes are rounded down.
        let border = 2 * (none.width + none.height) as usize;
        assert!(blank <= border, "{blank} of {} blank: {:?}", mask.len(), camera.intrinsics);
        let all = undistorted(
            &camera,
            &UndistortOptions { blank_pixels: 1.0, ..UndistortOptions::default() },
        );
        assert!(all.width >= none.width && all.height >= none.height);
        let undistortion = Undistortion::new(&camera, &all);
        for (x, y) in (0..camera.width).flat_map(|x| (0..camera.height).map(move |y| (x, y))) {
            let place =
                undistortion.pixel(&Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).unwrap();
            let (width, height) = (f64::from(all.width), f64::from(all.height));
            // Sizes are rounded down.
            assert!((-1.5..=width + 1.5).contains(&place.x), "{place:?} of {width} {height}");
            assert!((-1.5..=height + 1.5).contains(&place.y), "{place:?} of {width} {height}");
        }
    }
}

#[test]
fn scales_are_limited() {
    // 150° of a fisheye through a pinhole are far larger than twice the image.
    let fisheye = camera(
        CameraModelKind::OpencvFisheye,
        &[60.0, 60.0, 80.0, 60.0, 0.0, 0.0, 0.0, 0.0],
        160,
        120,
    );
    let options = UndistortOptions { blank_pixels: 1.0, ..UndistortOptions::default() };
    let large = undistorted(&fisheye, &options);
    assert_eq!((large.width, large.height), (320, 240));
    let small = undistorted(&fisheye, &UndistortOptions { max_scale: 0.5, ..options });
    assert_eq!((small.width, small.height), (80, 60));
}

#[test]
fn impossible_options_are_errors() {
    let default = UndistortOptions::default();
    let pinhole = camera(CameraModelKind::SimplePinhole, &[100.0, 50.0, 50.0], 100, 100);
    for (options, name) in [
        (UndistortOptions { blank_pixels: -0.1, ..default }, "blank_pixels"),
        (UndistortOptions { min_scale: 0.0, ..default }, "min_scale"),
        (UndistortOptions { max_scale: 0.1, ..default }, "max_scale"),
        (UndistortOptions { max_image_size: Some(0), ..default }, "max_image_size"),
    ] {
        let error = undistort_camera(&pinhole, &options).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}

/// An image whose grey values encode the rays: after undistortion each pixel has that of its ray.
#[test]
fn images_show_the_rays_of_their_camera() {
    for from in cameras() {
        for max_image_size in [None, Some(70)] {
            let grey = |intrinsics: &Intrinsics, x: f64, y: f64| {
                let ray = intrinsics.unproject(&Vector2::new(x, y)).unwrap();
                let (u, v) = (ray.x / ray.z, ray.y / ray.z);
                [128.0 + 60.0 * (2.0 * u).sin(), 128.0 + 60.0 * (2.0 * v).cos()]
            };
            let pixels: Vec<u8> = (0..from.height)
                .flat_map(|y| (0..from.width).map(move |x| (x, y)))
                .flat_map(|(x, y)| {
                    let grey = grey(&from.intrinsics, f64::from(x) + 0.5, f64::from(y) + 0.5);
                    grey.map(|grey| grey.round() as u8)
                })
                .collect();
            let options = UndistortOptions { max_image_size, ..UndistortOptions::default() };
            let to = undistorted(&from, &options);
            let undistortion = Undistortion::new(&from, &to);
            let image = undistortion.image::<2>(&pixels).unwrap();
            assert_eq!(image.len(), 2 * (to.width * to.height) as usize);
            for (index, found) in image.chunks_exact(2).enumerate() {
                let (x, y) = (index as u32 % to.width, index as u32 / to.width);
                let edge = x.min(y).min(to.width - 1 - x).min(to.height - 1 - y);
                if edge < 2 {
                    continue;
                }
                let expected = grey(&to.intrinsics, f64::from(x) + 0.5, f64::from(y) + 0.5);
                for channel in 0..2 {
                    let error = (f64::from(found[channel]) - expected[channel]).abs();
                    assert!(error < 1.6, "{:?} at {x}, {y}: {error}", from.intrinsics);
                }
            }
            assert!(undistortion.image::<1>(&pixels).is_err());
        }
    }
}

#[test]
fn masks_are_never_wider_than_their_source() {
    let from = cameras().remove(2);
    let to = undistorted(&from, &UndistortOptions::default());
    let undistortion = Undistortion::new(&from, &to);
    let is_left = |x: u32| x < 60;
    let mask: Vec<u8> = (0..from.width * from.height)
        .map(|index| if is_left(index % from.width) { 0 } else { 255 })
        .collect();
    let new = undistortion.mask(Some(&mask)).unwrap();
    let mut used = 0;
    for (index, value) in new.iter().enumerate() {
        let pixel = Vector2::new(
            (index as u32 % to.width) as f64 + 0.5,
            (index as u32 / to.width) as f64 + 0.5,
        );
        let ray = to.intrinsics.unproject(&pixel).unwrap();
        let source = from.intrinsics.project(&ray).unwrap();
        if *value != 0 {
            assert!(!is_left(source.x as u32));
            used += 1;
        }
    }
    assert!(used > new.len() / 2 && used < new.len());
}

#[test]
fn models_keep_their_reprojection_errors_at_zero() {
    for from in cameras() {
        let mut model = Reconstruction::default();
        let id = model.add_camera(from);
        let points: Vec<Vector3<f64>> = (0..12)
            .map(|k| Vector3::new(0.2 * f64::from(k % 4) - 0.3, 0.2 * f64::from(k / 4) - 0.2, 2.0))
            .collect();
        let poses = [0.0, 0.1, 0.2].map(|x| {
            Rigid3::from_axis_angle(Vector3::new(0.0, 0.1 * x, 0.0), Vector3::new(-x, 0.0, 0.0))
        });
        let keypoints = |pose: &Rigid3| -> Vec<Keypoint> {
            let pixel = |point| from.intrinsics.project(&(*pose * point)).unwrap();
            points.iter().map(|p| Keypoint { pixel: pixel(*p), scale_px: 2.0 }).collect()
        };
        // The second image has no pose: it is left out.
        let images = poses.map(|pose| {
            let name = format!("{}.jpg", pose.translation.x);
            model.add_image(Image::new(name, id, keypoints(&pose)))
        });
        model.register(images[0], poses[0]);
        model.register(images[2], poses[2]);
        for (keypoint, point) in points.iter().enumerate() {
            let observations = [images[0], images[2]]
                .map(|image| Observation { image, keypoint: keypoint as u32 });
            model.add_track(Track::new(*point, observations.to_vec()));
        }
        let new = undistort_model(&model, &UndistortOptions::default()).unwrap();
        new.validate().unwrap();
        assert_eq!((new.num_images(), new.num_tracks()), (2, points.len()));
        assert!(new.mean_reprojection_error_px() < 1e-9);
        assert!(new.cameras().all(|(_, c)| c.intrinsics.kind() == CameraModelKind::Pinhole));
    }
}
