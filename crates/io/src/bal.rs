//! The text files of Bundle Adjustment in the Large (Agarwal et al. 2010), a benchmark of solvers.
//!
//! A point X projects to f · (1 + k1 |p|² + k2 |p|⁴) · p, with P = R X + t and p = −(P.x, P.y) /
//! P.z: the camera looks along −z, y is up, and (0, 0) is the centre of the image. A rotation of
//! the camera and the image axes by π about x gives our convention and the model RADIAL of COLMAP
//! with a fixed principal point, without loss.

use std::io::Write;
use std::path::Path;

use tiepoint_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, so3};
use tiepoint_scene::{
    Camera, CameraId, Image, ImageId, Keypoint, Observation, Reconstruction, Track,
};

use crate::atomic::write_atomic;
use crate::text::excerpt::Excerpt;
use crate::text::{Lines, Numbers};
use crate::{Error, Result};

/// A camera in the convention of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BalCamera {
    /// Rotation from the world to the camera, as an axis-angle vector.
    pub axis_angle_rad: Vector3<f64>,
    /// Translation from the world to the camera.
    pub translation: Vector3<f64>,
    /// Focal length f, in pixels.
    pub focal_px: f64,
    /// First coefficient of radial distortion.
    pub k1: f64,
    /// Second coefficient of radial distortion.
    pub k2: f64,
}

/// An observation of a point by a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BalObservation {
    /// Index of the camera.
    pub camera: u32,
    /// Index of the point.
    pub point: u32,
    /// The image point relative to the centre of the image; x right, y up.
    pub pixel: Vector2<f64>,
}

/// A bundle adjustment problem.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bal {
    /// The cameras.
    pub cameras: Vec<BalCamera>,
    /// The points.
    pub points: Vec<Vector3<f64>>,
    /// The observations.
    pub observations: Vec<BalObservation>,
}

/// Largest entry of an axis-angle vector that is read: a larger angle has too few digits left for
/// its remainder modulo 2π.
const MAX_ANGLE_RAD: f64 = 1e6;

/// Rotation by π about x: its own inverse, exact in floating point.
fn rotation_by_pi_about_x() -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0))
}

impl BalCamera {
    /// Projects a point of the world; `None` in the plane z = 0 of the camera. A point behind the
    /// camera has a projection, too.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let p = so3::exp(&self.axis_angle_rad) * point + self.translation;
        let p = Vector2::new(-p.x / p.z, -p.y / p.z);
        let r2 = p.norm_squared();
        let pixel = p * (self.focal_px * (1.0 + r2 * (self.k1 + r2 * self.k2)));
        pixel.iter().all(|value| value.is_finite()).then_some(pixel)
    }
}

impl Bal {
    /// Reads a problem.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, if a number is missing, additional or out of range, and if an
    /// observation refers to a camera or point that does not exist.
    pub fn read(path: &Path) -> Result<Self> {
        let mut lines = Lines::open(path)?;
        let mut counts = lines.expect("the numbers of cameras, points and observations")?;
        let (cameras, points) =
            (counts.number("the number of cameras")?, counts.number("the number of points")?);
        let num_observations: u64 = counts.number("the number of observations")?;
        counts.end()?;
        let (num_cameras, num_points): (u32, u32) = (cameras, points);
        let mut observations = Vec::new();
        for _ in 0..num_observations {
            let mut words = lines.expect("an observation")?;
            let (camera, point) =
                (words.number("a camera's index")?, words.number("a point's index")?);
            if camera >= num_cameras || point >= num_points {
                return Err(words.error(format!(
                    "camera {camera} sees point {point}, but there are {num_cameras} cameras and \
                    {num_points} points"
                )));
            }
            let pixel = Vector2::from(words.f64s::<2>("a pixel")?);
            words.end()?;
            observations.push(BalObservation { camera, point, pixel });
        }
        // Files have one number in a line; any white space is accepted.
        let mut pending: std::collections::VecDeque<f64> = Default::default();
        let mut next = |what: &str| -> Result<f64> {
            while pending.is_empty() {
                let mut words = lines.expect(what)?;
                while !words.is_empty() {
                    pending.push_back(words.f64(what)?);
                }
            }
            Ok(pending.pop_front().unwrap_or_default())
        };
        let mut vector = |what: &str| -> Result<Vector3<f64>> {
            Ok(Vector3::new(next(what)?, next(what)?, next(what)?))
        };
        let mut cameras = Vec::new();
        for _ in 0..num_cameras {
            let axis_angle_rad = vector("a camera's rotation")?;
            if axis_angle_rad.amax() > MAX_ANGLE_RAD {
                let what = format!("the rotation of camera {} is out of range", cameras.len());
                return Err(Error::content(path, what));
            }
            let translation = vector("a camera's translation")?;
            let intrinsics = vector("a camera's focal length and distortion")?;
            let [focal_px, k1, k2] = intrinsics.into();
            cameras.push(BalCamera { axis_angle_rad, translation, focal_px, k1, k2 });
        }
        let mut points = Vec::new();
        for _ in 0..num_points {
            points.push(vector("a point")?);
        }
        let left_over = match pending.front() {
            Some(number) => Some(number.to_string()),
            None => lines.next()?.map(|mut words| words.rest().to_owned()),
        };
        if let Some(text) = left_over {
            return Err(lines
                .error(format!("`{}` follows the last of {num_points} points", Excerpt(&text))));
        }
        Ok(Self { cameras, points, observations })
    }

    /// Writes a problem; numbers have as many digits as identify them.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomic(path, |file| {
            writeln!(
                file,
                "{} {} {}",
                self.cameras.len(),
                self.points.len(),
                self.observations.len()
            )?;
            for BalObservation { camera, point, pixel } in &self.observations {
                writeln!(file, "{camera} {point} {}", Numbers(pixel.as_slice()))?;
            }
            for camera in &self.cameras {
                let BalCamera { axis_angle_rad: r, translation: t, focal_px, k1, k2 } = camera;
                for value in [r.x, r.y, r.z, t.x, t.y, t.z, *focal_px, *k1, *k2] {
                    writeln!(file, "{}", Numbers(&[value]))?;
                }
            }
            self.points
                .iter()
                .flat_map(Vector3::iter)
                .try_for_each(|value| writeln!(file, "{}", Numbers(&[*value])))
        })
    }

    /// Converts to a reconstruction. Each camera becomes an image, named by its index, with a
    /// RADIAL camera of its own; points keep their order. The size of an image is the smallest,
    /// symmetric about its centre, that contains the observations.
    ///
    /// # Errors
    ///
    /// [`BalError`] if an observation refers to a camera or point that does not exist, and if a
    /// camera has invalid parameters.
    pub fn to_reconstruction(&self) -> Result<Reconstruction, BalError> {
        let mut keypoints: Vec<Vec<Vector2<f64>>> = vec![Vec::new(); self.cameras.len()];
        let mut tracks: Vec<Vec<Observation>> = vec![Vec::new(); self.points.len()];
        for &BalObservation { camera, point, pixel } in &self.observations {
            let list =
                keypoints.get_mut(camera as usize).ok_or(BalError::NoSuchCamera { camera })?;
            let observation = Observation { image: ImageId(camera), keypoint: list.len() as u32 };
            list.push(Vector2::new(pixel.x, -pixel.y));
            tracks
                .get_mut(point as usize)
                .ok_or(BalError::NoSuchPoint { point })?
                .push(observation);
        }
        let mut model = Reconstruction::default();
        for (index, (camera, keypoints)) in self.cameras.iter().zip(keypoints).enumerate() {
            let half_size =
                |axis: usize| keypoints.iter().map(|p| p[axis].abs().ceil()).fold(1.0, f64::max);
            let centre = Vector2::new(half_size(0), half_size(1));
            let params = [camera.focal_px, centre.x, centre.y, camera.k1, camera.k2];
            let intrinsics = Intrinsics::new(CameraModelKind::Radial, &params)
                .map_err(|cause| BalError::BadCamera { camera: index, cause })?;
            let [width, height] = [2.0 * centre.x, 2.0 * centre.y].map(|side| side as u32);
            let id = model.add_camera(Camera { intrinsics, width, height, has_focal_prior: true });
            let keypoints =
                keypoints.iter().map(|p| Keypoint { pixel: p + centre, scale_px: 1.0 }).collect();
            let image = model.add_image(Image::new(format!("{index:06}"), id, keypoints));
            let rotation = rotation_by_pi_about_x() * so3::exp(&camera.axis_angle_rad);
            model.register(
                image,
                Rigid3::new(rotation, rotation_by_pi_about_x() * camera.translation),
            );
        }
        for (xyz, observations) in self.points.iter().zip(tracks) {
            model.add_track(Track::new(*xyz, observations));
        }
        Ok(model)
    }

    /// Converts the registered images and the points of a reconstruction, in their order. The
    /// cameras must have one focal length and at most two coefficients of radial distortion; the
    /// principal point becomes the centre of the image.
    ///
    /// # Errors
    ///
    /// [`BalError::NotRadial`] for other camera models.
    pub fn from_reconstruction(model: &Reconstruction) -> Result<Self, BalError> {
        let mut bal = Self::default();
        let mut index_of = vec![None; model.images().count()];
        for (id, image, pose) in model.registered() {
            index_of[id.index()] = Some(bal.cameras.len() as u32);
            let (focal_px, k1, k2) = radial(model.camera(image.camera), image.camera)?;
            let pose = Rigid3::new(
                rotation_by_pi_about_x() * pose.rotation,
                rotation_by_pi_about_x() * pose.translation,
            );
            bal.cameras.push(BalCamera {
                axis_angle_rad: so3::log(&pose.rotation),
                translation: pose.translation,
                focal_px,
                k1,
                k2,
            });
        }
        for (_, track) in model.tracks() {
            let point = bal.points.len() as u32;
            bal.points.push(track.xyz);
            for observation in &track.observations {
                let Some(camera) = index_of[observation.image.index()] else { continue };
                let centre = model.camera_of(observation.image).intrinsics.principal_point();
                let pixel = model.image(observation.image).keypoints[observation.keypoint as usize]
                    .pixel
                    - centre;
                let pixel = Vector2::new(pixel.x, -pixel.y);
                bal.observations.push(BalObservation { camera, point, pixel });
            }
        }
        Ok(bal)
    }
}

/// f, k1, k2 of a camera without other parameters than the principal point.
fn radial(camera: &Camera, id: CameraId) -> Result<(f64, f64, f64), BalError> {
    let params = camera.intrinsics.params();
    match (camera.intrinsics.kind(), params) {
        (CameraModelKind::SimplePinhole, [f, _, _]) => Ok((*f, 0.0, 0.0)),
        (CameraModelKind::Pinhole, [fx, fy, _, _]) if fx == fy => Ok((*fx, 0.0, 0.0)),
        (CameraModelKind::SimpleRadial, [f, _, _, k]) => Ok((*f, *k, 0.0)),
        (CameraModelKind::Radial, [f, _, _, k1, k2]) => Ok((*f, *k1, *k2)),
        (kind, _) => Err(BalError::NotRadial { camera: id, model: kind.name() }),
    }
}

/// Why a problem and a reconstruction cannot be converted into each other.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BalError {
    /// An observation refers to a camera that does not exist.
    #[error("an observation names camera {camera}, which does not exist")]
    NoSuchCamera {
        /// The index.
        camera: u32,
    },
    /// An observation refers to a point that does not exist.
    #[error("an observation names point {point}, which does not exist")]
    NoSuchPoint {
        /// The index.
        point: u32,
    },
    /// A camera's focal length or distortion is out of range.
    #[error("camera {camera}: {cause}")]
    BadCamera {
        /// The index.
        camera: usize,
        /// What is wrong.
        cause: tiepoint_geometry::Error,
    },
    /// A camera model that the format cannot express.
    #[error(
        "a BAL file knows one focal length and two radial distortions, but camera {camera} is a \
        {model}"
    )]
    NotRadial {
        /// The camera.
        camera: CameraId,
        /// Its model.
        model: &'static str,
    },
}

impl BalError {
    /// Converts to an error about a file.
    pub fn of(self, path: &Path) -> Error {
        Error::content(path, self.to_string())
    }
}
