//! Rolling shutter: rows are read one after the other, while the camera moves.
//!
//! A row at y of a frame of height h is exposed (y/h − ½) · readout after the middle one, whose pose is the image's. In that time the
//! camera's centre goes on with the velocity, and its rotation with the angular velocity, that the cubic through its neighbouring images
//! has there. So a point X is seen at π(exp(s ω) R (X − c − s ċ)) instead of at π(R (X − c)), and what lies between the two is
//! taken off the keypoint: afterwards the model is one of cameras that see all rows at once, and nothing else needs to know. The shift hardly
//! changes with the pose (a hundredth of what the point's depth does), so that it is computed between adjustments and not in them.
//!
//! Where the readouts are to be found, they are variables of an adjustment in which each keypoint is shifted in proportion; the shifts of a
//! second of readout are computed anew between its steps.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::so3;
use tiepoint_rig::Trajectory;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::Error;
use crate::adjust::{AdjustOptions, Shifted, Shutters, adjust_readouts, with_deviations};
use crate::continuity::usual;
use crate::rig_pairs::posed_in_time;

/// Time from the first row of an image to the last one, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Readout {
    /// As given, for every camera.
    Known(f64),
    /// Found, for each camera on its own.
    Estimated,
}

/// What the shutter of a camera does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollingShutter {
    /// Which camera.
    pub camera: CameraId,
    /// Time from the first row to the last one, in seconds; negative where the last row comes first.
    pub readout_s: f64,
    /// Its standard deviation, where it was found; infinite where the images tell nothing.
    pub readout_sd_s: Option<f64>,
}

/// The readouts are found when a step moves them by less than this, in seconds, or after so many steps.
const MIN_STEP_S: f64 = 5e-5;
const MAX_STEPS: usize = 6;
/// A camera is no more than so many times as fast as it usually is.
const MAX_SPEED: f64 = 3.0;
/// Velocities are differences over this time, in seconds.
const DIFFERENCE_S: f64 = 1e-3;

/// The keypoints as they were detected.
struct Detected(BTreeMap<ImageId, Vec<Vector2<f64>>>);

/// The shutters of a model's cameras, and what they did to its keypoints.
pub(crate) struct RollingShutters {
    readout: Readout,
    detected: Detected,
    shutters: Vec<RollingShutter>,
}

impl RollingShutters {
    /// Of a model whose keypoints are as they were detected.
    pub(crate) fn new(model: &Reconstruction, readout: Readout) -> Self {
        let pixels = |(id, image): (ImageId, &tiepoint_scene::Image)| {
            (id, image.keypoints.iter().map(|keypoint| keypoint.pixel).collect())
        };
        let readout_s = match readout {
            Readout::Known(readout_s) => readout_s,
            Readout::Estimated => 0.0,
        };
        let shutter = |camera| RollingShutter { camera, readout_s, readout_sd_s: None };
        Self {
            readout,
            detected: Detected(model.images().map(pixels).collect()),
            shutters: model.cameras().map(|(camera, _)| shutter(camera)).collect(),
        }
    }

    /// What is known of each shutter.
    pub(crate) fn get(&self) -> &[RollingShutter] {
        &self.shutters
    }

    /// Back to what was known before.
    pub(crate) fn set(&mut self, shutters: Vec<RollingShutter>) {
        self.shutters = shutters;
    }

    /// Finds the readouts where they are not given, from those that were found before, and takes off the keypoints what they did. The model is
    /// left adjusted for them.
    pub(crate) fn find(&mut self, model: &mut Reconstruction, options: &AdjustOptions) -> Result<(), Error> {
        if self.readout != Readout::Estimated {
            self.take_off(model);
            return Ok(());
        }
        for _ in 0..MAX_STEPS {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            let shutters = Shutters { shutters: &self.shutters, keypoints: &keypoints };
            let found = adjust_readouts(model, options, &shutters)?;
            let has_moved =
                |(a, b): (&RollingShutter, &RollingShutter)| (a.readout_s - b.readout_s).abs() > MIN_STEP_S;
            let is_over = !self.shutters.iter().zip(&found).any(has_moved);
            self.shutters = found;
            // In each step, for points that take no part in the next one are put where the keypoints say.
            self.take_off(model);
            if is_over {
                break;
            }
        }
        Ok(())
    }

    /// Says how well the readouts that were found are known.
    pub(crate) fn find_deviations(
        &mut self,
        model: &Reconstruction,
        options: &AdjustOptions,
    ) -> Result<(), Error> {
        if self.readout == Readout::Estimated {
            let keypoints = shifted(model, &self.detected, &self.shutters);
            let shutters = Shutters { shutters: &self.shutters, keypoints: &keypoints };
            self.shutters = with_deviations(model, options, &shutters)?;
        }
        Ok(())
    }

    /// Puts the keypoints where a global shutter would have them, as the cameras move in the model.
    pub(crate) fn take_off(&self, model: &mut Reconstruction) {
        for (id, keypoints) in shifted(model, &self.detected, &self.shutters) {
            let readout_s = readout_s(&self.shutters, model.image(id).camera);
            let pixels: Vec<Vector2<f64>> =
                keypoints.iter().map(|keypoint| keypoint.pixel - keypoint.shift * readout_s).collect();
            model.move_keypoints(id, &pixels);
        }
    }
}

/// How a camera moves while it takes an image.
struct Motion {
    /// In the world, units a second.
    velocity: Vector3<f64>,
    /// In the camera's frame, radians a second.
    angular_velocity: Vector3<f64>,
}

/// Of the images of which times and neighbours are known, and that do not stand where their camera cannot have been: next to one that was
/// registered at the wrong place cameras fly, and a few such images outweigh thousands in what the readout is.
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
            let angular_velocity = so3::log(&(after.rotation * before.rotation.inverse())) / DIFFERENCE_S;
            of_camera.push((id, Motion { velocity, angular_velocity }));
        }
        let speed = |(_, motion): &(ImageId, Motion)| motion.velocity.norm();
        let usual = usual(of_camera.iter().map(speed).collect()).unwrap_or(0.0);
        motions.extend(of_camera.into_iter().filter(|motion| speed(motion) <= MAX_SPEED * usual));
    }
    motions
}

/// How far the shutters shift all keypoints, about the readouts of now.
fn shifted(
    model: &Reconstruction,
    detected: &Detected,
    shutters: &[RollingShutter],
) -> BTreeMap<ImageId, Vec<Shifted>> {
    let of_image = |(id, motion): &(ImageId, Motion)| {
        let readout_s = readout_s(shutters, model.image(*id).camera);
        // A shift is a difference, and needs some time to be one.
        let readout_s = if readout_s.abs() < DIFFERENCE_S { DIFFERENCE_S } else { readout_s };
        (*id, shifts(model, *id, &detected.0[id], motion, readout_s))
    };
    motions(model).par_iter().map(of_image).collect::<Vec<_>>().into_iter().collect()
}

fn readout_s(shutters: &[RollingShutter], camera: CameraId) -> f64 {
    shutters.iter().find(|shutter| shutter.camera == camera).map_or(0.0, |shutter| shutter.readout_s)
}

/// The same of an image. What sees no point is taken to be as far away as the median of what does.
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
    let mut distances: Vec<f64> = (0..pixels.len()).filter_map(|k| Some(in_camera(k)?.norm())).collect();
    let distance = median(&mut distances);
    let shift = |k: usize, pixel: &Vector2<f64>| {
        let point = match in_camera(k) {
            Some(point) => point,
            None => camera.intrinsics.unproject(pixel)? * distance?,
        };
        let time_s = (pixel.y / f64::from(camera.height) - 0.5) * readout_s;
        let velocity = pose?.rotation * motion.velocity;
        let moved = so3::exp(&(motion.angular_velocity * time_s)) * (point - velocity * time_s);
        Some((camera.intrinsics.project(&moved)? - camera.intrinsics.project(&point)?) / readout_s)
    };
    let shifted = |(k, pixel): (usize, &Vector2<f64>)| Shifted {
        pixel: *pixel,
        shift: shift(k, pixel).unwrap_or_default(),
    };
    pixels.iter().enumerate().map(shifted).collect()
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
    /// The cubics through it give these images a speed.
    const BESIDE: std::ops::RangeInclusive<usize> = MISPLACED - 2..=MISPLACED + 1;

    /// A camera at constant speed, one of whose images stands far off.
    fn drive(off_by: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
        let camera = model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        for i in 0..IMAGES {
            let id = model.add_image(Image::new(format!("{i}.png"), camera, Vec::new()));
            let time_s = i as f64 / RATE_HZ;
            let along = SPEED * time_s + if i == MISPLACED { off_by } else { 0.0 };
            model.set_time(id, Some(time_s));
            model.register(id, Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-along, 0.0, 0.0)));
        }
        model
    }

    #[test]
    fn beside_an_image_at_the_wrong_place_no_motion_is_known() {
        let of = |off_by: f64| {
            let motions = motions(&drive(off_by));
            motions.into_iter().map(|(id, motion)| (id.index(), motion.velocity.x)).collect::<Vec<_>>()
        };
        assert_eq!(of(0.0).len(), IMAGES);
        let around: Vec<usize> = of(30.0).into_iter().map(|(index, _)| index).collect();
        assert_eq!(around, (0..IMAGES).filter(|index| !BESIDE.contains(index)).collect::<Vec<_>>());
    }
}
