//! A drive: the street, the vehicle, the cameras with their clocks, and their images, which are
//! rendered on demand.

use image::RgbImage;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{Camera, Image, Reconstruction};

use crate::clocks::{Clock, schedule};
use crate::error::{Error, require};
use crate::lens::{ActionLens, Lens};
use crate::photometry::{Development, develop, jpeg_round_trip};
use crate::render::{Renderer, RowPose, surface_at};
use crate::route::Route;
use crate::trajectory::{Carrier, Motion, Trajectory};
use crate::world::{StreetOptions, SurfacePoint, World};
use crate::{Effects, Mount};

/// Focal length of the ideal pinhole, in image widths.
const PINHOLE_FOCAL: f64 = 0.60;
/// Fixed-point iteration of the projection through a rolling shutter: the step of the row at which
/// it ends, in pixels, and the most iterations.
const ROW_TOLERANCE_PX: f64 = 1e-9;
const ROW_ITERATIONS: usize = 50;
/// Periods of the automatic exposure, in seconds.
const EXPOSURE_PERIODS_S: [f64; 2] = [9.7, 4.1];

/// The shape of the route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouteKind {
    /// A loop around a block, with an overlap at its end.
    Loop,
    /// An open route without a loop.
    Open,
    /// A straight highway with little beside it.
    Highway,
}

impl RouteKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Loop, Self::Open, Self::Highway];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loop => "loop",
            Self::Open => "open",
            Self::Highway => "highway",
        }
    }
}

/// Options of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOptions {
    /// The seed of the world, the route and all random numbers.
    pub seed: u64,
    /// The shape of the route.
    pub route: RouteKind,
    /// Length of the street, in metres.
    pub length_m: f64,
    /// Motion of the cameras; suspension and vibration are taken from the effects.
    pub motion: Motion,
    /// Objects along a street; moving cars are taken from the effects.
    pub street: StreetOptions,
    /// The cameras. A hand or a drone holds the middle of their positions.
    pub mounts: Vec<Mount>,
    /// Size of the images, in pixels.
    pub width: u32,
    /// Size of the images, in pixels.
    pub height: u32,
    /// Frame rate, in images per second.
    pub rate_hz: f64,
    /// Effects that make the cameras and the motion realistic.
    pub effects: Effects,
}

impl Default for DriveOptions {
    /// A loop of 200 m with a forward-looking stereo pair, ten images per second, without effects.
    fn default() -> Self {
        Self {
            seed: 1,
            route: RouteKind::Loop,
            length_m: 200.0,
            motion: Motion::default(),
            street: StreetOptions::default(),
            mounts: Mount::stereo(crate::ViewDirection::Front, 0.5).to_vec(),
            width: 640,
            height: 480,
            rate_hz: 10.0,
            effects: Effects::default(),
        }
    }
}

/// An image of a camera, not yet rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposure {
    /// Path of the image relative to the input: `camera/000000.png`.
    pub name: String,
    /// True time of the exposure of the middle row, in seconds since the beginning of the drive.
    pub time_s: f64,
    /// Time stamp, in seconds on the clock of the camera.
    pub stamp_s: f64,
    development: Development,
}

/// Period of the swing of a flexible mount, in seconds: slow, as of rubber under braking and
/// turning.
const FLEX_PERIOD_S: f64 = 5.0;

/// A camera of the drive with its ground truth.
#[derive(Clone, Debug)]
pub struct DriveCamera {
    /// Name of the camera and of the folder of its images.
    pub name: String,
    /// Its lens.
    pub lens: Lens,
    /// Size of its images, in pixels.
    pub width: u32,
    /// Size of its images, in pixels.
    pub height: u32,
    /// Mean pose in the vehicle frame, in metres.
    pub cam_from_vehicle: Rigid3,
    /// Amplitude of the swing as an axis-angle vector, and its phase, in radians.
    flex: (Vector3<f64>, f64),
    /// Its clock.
    pub clock: Clock,
    /// Readout time from the first row to the last, in seconds.
    pub readout_s: f64,
    /// Its images in the order of time.
    pub exposures: Vec<Exposure>,
}

impl DriveCamera {
    fn cam_from_vehicle_at(&self, time_s: f64) -> Rigid3 {
        let (swing, phase) = self.flex;
        if swing == Vector3::zeros() {
            return self.cam_from_vehicle;
        }
        let angle = (std::f64::consts::TAU * time_s / FLEX_PERIOD_S + phase).sin();
        Rigid3::from_axis_angle(swing * angle, Vector3::zeros()) * self.cam_from_vehicle
    }
}

/// A random swing of amplitude `rad` about a random axis: axis-angle and phase.
fn flex(rad: f64, rng: &mut Rng) -> (Vector3<f64>, f64) {
    let height = 2.0 * rng.uniform() - 1.0;
    let [azimuth, phase] = std::array::from_fn(|_| std::f64::consts::TAU * rng.uniform());
    let level = (1.0 - height * height).sqrt();
    (rad * Vector3::new(level * azimuth.cos(), level * azimuth.sin(), height), phase)
}

/// A drive with its ground truth. Images are rendered on demand.
#[derive(Clone, Debug)]
pub struct Drive {
    route: Route,
    trajectory: Trajectory,
    world: World,
    cameras: Vec<DriveCamera>,
    jpeg_quality: Option<u8>,
}

impl Drive {
    /// Generates the street, simulates the vehicle and schedules the exposures.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if an option is out of its range.
    pub fn new(options: &DriveOptions) -> Result<Self, Error> {
        options.effects.validate()?;
        require(!options.mounts.is_empty(), "number of cameras", 0.0, "at least one")?;
        require(
            (0.01..=1000.0).contains(&options.rate_hz),
            "rate_hz",
            options.rate_hz,
            "0.01 to 1000",
        )?;
        for (name, size) in [("width", options.width), ("height", options.height)] {
            require((2..=20_000).contains(&size), name, f64::from(size), "2 to 20000 pixels")?;
        }
        let (seed, effects) = (options.seed, &options.effects);
        let mut rng = Rng::stream(seed, &[10]);
        let route = match options.route {
            RouteKind::Loop => Route::street_loop(options.length_m, &mut rng)?,
            RouteKind::Open => Route::open_street(options.length_m, &mut rng)?,
            RouteKind::Highway => Route::highway(options.length_m)?,
        };
        let street = StreetOptions { moving_cars: effects.moving_cars, ..options.street.clone() };
        let world = match options.route {
            RouteKind::Highway => World::highway(&route, street.moving_cars, seed),
            RouteKind::Loop | RouteKind::Open => World::street(&route, &street, seed)?,
        };
        let motion = Motion {
            suspension: effects.suspension,
            vibration_rad: effects.vibration_rad,
            ..options.motion.clone()
        };
        // Independent random streams: an effect does not change the random numbers of the others.
        let trajectory = Trajectory::drive(&route, &motion, &mut Rng::stream(seed, &[11]))?;
        let mounts = match motion.carrier {
            Carrier::Car => options.mounts.clone(),
            Carrier::Handheld | Carrier::Drone => Mount::centred(&options.mounts),
        };
        let cameras = mounts.iter().enumerate();
        let cameras =
            cameras.map(|(index, mount)| camera(options, index, mount, &trajectory)).collect();
        Ok(Self {
            route,
            trajectory,
            world,
            cameras,
            jpeg_quality: effects.photometry.jpeg_quality,
        })
    }

    /// Removes the images of every camera after the first `frames`.
    pub fn keep_first(&mut self, frames: usize) {
        for camera in &mut self.cameras {
            camera.exposures.truncate(frames);
        }
    }

    /// The centre line of the street.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// The trajectory of the vehicle.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// The street.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The cameras, in the order of the mounts.
    pub fn cameras(&self) -> &[DriveCamera] {
        &self.cameras
    }

    /// The camera and the exposure of an image by its name; `None` if the drive has no such image.
    pub fn find(&self, image: &str) -> Option<(usize, &Exposure)> {
        self.cameras.iter().enumerate().find_map(|(camera, DriveCamera { exposures, .. })| {
            // Numbers are zero-padded, so that names are sorted.
            let index =
                exposures.binary_search_by(|exposure| exposure.name.as_str().cmp(image)).ok()?;
            Some((camera, &exposures[index]))
        })
    }

    /// Ground truth of the rig: cam_from_rig of a camera. The first camera is the reference sensor.
    pub fn cam_from_rig(&self, camera: usize) -> Rigid3 {
        if camera == 0 {
            return Rigid3::identity();
        }
        self.cameras[camera].cam_from_vehicle * self.cameras[0].cam_from_vehicle.inverse()
    }

    /// cam_from_world of a camera at a true time.
    pub fn cam_from_world(&self, camera: usize, time_s: f64) -> Rigid3 {
        let camera = &self.cameras[camera];
        camera.cam_from_vehicle_at(time_s) * self.trajectory.world_from_vehicle(time_s).inverse()
    }

    /// Pose of a camera at the exposure of the height `y` (in pixels) of an image, whose middle row
    /// is exposed at `time_s`.
    pub fn row_pose(&self, camera: usize, time_s: f64, y: f64) -> RowPose {
        let camera = &self.cameras[camera];
        let time_s = time_s + (y / f64::from(camera.height) - 0.5) * camera.readout_s;
        let world_from_cam = self.trajectory.world_from_vehicle(time_s)
            * camera.cam_from_vehicle_at(time_s).inverse();
        RowPose { world_from_cam, time_s }
    }

    /// Projects a static point of the world, through rolling shutter and lens; `None` if the lens
    /// does not image it. The pixel may lie outside of the image, and occlusion is not tested.
    pub fn project(
        &self,
        camera: usize,
        time_s: f64,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let DriveCamera { lens, height, readout_s, .. } = &self.cameras[camera];
        let project_from_row = |y: f64| {
            let cam_from_world = self.row_pose(camera, time_s, y).world_from_cam.inverse();
            lens.project(&(cam_from_world * *point_in_world))
        };
        let mut pixel = project_from_row(0.5 * f64::from(*height))?;
        if *readout_s == 0.0 {
            return Some(pixel);
        }
        // The row of the projection depends on the projection. The fixed-point iteration is a
        // contraction, because images move by much less than their height during the readout.
        for _ in 0..ROW_ITERATIONS {
            let next = project_from_row(pixel.y)?;
            let moved = (next.y - pixel.y).abs();
            pixel = next;
            if moved < ROW_TOLERANCE_PX {
                return Some(pixel);
            }
        }
        None
    }

    /// The surface point of a pixel; `None` for the sky.
    pub fn surface_at(
        &self,
        camera: usize,
        time_s: f64,
        pixel: &Vector2<f64>,
    ) -> Option<SurfacePoint> {
        let pose = self.row_pose(camera, time_s, pixel.y);
        surface_at(&self.world, &self.cameras[camera].lens, &pose, pixel)
    }

    /// The renderer of a camera. Keep it for several images: it computes the ray of each pixel
    /// once.
    pub fn renderer(&self, camera: usize) -> Renderer<'_> {
        let DriveCamera { lens, width, height, .. } = &self.cameras[camera];
        Renderer::new(&self.world, lens, *width, *height)
    }

    /// Renders an image with exposure, noise and compression.
    pub fn render(&self, camera: usize, exposure: &Exposure, renderer: &Renderer) -> RgbImage {
        let raw = self.render_raw(camera, exposure, renderer);
        match self.jpeg_quality {
            Some(quality) => jpeg_round_trip(&raw, quality).unwrap_or(raw),
            None => raw,
        }
    }

    /// Renders an image with exposure and noise, before compression.
    pub(crate) fn render_raw(
        &self,
        camera: usize,
        exposure: &Exposure,
        renderer: &Renderer,
    ) -> RgbImage {
        let light = renderer.render(|y| self.row_pose(camera, exposure.time_s, y));
        develop(&light, &exposure.development)
    }

    pub(crate) fn jpeg_quality(&self) -> Option<u8> {
        self.jpeg_quality
    }

    /// The ground truth as a reconstruction: poses of all images at their middle rows and time
    /// stamps, without points. The intrinsics are the pinhole that equals the lens at its axis:
    /// exact for the ideal lens; no camera model of COLMAP equals the action lens or a lens field.
    /// Images are ordered by camera, then by time.
    pub fn truth(&self) -> Reconstruction {
        let mut truth = Reconstruction::default();
        for (index, camera) in self.cameras.iter().enumerate() {
            let id = truth.add_camera(Camera {
                intrinsics: camera.lens.paraxial_intrinsics(),
                width: camera.width,
                height: camera.height,
                has_focal_prior: true,
            });
            for exposure in &camera.exposures {
                let image = truth.add_image(Image::new(exposure.name.clone(), id, Vec::new()));
                truth.set_time(image, Some(exposure.stamp_s));
                truth.register(image, self.cam_from_world(index, exposure.time_s));
            }
        }
        truth
    }
}

fn camera(
    options: &DriveOptions,
    index: usize,
    mount: &Mount,
    trajectory: &Trajectory,
) -> DriveCamera {
    let (seed, effects) = (options.seed, &options.effects);
    let stream = |purpose: u64| Rng::stream(seed, &[12, index as u64, purpose]);
    let lens = if effects.has_action_lens {
        Lens::Action(ActionLens::sample(options.width, options.height, &mut stream(0)))
    } else {
        Lens::pinhole(PINHOLE_FOCAL * f64::from(options.width), options.width, options.height)
    };
    let lens = if effects.lens_field_px > 0.0 {
        lens.with_field(effects.lens_field_px, options.width, options.height, &mut stream(6))
    } else {
        lens
    };
    let mount =
        if effects.is_misaligned { mount.misaligned(&mut stream(1)) } else { mount.clone() };
    let timing = schedule(
        &effects.clocks,
        index == 0,
        options.rate_hz,
        trajectory.duration_s(),
        &mut stream(2),
    );
    let phases: [f64; 2] = {
        let mut rng = stream(3);
        std::array::from_fn(|_| std::f64::consts::TAU * rng.uniform())
    };
    let extension = if effects.photometry.jpeg_quality.is_some() { "jpg" } else { "png" };
    let exposure = |(k, &(time_s, stamp_s)): (usize, &(f64, f64))| {
        let waves = EXPOSURE_PERIODS_S.iter().zip(phases);
        let wave: f64 = waves
            .map(|(period, phase)| 0.5 * (std::f64::consts::TAU * time_s / period + phase).sin())
            .sum();
        Exposure {
            name: format!("{}/{k:06}.{extension}", mount.name),
            time_s,
            stamp_s,
            development: Development {
                gain: (effects.photometry.exposure_stops * wave).exp2(),
                noise: effects.photometry.noise,
                seed: stream(4).next_u64() ^ (k as u64) << 20,
            },
        }
    };
    DriveCamera {
        name: mount.name.clone(),
        lens,
        width: options.width,
        height: options.height,
        cam_from_vehicle: mount.cam_from_vehicle,
        flex: if index == 0 { Default::default() } else { flex(effects.flex_rad, &mut stream(5)) },
        clock: timing.clock,
        readout_s: effects.readout_s,
        exposures: timing.times_s.iter().enumerate().map(exposure).collect(),
    }
}
