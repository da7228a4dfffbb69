//! Motion of cameras during the exposure of an image, and the shift of keypoints that it causes.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tiepoint_adjust::Shifted;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{RowPoses, so3};
use tiepoint_rig::Trajectory;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::readout::RollingShutter;
use crate::timeline::{posed_in_time, usual};

/// Maximum speed of a camera relative to its usual speed.
const MAX_SPEED: f64 = 3.0;
/// Step of the differences for velocities, in seconds.
const DIFFERENCE_S: f64 = 1e-3;

/// Velocity of a camera at the time of an image.
struct Motion {
    /// In the world frame, units of the model a second.
    velocity: Vector3<f64>,
    /// In the camera frame, radians a second.
    angular_velocity: Vector3<f64>,
}

/// Returns the motion of the images with known times and neighbours. Images with an implausible
/// speed are left out: a camera next to a wrongly registered image seems to move fast, and a few
/// such images outweigh thousands in the estimate of the readout time.
fn motions(model: &Reconstruction) -> Vec<(ImageId, Motion)> {
    let mut motions = Vec::new();
    for (camera, _) in model.cameras() {
        let posed = posed_in_time(model, camera);
        let trajectory = Trajectory::new(posed.iter().map(|(time_s, _, pose)| (*time_s, *pose)));
        let mut of_camera = Vec::new();
        for (time_s, id, _) in posed {
            let Some(first) = trajectory.knots_around(time_s) else { continue };
            let knots = trajectory.knots(first);
            let [before, after] = [-0.5, 0.5].map(|side| knots.at(time_s + side * DIFFERENCE_S));
            let velocity = (after.origin_in_a() - before.origin_in_a()) / DIFFERENCE_S;
            let angular_velocity =
                so3::log(&(after.rotation * before.rotation.inverse())) / DIFFERENCE_S;
            of_camera.push((id, Motion { velocity, angular_velocity }));
        }
        let speed = |(_, motion): &(ImageId, Motion)| motion.velocity.norm();
        let usual_speed = usual(of_camera.iter().map(speed).collect()).unwrap_or(0.0);
        motions.extend(
            of_camera.into_iter().filter(|motion| speed(motion) <= MAX_SPEED * usual_speed),
        );
    }
    motions
}

/// Returns the shift per second of readout of all keypoints, linearised at the current readout
/// times.
pub(super) fn shifted(
    model: &Reconstruction,
    detected: &BTreeMap<ImageId, Vec<Vector2<f64>>>,
    shutters: &[RollingShutter],
) -> BTreeMap<ImageId, Vec<Shifted>> {
    let of_image = |(id, motion): &(ImageId, Motion)| {
        let readout_s = readout_s(shutters, model.image(*id).camera);
        // The shift is a difference quotient and needs a step.
        let readout_s = if readout_s.abs() < DIFFERENCE_S { DIFFERENCE_S } else { readout_s };
        (*id, shifts(model, *id, &detected[id], motion, readout_s))
    };
    motions(model).par_iter().map(of_image).collect::<Vec<_>>().into_iter().collect()
}

pub(super) fn readout_s(shutters: &[RollingShutter], camera: CameraId) -> f64 {
    shutters
        .iter()
        .find(|shutter| shutter.camera == camera)
        .map_or(0.0, |shutter| shutter.readout_s)
}

/// Returns the detected keypoints of one image, each with its shift per second of readout (pixels
/// per second) at the current readout time. A keypoint without a point is assumed to be at the
/// median distance of the image's points.
fn shifts(
    model: &Reconstruction,
    image: ImageId,
    pixels: &[Vector2<f64>],
    motion: &Motion,
    readout_s: f64,
) -> Vec<Shifted> {
    let (camera, image) = (model.camera_of(image), model.image(image));
    let pose = image.cam_from_world();
    let in_camera = |keypoint: usize| {
        let track = model.track(image.point_of(keypoint as u32)?)?;
        Some(*pose? * track.xyz)
    };
    let mut distances: Vec<f64> =
        (0..pixels.len()).filter_map(|k| Some(in_camera(k)?.norm())).collect();
    let distance = median(&mut distances);
    let shift = |k: usize, pixel: &Vector2<f64>| {
        let point = match in_camera(k) {
            Some(point) => point,
            None => camera.intrinsics.unproject(pixel)? * distance?,
        };
        let time_s = (pixel.y / f64::from(camera.height) - 0.5) * readout_s;
        let velocity = pose?.rotation * motion.velocity;
        let moved = so3::exp(&(motion.angular_velocity * time_s)) * (point - velocity * time_s);
        let intrinsics = &camera.intrinsics;
        let (moved, still) = (intrinsics.project(&moved)?, intrinsics.project(&point)?);
        Some(intrinsics.displacement(&moved, &still) / readout_s)
    };
    let shifted = |(k, pixel): (usize, &Vector2<f64>)| Shifted {
        pixel: *pixel,
        shift: shift(k, pixel).unwrap_or_default(),
    };
    pixels.iter().enumerate().map(shifted).collect()
}

/// Returns the motion of the images of rolling-shutter cameras, if known: images with times and
/// neighbours in time, except next to one that seems to be misplaced. It is a function of the poses
/// and times of a model.
pub fn row_poses(
    model: &Reconstruction,
    shutters: &[RollingShutter],
) -> BTreeMap<ImageId, RowPoses> {
    let of_image = |(id, motion): (ImageId, Motion)| {
        let readout_s = readout_s(shutters, model.image(id).camera);
        let rows = RowPoses {
            velocity_in_world: motion.velocity,
            angular_velocity_rad_s: motion.angular_velocity,
            readout_s,
            height_px: f64::from(model.camera_of(id).height),
        };
        (readout_s != 0.0).then_some((id, rows))
    };
    motions(model).into_iter().filter_map(of_image).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Image};

    const IMAGES: usize = 100;
    const RATE_HZ: f64 = 10.0;
    const SPEED: f64 = 2.0;
    const MISPLACED: usize = 50;
    /// Images whose velocity depends on the misplaced one.
    const AFFECTED: std::ops::RangeInclusive<usize> = MISPLACED - 2..=MISPLACED + 1;

    /// A camera at constant speed with one misplaced image.
    fn drive(error: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        for i in 0..IMAGES {
            let id = model.add_image(Image::new(format!("{i}.png"), camera, Vec::new()));
            let time_s = i as f64 / RATE_HZ;
            let along = SPEED * time_s + if i == MISPLACED { error } else { 0.0 };
            model.set_time(id, Some(time_s));
            model.register(
                id,
                Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-along, 0.0, 0.0)),
            );
        }
        model
    }

    const READOUT_S: f64 = 0.02;
    /// Rounding error in pixels of the difference over the readout time.
    const ROUNDING_PX: f64 = 1e-9;

    /// The projection with the pose of the row equals the keypoint shifted by the rolling shutter.
    #[test]
    fn the_pose_of_a_row_projects_to_the_shifted_keypoint() {
        let mut model = drive(0.0);
        let id = ImageId(MISPLACED as u32);
        let motion = Motion {
            velocity: Vector3::new(SPEED, 0.3, -0.2),
            angular_velocity: Vector3::new(0.1, -0.4, 0.05),
        };
        model.register(
            id,
            Rigid3::from_axis_angle(Vector3::new(0.2, -0.1, 0.3), Vector3::new(1.0, 2.0, 0.5)),
        );
        let (image, camera) = (model.image(id), *model.camera_of(id));
        let middle = *image.cam_from_world().unwrap();
        let rows = RowPoses {
            velocity_in_world: motion.velocity,
            angular_velocity_rad_s: motion.angular_velocity,
            readout_s: READOUT_S,
            height_px: f64::from(camera.height),
        };
        for y_px in [0.0, 100.0, 479.0] {
            let pixel = Vector2::new(200.0, y_px);
            let point_in_cam = camera.intrinsics.unproject(&pixel).unwrap() * 7.0;
            let keypoint = tiepoint_scene::Keypoint { pixel, scale_px: 1.0 };
            let mut one = Reconstruction::default();
            let camera = one.add_camera(camera);
            let id = one.add_image(tiepoint_scene::Image::new("a", camera, vec![keypoint; 2]));
            one.register(id, middle);
            let observations = (0..2)
                .map(|keypoint| tiepoint_scene::Observation { image: id, keypoint })
                .collect();
            let xyz = middle.inverse() * point_in_cam;
            one.add_track(tiepoint_scene::Track::new(xyz, observations));
            let shifted = shifts(&one, id, &[pixel], &motion, READOUT_S)[0].shift * READOUT_S;
            let seen = rows.cam_from_world(&middle, y_px) * xyz;
            let seen = one.camera(camera).intrinsics.project(&seen).unwrap();
            assert!(
                (seen - pixel - shifted).norm() < ROUNDING_PX,
                "{y_px}: {seen} {pixel} {shifted}"
            );
        }
    }

    #[test]
    fn images_near_a_misplaced_one_have_no_motion() {
        let of = |error: f64| {
            let motions = motions(&drive(error));
            motions
                .into_iter()
                .map(|(id, motion)| (id.index(), motion.velocity.x))
                .collect::<Vec<_>>()
        };
        assert_eq!(of(0.0).len(), IMAGES);
        let around: Vec<usize> = of(30.0).into_iter().map(|(index, _)| index).collect();
        assert_eq!(
            around,
            (0..IMAGES).filter(|index| !AFFECTED.contains(index)).collect::<Vec<_>>()
        );
    }
}
